"""Data types for raw frames, scenes and lab measurements, with the corrections and checks of raw frames."""
