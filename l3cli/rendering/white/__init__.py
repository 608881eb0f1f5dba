"""Scene white points, how to find them, and white balance."""
