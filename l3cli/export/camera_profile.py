"""Camera model → what other software wants of its colours: matrices for lights, the channels of greys over colour
temperature, noise over signal (docs/method.md#colour-matrices)."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.camera import CameraModel
from l3cli.calibration.figures import camera_figures
from l3cli.physics import spectra
from l3cli.physics.display import SRGB_FROM_XYZ, lab, xyz_from_srgb_matrix
from l3cli.physics.matrices import colour_errors, fit_through, refinement

TEMPERATURES = {"A": 2856, "D50": 5003, "D65": 6504}  # K, correlated
STEP = 5.0  # nm
VISIBLE = (380.0, 780.0)
DIMMEST = 1e-4  # of the brightest channel: below, white balance would only amplify noise
TYPICAL = 0.2  # of a white: signal at which noise is weighed against colour
DIGITS = 5  # decimals of what is written
BLACK_BODIES = (2200, 2500, 2856, 3200, 3600)  # K
DAYLIGHTS = (4500, 5000, 5500, 6500, 7500, 8600)  # K
NOISE_LEVELS = 64  # signals from 1 DN of 16 bits to the white level that a noise profile is fitted over
LEAST_CHANNELS = 3
RGB = ({"r", "red"}, {"g", "green"}, {"b", "blue"})  # names of channels
SIXTEEN = 16  # bits of the scale of tuning files
Array = NDArray[np.floating]
DECLARED_AS = {  # figure: what calibration calls it where it did not measure it
    "overall system gain K": "gain",
    "temporal dark noise": "noise",
    "saturation capacity": "noise",
    "black level": "black level",
    "white level": "white level",
}
NOISE = ("dark current", "DSNU", "PRNU")
Row = tuple[str, str, float | str, str, str]


@dataclass(frozen=True)
class Matrix:
    """A matrix as it is written, and what it leaves of the colours of measured surfaces."""

    values: Array  # (row, column), of DIGITS decimals
    errors: Array  # (surface) CIEDE2000
    worst: Array  # (3) L*a*b* that the surface of the largest error should have


@dataclass(frozen=True)
class LightMatrices:
    """Matrices of a camera with n channels for one light."""

    neutral: Array  # (n) channels of a grey, the brightest 1
    colour: Matrix  # (n, 3) XYZ under this light, a white's Y 1 → channels, the brightest of a white 1
    forward: Matrix  # (3, n) channels over those of a grey → XYZ of the surface under D50
    correction: Matrix  # (3, n) channels over those of a grey → linear sRGB of the surface under daylight; rows sum to 1


def light_matrices(camera: CameraModel, light: str) -> LightMatrices | None:
    """Return the matrices for a light by name; None with fewer than three channels, or where one sees nothing of that
    light."""
    neutral, balanced = _responses(camera, light)
    if len(neutral) < LEAST_CHANNELS or neutral.min() < DIMMEST:
        return None
    signal = (camera.white_level - camera.black_level) * neutral
    noise = camera.noise_variance(TYPICAL * signal) / signal**2
    library = spectra.reflectance_library(_grid(camera))
    seen, white_seen = _colours(camera, library, light)
    return LightMatrices(
        np.round(neutral, DIGITS),
        _colour_matrix(seen, white_seen, balanced * neutral, np.round(neutral, DIGITS)),
        _matrix_to(np.eye(3), balanced, noise, *_colours(camera, library, "D50")),
        _matrix_to(SRGB_FROM_XYZ, balanced, noise, _colours(camera, library, "D65")[0], xyz_from_srgb_matrix().sum(axis=1)),
    )


def _colour_matrix(xyz: Array, white: Array, channels: Array, neutral: Array) -> Matrix:
    """(n, 3), whose pseudo-inverse gives the best colours: so developers use it."""
    start = fit_through(xyz, channels, white, neutral)
    ours = refinement(channels @ np.linalg.pinv(start).T, xyz, white)
    values = np.round(start @ np.linalg.inv(ours), DIGITS)
    return _judged(values, channels @ np.linalg.pinv(values).T, xyz, white)


def _matrix_to(space: Array, balanced: Array, noise: Array, wanted: Array, white: Array) -> Matrix:
    """(3, n) from balanced channels to a linear `space` (3, 3) of XYZ, where a white has exactly the white's colour."""
    start = fit_through(balanced, wanted, np.ones(balanced.shape[1]), white, noise)
    values = np.round(space @ refinement(balanced @ start.T, wanted, white) @ start, DIGITS)
    largest = np.abs(values).argmax(axis=1)
    values[np.arange(3), largest] += np.round(space @ white, DIGITS) - values.sum(axis=1)  # what rounding has changed
    values = np.round(values, DIGITS)
    return _judged(values, balanced @ values.T @ np.linalg.inv(space).T, wanted, white)


def _judged(values: Array, xyz: Array, wanted: Array, white: Array) -> Matrix:
    errors = colour_errors(xyz, wanted, white)
    return Matrix(values, errors, np.asarray(lab(wanted[errors.argmax()], white)))


def _grid(camera: CameraModel) -> Array:
    """Return the wavelengths (nm) of all that the eye or the camera sees."""
    low, high = min(camera.wavelength[0], VISIBLE[0]), max(camera.wavelength[-1], VISIBLE[1])
    return np.arange(STEP * np.floor(low / STEP), high + STEP / 2, STEP)


def _responses(camera: CameraModel, light: str) -> tuple[Array, Array]:
    """Return the channels of a white (n), the brightest 1, and those of the surfaces over a white's (surface, n)."""
    grid = _grid(camera)
    weights = spectra.average(camera.responsivity, camera.wavelength, grid) * spectra.illuminant(light, grid)
    white = weights.sum(axis=1)
    balanced = spectra.reflectance_library(grid) @ weights.T / np.where(white > 0, white, 1.0)
    return white / white.max() if white.max() > 0 else white, balanced


def _colours(camera: CameraModel, library: Array, light: str) -> tuple[Array, Array]:
    """Return XYZ (surface, 3) of the surfaces under a light, and of its white (3), whose Y is 1."""
    grid = _grid(camera)
    weights = spectra.xyz_weights(grid) * spectra.illuminant(light, grid)
    white = weights.sum(axis=1)
    return library @ weights.T / white[1], white / white[1]


def errors(matrices: LightMatrices) -> dict[str, dict[str, Any]]:
    """Return each matrix, and what it leaves of the colours of measured surfaces, ready for JSON: mean, 95 % and worst
    CIEDE2000, L*a*b* of the worst surface."""
    kinds = {"CCM": matrices.correction, "ForwardMatrix": matrices.forward, "ColorMatrix": matrices.colour}
    return {
        name: {
            "mean": float(each.errors.mean()),
            "95 %": float(np.percentile(each.errors, 95)),
            "worst": float(each.errors.max()),
            "worst L*a*b*": [float(value) for value in each.worst],
            "matrix": each.values.tolist(),
        }
        for name, each in kinds.items()
    }


# -------------------------------------------------------------------------------------------------- white, noise


def temperature_curve(camera: CameraModel, order: tuple[int, int, int]) -> Array | None:
    """(temperature, 3): K, r over g, b over g of a grey under black bodies and daylights, the channels r, g, b in this
    `order`; None unless r falls and b rises all the way, as who searches along the curve expects."""
    names = [f"{kelvin}K" for kelvin in BLACK_BODIES] + [f"D{kelvin}K" for kelvin in DAYLIGHTS]
    greys = np.array([_responses(camera, name)[0] for name in names])
    first, middle, last = greys[:, order].T
    if middle.min() < DIMMEST:
        return None
    curve = np.stack([(*BLACK_BODIES, *DAYLIGHTS), np.round(first / middle, 4), np.round(last / middle, 4)], axis=1)
    falls, rises = (np.diff(curve[:, 1]) < 0).all(), (np.diff(curve[:, 2]) > 0).all()
    return curve if falls and rises else None


def noise_profile(camera: CameraModel) -> tuple[float, float]:
    """Constant and slope of a pixel's standard deviation, constant + slope · √signal, on a scale of 16 bits: least squares
    over signals evenly spaced in their roots; a constant below zero is none."""
    scale = 2.0 ** (SIXTEEN - camera.bits)
    root = np.linspace(1.0, np.sqrt((camera.white_level - camera.black_level) * scale), NOISE_LEVELS)
    deviation = scale * np.sqrt(camera.noise_variance(root**2 / scale))
    slope, constant = np.polyfit(root, deviation, 1)
    if constant < 0:
        constant, slope = 0.0, root @ deviation / (root @ root)
    return round(float(constant), 3), round(float(slope), 4)


def black_level_16(camera: CameraModel) -> int:
    """Return the black level on a scale of 16 bits, as tuning files state it."""
    return round(camera.black_level * 2 ** (SIXTEEN - camera.bits))


def rgb_order(channels: Sequence[str]) -> tuple[int, int, int] | None:
    """Return the places of the channels r, g, b among three of these names; None for any others."""
    colours = [next((index for index, each in enumerate(RGB) if name.casefold() in each), None) for name in channels]
    if len(colours) != len(RGB) or set(colours) != {0, 1, 2}:
        return None
    return colours.index(0), colours.index(1), colours.index(2)


def bayer_order(channels: Sequence[str], cfa: NDArray[np.integer]) -> tuple[int, int, int] | None:
    """`rgb_order` of a Bayer array (2×2, g on a diagonal); None for any other array."""
    order = rgb_order(channels)
    if order is None or cfa.shape != (2, 2):
        return None
    red, green, blue = order
    diagonals = [set(np.diag(cfa).tolist()), set(np.diag(cfa[:, ::-1]).tolist())]
    return order if {green} in diagonals and {red, blue} in diagonals else None


def datasheet(camera: CameraModel) -> list[Row]:
    """Return the rows of a camera, then of each of its channels; the channel is empty where a row holds for all, the source
    one of "measured", "declared", "recipe"."""
    optics, source = camera.optics, "recipe" if camera.fit is None else "measured"
    given = "recipe" if camera.fit is None else "declared"
    cfa = "/".join(" ".join(camera.channels[channel] for channel in row) for row in camera.cfa)
    rows: list[Row] = [
        ("camera", "", camera.name, "", given),
        ("rows", "", camera.rows, "pixel", given),
        ("columns", "", camera.cols, "pixel", given),
        ("colour filter array", "", cfa, "", given),
        ("pixel pitch", "", 1e6 * camera.pixel_pitch, "um", given),
        ("bits", "", camera.bits, "bit", given),
        ("focal length", "", 1e3 * optics.focal_length, "mm", given),
        ("f-number", "", optics.f_number, "1", given),
    ]
    rows += [
        (name, "", value, unit, given if _declared(name, camera) else source)
        for name, (value, unit) in camera_figures(camera).items()
    ]
    rows.append(("column noise", "", camera.noise.column_noise, "e-", given))
    peaks, unit = camera.responsivity.argmax(axis=1), "e-/photon" if camera.absolute else "relative"
    for index, (channel, peak) in enumerate(zip(camera.channels, peaks, strict=True)):
        height, band = camera.responsivity[index, peak], camera.responsivity_band[index, peak]
        rows.append(("peak responsivity", channel, float(height), unit, source))
        rows += [("95 % band at the peak", channel, float(band), unit, source)] if band else []
        rows.append(("peak wavelength", channel, float(camera.wavelength[peak]), "nm", source))
    share = np.bincount(camera.cfa.ravel(), minlength=len(camera.channels)) / camera.cfa.size
    rows += [("share of the pixels", n, 100 * float(s), "%", given) for n, s in zip(camera.channels, share, strict=True)]
    return rows


def _declared(name: str, camera: CameraModel) -> bool:
    """Return whether calibration took a figure from a data sheet, or as 0."""
    known = DECLARED_AS.get(name, name)
    return known in camera.declared or (name in NOISE and "noise" in camera.declared)
