"""A mosaic as a raw file for other developers, who give its channels back as they are.

The file says that the camera's channels are linear sRGB and that a grey is alike in all of them. So every developer has the
right white balance and matrix, denoises in colours that it knows, and its linear sRGB is the channels themselves.
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
WHITE_SHARE = 0.8  # of full scale, of a mosaic's 1: what is brighter than white is not clipped at once
LEAST = 256  # pixels, of a file's sides: RawTherapee opens none of 180
PERIOD = 12  # pixels, of margins: whole periods of 2×2, 4×4 and 6×6 arrays
MARGIN = 12  # pixels mirrored in phase, at least: developers cut some off, or know less there


def write_mosaic(path: Path, mosaic: Array, cfa: NDArray[np.uint8]) -> None:
    """A mosaic (row, col) of the channels red, green, blue in which a white is 1, as a new DNG file."""
    values = np.clip(np.rint(BLACK + WHITE_SHARE * (TOP - BLACK) * mosaic), 0, TOP).astype(np.uint16)
    matrix = SRGB_FROM_XYZ
    colour = dict.fromkeys(LIGHT_CODES, matrix)
    write_dng(path, values, _camera(cfa, values.shape), colour, np.ones(3), exposure=0.01)


def through_file(develop: Callable[[Path], Array], mosaic: Array, cfa: NDArray[np.uint8]) -> Array:
    """Channels (channel, row, col) of a mosaic, by a developer that makes linear planes, full scale as 1, of a DNG file.

    It is given more than the mosaic on all sides, and may cut as much from each."""
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
    """A camera for the file's tags; what light and noise would be is not read from it."""
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
