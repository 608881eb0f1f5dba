"""Pictures as the bytes of a file, for what carries them inside itself."""

import numpy as np
from numpy.typing import NDArray

from l3cli.io.images import encoded


def jpeg(picture: NDArray[np.uint8], quality: int) -> bytes:
    """Encoded sRGB (row, col, 3) as a JPEG file of `quality` 1…100, colour at full resolution."""
    import OpenImageIO as oiio

    rows, cols, channels = picture.shape
    spec = oiio.ImageSpec(cols, rows, channels, "uint8")
    spec.attribute("oiio:ColorSpace", "sRGB")
    spec.attribute("Compression", f"jpeg:{quality}")
    spec.attribute("jpeg:subsampling", "4:4:4")
    return encoded("picture.jpg", spec, picture)
