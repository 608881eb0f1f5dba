"""Recipes: typed values from TOML files, their faults, their JSON schemas, and the recipes that come with l3."""
