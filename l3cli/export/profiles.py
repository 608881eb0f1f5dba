"""Export a camera model to other software (docs/method.md#colour-matrices).

The exported files are the responsivities (as CSV, and as JSON for rawtoaces), a DCP profile in the JSON format of dcamprof,
tuning files for libcamera, and a data sheet (CSV).
"""

import csv
import io
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from l3cli import __version__
from l3cli.artifacts.camera import CameraModel, FlatField
from l3cli.calibration.figures import camera_figures, noise_errors
from l3cli.calibration.responsivity import COVERAGE
from l3cli.frames.shading import interpolation
from l3cli.io.curves import curve_text
from l3cli.physics import spectra
from l3cli.physics.display import SRGB_FROM_XYZ, delta_e_2000, fit_through, lab, refinement, xyz_from_srgb_matrix
from l3cli.system.text import printable

TEMPERATURES = {"A": 2856, "D50": 5003, "D65": 6504}  # illuminant → correlated colour temperature in K
STEP_NM = 5.0  # wavelength spacing for computing colour matrices, in nm
VISIBLE = (380.0, 780.0)  # visible range in nm
# If a channel's response to grey is below this fraction of the most sensitive channel's response, its signal is almost only
# noise, and no colour matrices are computed.
DIMMEST = 1e-4
TYPICAL = 0.2  # signal, as a fraction of white, at which the matrices balance noise against colour errors
DIGITS = 5  # decimals of the matrices in files
BLACK_BODIES = (2200, 2500, 2856, 3200, 3600)  # colour temperatures (K) of black bodies in the white-balance curve
DAYLIGHTS = (4500, 5000, 5500, 6500, 7500, 8600)  # colour temperatures (K) of daylight in the white-balance curve
NOISE_LEVELS = 64  # a noise profile is fitted to this number of signals, from 1 DN (at 16 bits) to the white level
MIN_COLOURS = 3  # colour matrices require at least this number of channels with different responsivities
# To count the channels with different responsivities, each channel is scaled to a sum of 1. Singular values of at least this
# fraction of the largest one are then counted. If equal channels are measured with errors of 5 %, the smaller singular
# values reach 0.03 times the largest one. For RCCG, the third singular value is 0.2 times the largest one.
DIFFERENT = 0.05
RGB = ({"r", "red"}, {"g", "green"}, {"b", "blue"})  # names of red, green and blue channels
SIGNAL_BITS = 16  # bit depth of the signals in tuning files
DECLARED_AS = {  # quantity in the data sheet → its name in `CameraModel.declared`
    "overall system gain K": "gain",
    "temporal dark noise": "noise",
    "saturation capacity": "noise",
    "black level": "black level",
    "white level": "white level",
}
NOISE = (
    "dark current", "DSNU", "PRNU", "row temporal noise", "column temporal noise", "row noise", "column noise", "row PRNU",
    "column PRNU",
)  # fmt: skip
Row = tuple[str, str, float | str, str, str]
# Files for every camera.
CURVES, RAWTOACES_JSON, DATASHEET = "responsivity.csv", "rawtoaces.json", "datasheet.csv"
# Files for cameras with suitable channels.
DCP, RASPBERRY_PI, PI_5, SIMPLE = "dcp.json", "libcamera_rpi.json", "libcamera_pisp.json", "libcamera_simple.yaml"

ILLUMINANTS = {"A": "StdA", "D65": "D65"}  # illuminants of a DCP, in order of colour temperature → names in dcamprof
SIMPLE_DARKEST = 2**15 - 1  # maximum black level in a tuning file for the simple pipeline
RAWTOACES = np.arange(380.0, 781.0, 5.0)  # wavelengths of the curves for rawtoaces, in nm
ALSC_TEMPERATURE = 5000  # nominal colour temperature (K) of the shading tables; libcamera uses a single table for all
SMOOTHNESS = 0.003  # weight of squared second differences, relative to squared errors, in the fit of shading tables
Array = NDArray[np.floating]


class Target(NamedTuple):
    """Image signal processor (ISP) of a Raspberry Pi."""

    name: str  # name in libcamera
    cells: tuple[int, int]  # rows and columns of the shading tables
    vertices: tuple[int, int]  # maximum rows and columns of the ISP's interpolation grid, which spans the whole frame


VC4, PISP = Target("bcm2835", (12, 16), (49, 64)), Target("pisp", (32, 32), (33, 33))


@dataclass(frozen=True)
class Matrix:
    """A colour matrix and its colour errors for measured surfaces."""

    values: Array  # (row, column), rounded to DIGITS decimals as in the exported files
    errors: Array  # (surface,) CIEDE2000
    worst: Array  # (3,) true L*a*b* of the surface with the largest error


@dataclass(frozen=True)
class LightMatrices:
    """Colour matrices of a camera with n channels for one illuminant."""

    neutral: Array  # (n,) signals of a grey surface, scaled to a maximum of 1
    colour: Matrix  # (n, 3) converts XYZ under the illuminant (Y = 1 for white) to channels (maximum 1 for white)
    forward: Matrix  # (3, n) converts white-balanced channels to the XYZ that the surface has under D50
    correction: Matrix  # (3, n) converts white-balanced channels to the linear sRGB that the surface has under D65


def light_matrices(camera: CameraModel, light: str) -> LightMatrices | None:
    """Fit the colour matrices of a camera for a named illuminant.

    The result is None if the camera has fewer than three channels with different responsivities, or if a channel's response
    to grey is less than DIMMEST times the response of the most sensitive channel.
    """
    neutral, balanced = _responses(camera, light)
    if neutral.min() < DIMMEST or _colours_of(camera) < MIN_COLOURS:
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


def _colours_of(camera: CameraModel) -> int:
    """Count the channels with different responsivities, apart from a scale factor.

    For example, the result is 1 for a monochrome camera with four polarisers, and 3 for a Bayer array with two exposures.
    """
    curves = camera.electron_weights
    values = np.linalg.svd(curves / np.maximum(curves.sum(axis=1, keepdims=True), 1e-30), compute_uv=False)
    return int((values >= DIFFERENT * values[0]).sum())


def _colour_matrix(xyz: Array, white: Array, channels: Array, neutral: Array) -> Matrix:
    """Fit a ColorMatrix (n, 3) so that its pseudo-inverse, which raw converters apply, has small colour errors."""
    start = fit_through(xyz, channels, white, neutral)
    ours = refinement(channels @ np.linalg.pinv(start).T, xyz, white)
    values = np.round(start @ np.linalg.inv(ours), DIGITS)
    return _judged(values, channels @ np.linalg.pinv(values).T, xyz, white)


def _matrix_to(space: Array, balanced: Array, noise: Array, wanted: Array, white: Array) -> Matrix:
    """Fit the matrix (3, n) from white-balanced channels to a linear colour space. White is converted exactly.

    `space` (3, 3) is the matrix from XYZ to this colour space.
    """
    start = fit_through(balanced, wanted, np.ones(balanced.shape[1]), white, noise)
    values = np.round(space @ refinement(balanced @ start.T, wanted, white) @ start, DIGITS)
    largest = np.abs(values).argmax(axis=1)
    # Rounding changes the row sums. Correct the largest value in each row, so that white remains exact.
    values[np.arange(3), largest] += np.round(space @ white, DIGITS) - values.sum(axis=1)
    values = np.round(values, DIGITS)
    return _judged(values, balanced @ values.T @ np.linalg.inv(space).T, wanted, white)


def _judged(values: Array, xyz: Array, wanted: Array, white: Array) -> Matrix:
    errors = delta_e_2000(lab(xyz, white), lab(wanted, white))
    return Matrix(values, errors, np.asarray(lab(wanted[errors.argmax()], white)))


def _grid(camera: CameraModel) -> Array:
    """Return a wavelength grid in nm that covers the visible range and the camera's range."""
    low, high = min(camera.wavelength[0], VISIBLE[0]), max(camera.wavelength[-1], VISIBLE[1])
    return np.arange(STEP_NM * np.floor(low / STEP_NM), high + STEP_NM / 2, STEP_NM)


def _responses(camera: CameraModel, light: str) -> tuple[Array, Array]:
    """Return the responses of a camera with n channels to white and to measured surfaces under an illuminant.

    Returns
    -------
    white : ndarray, (n,)
        Signals of white, scaled to a maximum of 1, or all 0 if the camera does not respond to the illuminant.
    balanced : ndarray, (surface, n)
        Signals of the surfaces, divided by the signals of white.
    """
    grid = _grid(camera)
    weights = spectra.average(camera.responsivity, camera.wavelength, grid) * spectra.illuminant(light, grid)
    white = weights.sum(axis=1)
    balanced = spectra.reflectance_library(grid) @ weights.T / np.where(white > 0, white, 1.0)
    return white / white.max() if white.max() > 0 else white, balanced


def _colours(camera: CameraModel, library: Array, light: str) -> tuple[Array, Array]:
    """Return the XYZ of surfaces (surface, 3) and white (3,) under an illuminant, scaled to Y = 1 for white."""
    grid = _grid(camera)
    weights = spectra.xyz_weights(grid) * spectra.illuminant(light, grid)
    white = weights.sum(axis=1)
    return library @ weights.T / white[1], white / white[1]


def errors(matrices: LightMatrices) -> dict[str, dict[str, Any]]:
    """Return colour matrices and their errors for JSON, by matrix name.

    The errors are the mean, 95th percentile and maximum of CIEDE2000 over measured surfaces, and the L*a*b* of the surface
    with the largest error.
    """
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


# ------------------------------------------------------------------------------- white balance, noise and shading


def temperature_curve(camera: CameraModel, order: tuple[int, int, int]) -> Array | None:
    """Return the channel ratios of a grey surface as a function of colour temperature.

    Parameters
    ----------
    camera : CameraModel
        The camera.
    order : tuple of int
        Indices of the channels r, g and b.

    Returns
    -------
    ndarray, (temperature, 3), or None
        Temperature in K, r/g and b/g, for black bodies and daylight. None if the signal in g is almost 0. Also None if r/g
        does not decrease, or b/g does not increase, monotonically with temperature, because libcamera searches along the
        curve.
    """
    names = [f"{kelvin}K" for kelvin in BLACK_BODIES] + [f"D{kelvin}K" for kelvin in DAYLIGHTS]
    greys = np.array([_responses(camera, name)[0] for name in names])
    first, middle, last = greys[:, order].T
    if middle.min() < DIMMEST:
        return None
    curve = np.stack([(*BLACK_BODIES, *DAYLIGHTS), np.round(first / middle, 4), np.round(last / middle, 4)], axis=1)
    falls, rises = (np.diff(curve[:, 1]) < 0).all(), (np.diff(curve[:, 2]) > 0).all()
    return curve if falls and rises else None


def noise_profile(camera: CameraModel) -> tuple[float, float]:
    """Fit libcamera's noise model to a camera: standard deviation = constant + slope · √signal.

    Standard deviation and signal are in DN at 16 bits. The square roots of the signals in the least-squares fit are evenly
    spaced.

    Returns
    -------
    constant : float
        Standard deviation without signal. If the fit were negative, this is 0, and only the slope is fitted.
    slope : float
        Increase of the standard deviation with √signal.
    """
    scale = 2.0 ** (SIGNAL_BITS - camera.bits)
    root = np.linspace(1.0, np.sqrt((camera.white_level - camera.black_level) * scale), NOISE_LEVELS)
    deviation = scale * np.sqrt(camera.noise_variance(root**2 / scale))
    slope, constant = np.polyfit(root, deviation, 1)
    if constant < 0:
        constant, slope = 0.0, root @ deviation / (root @ root)
    return round(float(constant), 3), round(float(slope), 4)


def black_level_16(camera: CameraModel) -> int:
    """Return the black level for tuning files: in DN at 16 bits, rounded to an integer."""
    return round(camera.black_level * 2 ** (SIGNAL_BITS - camera.bits))


def shading_tables(field: FlatField, order: tuple[int, int, int], target: Target) -> tuple[Array, Array, Array]:
    """Fit a Raspberry Pi's shading tables to a flat field.

    The ISP interpolates between the centres of the table's cells, and uses constant values from the outermost centres to the
    edges of the frame. Tables that simply contain the gains at the centres would be inaccurate. For a lens that halves the
    light in the corners of the frame, the error in the corners would be 4 %. The tables are therefore smooth least-squares
    fits that take this interpolation into account.

    Parameters
    ----------
    field : FlatField
        Flat field of the camera.
    order : tuple of int
        Indices of the channels r, g and b.
    target : Target
        ISP, which determines the size of the tables.

    Returns
    -------
    green, red, blue : ndarray, (row, col)
        Gain of g, and the gains of r and b relative to g. The smallest value in each table is 1.
    """
    ends = field.grid_row[-1] + 1, field.grid_col[-1] + 1
    fine = [length * _middles(4 * vertices) - 0.5 for length, vertices in zip(ends, target.vertices, strict=True)]
    down, across = interpolation(field.grid_row, fine[0]), interpolation(field.grid_col, fine[1])
    fits = [_fit(*each) for each in zip(target.cells, target.vertices, strict=True)]
    red, green, blue = (fits[0] @ down @ field.shading_gain[channel] @ across.T @ fits[1].T for channel in order)
    first, last = red / green, blue / green
    return green / green.min(), first / first.min(), last / last.min()


def _fit(cells: int, vertices: int) -> Array:
    """Return the matrix (cell, sample) that fits cell values to gains along one axis, by regularised least squares.

    The gains are sampled at four points per vertex of the ISP's grid.
    """
    places, middles = _middles(4 * vertices), _middles(cells)
    corners = np.linspace(0, 1, vertices)
    made = interpolation(corners, places) @ interpolation(middles, np.clip(corners, middles[0], middles[-1]))
    bends = np.diff(np.eye(cells), 2, axis=0)
    made, rest = made / np.sqrt(len(places) / cells), SMOOTHNESS * bends.T @ bends
    return np.asarray(np.linalg.solve(made.T @ made + rest, made.T) / np.sqrt(len(places) / cells))


def _middles(count: int) -> Array:
    """Return the centres of `count` equal parts of the interval 0 to 1."""
    return (np.arange(count) + 0.5) / count


def rgb_order(channels: Sequence[str]) -> tuple[int, int, int] | None:
    """Return the indices of r, g and b, or None if these are not the camera's channels."""
    colours = [next((index for index, each in enumerate(RGB) if name.casefold() in each), None) for name in channels]
    if len(colours) != len(RGB) or set(colours) != {0, 1, 2}:
        return None
    return colours.index(0), colours.index(1), colours.index(2)


def bayer_order(channels: Sequence[str], cfa: NDArray[np.integer]) -> tuple[int, int, int] | None:
    """Return the indices of r, g and b for a 2×2 Bayer array with g on a diagonal, or None for other arrays."""
    order = rgb_order(channels)
    if order is None or cfa.shape != (2, 2):
        return None
    red, green, blue = order
    diagonals = [set(np.diag(cfa).tolist()), set(np.diag(cfa[:, ::-1]).tolist())]
    return order if {green} in diagonals and {red, blue} in diagonals else None


def datasheet(camera: CameraModel) -> list[Row]:
    """Return the rows of a camera's data sheet: quantity, channel, value, unit and source.

    The channel is empty for quantities of the whole camera. The source is "measured", "declared" (from the user's
    measurement file) or "recipe".
    """
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
        for name, (value, unit) in (camera_figures(camera) | noise_errors(camera)).items()
    ]
    peaks, unit = camera.responsivity.argmax(axis=1), "e-/photon" if camera.absolute else "relative"
    for index, (channel, peak) in enumerate(zip(camera.channels, peaks, strict=True)):
        height, band = camera.responsivity[index, peak], camera.responsivity_band[index, peak]
        rows.append(("peak responsivity", channel, float(height), unit, source))
        rows += [("95 % band at the peak", channel, float(band), unit, source)] if band else []
        rows.append(("peak wavelength", channel, float(camera.wavelength[peak]), "nm", source))
    rows += _polariser_rows(camera, peaks, given)
    share = np.bincount(camera.cfa.ravel(), minlength=len(camera.channels)) / camera.cfa.size
    rows += [("share of the pixels", n, 100 * float(s), "%", given) for n, s in zip(camera.channels, share, strict=True)]
    return rows


def _polariser_rows(camera: CameraModel, peaks: NDArray[np.integer], given: str) -> list[Row]:
    """Return the data sheet rows with the angles of the polarisers and their extinction ratios, except for infinite ratios.

    `peaks` contains the index of each channel's peak wavelength. `given` is the source to name for values that were not
    measured. Measured values are followed by the half widths of their 95 % confidence intervals.
    """
    polarisers, fit = camera.polarisers, camera.fit.polarisers if camera.fit else None
    rows: list[Row] = []
    if polarisers is None:
        return rows
    source = given if fit is None else "measured"
    for index in np.flatnonzero(polarisers.present).tolist():
        channel, leakage = camera.channels[index], float(polarisers.leakage[index, peaks[index]])
        rows.append(("polariser angle", channel, float(polarisers.polariser_deg[index]), "deg", source))
        if fit is not None:
            rows.append(("95 % band of the angle", channel, COVERAGE * float(fit.angle_error[index]), "deg", source))
        if leakage > 0:
            rows.append(("extinction ratio", channel, 1 / leakage, "1", source))
        if leakage > 0 and fit is not None:
            band = COVERAGE * float(fit.leakage_error[index]) / leakage**2
            rows.append(("95 % band of the extinction ratio", channel, band, "1", source))
    return rows


def _declared(name: str, camera: CameraModel) -> bool:
    """Whether a quantity was copied from a data sheet or assumed to be 0, not measured."""
    known = DECLARED_AS.get(name, name)
    return known in camera.declared or (name in NOISE and "noise" in camera.declared)


class Exported(NamedTuple):
    """Files that describe a camera to other software."""

    files: dict[str, str]  # file name → content
    errors: dict[str, dict[str, dict[str, Any]]]  # illuminant → matrix name → colour errors (see `errors`)
    note: str | None  # names of missing files, and the reason; None if no file is missing


def export(camera: CameraModel) -> Exported:
    """Export a camera to other software, as responsivities, data sheet, DCP profile and tuning files.

    The DCP profile and the tuning files contain colour matrices, which require at least three channels with different
    responsivities. Tuning files also require a Bayer array. The note in the result explains why files are missing.
    """
    camera = replace(camera, name=printable(camera.name))  # the name may contain unprintable bytes
    files = {**_curves(camera), DATASHEET: _datasheet_csv(camera)}
    lights = {name: light_matrices(camera, name) for name in TEMPERATURES}
    known = {name: matrices for name, matrices in lights.items() if matrices is not None}
    if missing := [name for name in lights if name not in known]:
        reason = f"a channel receives almost no light from {missing[0]}"
        if len(camera.channels) < MIN_COLOURS:
            reason = "it has fewer than three channels"
        elif _colours_of(camera) < MIN_COLOURS and _responses(camera, missing[0])[0].min() >= DIMMEST:
            reason = "fewer than three of its channels have different responsivities"
        return Exported(files, {}, f"{camera.name} has no colour matrices and no tuning files, because {reason}")
    files[DCP] = _dcp_json(camera, known)
    order, note = bayer_order(camera.channels, camera.cfa), None
    if order is None:
        note = f"{camera.name} has no tuning files for libcamera, which supports only 2×2 arrays of r, g and b"
    else:
        corrections = {TEMPERATURES[name]: each.correction.values[:, order] for name, each in known.items()}
        curve = temperature_curve(camera, order)
        for name, target in ((RASPBERRY_PI, VC4), (PI_5, PISP)):
            files[name] = _raspberry_pi_json(camera, corrections, curve, order, target)
        files[SIMPLE] = _simple_yaml(camera, corrections)
    kinds = {name: ("CCM", "ForwardMatrix", "ColorMatrix") if name in ILLUMINANTS else ("CCM",) for name in known}
    judged = {name: errors(each) for name, each in known.items()}
    return Exported(files, {name: {kind: judged[name][kind] for kind in kinds[name]} for name in known}, note)


def _curves(camera: CameraModel) -> dict[str, str]:
    """Return the relative responsivities per energy as two files: CSV, and JSON for rawtoaces.

    They are scaled to a maximum of 1. The CSV file contains the camera's own wavelengths.
    """
    curves = camera.responsivity * camera.wavelength
    curves = curves / curves.max()
    table = spectra.average(curves, camera.wavelength, RAWTOACES).T
    manufacturer, _, model = camera.name.partition(" ")
    content: dict[str, Any] = {
        "header": {
            "schema_version": "0.1.0",
            "manufacturer": manufacturer,
            "model": model or manufacturer,
            "description": "camera spectral sensitivity data, relative, per energy",
            "document_creator": "l3 calibrate",
        },
        "spectral_data": {
            "units": "relative",
            "index": {"main": [name.upper() for name in camera.channels]},
            "data": {"main": {f"{nm:g}": row.tolist() for nm, row in zip(RAWTOACES, table, strict=True)}},
        },
    }
    text = json.dumps(content, indent=2, ensure_ascii=False) + "\n"
    return {CURVES: curve_text(camera.wavelength, curves, camera.channels), RAWTOACES_JSON: text}


def _dcp_json(camera: CameraModel, known: Mapping[str, LightMatrices]) -> str:
    """Return a DCP with matrices for ILLUMINANTS, in the JSON format of `dcamprof json2dcp`.

    Two additional keys are not part of a DCP. "Channels" lists the channel names: r, g, b if these are the camera's
    channels, otherwise all channels in the camera's order. "AsShotNeutral" contains the signals of a grey surface under each
    illuminant, for use in DNG files.
    """
    planes = list(rgb_order(camera.channels) or range(len(camera.channels)))
    lights = [known[light] for light in ILLUMINANTS]
    content: dict[str, Any] = {"UniqueCameraModel": camera.name, "ProfileName": "l3", "ProfileEmbedPolicy": "Allow copying"}
    content |= {f"CalibrationIlluminant{i}": code for i, code in enumerate(ILLUMINANTS.values(), 1)}
    content |= {f"ColorMatrix{i}": each.colour.values[planes].tolist() for i, each in enumerate(lights, 1)}
    content |= {f"ForwardMatrix{i}": each.forward.values[:, planes].tolist() for i, each in enumerate(lights, 1)}
    content["Channels"] = [camera.channels[plane] for plane in planes]
    neutrals = (each.neutral[planes].tolist() for each in lights)
    content["AsShotNeutral"] = dict(zip(ILLUMINANTS.values(), neutrals, strict=True))
    return _json(content) + "\n"


def _raspberry_pi_json(
    camera: CameraModel, corrections: Mapping[int, Array], curve: Array | None, order: tuple[int, int, int], target: Target
) -> str:
    """Return a tuning file (version 2.0, JSON) for libcamera's Raspberry Pi pipelines.

    libcamera and picamera2 expect the file name SENSOR.json.

    Parameters
    ----------
    camera : CameraModel
        The camera.
    corrections : mapping of int to ndarray, (3, 3)
        Colour temperature in K, in increasing order → colour correction matrix.
    curve : ndarray, (temperature, 3), or None
        White-balance curve from `temperature_curve`. None omits it from the file.
    order : tuple of int
        Indices of the channels r, g and b.
    target : Target
        ISP, which determines the size of the shading tables. These require a flat field.
    """
    flat = {"priors": [{"lux": 0, "prior": [2000, 0.0, 13000, 0.0]}]}  # flat prior, because the illuminance is unknown
    awb: dict[str, Any] = {"bayes": 0}
    missing = ["missing: ct_curve of rpi.awb, because the colour of greys does not change monotonically with temperature"]
    if curve is not None:
        low, high = int(curve[0, 0]), int(curve[-1, 0])
        awb = {**flat, "modes": {"auto": {"lo": low, "hi": high}}, "bayes": 1, "ct_curve": curve.ravel().tolist()}
        missing = []
    ccms = [{"ct": ct, "ccm": matrix.ravel().tolist()} for ct, matrix in corrections.items()]
    constant, slope = noise_profile(camera)
    algorithms = {
        "rpi.black_level": {"black_level": black_level_16(camera)},
        "rpi.noise": {"reference_constant": constant, "reference_slope": slope},
        "rpi.awb": awb,
        "rpi.ccm": {"ccms": ccms},
    }
    shading = ["missing: rpi.alsc, because no evenly lit white was measured through the lens"]
    if camera.flat_field is not None:
        luminance, *ratios = (np.round(each, 4) for each in shading_tables(camera.flat_field, order, target))
        red, blue = ([{"ct": ALSC_TEMPERATURE, "table": each.ravel().tolist()}] for each in ratios)
        tables = {"calibrations_Cr": red, "calibrations_Cb": blue, "luminance_lut": luminance.ravel().tolist()}
        algorithms["rpi.alsc"] = {"luminance_strength": 1.0, **tables}
        shading = ["rpi.alsc: measured under the light of the white frames, used at every temperature"]
    content = {
        "version": 2.0,
        "target": target.name,
        "comment": [  # libcamera ignores this key; it reads only version, target and algorithms
            f"{camera.name}, l3cli {__version__}: black level, noise, white balance and colours of the camera model",
            "rpi.noise: valid at the analogue gain of the calibration, which counts as 1",
            *shading,
            "missing: rpi.agc, rpi.contrast and rpi.sharpen; copy them from the tuning file of a similar sensor",
            "missing: rpi.lux, because no scene of known illuminance was measured through the lens; the priors of rpi.awb "
            "are therefore flat",
            *missing,
        ],
        "algorithms": [{key: value} for key, value in algorithms.items()],
    }
    return _json(content) + "\n"


def _simple_yaml(camera: CameraModel, corrections: Mapping[int, Array]) -> str:
    """Return the tuning file SENSOR.yaml for libcamera's simple pipeline, the software ISP of laptops and phones."""
    black_level = black_level_16(camera)
    lines = [
        "# " + json.dumps(f"{camera.name}, l3cli {__version__}")[1:-1],
        "%YAML 1.1",
        "---",
        "version: 1",
        "algorithms:",
        "  - BlackLevel:",
        *([f"      blackLevel: {black_level}"] if black_level <= SIMPLE_DARKEST else []),
        "  - Awb:",
        "  - Ccm:",
        "      ccms:",
    ]
    for ct, matrix in corrections.items():
        rows = [", ".join(f"{value:.6f}" for value in row) for row in matrix]
        lines += [f"        - ct: {ct}", f"          ccm: [ {rows[0]},", f"                 {rows[1]},"]
        lines.append(f"                 {rows[2]} ]")
    return "\n".join([*lines, "  - Adjust:  # older versions of libcamera call it Lut", "  - Agc:", "..."]) + "\n"


def _datasheet_csv(camera: CameraModel) -> str:
    """Return the data sheet as CSV with column headings."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    for row in (("quantity", "channel", "value", "unit", "source"), *datasheet(camera)):
        writer.writerow([f"{cell:.8g}" if not isinstance(cell, str) else cell for cell in row])
    return text.getvalue()


def _json(value: Any, indent: int = 0) -> str:
    """Format a value as ASCII JSON, indented by two spaces per level, with each list of numbers on one line."""
    inner = " " * (indent + 2)
    if isinstance(value, dict):
        lines = [f"{inner}{json.dumps(key)}: {_json(each, indent + 2)}" for key, each in value.items()]
        return "{\n" + ",\n".join(lines) + "\n" + " " * indent + "}"
    if isinstance(value, list) and any(isinstance(each, dict | list | str) for each in value):
        return "[\n" + ",\n".join(inner + _json(each, indent + 2) for each in value) + "\n" + " " * indent + "]"
    return json.dumps(value)
