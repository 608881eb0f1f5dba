"""The white of a scene: where it comes from, and the white balance that follows from it."""
