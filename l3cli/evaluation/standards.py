"""Standard metrics: slanted-edge MTF, and SNR of a grey target at several illuminances (docs/measurement.md).

The metrics are measured on rendered pictures, and compared with theoretical values. The theoretical MTF is computed from the
lens and the pixel aperture, and the theoretical SNR from the camera's noise model.
"""

import dataclasses
import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.camera import CameraModel
from l3cli.artifacts.training_set import TrainingFrame
from l3cli.evaluation.basic import electrons_of, lit_library
from l3cli.physics.display import delta_e_2000, lab
from l3cli.physics.lens import diffraction_transfer
from l3cli.physics.stokes import luminance_name

Array = NDArray[np.floating]
BINS_PER_PIXEL = 4  # oversampling of the edge profile
HALF_PROFILE_PIXELS = 48.0  # half the length of the edge profile, which must contain the blur of the lens
TAPER = 8.0  # pixels at each end of the profile over which its slope is tapered to zero
SEARCHED = 6.0  # pixels; the edge is searched within this distance from the line of the previous fit
MAX_FREQUENCY = 1.0  # cycles/pixel; highest frequency of MTF curves
HALF = 0.5  # MTF at the frequency MTF50
PROFILE_BINS = int(2 * HALF_PROFILE_PIXELS * BINS_PER_PIXEL)
FREQUENCIES = np.fft.rfftfreq(2 * PROFILE_BINS, 1 / BINS_PER_PIXEL)
FREQUENCIES = FREQUENCIES[FREQUENCIES <= MAX_FREQUENCY]  # of all MTF curves, in cycles/pixel


class EdgeError(ValueError):
    """Raised if a picture contains no edge that is suitable for an MTF measurement."""


@dataclass(frozen=True)
class Sharpness:
    """Modulation transfer function (MTF) across an edge."""

    frequency: Array  # (sample) cycles/pixel, from 0
    transfer: Array  # (sample) MTF, 1 at the frequency 0
    angle: float  # degrees between the edge and the picture columns

    @property
    def mtf50(self) -> float | None:
        """Lowest frequency at which the MTF is 0.5, in cycles/pixel, or None if it never falls below 0.5."""
        below = np.flatnonzero(self.transfer < HALF)
        if not below.size:
            return None
        at = np.s_[below[0] - 1 : below[0] + 1]
        return float(np.interp(-HALF, -self.transfer[at], self.frequency[at]))


def edge_sharpness(plane: Array) -> Sharpness:
    """Measure the MTF across a straight edge that is slanted by 2° to 15° from the vertical.

    Parameters
    ----------
    plane : ndarray, (row, col)
        Linear brightness of a picture.

    Raises
    ------
    EdgeError
        If the picture contains no such edge, or is too narrow for the edge profile.

    Notes
    -----
    In each row, the edge position is the centroid of the absolute slope. A straight line is fitted to these positions.
    Pixels are averaged by their distance from this line, in bins of a quarter pixel. The MTF is the Fourier spectrum of this
    profile's slope, corrected for the bin width and for the finite differences.
    """
    plane = np.asarray(plane, np.float64)
    slope = np.abs(np.diff(plane, axis=1))
    rows, place = np.arange(len(plane)), np.arange(slope.shape[1]) + 0.5
    if not slope.sum(axis=1).min() > 0:
        raise EdgeError("the picture contains no edge that crosses every row")
    line, reach = np.array([0.0, slope.sum(axis=0) @ place / slope.sum()]), np.inf
    for _ in range(4):
        weight = np.where(np.abs(place - np.polyval(line, rows)[:, None]) < reach, slope, 0.0)
        crossed = weight.any(axis=1)
        if crossed.sum() < len(rows) / 2:
            raise EdgeError("the picture contains no straight edge that crosses its rows")
        at = (weight[crossed] @ place) / weight[crossed].sum(axis=1)
        line, reach = np.polyfit(rows[crossed], at, 1), SEARCHED
    angle = np.arctan(line[0])
    if not 2.0 <= abs(np.degrees(angle)) <= 15.0:
        raise EdgeError(
            f"the edge is slanted by {abs(np.degrees(angle)):.2g}° from the vertical, but must be slanted by 2° to 15°"
        )
    turns = int(len(rows) * abs(line[0]))  # number of columns that the edge crosses completely
    # Use only the rows in which the edge crosses these columns, so that all subpixel positions are equally frequent.
    rows = rows[: round(turns / abs(line[0]))]
    distance = (np.arange(plane.shape[1]) - np.polyval(line, rows)[:, None]) * np.cos(angle)
    inside = np.abs(distance) < HALF_PROFILE_PIXELS
    number = np.floor((distance[inside] + HALF_PROFILE_PIXELS) * BINS_PER_PIXEL).astype(int)
    count = np.bincount(number, minlength=PROFILE_BINS)
    if not count.min():
        raise EdgeError(
            f"the picture is too narrow for the edge profile; it must extend at least {HALF_PROFILE_PIXELS:g} "
            "pixels beyond the edge on both sides"
        )
    profile = np.bincount(number, plane[: len(rows)][inside], PROFILE_BINS) / count
    ends = np.minimum(np.arange(1, PROFILE_BINS), np.arange(1, PROFILE_BINS)[::-1]) / (TAPER * BINS_PER_PIXEL)
    spread = np.diff(profile) * np.sin(np.pi / 2 * np.minimum(ends, 1.0)) ** 2
    spectrum = np.abs(np.fft.rfft(spread, 2 * PROFILE_BINS))[: FREQUENCIES.size]
    return Sharpness(
        FREQUENCIES, spectrum / spectrum[0] / np.sinc(FREQUENCIES / BINS_PER_PIXEL) ** 2, float(np.degrees(angle))
    )


DARK_SIDE, BRIGHT_SIDE = 0.1, 0.4  # reflectances on the two sides of an edge, in the ratio 1:4 of ISO 12233
ANGLE, SIDE = 5.0, 192  # slant of the edge in degrees, and side of the frames in pixels
EDGE_FRAME_WHITE = 0.8  # signal of a perfect white in edge frames, as a fraction of full scale
GREY, EXPOSURE = 0.18, 1 / 15  # reflectance of the grey target, and exposure time of its frames in s
LIGHT = "D65"
SNR = 10.0  # SNR10 is the illuminance at which the signal-to-noise ratio reaches this value
OCTAVES = np.arange(-6.0, 3.0)  # illuminances of the grey target, in octaves relative to the camera's SNR10
RAW_SIDE, GREY_SIDE = 400, 160  # pixels; sides of the raw frames of the grey target, and of the rendered area
KNOWN = "lens and pixel"  # name of the theoretical MTF curve, for a diffraction-limited lens and the pixel aperture
DRAWN = 8  # number of random cameras
CORRELATED = 30.0  # nm; correlation length of the errors in the random cameras' responsivity curves
SIGMAS_95 = 1.96  # half width of a 95 % confidence band, in standard deviations
PATCHES = 4, 6  # rows and columns of the chart that the random cameras photograph
MARGIN_PIXELS = 24  # margin of a frame that is not evaluated


@dataclass(frozen=True)
class GreyNoise:
    """Theoretical signal-to-noise ratio of a grey target in each channel of a camera.

    At a signal of S DN, the noise variance is constant + linear · S + quadratic · S².
    """

    per_lux: Array  # (channel) DN/lux
    constant: Array  # (channel) DN²
    linear: Array  # (channel) DN
    quadratic: float
    top: float  # DN; full scale

    @classmethod
    def of(cls, camera: CameraModel, frame: TrainingFrame) -> "GreyNoise":
        """Compute the noise of a target with the reflectance GREY, for a frame's illuminant and exposure time.

        Raises ValueError if the dark current alone saturates a pixel.
        """
        assert frame.light is not None
        white, falling = lit_library(frame.light)
        electrons = electrons_of(camera, frame.light, white[:1] * falling)[0] * GREY / np.pi * frame.exposure
        dark, channel = camera.dark_signal(frame.exposure), np.arange(len(camera.channels))
        constant, linear, quadratic = camera.noise_terms(dark, channel)
        span = camera.white_level - camera.black_level
        signal = electrons * camera.gain * camera.channel_gains * span / (span - dark)
        ones = np.ones(channel.size)
        return cls(signal, constant * ones, linear * ones, quadratic, span)

    def snr(self, lux: Array) -> Array:
        """Return the signal-to-noise ratios (lux, channel) at illuminances `lux`."""
        signal = np.asarray(lux)[:, None] * self.per_lux
        return np.asarray(signal / np.sqrt(self.constant + (self.linear + self.quadratic * signal) * signal))

    def lux(self) -> list[float | None]:
        """Return the illuminance in lux at which each channel reaches the signal-to-noise ratio SNR.

        The signal S there solves S² = SNR² · (constant + linear · S + quadratic · S²). The result is None if photo-response
        nonuniformity limits the ratio to lower values, or if the channel saturates first or does not respond to the
        illuminant.
        """
        found: list[float | None] = []
        for per_lux, constant, linear in zip(self.per_lux, self.constant, self.linear, strict=True):
            rest = 1.0 - SNR**2 * self.quadratic
            half = SNR**2 * linear / 2
            signal = (half + math.sqrt(half**2 + SNR**2 * constant * rest)) / rest if rest > 0 else math.inf
            found.append(float(signal / per_lux) if signal < self.top and per_lux > 0 else None)
        return found


def measured_snr(plane: Array) -> float:
    """Return the SNR in a picture of a uniform target: the mean divided by the standard deviation, or 0 if negative."""
    return max(float(plane.mean() / max(plane.std(), 1e-30)), 0.0)


def crossing(lux: Array, snr: Array) -> float | None:
    """Return the illuminance in lux above which all measured signal-to-noise ratios are at least `SNR`.

    It is interpolated on logarithmic scales between the last measured ratio below `SNR` and the next. The result is None if
    the illuminance is outside the measured range, or if the ratio below `SNR` is 0.
    """
    below = np.flatnonzero(snr < SNR)
    if not below.size or below[-1] == len(lux) - 1 or not snr[below[-1]] > 0:
        return None
    at = np.s_[below[-1] : below[-1] + 2]
    return float(np.exp(np.interp(np.log(SNR), np.log(snr[at]), np.log(lux[at]))))


def known_sharpness(camera: CameraModel, wavelength: Array, weights: Array) -> Sharpness:
    """Compute the theoretical MTF of a diffraction-limited lens and the pixel aperture, across an edge with the slant ANGLE.

    Parameters
    ----------
    camera : CameraModel
        The camera.
    wavelength : ndarray, (wavelength,)
        Wavelengths in nm at which the lens MTF is computed.
    weights : ndarray, (wavelength,)
        Weight of each wavelength in the mean lens MTF.
    """
    lens = diffraction_transfer(FREQUENCIES / camera.pixel_pitch, wavelength, camera.optics.f_number)
    pixel = np.sinc(FREQUENCIES * np.cos(np.radians(ANGLE))) * np.sinc(FREQUENCIES * np.sin(np.radians(ANGLE)))
    return Sharpness(FREQUENCIES, lens @ weights / weights.sum() * np.abs(pixel), ANGLE)


def brightness(planes: Array, outputs: tuple[str, ...]) -> Array:
    """Return the brightness (row, col) of outputs (output, row, col), without the margin.

    This is Y or S0 if available, otherwise the mean of all outputs.
    """
    name = luminance_name(outputs)
    plane = planes[outputs.index(name)] if name in outputs else planes.mean(axis=0)
    return np.asarray(plane[MARGIN_PIXELS:-MARGIN_PIXELS, MARGIN_PIXELS:-MARGIN_PIXELS], np.float64)


def edge_document(planes: dict[str, Array], known: tuple[CameraModel, Array, Array], across: str) -> dict[str, Any]:
    """Measure each pipeline's MTF, and compute the theoretical MTF of the lens and the pixel aperture.

    Parameters
    ----------
    planes : dict of str to ndarray, (row, col)
        Brightness of each pipeline's picture of an edge.
    known : tuple
        Arguments of `known_sharpness`: camera, wavelengths and weights.
    across : str
        "rows" if the edge is nearly vertical, "columns" if it is nearly horizontal.

    Returns
    -------
    dict
        Keys "frequency" (cycles/pixel), "mtf" and "mtf50" (cycles/pixel). The last two have an entry for each pipeline and
        for "lens and pixel". Both entries are None if no edge can be measured. "mtf50" is also None if the MTF never falls
        below 0.5.
    """
    curves: dict[str, Sharpness | None] = {KNOWN: known_sharpness(*known)}
    for name, plane in planes.items():
        try:
            curves[name] = edge_sharpness(plane if across == "rows" else plane.T)
        except EdgeError:
            curves[name] = None
    return {
        "frequency": FREQUENCIES.tolist(),
        "mtf": {name: curve and curve.transfer.tolist() for name, curve in curves.items()},
        "mtf50": {name: curve and curve.mtf50 for name, curve in curves.items()},
    }


def grey_document(camera: CameraModel, noise: GreyNoise, lux: Array, raw: Array, snr: dict[str, Array]) -> dict[str, Any]:
    """Collect the signal-to-noise ratios of a grey target, and the illuminances at which they reach 10 (SNR10).

    Parameters
    ----------
    camera : CameraModel
        Camera that photographs the target.
    noise : GreyNoise
        Theoretical noise of the camera.
    lux : ndarray, (lux)
        Illuminances in lux.
    raw : ndarray, (lux, channel)
        Signal-to-noise ratios measured in raw frames.
    snr : dict of str to ndarray, (lux)
        Signal-to-noise ratios of the brightness, measured in the pictures of each pipeline.
    """
    closed, names = noise.snr(lux), camera.channels
    return {
        "reflectance": GREY, "light": LIGHT, "exposure": EXPOSURE, "f_number": camera.optics.f_number,
        "pixel_pitch": camera.pixel_pitch, "lux": lux.tolist(),
        "closed_form": {name: closed[:, index].tolist() for index, name in enumerate(names)},
        "raw": {name: raw[:, index].tolist() for index, name in enumerate(names)},
        "pipelines": {name: each.tolist() for name, each in snr.items()},
        "snr10": {
            "closed_form": dict(zip(names, noise.lux(), strict=True)),
            "raw": {name: crossing(lux, raw[:, index]) for index, name in enumerate(names)},
            **{name: crossing(lux, each) for name, each in snr.items()},
        },
    }  # fmt: skip


def drawn_cameras(camera: CameraModel, rng: np.random.Generator) -> list[CameraModel]:
    """Draw random cameras whose responsivity curves deviate from `camera` as its 95 % confidence bands predict.

    The deviations are normally distributed and independent between channels. Their correlation at a wavelength difference of
    CORRELATED is exp(−1/2).
    """
    distance = np.subtract.outer(camera.wavelength, camera.wavelength) / CORRELATED
    values, vectors = np.linalg.eigh(np.exp(-0.5 * distance**2))
    smooth = vectors * np.sqrt(np.maximum(values, 0.0))
    errors = rng.standard_normal((DRAWN, len(camera.channels), camera.wavelength.size)) @ smooth.T
    curves = np.maximum(camera.responsivity + camera.responsivity_band / SIGMAS_95 * errors, 0.0)
    return [dataclasses.replace(camera, responsivity=np.minimum(each, 1.0) if camera.absolute else each) for each in curves]


def patch_means(planes: Array) -> Array:
    """Average the central part of each chart patch. The chart fills `planes` (output, row, col).

    The result has the axes (output, patch).
    """
    rows, cols = PATCHES
    tall, wide = planes.shape[1] // rows, planes.shape[2] // cols
    cells = planes.reshape(len(planes), rows, tall, cols, wide)[:, :, tall // 4 : -(tall // 4), :, wide // 4 : -(wide // 4)]
    return np.asarray(cells.mean(axis=(2, 4)).reshape(len(planes), -1))


def colour_differences(xyz: Array, of_camera: Array, white: Array) -> Array:
    """Return the CIEDE2000 difference (patch,) between two cameras' pictures of a chart.

    Parameters
    ----------
    xyz, of_camera : ndarray, (3, patch)
        XYZ of the patches in each picture. `xyz` is first scaled to the mean luminance of `of_camera`.
    white : ndarray, (3,)
        XYZ of a perfect white.
    """
    same = xyz * (of_camera[1].sum() / xyz[1].sum())
    return delta_e_2000(*(lab(each.T / white[1], white / white[1]) for each in (same, of_camera)))


def figures_of(document: dict[str, Any]) -> dict[str, dict[str, float | None]]:
    """Return each pipeline's MTF50 along rows and columns, SNR10 and `camera_delta_e`.

    `camera_delta_e` is the CIEDE2000 difference due to the uncertainty of the responsivity curves, or None if the curves
    have no confidence band. SNR10 is None if the curves are not absolute, or if it cannot be measured.
    """
    edge, grey, chart = document["edge"], document["grey"], document["chart"]
    return {
        name: {
            "mtf50_rows": edge["rows"]["mtf50"][name],
            "mtf50_columns": edge["columns"]["mtf50"][name],
            "snr10": grey["snr10"][name] if grey else None,
            "camera_delta_e": chart["delta_e"][name] if chart else None,
        }
        for name in edge["rows"]["mtf50"]
        if name != KNOWN
    }
