"""Spectra, lenses, colour spaces and displays. The functions operate on arrays, and do not depend on cameras or files."""
