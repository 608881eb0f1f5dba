"""Spectra with units, read from the file formats of instruments."""
