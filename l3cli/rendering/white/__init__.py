"""The white of a scene: its sources, and the white balance of frames."""
