"""Files, locks, signals, limits and text output. Nothing here depends on cameras or pictures."""
