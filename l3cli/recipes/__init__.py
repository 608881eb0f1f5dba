"""Recipes: TOML to typed values, what is wrong with it, its JSON schema, and those that come with l3."""
