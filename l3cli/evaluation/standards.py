"""Metrics from standards: sharpness of slanted edges, and SNR of a grey as a function of illuminance (docs/measurement.md).

Each measurement on pictures is compared with the value that follows in closed form from lens, pixel and camera noise.
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

Array = NDArray[np.floating]
BINS_PER_PIXEL = 4  # number of bins per pixel in the edge profile
HALF_PROFILE_PIXELS = 48.0  # pixels; half length of the edge profile, as far as a lens spreads light
TAPER = 8.0  # pixels; length at each end over which the slope of the profile is tapered
SEARCHED = 6.0  # pixels; in each row, the edge is searched for within this distance of the first estimate
MAX_FREQUENCY = 1.0  # cycles/pixel; highest frequency of the curves
HALF = 0.5  # value of the MTF that defines MTF50
PROFILE_BINS = int(2 * HALF_PROFILE_PIXELS * BINS_PER_PIXEL)  # number of bins
FREQUENCIES = np.fft.rfftfreq(2 * PROFILE_BINS, 1 / BINS_PER_PIXEL)
FREQUENCIES = FREQUENCIES[FREQUENCIES <= MAX_FREQUENCY]  # (sample) cycles/pixel of every curve


class EdgeError(ValueError):
    """Raised if a plane has no edge that can be measured."""


@dataclass(frozen=True)
class Sharpness:
    """Modulation transfer function across an edge."""

    frequency: Array  # (sample) cycles/pixel across the edge, starting at 0
    transfer: Array  # (sample) MTF, 1 at frequency 0
    angle: float  # degrees between the edge and the columns of the plane

    @property
    def mtf50(self) -> float | None:
        """Lowest frequency, in cycles/pixel, at which the MTF is 0.5. None if it is higher at all frequencies."""
        below = np.flatnonzero(self.transfer < HALF)
        if not below.size:
            return None
        at = np.s_[below[0] - 1 : below[0] + 1]
        return float(np.interp(-HALF, -self.transfer[at], self.frequency[at]))


def edge_sharpness(plane: Array) -> Sharpness:
    """Measure the sharpness of a straight edge that is 2° to 15° from the vertical.

    Parameters
    ----------
    plane : ndarray, (row, col)
        Linear values.

    Raises
    ------
    EdgeError
        If the plane has no such edge.

    Notes
    -----
    The edge is the straight line through the centroids of the slopes of all rows. Pixels are averaged in bins of a quarter
    pixel, according to their distance from this line. The MTF is the spectrum of the slope of the resulting profile,
    corrected for the width of the bins and the finite differences.
    """
    plane = np.asarray(plane, np.float64)
    slope = np.abs(np.diff(plane, axis=1))
    rows, place = np.arange(len(plane)), np.arange(slope.shape[1]) + 0.5
    if not slope.sum(axis=1).min() > 0:
        raise EdgeError("no edge crosses every row of the picture")
    line, reach = np.array([0.0, slope.sum(axis=0) @ place / slope.sum()]), np.inf
    for _ in range(4):
        weight = np.where(np.abs(place - np.polyval(line, rows)[:, None]) < reach, slope, 0.0)
        crossed = weight.any(axis=1)
        if crossed.sum() < len(rows) / 2:
            raise EdgeError("no straight edge crosses the rows of the picture")
        at = (weight[crossed] @ place) / weight[crossed].sum(axis=1)
        line, reach = np.polyfit(rows[crossed], at, 1), SEARCHED
    angle = np.arctan(line[0])
    if not 2.0 <= abs(np.degrees(angle)) <= 15.0:
        raise EdgeError(f"the edge is {abs(np.degrees(angle)):.2g}° from the vertical, not 2° to 15°")
    turns = int(len(rows) * abs(line[0]))  # number of whole columns by which the edge moves
    rows = rows[: round(turns / abs(line[0]))]  # over whole columns, all subpixel phases occur equally often
    distance = (np.arange(plane.shape[1]) - np.polyval(line, rows)[:, None]) * np.cos(angle)
    inside = np.abs(distance) < HALF_PROFILE_PIXELS
    number = np.floor((distance[inside] + HALF_PROFILE_PIXELS) * BINS_PER_PIXEL).astype(int)
    count = np.bincount(number, minlength=PROFILE_BINS)
    if not count.min():
        raise EdgeError(
            f"the picture must extend at least {HALF_PROFILE_PIXELS:g} pixels to both sides of the edge at every sub-pixel "
            "position, and it does not"
        )
    profile = np.bincount(number, plane[: len(rows)][inside], PROFILE_BINS) / count
    ends = np.minimum(np.arange(1, PROFILE_BINS), np.arange(1, PROFILE_BINS)[::-1]) / (TAPER * BINS_PER_PIXEL)
    spread = np.diff(profile) * np.sin(np.pi / 2 * np.minimum(ends, 1.0)) ** 2
    spectrum = np.abs(np.fft.rfft(spread, 2 * PROFILE_BINS))[: FREQUENCIES.size]
    return Sharpness(
        FREQUENCIES, spectrum / spectrum[0] / np.sinc(FREQUENCIES / BINS_PER_PIXEL) ** 2, float(np.degrees(angle))
    )


DARK_SIDE, BRIGHT_SIDE = 0.1, 0.4  # reflectances on the two sides of an edge, 4:1 as in ISO 12233
ANGLE, SIDE = 5.0, 192  # slant of the edge in degrees; side of a frame in pixels
EDGE_FRAME_WHITE = 0.8  # signal of a perfect white in the frames with edges, as a fraction of full scale
GREY, EXPOSURE = 0.18, 1 / 15  # reflectance of the grey, and its exposure time in s
LIGHT = "D65"
SNR = 10.0  # signal-to-noise ratio that defines SNR10
OCTAVES = np.arange(-6.0, 3.0)  # illuminances of the grey, in octaves relative to the camera's SNR10
RAW_SIDE, GREY_SIDE = 400, 160  # pixels; side of a raw frame of the grey, and side of the rendered part
KNOWN = "lens and pixel"  # name of the MTF curve of an ideal lens and pixel
# Number of random cameras, correlation length of their errors in nm, and half width of a 95 % band in standard deviations.
DRAWN, CORRELATED, SIGMAS_95 = 8, 30.0, 1.96
PATCHES = 4, 6  # rows and columns of the chart for random cameras
MARGIN_PIXELS = 24  # pixels; width of the margin that is left out at each edge of a frame


@dataclass(frozen=True)
class GreyNoise:
    """Signal-to-noise ratio of a grey in each channel of a camera, in closed form.

    `per_lux` (channel) is the signal in DN per lux. At signal S, the noise variance is constant + linear · S + quadratic ·
    S², with `constant` in DN² and `linear` in DN.
    """

    per_lux: Array
    constant: Array
    linear: Array
    quadratic: float
    top: float  # DN, full scale

    @classmethod
    def of(cls, camera: CameraModel, frame: TrainingFrame) -> "GreyNoise":
        """Return the noise for a grey of reflectance GREY, at the illuminant and exposure time of a frame.

        Raises ValueError if dark current alone saturates a pixel.
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
        """Return the signal-to-noise ratio (lux, channel)."""
        signal = np.asarray(lux)[:, None] * self.per_lux
        return np.asarray(signal / np.sqrt(self.constant + (self.linear + self.quadratic * signal) * signal))

    def lux(self) -> list[float | None]:
        """Return the illuminance in lux (channel) at which each channel reaches the signal-to-noise ratio SNR.

        With s = SNR and the constant, linear and quadratic terms c, l and q, it follows from S² = s² (c + l S + q S²). It is
        None if PRNU makes this ratio impossible or if pixels saturate first.
        """
        found: list[float | None] = []
        for per_lux, constant, linear in zip(self.per_lux, self.constant, self.linear, strict=True):
            rest = 1.0 - SNR**2 * self.quadratic
            half = SNR**2 * linear / 2
            signal = (half + math.sqrt(half**2 + SNR**2 * constant * rest)) / rest if rest > 0 else math.inf
            found.append(float(signal / per_lux) if signal < self.top and per_lux > 0 else None)
        return found


def measured_snr(plane: Array) -> float:
    """Return the mean divided by the standard deviation of a plane that shows a uniform grey. It is at least 0."""
    return max(float(plane.mean() / max(plane.std(), 1e-30)), 0.0)


def crossing(lux: Array, snr: Array) -> float | None:
    """Return the illuminance in lux above which a measured signal-to-noise ratio stays at SNR or higher.

    It is interpolated logarithmically. The result is None if it lies outside the measured range.
    """
    below = np.flatnonzero(snr < SNR)
    if not below.size or below[-1] == len(lux) - 1 or not snr[below[-1]] > 0:
        return None
    at = np.s_[below[-1] : below[-1] + 2]
    return float(np.exp(np.interp(np.log(SNR), np.log(snr[at]), np.log(lux[at]))))


def known_sharpness(camera: CameraModel, wavelength: Array, weights: Array) -> Sharpness:
    """Return the MTF of diffraction and pixel aperture across an edge with the slant ANGLE.

    `weights` are the weights of the wavelengths, which are in nm.
    """
    lens = diffraction_transfer(FREQUENCIES / camera.pixel_pitch, wavelength, camera.optics.f_number)
    pixel = np.sinc(FREQUENCIES * np.cos(np.radians(ANGLE))) * np.sinc(FREQUENCIES * np.sin(np.radians(ANGLE)))
    return Sharpness(FREQUENCIES, lens @ weights / weights.sum() * np.abs(pixel), ANGLE)


def brightness(planes: Array, outputs: tuple[str, ...]) -> Array:
    """Return the luminance (row, col) of a picture without its margin, or the mean of its outputs if Y is not an output."""
    plane = planes[outputs.index("Y")] if "Y" in outputs else planes.mean(axis=0)
    return np.asarray(plane[MARGIN_PIXELS:-MARGIN_PIXELS, MARGIN_PIXELS:-MARGIN_PIXELS], np.float64)


def edge_document(planes: dict[str, Array], known: tuple[CameraModel, Array, Array], across: str) -> dict[str, Any]:
    """Return the MTF curves and MTF50 (cycles/pixel) of each pipeline, and of lens and pixel.

    Parameters
    ----------
    planes : dict of str to ndarray, (row, col)
        Pipeline → brightness of a picture of an edge.
    known : tuple
        Arguments of `known_sharpness`.
    across : str
        "rows" for a nearly vertical edge, otherwise "columns".

    Returns
    -------
    dict
        Frequencies, and MTF and MTF50 of each pipeline. MTF and MTF50 are None if the picture of the pipeline has no edge.
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
    """Return the signal-to-noise ratio of a grey at each illuminance, and the illuminance at which it reaches SNR.

    Parameters
    ----------
    camera : CameraModel
        The camera.
    noise : GreyNoise
        Its noise in closed form.
    lux : ndarray, (lux)
        Illuminances in lux.
    raw : ndarray, (lux, channel)
        Signal-to-noise ratios measured in raw frames.
    snr : dict of str to ndarray, (lux)
        Pipeline → signal-to-noise ratio of the brightness.
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
    """Draw DRAWN random cameras whose curves vary around the curves of `camera` within their uncertainty (95 % band).

    Errors of different channels are independent. Errors at wavelengths that are CORRELATED nm apart have a correlation of
    exp(-1/2).
    """
    distance = np.subtract.outer(camera.wavelength, camera.wavelength) / CORRELATED
    values, vectors = np.linalg.eigh(np.exp(-0.5 * distance**2))
    smooth = vectors * np.sqrt(np.maximum(values, 0.0))
    errors = rng.standard_normal((DRAWN, len(camera.channels), camera.wavelength.size)) @ smooth.T
    curves = np.maximum(camera.responsivity + camera.responsivity_band / SIGMAS_95 * errors, 0.0)
    return [dataclasses.replace(camera, responsivity=np.minimum(each, 1.0) if camera.absolute else each) for each in curves]


def patch_means(planes: Array) -> Array:
    """Return the mean (output, patch) over the centre of each patch of a chart that fills a frame (output, row, col)."""
    rows, cols = PATCHES
    tall, wide = planes.shape[1] // rows, planes.shape[2] // cols
    cells = planes.reshape(len(planes), rows, tall, cols, wide)[:, :, tall // 4 : -(tall // 4), :, wide // 4 : -(wide // 4)]
    return np.asarray(cells.mean(axis=(2, 4)).reshape(len(planes), -1))


def colour_differences(xyz: Array, of_camera: Array, white: Array) -> Array:
    """Return ΔE00 (patch) between XYZ (3, patch) from two cameras, after scaling to the same mean luminance."""
    same = xyz * (of_camera[1].sum() / xyz[1].sum())
    return delta_e_2000(*(lab(each.T / white[1], white / white[1]) for each in (same, of_camera)))


def figures_of(document: dict[str, Any]) -> dict[str, dict[str, float | None]]:
    """Return the metrics of each pipeline: MTF50 along rows and columns, SNR10, and ΔE00 from the uncertainty of the curves.

    SNR10 is None without absolute curves. ΔE00 is None if the curves have no uncertainty band.
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
