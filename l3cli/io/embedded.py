"""Pictures as the bytes of a file, for what carries them inside itself."""

import tempfile
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from l3cli.errors import L3Error


def jpeg(picture: NDArray[np.uint8], quality: int) -> bytes:
    """Encoded sRGB (row, col, 3) as a JPEG file of `quality` 1…100, colour at full resolution."""
    import OpenImageIO as oiio

    rows, cols, channels = picture.shape
    spec = oiio.ImageSpec(cols, rows, channels, "uint8")
    spec.attribute("oiio:ColorSpace", "sRGB")
    spec.attribute("Compression", f"jpeg:{quality}")
    spec.attribute("jpeg:subsampling", "4:4:4")
    spec.attribute("DateTime", "")  # else the clock is written into the file: the same input must give the same bytes
    with tempfile.TemporaryDirectory() as folder:  # OpenImageIO writes to named files only
        path = Path(folder, "picture.jpg")
        sink = oiio.ImageOutput.create(str(path))
        if sink is None or not (sink.open(str(path), spec) and sink.write_image(np.ascontiguousarray(picture))):
            raise L3Error(f"a picture cannot be encoded as JPEG: {oiio.geterror().strip()}")
        sink.close()
        return path.read_bytes()
