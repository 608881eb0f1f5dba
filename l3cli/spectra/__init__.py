"""Read spectra and their units from the file formats of instruments."""
