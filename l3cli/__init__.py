"""Give a camera with any colour filter array its image pipeline: calibrate, simulate, train, render."""

__version__ = "0.1.0"
