"""White points of scenes, methods for finding the white point, and white balance."""
