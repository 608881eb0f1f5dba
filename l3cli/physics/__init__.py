"""Spectra, lenses, colour spaces and displays. The functions use only arrays, and do not depend on cameras or files."""
