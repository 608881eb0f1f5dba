"""Physics of light: spectra, lenses and displays. Functions take and return arrays and know nothing of cameras or files."""
