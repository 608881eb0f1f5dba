"""Recipes: parsing of TOML files into typed values, error reporting, JSON schemas, and the recipes supplied with l3."""
