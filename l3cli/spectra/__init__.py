"""Tables of values over wavelength, with their units, in the file formats of instruments."""
