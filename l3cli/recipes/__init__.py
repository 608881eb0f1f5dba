"""Read TOML recipes as typed values, report their faults, derive JSON schemas, and find the recipes that come with l3."""
