"""The white point of a scene, methods for finding the white point, and the white balance that follows."""
