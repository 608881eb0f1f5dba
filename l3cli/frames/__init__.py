"""Data types for raw frames, scenes and lab measurements, and functions that correct and check raw frames."""
