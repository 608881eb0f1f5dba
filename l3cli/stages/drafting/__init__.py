"""A folder of captures → the draft of a measurement file."""
