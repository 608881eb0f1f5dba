"""Lab measurements: the input of calibration, from a real lab or from the virtual one.

Frames are read one by one, and again for each pass, so that memory does not grow with their number.
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
DIODE = {  # alternative names of a sweep's columns
    **dict.fromkeys(("diode", "photodiode", "photodiode light"), "diode light"),
    **dict.fromkeys(("dark", "photodiode dark"), "diode dark"),
}


@dataclass(frozen=True)
class Body:
    """What is known about a camera without measuring."""

    name: str
    rows: int
    cols: int
    pixel_pitch: float  # m
    bits: int
    channels: tuple[str, ...]
    cfa: NDArray[np.uint8]  # (cfa_row, cfa_col) channel of each site
    optics: Optics
    readout: Readout | None = None  # exposure and gain of each channel, without read noise; None: all channels alike

    @property
    def channel_gains(self) -> NDArray[np.float64]:
        """Conversion gain (channel), relative to the camera's."""
        return np.ones(len(self.channels)) if self.readout is None else self.readout.channel_gain

    @property
    def channel_exposures(self) -> NDArray[np.float64]:
        """Exposure time (channel), relative to the frame's."""
        return np.ones(len(self.channels)) if self.readout is None else self.readout.channel_exposure

    @property
    def photons_per_radiance(self) -> float:
        """Photons/s on a pixel's area for a radiance of 1 photon/s/sr/m², in m² sr (docs/method.md#optics)."""
        return self.optics.irradiance_per_radiance * self.pixel_pitch**2

    @property
    def relative_illumination(self) -> NDArray[np.float64]:
        """Light (row, col) of a uniform scene, relative to the axis (docs/method.md#optics)."""
        return relative_illumination(self.optics.image_distance, self.pixel_pitch, (self.rows, self.cols))


@dataclass(frozen=True)
class Capture:
    """Frames of one scene at one exposure: dark (lens cap) or white (uniform light)."""

    name: str  # for messages: its first frame, as named in the measurement file
    exposure: float  # s
    frames: Iterable[NDArray[np.uint16]]  # each (row, col) DN; can be iterated repeatedly
    monitor: float = field(default=1.0, kw_only=True)  # light of the lamp, relative to its measured spectrum

    @property
    def lit(self) -> float:
        """Exposure time in s under the measured light that would give the same exposure."""
        return self.exposure * self.monitor


@dataclass(frozen=True)
class MonoCapture(Capture):
    """A uniform field lit by one step of a monochromator. The measured spectrum includes bandwidth and stray light."""

    wavelength: NDArray[np.float64]  # (wavelength) nm
    radiance: NDArray[np.float64]  # (wavelength) photons/s/sr/m²/nm
    absolute: bool = field(default=True, kw_only=True)  # whether the scale of the radiance is known


@dataclass(frozen=True)
class ChartCapture(Capture):
    """A 4 × 6 ColorChecker with the measured radiance of every patch."""

    illuminant: str
    corners: NDArray[np.float64]  # (4, 2) col, row in pixels: outer corners of patch 1, 6, 24, 19 (clockwise from dark skin)
    wavelength: NDArray[np.float64]  # (wavelength) nm
    radiance: NDArray[np.float64]  # (24, wavelength) photons/s/sr/m²/nm, row by row from dark skin to black


@dataclass(frozen=True)
class BandCapture(ChartCapture):
    """A ColorChecker behind a narrow-band filter, at one of several exposures. Its radiance may be relative."""


@dataclass(frozen=True)
class SweepTable:
    """Mean values of a monochromator sweep and of a photodiode beside the camera, with dark readings at every step."""

    wavelength: NDArray[np.float64]  # (wavelength) nm
    light: NDArray[np.float64]  # (channel, wavelength) DN
    dark: NDArray[np.float64]  # (channel, wavelength) DN
    diode_light: NDArray[np.float64]  # (wavelength) reading of the photodiode, any unit
    diode_dark: NDArray[np.float64]  # (wavelength)
    diode_response: NDArray[np.float64]  # (wavelength) reading per energy, any unit


@dataclass(frozen=True)
class FinishedCurves:
    """Responsivities measured by somebody else, relative and per photon."""

    wavelength: NDArray[np.float64]  # (wavelength) nm
    responsivity: NDArray[np.float64]  # (channel, wavelength)
    note: str | None = None  # names columns of the file that were ignored


@dataclass(frozen=True)
class CurveStatistics:
    """Statistics of the curves of measured cameras: per photon, each channel scaled to a peak of 1."""

    wavelength: NDArray[np.float64]  # (wavelength) nm
    mean: NDArray[np.float64]  # (channel, wavelength)
    modes: NDArray[np.float64]  # (mode, channel, wavelength) principal modes, each by its standard deviation
    log_peak: NDArray[np.float64]  # (channel) mean natural logarithm of the peak over the geometric mean of all channels
    log_peak_covariance: NDArray[np.float64]  # (channel, channel)


@dataclass(frozen=True)
class Chart:
    """A chart with known reflectances."""

    name: str
    grid: tuple[int, int]  # rows, columns of patches
    wavelength: NDArray[np.float64]  # (wavelength) nm
    reflectance: NDArray[np.float64]  # (patch, wavelength), row by row

    def __post_init__(self) -> None:
        patches, (rows, cols) = len(self.reflectance), self.grid
        if patches != rows * cols:
            raise ValueError(f"{self.name} has {patches} patches, but layout = [{rows}, {cols}] has {rows * cols}")


@dataclass(frozen=True)
class PhotoCapture:
    """Raw frames of a chart under one light and at one exposure."""

    name: str  # for messages
    frames: tuple[RawFrame, ...]
    chart: Chart
    light: str | None  # name of the light; None if it has to be guessed
    wavelength: NDArray[np.float64]  # (light_wavelength) nm
    radiance: NDArray[np.float64]  # (light_wavelength) relative photon radiance; not used if the light is guessed
    corners: NDArray[np.float64] | None  # (4, 2) as in ChartCapture; None if they have to be found
    darks: tuple[RawFrame, ...] = ()  # without light, at the same exposure
    whites: tuple[RawFrame, ...] = ()  # a uniform white in place of the chart, under the same light

    def __post_init__(self) -> None:
        first, *others = (*self.frames, *self.darks, *self.whites)
        for frame in others:
            if frame.values.shape != first.values.shape or frame.phase != first.phase:
                raise ValueError(f"{frame.name} has another size or phase than {first.name}; give frames of one camera")


@dataclass(frozen=True)
class SensorFigures:
    """Sensor data of a camera model, measured or from a data sheet."""

    gain: float  # DN/e-
    black_level: float  # DN
    white_level: float  # DN
    noise: Noise


@dataclass(frozen=True)
class GainCaptures:
    """Dark and white frames at another analog gain."""

    iso: float
    darks: tuple[Capture, ...]
    whites: tuple[Capture, ...]


@dataclass(frozen=True)
class Measurements:
    """All measurements of one camera, and how well the lights are known.

    The responsivity comes from one of `mono`, `bands`, `curve` and `photos`. The sensor data come from `darks` and
    `whites`, or otherwise from `datasheet`, or otherwise from the photos. With a `base`, only defects and flat field are
    measured, and everything else comes from the base.
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
    cameras: CurveStatistics | tuple[FinishedCurves, ...] | None = None  # prior knowledge of curves, for photos
    datasheet: SensorFigures | None = None
    base: CameraModel | None = None  # a known camera, of which `darks` and `whites` only give defects and flat field
    lamp_drift: float = 0.0  # relative standard deviation between a light and its measured spectrum
    wavelength_uncertainty: float = 0.0  # nm, standard deviation of the spectrometer's scale


@dataclass(frozen=True)
class StatedMatrix:
    """A matrix from the XYZ of a surface under a light to the camera's signals."""

    light: str  # name of the light
    assumed: bool  # whether the light is assumed, because the file does not name it
    rows: dict[int, NDArray[np.float64]]  # colour code → row (3) of the matrix

    def of(self, codes: Sequence[int | None]) -> NDArray[np.float64]:
        """Return the rows (channel, 3) for these colours."""
        return np.array([self.rows[code] for code in codes if code is not None])


@dataclass(frozen=True)
class Stated:
    """What a raw file states about its camera; None and "" for what it does not state."""

    camera: str  # make and model
    matrices: tuple[StatedMatrix, ...]
    noise: tuple[float, float] | None  # slope and constant of variance over signal, as fractions of full scale above black
    iso: float | None
    pitch_um: float | None
    focal_length_mm: float | None
    f_number: float | None


@dataclass(frozen=True)
class CaptureFolder:
    """The files of a folder, with paths relative to it."""

    folder: Path
    frames: tuple[str, ...]
    tables: tuple[str, ...]
    notes: tuple[str, ...]  # one line per kind of file that is ignored


@dataclass(frozen=True)
class RawFile:
    """A raw frame and what its file states about it."""

    values: NDArray[np.uint16]  # (row, col) DN as stored, never developed
    seconds: float | None
    pattern: NDArray[np.int64] | None  # colour codes of the array
    black_level: float | None  # DN
    white_level: float | None  # DN
    count: int = 1  # number of frames in the file, of which this is the first
