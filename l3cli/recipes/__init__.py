"""Recipes: TOML files read as typed values, their faults and JSON schemas, and the recipes that come with l3."""
