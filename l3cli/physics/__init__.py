"""Physics of light, each formula once: spectra, lenses, displays. Arrays in, arrays out; no camera, no file."""
