"""Recipes checked before anything runs: all that is wrong with them, and what they mean."""
