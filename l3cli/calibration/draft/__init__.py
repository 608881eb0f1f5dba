"""A first measurement file of a folder of captures: what they are by name and content, and what they lack."""
