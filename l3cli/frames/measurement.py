"""Lab measurements, which are the input of calibration. They come from a real lab or from the virtual lab.

Frames are read one by one in each pass, so that memory does not grow with their number.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.camera import CameraModel, Noise, Optics, Polarisers, Readout
from l3cli.frames.frame import RawFrame
from l3cli.physics.lens import relative_illumination

CHART_ROWS, CHART_COLS = 4, 6
LEAKAGE_NM = np.arange(200.0, 2001.0, 5.0)  # wavelengths of stated leakages, until the wavelengths of the camera are known
PATCHES = CHART_ROWS * CHART_COLS
PATCH_NAMES = (
    "dark skin", "light skin", "blue sky", "foliage", "blue flower", "bluish green",
    "orange", "purplish blue", "moderate red", "purple", "yellow green", "orange yellow",
    "blue", "green", "red", "yellow", "magenta", "cyan",
    "white 9.5", "neutral 8", "neutral 6.5", "neutral 5", "neutral 3.5", "black 2",
)  # fmt: skip
DIODE = {  # alternative name → name of a column in a sweep
    **dict.fromkeys(("diode", "photodiode", "photodiode light"), "diode light"),
    **dict.fromkeys(("dark", "photodiode dark"), "diode dark"),
}


@dataclass(frozen=True)
class Body:
    """The properties of a camera that are known without a measurement."""

    name: str
    rows: int
    cols: int
    pixel_pitch: float  # m
    bits: int
    channels: tuple[str, ...]
    cfa: NDArray[np.uint8]  # (cfa_row, cfa_col) channel of each site
    optics: Optics
    readout: Readout | None = None  # exposure and gain of each channel, without read noise; None if all channels are equal
    polarisers: Polarisers | None = None  # as stated, with the leakages at LEAKAGE_NM; None if none are stated

    @property
    def channel_gains(self) -> NDArray[np.float64]:
        """Conversion gain of each channel, relative to the gain of the camera."""
        return np.ones(len(self.channels)) if self.readout is None else self.readout.channel_gain

    @property
    def channel_exposures(self) -> NDArray[np.float64]:
        """Exposure time of each channel, relative to the exposure time of the frame."""
        return np.ones(len(self.channels)) if self.readout is None else self.readout.channel_exposure

    @property
    def photons_per_radiance(self) -> float:
        """Photons/s on a pixel for a radiance of 1 photon/s/sr/m², in m² sr (docs/method.md#optics)."""
        return self.optics.irradiance_per_radiance * self.pixel_pitch**2

    @property
    def relative_illumination(self) -> NDArray[np.float64]:
        """Illumination of each pixel (row, col) by a uniform scene, relative to the axis (docs/method.md#optics)."""
        return relative_illumination(self.optics.image_distance, self.pixel_pitch, (self.rows, self.cols))


@dataclass(frozen=True)
class Capture:
    """Frames of one scene at one exposure: dark (lens cap on) or white (uniform light)."""

    name: str  # name in messages: the first frame in the measurement file
    exposure: float  # s
    frames: Iterable[NDArray[np.uint16]]  # each (row, col) in DN; can be iterated repeatedly
    monitor: float = field(default=1.0, kw_only=True)  # light of the lamp, relative to its light when it was measured

    @property
    def lit(self) -> float:
        """Exposure time in s that would give the same exposure if the lamp were as bright as when it was measured."""
        return self.exposure * self.monitor


@dataclass(frozen=True)
class MonoCapture(Capture):
    """A uniform field illuminated by one step of a monochromator.

    The measured spectrum includes the bandwidth and the stray light of the monochromator.
    """

    wavelength: NDArray[np.float64]  # (wavelength) nm
    radiance: NDArray[np.float64]  # (wavelength) photons/s/sr/m²/nm
    absolute: bool = field(default=True, kw_only=True)  # whether the absolute scale of the radiance is known


@dataclass(frozen=True)
class ChartCapture(Capture):
    """A 4 × 6 ColorChecker with the measured radiance of every patch."""

    illuminant: str
    corners: NDArray[np.float64]  # (4, 2) column and row of the outer corners of patches 1 (dark skin), 6, 24 and 19
    wavelength: NDArray[np.float64]  # (wavelength) nm
    radiance: NDArray[np.float64]  # (24, wavelength) photons/s/sr/m²/nm, row by row from dark skin to black


@dataclass(frozen=True)
class BandCapture(ChartCapture):
    """A ColorChecker behind a narrow-band filter, at one of several exposures. The radiance may be relative."""


@dataclass(frozen=True)
class PolariserCapture(Capture):
    """Frames of a uniform light behind a rotating linear polariser."""

    angle: float = field(kw_only=True)  # degrees; transmission axis of the polariser, counter-clockwise in the picture


@dataclass(frozen=True)
class Rotator:
    """The rotating polariser in front of the light."""

    leakage: float = 0.0  # inverse of its extinction ratio
    angle_error: float = 0.0  # degrees; standard deviation of the angle of a capture
    reference: str | None = None  # channel whose stated angle is taken as true; None: the angles of the captures are true

    @property
    def polarisation(self) -> float:
        """Degree of linear polarisation of the light behind the polariser."""
        return (1.0 - self.leakage) / (1.0 + self.leakage)


@dataclass(frozen=True)
class SweepTable:
    """Mean values of a monochromator sweep. A photodiode next to the camera and dark values are read at every step."""

    wavelength: NDArray[np.float64]  # (wavelength) nm
    light: NDArray[np.float64]  # (channel, wavelength) DN
    dark: NDArray[np.float64]  # (channel, wavelength) DN
    diode_light: NDArray[np.float64]  # (wavelength) reading of the photodiode, in any unit
    diode_dark: NDArray[np.float64]  # (wavelength) dark reading of the photodiode, in the same unit
    diode_response: NDArray[np.float64]  # (wavelength) reading of the photodiode per energy, in any unit


@dataclass(frozen=True)
class FinishedCurves:
    """Responsivities from another source, relative and per photon."""

    wavelength: NDArray[np.float64]  # (wavelength) nm
    responsivity: NDArray[np.float64]  # (channel, wavelength)
    note: str | None = None  # message that lists unused columns of the file, or None


@dataclass(frozen=True)
class CurveStatistics:
    """Statistics of the responsivities of measured cameras, per photon, with each channel scaled to a peak of 1."""

    wavelength: NDArray[np.float64]  # (wavelength) nm
    mean: NDArray[np.float64]  # (channel, wavelength)
    modes: NDArray[np.float64]  # (mode, channel, wavelength) principal modes, each scaled to its standard deviation
    log_peak: NDArray[np.float64]  # (channel) mean of ln(peak / geometric mean of the peaks of all channels)
    log_peak_covariance: NDArray[np.float64]  # (channel, channel)


@dataclass(frozen=True)
class Chart:
    """A chart with known reflectances."""

    name: str
    grid: tuple[int, int]  # rows and columns of patches
    wavelength: NDArray[np.float64]  # (wavelength) nm
    reflectance: NDArray[np.float64]  # (patch, wavelength); patches row by row

    def __post_init__(self) -> None:
        patches, (rows, cols) = len(self.reflectance), self.grid
        if patches != rows * cols:
            raise ValueError(
                f"{self.name} has {patches} patches, but layout = [{rows}, {cols}] has {rows * cols}; correct the layout"
            )


@dataclass(frozen=True)
class PhotoCapture:
    """Raw frames of a chart under one illuminant and at one exposure."""

    name: str  # name in messages
    frames: tuple[RawFrame, ...]
    chart: Chart
    light: str | None  # name of the illuminant; None if the illuminant must be estimated
    wavelength: NDArray[np.float64]  # (light_wavelength) nm
    radiance: NDArray[np.float64]  # (light_wavelength) relative photon radiance; not used if the illuminant is estimated
    corners: NDArray[np.float64] | None  # (4, 2) as in ChartCapture; None if the chart must be found
    darks: tuple[RawFrame, ...] = ()  # frames without light, with the same exposure
    whites: tuple[RawFrame, ...] = ()  # frames of a uniform white target in place of the chart, under the same illuminant

    def __post_init__(self) -> None:
        first, *others = (*self.frames, *self.darks, *self.whites)
        for frame in others:
            if frame.values.shape != first.values.shape or frame.phase != first.phase:
                raise ValueError(f"{frame.name} and {first.name} differ in size or phase; use frames of one camera")


@dataclass(frozen=True)
class SensorFigures:
    """Sensor data of a camera model, from a measurement or from a data sheet."""

    gain: float  # DN/e-
    black_level: float  # DN
    white_level: float  # DN
    noise: Noise


@dataclass(frozen=True)
class GainCaptures:
    """Dark and white frames at a higher ISO speed."""

    iso: float
    darks: tuple[Capture, ...]
    whites: tuple[Capture, ...]


@dataclass(frozen=True)
class Measurements:
    """All measurements of one camera, and the uncertainty of the light sources.

    The responsivity is determined from one of `mono`, `bands`, `curve` and `photos`, whose light is not polarised. The
    sensor data are determined from `darks` and `whites` if there are any, otherwise from `datasheet` or, without a data
    sheet, from the photos. Polarisers are determined from `polariser`, or stated in `body`. If there is a `base`, only
    defects and flat field, or polarisers, are measured, and all other data come from the base.
    """

    body: Body
    mono: tuple[MonoCapture, ...] = ()
    charts: tuple[ChartCapture, ...] = ()
    darks: tuple[Capture, ...] = ()
    whites: tuple[Capture, ...] = ()
    iso: float | None = None  # ISO speed of `darks` and `whites`; None if it is not stated
    gains: tuple[GainCaptures, ...] = ()  # captures at higher ISO speeds
    bands: tuple[BandCapture, ...] = ()
    curve: SweepTable | FinishedCurves | None = None
    photos: tuple[PhotoCapture, ...] = ()
    polariser: tuple[PolariserCapture, ...] = ()
    rotator: Rotator = Rotator()
    cameras: CurveStatistics | tuple[FinishedCurves, ...] | None = None  # curves of other cameras, for photos
    datasheet: SensorFigures | None = None
    base: CameraModel | None = None  # a known camera; only defects and flat field, or polarisers, are measured
    lamp_drift: float = 0.0  # relative standard deviation of a lamp's light since its spectrum was measured
    wavelength_uncertainty: float = 0.0  # nm; standard deviation of the spectrometer's wavelength scale


@dataclass(frozen=True)
class StatedMatrix:
    """A matrix that converts the XYZ of a surface under an illuminant to camera signals."""

    light: str  # name of the illuminant
    assumed: bool  # whether the illuminant is an assumption, because the file does not state it
    rows: dict[int, NDArray[np.float64]]  # colour code → row (3) of the matrix

    def of(self, codes: Sequence[int | None]) -> NDArray[np.float64]:
        """Return the rows (channel, 3) of the matrix for the given colour codes."""
        return np.array([self.rows[code] for code in codes if code is not None])


@dataclass(frozen=True)
class Stated:
    """Properties of a camera according to a raw file. A property that the file does not state is None or ""."""

    camera: str  # make and model
    matrices: tuple[StatedMatrix, ...]
    noise: tuple[float, float] | None  # slope and intercept of the variance, on a scale from 0 (black) to 1 (white)
    iso: float | None
    pitch_um: float | None
    focal_length_mm: float | None
    f_number: float | None


@dataclass(frozen=True)
class CaptureFolder:
    """The files in a folder. Their paths are relative to the folder."""

    folder: Path
    frames: tuple[str, ...]
    tables: tuple[str, ...]
    notes: tuple[str, ...]  # one line for each type of file that is left out


@dataclass(frozen=True)
class RawFile:
    """A raw frame, with the properties that its file states."""

    values: NDArray[np.uint16]  # (row, col) DN as stored, without any processing
    seconds: float | None
    pattern: NDArray[np.int64] | None  # colour codes of the CFA
    black_level: float | None  # DN
    white_level: float | None  # DN
    count: int = 1  # number of frames in the file, of which this is the first
