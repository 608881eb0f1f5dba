"""Files, locks, signals, limits and text output. This package does not depend on cameras or pictures."""
