"""White of the scene: where it comes from, and how frames are balanced for it."""
