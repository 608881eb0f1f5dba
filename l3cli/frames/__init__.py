"""Raw frames, scenes and lab measurements as data, with the corrections and checks of raw frames."""
