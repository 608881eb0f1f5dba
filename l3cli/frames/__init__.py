"""Data types for raw frames, scenes and lab measurements, and functions that check and correct raw frames."""
