"""Pictures of many channels, such as EXR, with one channel a band."""

import re
from pathlib import Path

import numpy as np

from l3cli.io.images import picture_size, read_image
from l3cli.scene import SpectralCube

size = picture_size


def read(path: Path) -> SpectralCube:
    """All channels as bands in increasing wavelength, which their names may give ("450nm", "S0.450,5nm")."""
    pixels, names = read_image(path)
    matches = [re.search(r"(\d+(?:[.,]\d+)?)\s*nm", name) for name in names]
    keep = [index for index, match in enumerate(matches) if match]
    if not keep:
        return SpectralCube(pixels, None)
    nanometres = np.array([float(match[1].replace(",", ".")) for match in matches if match])
    order = np.argsort(nanometres, kind="stable")
    return SpectralCube(pixels[..., np.array(keep)[order]], nanometres[order])
