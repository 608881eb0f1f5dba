"""Tables of values over wavelength, with units, in the file formats of instruments."""
