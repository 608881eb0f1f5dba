"""Draft a measurement file for a folder of captures: classify files by name and content, and mark what is missing."""
