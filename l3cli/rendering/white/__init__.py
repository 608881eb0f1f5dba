"""White of the scene: where it is taken from, and how frames are balanced for it."""
