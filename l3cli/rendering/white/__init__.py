"""Find the white point of a scene, and apply white balance."""
