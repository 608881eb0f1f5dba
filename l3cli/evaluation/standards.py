"""Metrics from standards: sharpness of slanted edges, and signal-to-noise ratio of a grey against lux (docs/measurement.md).

Measurements on pictures are accompanied by the values that lens, pixel and camera noise imply in closed form.
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
BINS = 4  # bins of the edge profile per pixel
REACH = 48.0  # pixels, half length of the profile; a lens spreads light this far
TAPER = 8.0  # pixels at either end over which the profile's slope is tapered
SEARCHED = 6.0  # pixels on either side of the first line within which each row's edge is searched
TOP = 1.0  # cycles/pixel, end of the curves
HALF = 0.5  # transfer that defines MTF50
SIZE = int(2 * REACH * BINS)  # number of bins
FREQUENCIES = np.fft.rfftfreq(2 * SIZE, 1 / BINS)
FREQUENCIES = FREQUENCIES[FREQUENCIES <= TOP]  # (sample) cycles/pixel of every curve


class EdgeError(ValueError):
    """Raised if a plane has no edge that can be measured."""


@dataclass(frozen=True)
class Sharpness:
    """Modulation transfer function across an edge."""

    frequency: Array  # (sample) cycles/pixel across the edge, from 0
    transfer: Array  # (sample), 1 at frequency 0
    angle: float  # degrees between the edge and the columns of the plane

    @property
    def mtf50(self) -> float | None:
        """Lowest frequency in cycles/pixel at which the transfer is one half. None if it stays above."""
        below = np.flatnonzero(self.transfer < HALF)
        if not below.size:
            return None
        at = np.s_[below[0] - 1 : below[0] + 1]
        return float(np.interp(-HALF, -self.transfer[at], self.frequency[at]))


def edge_sharpness(plane: Array) -> Sharpness:
    """Measure the sharpness of a straight edge, 2° to 15° from the vertical.

    Parameters
    ----------
    plane : ndarray, (row, col)
        Values linear in light.

    Raises
    ------
    EdgeError
        If the plane has no such edge.

    Notes
    -----
    The edge is the line through the centroids of the slope of each row. Pixels are averaged in bins of a quarter pixel by
    their distance from the line. The transfer is the spectrum of the slope of this profile, corrected for the bins and the
    finite differences.
    """
    plane = np.asarray(plane, np.float64)
    slope = np.abs(np.diff(plane, axis=1))
    rows, place = np.arange(len(plane)), np.arange(slope.shape[1]) + 0.5
    if not slope.sum(axis=1).min() > 0:
        raise EdgeError("no edge crosses every row of the plane")
    line, reach = np.array([0.0, slope.sum(axis=0) @ place / slope.sum()]), np.inf
    for _ in range(4):
        weight = np.where(np.abs(place - np.polyval(line, rows)[:, None]) < reach, slope, 0.0)
        crossed = weight.any(axis=1)
        if crossed.sum() < len(rows) / 2:
            raise EdgeError("no straight edge crosses the rows of the plane")
        at = (weight[crossed] @ place) / weight[crossed].sum(axis=1)
        line, reach = np.polyfit(rows[crossed], at, 1), SEARCHED
    angle = np.arctan(line[0])
    if not 2.0 <= abs(np.degrees(angle)) <= 15.0:
        raise EdgeError(f"the edge is {abs(np.degrees(angle)):.2g}° from the vertical, not 2° to 15°")
    turns = int(len(rows) * abs(line[0]))  # number of times that the edge moves by a whole column
    rows = rows[: round(turns / abs(line[0]))]  # a whole number of turns contains all phases equally often
    distance = (np.arange(plane.shape[1]) - np.polyval(line, rows)[:, None]) * np.cos(angle)
    inside = np.abs(distance) < REACH
    number = np.floor((distance[inside] + REACH) * BINS).astype(int)
    count = np.bincount(number, minlength=SIZE)
    if not count.min():
        raise EdgeError(f"the plane does not reach {REACH:g} pixels beyond the edge on both sides in every phase")
    profile = np.bincount(number, plane[: len(rows)][inside], SIZE) / count
    ends = np.minimum(np.arange(1, SIZE), np.arange(1, SIZE)[::-1]) / (TAPER * BINS)
    spread = np.diff(profile) * np.sin(np.pi / 2 * np.minimum(ends, 1.0)) ** 2
    spectrum = np.abs(np.fft.rfft(spread, 2 * SIZE))[: FREQUENCIES.size]
    return Sharpness(FREQUENCIES, spectrum / spectrum[0] / np.sinc(FREQUENCIES / BINS) ** 2, float(np.degrees(angle)))


DARK_SIDE, BRIGHT_SIDE = 0.1, 0.4  # reflectances on both sides of an edge, 4:1 as in ISO 12233
ANGLE, SIDE = 5.0, 192  # degrees, slant of the edge; pixels, side of a frame
EXPOSED = 0.8  # fraction of full scale of a perfect white in the frames of edges
GREY, EXPOSURE = 0.18, 1 / 15  # reflectance and exposure time (s) of the grey
LIGHT = "D65"
SNR = 10.0  # signal-to-noise ratio that defines SNR10
OCTAVES = np.arange(-6.0, 3.0)  # octaves of lux, relative to the camera's SNR10, at which greys are taken
RAW_SIDE, GREY_SIDE = 400, 160  # pixels, sides of the raw frames of greys and of the part that is rendered
KNOWN = "lens and pixel"  # name of the curve of an ideal lens and pixel
DRAWN, CORRELATED, SIGMAS_95 = 8, 30.0, 1.96  # number of cameras; correlation length, nm; half width of a 95 % band in σ
PATCHES = 4, 6  # rows and columns of the chart for drawn cameras
MARGIN = 24  # pixels left out at each edge of a frame


@dataclass(frozen=True)
class GreyNoise:
    """Signal-to-noise ratio of a grey in each channel of a camera, in closed form.

    `per_lux` (channel) is the signal in DN per lux. The noise variance of a signal S is constant (DN²) + linear (DN) · S +
    quadratic · S².
    """

    per_lux: Array
    constant: Array
    linear: Array
    quadratic: float
    top: float  # DN, full scale

    @classmethod
    def of(cls, camera: CameraModel, frame: TrainingFrame) -> "GreyNoise":
        """Return the noise for a grey of reflectance GREY, in the light and exposure time of a frame.

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
        """Return the lux (channel) at which each channel reaches the signal-to-noise ratio s = SNR.

        It is the root of S² = s² (c + l S + q S²). None if PRNU prevents it, or if pixels saturate first.
        """
        found: list[float | None] = []
        for per_lux, constant, linear in zip(self.per_lux, self.constant, self.linear, strict=True):
            rest = 1.0 - SNR**2 * self.quadratic
            half = SNR**2 * linear / 2
            signal = (half + math.sqrt(half**2 + SNR**2 * constant * rest)) / rest if rest > 0 else math.inf
            found.append(float(signal / per_lux) if signal < self.top and per_lux > 0 else None)
        return found


def measured_snr(plane: Array) -> float:
    """Return the mean over the standard deviation of a plane of an even grey, or 0 if the mean is not positive."""
    return max(float(plane.mean() / max(plane.std(), 1e-30)), 0.0)


def crossing(lux: Array, snr: Array) -> float | None:
    """Return the lux from which a measured ratio stays at SNR or above, by logarithmic interpolation.

    Returns None if the measured range does not contain it.
    """
    below = np.flatnonzero(snr < SNR)
    if not below.size or below[-1] == len(lux) - 1 or not snr[below[-1]] > 0:
        return None
    at = np.s_[below[-1] : below[-1] + 2]
    return float(np.exp(np.interp(np.log(SNR), np.log(snr[at]), np.log(lux[at]))))


def known_sharpness(camera: CameraModel, wavelength: Array, weights: Array) -> Sharpness:
    """Return the transfer function of diffraction and pixels across an edge at ANGLE.

    `weights` are the weights of each `wavelength` (nm).
    """
    lens = diffraction_transfer(FREQUENCIES / camera.pixel_pitch, wavelength, camera.optics.f_number)
    pixel = np.sinc(FREQUENCIES * np.cos(np.radians(ANGLE))) * np.sinc(FREQUENCIES * np.sin(np.radians(ANGLE)))
    return Sharpness(FREQUENCIES, lens @ weights / weights.sum() * np.abs(pixel), ANGLE)


def brightness(planes: Array, outputs: tuple[str, ...]) -> Array:
    """Return the luminance (row, col) of a picture without the margin, or the mean of its outputs if there is no Y."""
    plane = planes[outputs.index("Y")] if "Y" in outputs else planes.mean(axis=0)
    return np.asarray(plane[MARGIN:-MARGIN, MARGIN:-MARGIN], np.float64)


def edge_document(planes: dict[str, Array], known: tuple[CameraModel, Array, Array], across: str) -> dict[str, Any]:
    """Return the MTF curves and MTF50 (cycles/pixel) of each pipeline, and of lens and pixel.

    Parameters
    ----------
    planes : dict of str to ndarray, (row, col)
        Pipeline → brightness of an edge.
    known : tuple
        Arguments of `known_sharpness`.
    across : str
        "rows" for a nearly vertical edge, otherwise "columns".

    Returns
    -------
    dict
        Curves are None where a pipeline shows no edge.
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
    """Return the signal-to-noise ratio of a grey at each lux, and the lux at which it reaches SNR.

    Parameters
    ----------
    camera : CameraModel
        The camera.
    noise : GreyNoise
        Its noise in closed form.
    lux : ndarray, (lux)
        Illuminances.
    raw : ndarray, (lux, channel)
        Ratios measured in raw frames.
    snr : dict of str to ndarray, (lux)
        Pipeline → ratio of the brightness.
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
    """Draw DRAWN cameras with curves that scatter around those of `camera` according to their 95 % band.

    Errors of different channels are independent. Errors at wavelengths CORRELATED nm apart have the correlation exp(-1/2).
    """
    distance = np.subtract.outer(camera.wavelength, camera.wavelength) / CORRELATED
    values, vectors = np.linalg.eigh(np.exp(-0.5 * distance**2))
    smooth = vectors * np.sqrt(np.maximum(values, 0.0))
    errors = rng.standard_normal((DRAWN, len(camera.channels), camera.wavelength.size)) @ smooth.T
    curves = np.maximum(camera.responsivity + camera.responsivity_band / SIGMAS_95 * errors, 0.0)
    return [dataclasses.replace(camera, responsivity=np.minimum(each, 1.0) if camera.absolute else each) for each in curves]


def patch_means(planes: Array) -> Array:
    """Return the means (output, patch) of the centres of a chart of PATCHES that fills a frame (output, row, col)."""
    rows, cols = PATCHES
    tall, wide = planes.shape[1] // rows, planes.shape[2] // cols
    cells = planes.reshape(len(planes), rows, tall, cols, wide)[:, :, tall // 4 : -(tall // 4), :, wide // 4 : -(wide // 4)]
    return np.asarray(cells.mean(axis=(2, 4)).reshape(len(planes), -1))


def colour_differences(xyz: Array, of_camera: Array, white: Array) -> Array:
    """Return ΔE00 (patch) between XYZ (3, patch) from two cameras, exposed to the same mean luminance."""
    same = xyz * (of_camera[1].sum() / xyz[1].sum())
    return delta_e_2000(*(lab(each.T / white[1], white / white[1]) for each in (same, of_camera)))


def figures_of(document: dict[str, Any]) -> dict[str, dict[str, float | None]]:
    """Return the metrics of each pipeline: MTF50 along rows and columns, SNR10 and ΔE00 from the camera's uncertainty.

    SNR10 needs absolute curves, the ΔE00 needs curves with a band. Otherwise they are None.
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
