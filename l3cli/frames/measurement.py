"""Lab measurements: what calibration is given, whoever took them, a real lab or the virtual one.

Frames are gone through one by one, each time from their files, so that memory never grows with their number.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.camera import CameraModel, Noise, Optics, Readout
from l3cli.frames.frame import RawFrame
from l3cli.physics.lens import relative_illumination

CHART_ROWS, CHART_COLS = 4, 6
PATCHES = CHART_ROWS * CHART_COLS
PATCH_NAMES = (
    "dark skin", "light skin", "blue sky", "foliage", "blue flower", "bluish green",
    "orange", "purplish blue", "moderate red", "purple", "yellow green", "orange yellow",
    "blue", "green", "red", "yellow", "magenta", "cyan",
    "white 9.5", "neutral 8", "neutral 6.5", "neutral 5", "neutral 3.5", "black 2",
)  # fmt: skip
DIODE = {  # other names of a sweep's columns
    **dict.fromkeys(("diode", "photodiode", "photodiode light"), "diode light"),
    **dict.fromkeys(("dark", "photodiode dark"), "diode dark"),
}


@dataclass(frozen=True)
class Body:
    """The part of a camera that is known without measuring."""

    name: str
    rows: int
    cols: int
    pixel_pitch: float  # m
    bits: int
    channels: tuple[str, ...]
    cfa: NDArray[np.uint8]  # (cfa_row, cfa_col) channel of each site
    optics: Optics
    readout: Readout | None = None  # settings of the captures, read noise not yet known; None: all channels alike

    @property
    def channel_gains(self) -> NDArray[np.float64]:
        """Return the conversion gain (channel) over that of the camera."""
        return np.ones(len(self.channels)) if self.readout is None else self.readout.channel_gain

    @property
    def channel_exposures(self) -> NDArray[np.float64]:
        """Return the exposure time (channel) over that of the frame."""
        return np.ones(len(self.channels)) if self.readout is None else self.readout.channel_exposure

    @property
    def photons_per_radiance(self) -> float:
        """Return in m² sr the photons/s on a pixel's area for a radiance of 1 photon/s/sr/m² (docs/method.md#optics)."""
        return self.optics.irradiance_per_radiance * self.pixel_pitch**2

    @property
    def relative_illumination(self) -> NDArray[np.float64]:
        """Return the light (row, col) of an even scene over that on the axis (docs/method.md#optics)."""
        return relative_illumination(self.optics.image_distance, self.pixel_pitch, (self.rows, self.cols))


@dataclass(frozen=True)
class Capture:
    """Frames of one scene at one exposure: dark (lens cap) or white (even light) as they stand."""

    name: str  # what errors call it: its first frame, as the measurement file names it
    exposure: float  # s
    frames: Iterable[NDArray[np.uint16]]  # each (row, col) DN; may be gone through more than once
    monitor: float = field(default=1.0, kw_only=True)  # the lamp's light over that of its measured spectrum

    @property
    def lit(self) -> float:
        """Return the seconds of the measured light that the capture amounts to."""
        return self.exposure * self.monitor


@dataclass(frozen=True)
class MonoCapture(Capture):
    """An even field lit by one step of a monochromator, with its measured spectrum, bandwidth and stray light included."""

    wavelength: NDArray[np.float64]  # (wavelength) nm
    radiance: NDArray[np.float64]  # (wavelength) photons/s/sr/m²/nm
    absolute: bool = field(default=True, kw_only=True)  # whether the scale of the radiance is known, too


@dataclass(frozen=True)
class ChartCapture(Capture):
    """A 4 × 6 ColorChecker with the measured radiance of every patch."""

    illuminant: str
    corners: NDArray[np.float64]  # (4, 2) col, row in pixels: outer corners of patch 1, 6, 24, 19 (clockwise from dark skin)
    wavelength: NDArray[np.float64]  # (wavelength) nm
    radiance: NDArray[np.float64]  # (24, wavelength) photons/s/sr/m²/nm, row by row from dark skin to black


@dataclass(frozen=True)
class BandCapture(ChartCapture):
    """A ColorChecker behind a narrow filter at one of several exposures; its radiance need only be relative."""


@dataclass(frozen=True)
class SweepTable:
    """Means of a monochromator sweep beside a photodiode, dark readings taken at every step."""

    wavelength: NDArray[np.float64]  # (wavelength) nm
    light: NDArray[np.float64]  # (channel, wavelength) DN
    dark: NDArray[np.float64]  # (channel, wavelength) DN
    diode_light: NDArray[np.float64]  # (wavelength) reading of the photodiode, any unit
    diode_dark: NDArray[np.float64]  # (wavelength)
    diode_response: NDArray[np.float64]  # (wavelength) reading per energy, any unit


@dataclass(frozen=True)
class FinishedCurves:
    """Responsivities that somebody else measured, relative, per photon."""

    wavelength: NDArray[np.float64]  # (wavelength) nm
    responsivity: NDArray[np.float64]  # (channel, wavelength)
    note: str | None = None  # on columns of the file that are left out


@dataclass(frozen=True)
class CurveStatistics:
    """Curves of measured cameras in few numbers: per photon, each channel scaled to a peak of 1."""

    wavelength: NDArray[np.float64]  # (wavelength) nm
    mean: NDArray[np.float64]  # (channel, wavelength)
    modes: NDArray[np.float64]  # (mode, channel, wavelength) principal modes, each by its standard deviation
    log_peak: NDArray[np.float64]  # (channel) mean natural logarithm of the peak over the geometric mean of all channels
    log_peak_covariance: NDArray[np.float64]  # (channel, channel)


@dataclass(frozen=True)
class Chart:
    """A chart whose reflectances are known."""

    name: str
    grid: tuple[int, int]  # rows, columns of patches
    wavelength: NDArray[np.float64]  # (wavelength) nm
    reflectance: NDArray[np.float64]  # (patch, wavelength), row by row


@dataclass(frozen=True)
class PhotoCapture:
    """Raw frames of a chart under one light, at one exposure."""

    name: str  # what errors call it
    frames: tuple[RawFrame, ...]
    chart: Chart
    light: str | None  # its name; None: to be guessed
    wavelength: NDArray[np.float64]  # (light_wavelength) nm
    radiance: NDArray[np.float64]  # (light_wavelength) relative photon radiance; unused where the light is to be guessed
    corners: NDArray[np.float64] | None  # (4, 2) as of ChartCapture; None: to be found
    darks: tuple[RawFrame, ...] = ()  # without light, at the same exposure
    whites: tuple[RawFrame, ...] = ()  # an even white in the chart's place, under the same light


@dataclass(frozen=True)
class SensorFigures:
    """Figures of a camera model's sensor, measured or from a data sheet."""

    gain: float  # DN/e-
    black_level: float  # DN
    white_level: float  # DN
    noise: Noise


@dataclass(frozen=True)
class GainCaptures:
    """Dark and white frames at another analog gain than the camera's."""

    iso: float
    darks: tuple[Capture, ...]
    whites: tuple[Capture, ...]


@dataclass(frozen=True)
class Measurements:
    """All that was measured of one camera, and how well the lights were known.

    Responsivity comes from one of `mono`, `bands`, `curve` and `photos`; the sensor from `darks` and `whites`, or else from
    `datasheet`, or else from the photos; with a `base`, all but defects and flat field from that.
    """

    body: Body
    mono: tuple[MonoCapture, ...] = ()
    charts: tuple[ChartCapture, ...] = ()
    darks: tuple[Capture, ...] = ()
    whites: tuple[Capture, ...] = ()
    iso: float | None = None  # of `darks` and `whites`; None: not stated
    gains: tuple[GainCaptures, ...] = ()  # at higher ISO speeds
    bands: tuple[BandCapture, ...] = ()
    curve: SweepTable | FinishedCurves | None = None
    photos: tuple[PhotoCapture, ...] = ()
    cameras: CurveStatistics | tuple[FinishedCurves, ...] | None = None  # what is known of curves before a photo is taken
    datasheet: SensorFigures | None = None
    base: CameraModel | None = None  # all but its defects and flat field is known, for which `darks` and `whites` are
    lamp_drift: float = 0.0  # relative standard deviation between a light and its measured spectrum
    wavelength_uncertainty: float = 0.0  # nm, standard deviation of the spectrometer's scale


@dataclass(frozen=True)
class StatedMatrix:
    """From XYZ of a surface under a light to what the camera collects."""

    light: str  # its name
    assumed: bool  # whether the file does not name it
    rows: dict[int, NDArray[np.float64]]  # colour code → (3) its row

    def of(self, codes: Sequence[int | None]) -> NDArray[np.float64]:
        """Return the rows (channel, 3) of these colours."""
        return np.array([self.rows[code] for code in codes if code is not None])


@dataclass(frozen=True)
class Stated:
    """Facts that a raw file states about its camera; None and "" where it does not."""

    camera: str  # make and model
    matrices: tuple[StatedMatrix, ...]
    noise: tuple[float, float] | None  # variance = slope · signal + constant, as shares of full scale above black
    iso: float | None
    pitch_um: float | None
    focal_length_mm: float | None
    f_number: float | None


@dataclass(frozen=True)
class CaptureFolder:
    """The files of a folder, each path relative to it."""

    folder: Path
    frames: tuple[str, ...]
    tables: tuple[str, ...]
    notes: tuple[str, ...]  # a line for each kind of file that is left out


@dataclass(frozen=True)
class RawFile:
    """A raw frame and what its file states of it."""

    values: NDArray[np.uint16]  # (row, col) DN as stored, never developed
    seconds: float | None
    pattern: NDArray[np.int64] | None  # codes of the array
    black_level: float | None  # DN
    white_level: float | None  # DN
    count: int = 1  # frames of the file, of which this is the first
