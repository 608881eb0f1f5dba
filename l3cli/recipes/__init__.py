"""Read TOML recipes as typed values, report their faults, derive JSON schemas, and find built-in recipes."""
