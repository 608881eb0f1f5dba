"""Training of refinement layers on mosaics that the previous layers rendered with and without noise."""
