"""Recipes and camera models of small cameras."""

import numpy as np
from numpy.typing import ArrayLike

from l3cli.artifacts.camera import CameraModel, Noise, Optics


def bayer_camera(bits: int = 12, pattern: tuple[str, ...] = ("r g", "g b")) -> str:
    """Return the text of a recipe for a small Bayer camera."""
    rows = ", ".join(f'"{row}"' for row in pattern)
    return f"""
name = "small Bayer"
[sensor]
rows = 192
cols = 256
pixel_pitch_um = 4.0
bits = {bits}
gain_dn_per_e = {0.25 * 2.0 ** (bits - 12)}
black_level_dn = {64 * 2 ** (bits - 12)}
fixed_pattern_seed = 3
[cfa]
channels = ["r", "g", "b"]
pattern = [{rows}]
[responsivity]
wavelength_nm = [400, 700, 10]
peak_efficiency = 0.4
[responsivity.gaussians]
r = [{{ peak = 0.8, centre_nm = 600, sigma_nm = 35 }}]
g = [{{ peak = 1.0, centre_nm = 535, sigma_nm = 40 }}]
b = [{{ peak = 0.9, centre_nm = 460, sigma_nm = 30 }}]
[noise]
read_noise_e = 4.0
dark_current_e_per_s = 5.0
dsnu_e = 2.0
prnu = 0.005
well_capacity_e = 15000
[optics]
focal_length_mm = 25
f_number = 2.8
"""


def random_camera(cfa: ArrayLike, channels: int, bits: int, black_level: float) -> CameraModel:
    """Return a small camera model with the given colour filter array and uniform responsivities."""
    top = 2**bits - 1
    return CameraModel(
        name="random",
        rows=24,
        cols=32,
        pixel_pitch=5e-6,
        bits=bits,
        channels=tuple("rgbocwxyklmnpqst"[:channels]),
        cfa=np.asarray(cfa, np.uint8),
        wavelength=np.array([400.0, 700.0]),
        responsivity=np.ones((channels, 2)),
        responsivity_band=np.zeros((channels, 2)),
        absolute=True,
        gain=top / 20000,
        black_level=black_level,
        white_level=float(top),
        fixed_pattern_seed=0,
        noise=Noise(5.0, 1.0, 2.0, 0.01, 20000.0),
        optics=Optics(0.05, 2.8, 0.0),
    )


BAYER = [[0, 1], [1, 2]]
FIVE_BAND = [[2, 1, 4, 1], [1, 3, 1, 0], [4, 1, 2, 1], [1, 0, 1, 3]]
X_TRANS = [
    [1, 2, 1, 1, 0, 1],
    [0, 1, 0, 2, 1, 2],
    [1, 2, 1, 1, 0, 1],
    [1, 0, 1, 1, 2, 1],
    [2, 1, 2, 0, 1, 0],
    [1, 0, 1, 1, 2, 1],
]
