"""Learning of layers after the first: from mosaics, which the layers before have rendered with and without noise."""
