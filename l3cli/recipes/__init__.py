"""Recipes: TOML files as typed values, with error reports and JSON schemas, and the recipes that come with l3."""
