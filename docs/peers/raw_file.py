"""Write a mosaic as a raw file for other raw converters, and read the demosaiced channels from their output.

The file states that the channels of the camera are linear sRGB and that a grey has equal signals. Every raw converter
therefore uses the correct white balance and matrix, reduces noise in known colours, and outputs the channels as linear sRGB.
"""

import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.camera import CameraModel, Noise, Optics
from l3cli.evaluation.quality import cropped
from l3cli.frames.frame import pad_mosaic
from l3cli.io.pictures.dng import LIGHT_CODES, write_dng
from l3cli.physics.display import SRGB_FROM_XYZ

Array = NDArray[np.floating]
BITS = 16
BLACK, TOP = 1024.0, 2.0**BITS - 1  # DN
WHITE_SHARE = 0.8  # fraction of full scale to which white is mapped, so that brighter values do not clip
LEAST = 256  # smallest side of a file in pixels, because RawTherapee rejects files of 180 pixels
PERIOD = 12  # margins are multiples of this number of pixels, which contains whole periods of 2×2, 4×4 and 6×6 arrays
MARGIN = 12  # smallest mirrored margin in pixels, because raw converters cut off borders or are less accurate there


def write_mosaic(path: Path, mosaic: Array, cfa: NDArray[np.uint8]) -> None:
    """Write a mosaic (row, col) of red, green and blue, in which a white is 1, to a new DNG file."""
    values = np.clip(np.rint(BLACK + WHITE_SHARE * (TOP - BLACK) * mosaic), 0, TOP).astype(np.uint16)
    matrix = SRGB_FROM_XYZ
    colour = dict.fromkeys(LIGHT_CODES, matrix)
    write_dng(path, values, _camera(cfa, values.shape), colour, np.ones(3), exposure=0.01)


def through_file(develop: Callable[[Path], Array], mosaic: Array, cfa: NDArray[np.uint8]) -> Array:
    """Demosaic a mosaic with a raw converter. Return the channels (channel, row, col).

    `develop` converts a DNG file to linear planes in which full scale is 1. The file is larger than the mosaic on all sides,
    and `develop` may cut the same number of pixels from each side.
    """
    with tempfile.TemporaryDirectory(prefix="l3-peers-") as folder:
        path = Path(folder, "mosaic.dng")
        lacking = -(-max(LEAST - min(mosaic.shape), 0) // 2)
        write_mosaic(path, pad_mosaic(mosaic, max(MARGIN, -(-lacking // PERIOD) * PERIOD), cfa.shape), cfa)
        planes = develop(path)
    more = (planes.shape[1] - mosaic.shape[0]) // 2
    if planes.shape[1:] != tuple(length + 2 * more for length in mosaic.shape) or more < 0:
        raise ValueError(f"developed to {planes.shape[1]}×{planes.shape[2]} of a mosaic of {mosaic.shape}")
    channels: Array = cropped(planes, more) / WHITE_SHARE
    return channels


def _camera(cfa: NDArray[np.uint8], shape: tuple[int, ...]) -> CameraModel:
    """Return a camera model for the tags of the file. Raw converters do not read the responsivities and the noise."""
    return CameraModel(
        name="peers",
        rows=shape[0],
        cols=shape[1],
        pixel_pitch=4e-6,
        bits=BITS,
        channels=("r", "g", "b"),
        cfa=cfa,
        wavelength=np.array([400.0, 700.0]),
        responsivity=np.ones((3, 2)),
        responsivity_band=np.zeros((3, 2)),
        absolute=True,
        gain=1.0,
        black_level=BLACK,
        white_level=TOP,
        fixed_pattern_seed=0,
        noise=Noise(read_noise=1.0, dark_current=0.0, dsnu=0.0, prnu=0.0, well_capacity=TOP),
        optics=Optics(focal_length=0.05, f_number=4.0, object_distance=0.0),
    )
