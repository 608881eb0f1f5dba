"""Tables of numbers over wavelength with their units, as instruments write them."""
