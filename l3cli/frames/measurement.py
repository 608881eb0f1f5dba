"""Data types for measurements in a real or virtual lab, which are the input of calibration.

Captures contain iterables that read their frames one by one, so that memory use does not depend on the number of frames.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.camera import CameraModel, MaskedPixels, Noise, Optics, Polarisers, Readout
from l3cli.frames.frame import RawFrame
from l3cli.physics.lens import relative_illumination

CHART_ROWS, CHART_COLS = 4, 6
LEAKAGE_NM = np.arange(200.0, 2001.0, 5.0)  # nm; wavelengths of the polariser leakages in `Body.polarisers`
PATCHES = CHART_ROWS * CHART_COLS
PATCH_NAMES = (
    "dark skin", "light skin", "blue sky", "foliage", "blue flower", "bluish green",
    "orange", "purplish blue", "moderate red", "purple", "yellow green", "orange yellow",
    "blue", "green", "red", "yellow", "magenta", "cyan",
    "white 9.5", "neutral 8", "neutral 6.5", "neutral 5", "neutral 3.5", "black 2",
)  # fmt: skip
DIODE = {  # alternative column names in the table of a monochromator sweep → column names that l3 uses
    **dict.fromkeys(("diode", "photodiode", "photodiode light"), "diode light"),
    **dict.fromkeys(("dark", "photodiode dark"), "diode dark"),
}


@dataclass(frozen=True)
class Body:
    """Properties of a camera that are known without a measurement."""

    name: str
    rows: int
    cols: int
    pixel_pitch: float  # m
    bits: int
    channels: tuple[str, ...]
    cfa: NDArray[np.uint8]  # (cfa_row, cfa_col) channel of each site
    optics: Optics
    readout: Readout | None = None  # exposure and gain of each channel, without read noise; None if all channels are equal
    # polarisers in the measurement file, with leakages at LEAKAGE_NM; None if the file contains none
    polarisers: Polarisers | None = None
    masked: MaskedPixels | None = None  # masked pixels in the files; they are removed when frames are read

    @property
    def channel_gains(self) -> NDArray[np.float64]:
        """Conversion gain of each channel, relative to the camera's gain."""
        return np.ones(len(self.channels)) if self.readout is None else self.readout.channel_gain

    @property
    def channel_exposures(self) -> NDArray[np.float64]:
        """Exposure time of each channel, relative to the frame's exposure time."""
        return np.ones(len(self.channels)) if self.readout is None else self.readout.channel_exposure

    @property
    def photons_per_radiance(self) -> float:
        """Photon rate at a pixel, divided by the photon radiance, in m² sr (docs/method.md#optics)."""
        return self.optics.irradiance_per_radiance * self.pixel_pitch**2

    @property
    def relative_illumination(self) -> NDArray[np.float64]:
        """Illuminance of each pixel, (row, col), under a uniform scene, relative to the axis (docs/method.md#optics)."""
        return relative_illumination(self.optics.image_distance, self.pixel_pitch, (self.rows, self.cols))


@dataclass(frozen=True)
class Capture:
    """Frames of one subject with the same exposure, such as dark frames (lens cap on) or white frames (uniform light)."""

    name: str  # name in messages: the name of the first frame in the measurement file
    exposure: float  # exposure time in s
    frames: Iterable[NDArray[np.uint16]]  # frames, (row, col), in DN; can be iterated repeatedly
    # lamp intensity, relative to its intensity while the spectrum was measured
    monitor: float = field(default=1.0, kw_only=True)

    @property
    def lit(self) -> float:
        """Exposure time in s, multiplied by the relative lamp intensity."""
        return self.exposure * self.monitor


@dataclass(frozen=True)
class MonoCapture(Capture):
    """Frames of a uniform field, illuminated by a monochromator at one wavelength setting.

    The radiance is a measured spectrum, so it includes the monochromator's bandwidth and stray light.
    """

    wavelength: NDArray[np.float64]  # (wavelength) nm
    radiance: NDArray[np.float64]  # (wavelength) photons/s/sr/m²/nm
    absolute: bool = field(default=True, kw_only=True)  # whether the absolute scale of the radiance is known


@dataclass(frozen=True)
class ChartCapture(Capture):
    """Frames of a ColorChecker with 4×6 patches, and the measured radiance of every patch."""

    illuminant: str
    corners: NDArray[np.float64]  # (4, 2) column and row of the outer corners of patches 1 (dark skin), 6, 24 and 19
    wavelength: NDArray[np.float64]  # (wavelength) nm
    radiance: NDArray[np.float64]  # (24, wavelength) photons/s/sr/m²/nm, row by row from dark skin to black


@dataclass(frozen=True)
class BandCapture(ChartCapture):
    """Frames of a ColorChecker with a narrow-band filter in the light path. The radiances may be relative."""


@dataclass(frozen=True)
class PolariserCapture(Capture):
    """Frames of a uniform light source behind a linear polariser at one angle."""

    # degrees; angle of the polariser's transmission axis, counter-clockwise in the picture
    angle: float = field(kw_only=True)


@dataclass(frozen=True)
class Rotator:
    """The rotating polariser in front of the light source."""

    leakage: float = 0.0  # inverse of the extinction ratio
    angle_error: float = 0.0  # degrees; standard deviation of the error in the angle of a capture
    # Channel with a known angle, which determines the zero of the rotator's scale. None if the scale's zero is exact.
    reference: str | None = None

    @property
    def polarisation(self) -> float:
        """Degree of linear polarisation of the light behind the polariser."""
        return (1.0 - self.leakage) / (1.0 + self.leakage)


@dataclass(frozen=True)
class SweepTable:
    """Mean signals of a camera, and of a photodiode next to it, with and without light in a wavelength sweep."""

    wavelength: NDArray[np.float64]  # (wavelength) nm; wavelength setting of the monochromator
    light: NDArray[np.float64]  # (channel, wavelength) DN; signal with light
    dark: NDArray[np.float64]  # (channel, wavelength) DN; signal without light
    diode_light: NDArray[np.float64]  # (wavelength) signal of the photodiode with light, in any unit
    diode_dark: NDArray[np.float64]  # (wavelength) signal of the photodiode without light, in the same unit
    diode_response: NDArray[np.float64]  # (wavelength) photodiode signal per energy, in any unit


@dataclass(frozen=True)
class FinishedCurves:
    """Relative responsivities per photon that were read from a file, not computed from captures."""

    wavelength: NDArray[np.float64]  # (wavelength) nm
    responsivity: NDArray[np.float64]  # (channel, wavelength)
    note: str | None = None  # message that lists the unused columns in the file, if there are any


@dataclass(frozen=True)
class CurveStatistics:
    """Statistics of measured responsivities of many cameras, per photon, with each channel scaled to a peak of 1."""

    wavelength: NDArray[np.float64]  # (wavelength) nm
    mean: NDArray[np.float64]  # (channel, wavelength) mean over the cameras
    modes: NDArray[np.float64]  # (mode, channel, wavelength) principal components, scaled to their standard deviations
    log_peak: NDArray[np.float64]  # (channel) mean of ln(peak / geometric mean of the peaks of all channels)
    log_peak_covariance: NDArray[np.float64]  # (channel, channel) covariance of these logarithms


@dataclass(frozen=True)
class Chart:
    """A chart with known reflectances."""

    name: str
    grid: tuple[int, int]  # rows and columns of patches
    wavelength: NDArray[np.float64]  # (wavelength) nm
    reflectance: NDArray[np.float64]  # (patch, wavelength) reflectances of the patches, row by row

    def __post_init__(self) -> None:
        patches, (rows, cols) = len(self.reflectance), self.grid
        if patches != rows * cols:
            raise ValueError(
                f"{self.name} contains {patches} patches, but layout = [{rows}, {cols}] has {rows * cols} patches; correct "
                '"layout"'
            )


@dataclass(frozen=True)
class PhotoCapture:
    """Raw frames of a chart under one illuminant and with one exposure."""

    name: str  # name for messages
    frames: tuple[RawFrame, ...]
    chart: Chart
    light: str | None  # name of the illuminant; None if the illuminant must be estimated
    wavelength: NDArray[np.float64]  # (light_wavelength) nm
    radiance: NDArray[np.float64]  # (light_wavelength) relative photon radiance; unused if the illuminant is estimated
    corners: NDArray[np.float64] | None  # (4, 2) as in ChartCapture; None if l3 must find the chart
    darks: tuple[RawFrame, ...] = ()  # frames taken in the dark, with the same exposure
    # frames of a uniform white target in place of the chart, under the same illuminant
    whites: tuple[RawFrame, ...] = ()

    def __post_init__(self) -> None:
        first, *others = (*self.frames, *self.darks, *self.whites)
        for frame in others:
            if frame.values.shape != first.values.shape or frame.phase != first.phase:
                raise ValueError(f"{frame.name} and {first.name} differ in size or CFA phase; use frames from one camera")


@dataclass(frozen=True)
class SensorFigures:
    """Gain, levels and noise of a sensor, from a measurement or from a data sheet."""

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

    The responsivity is determined from `mono`, `bands`, `curve` or `photos`, all with unpolarised light. Gain, levels and
    noise come from the first available source: (1) `darks` and `whites`; (2) `datasheet`; (3) `photos`. Polarisers are
    measured with `polariser`, or specified in `body`. If there is a `base`, only defects and flat field, or only polarisers,
    are measured. All other data come from the base.
    """

    body: Body
    mono: tuple[MonoCapture, ...] = ()
    charts: tuple[ChartCapture, ...] = ()
    darks: tuple[Capture, ...] = ()
    whites: tuple[Capture, ...] = ()
    iso: float | None = None  # ISO speed of `darks` and `whites`; None if unknown
    gains: tuple[GainCaptures, ...] = ()  # captures at higher ISO speeds
    bands: tuple[BandCapture, ...] = ()
    curve: SweepTable | FinishedCurves | None = None
    photos: tuple[PhotoCapture, ...] = ()
    polariser: tuple[PolariserCapture, ...] = ()
    rotator: Rotator = Rotator()
    cameras: CurveStatistics | tuple[FinishedCurves, ...] | None = None  # curves of other cameras, used with `photos`
    datasheet: SensorFigures | None = None
    base: CameraModel | None = None  # existing camera model to which the new measurements are added
    lamp_drift: float = 0.0  # relative standard deviation of the change in lamp intensity since the spectra were measured
    wavelength_uncertainty: float = 0.0  # nm; standard deviation of the error in the spectrometer's wavelength scale
    blinking_defects: bool = False  # whether to add blinking pixels to the defects


@dataclass(frozen=True)
class StatedMatrix:
    """Colour matrix in a raw file. It converts XYZ to camera signals, and applies to one illuminant."""

    light: str  # name of the illuminant
    assumed: bool  # whether the illuminant is assumed, because the file does not name it
    rows: dict[int, NDArray[np.float64]]  # colour code of a channel → row of the matrix, (3,)

    def of(self, codes: Sequence[int | None]) -> NDArray[np.float64]:
        """Return the matrix rows of channels with these colour codes: (channel, 3). A code of None is skipped."""
        return np.array([self.rows[code] for code in codes if code is not None])


@dataclass(frozen=True)
class Stated:
    """Properties of a camera according to a raw file. Missing properties are None or ""."""

    camera: str  # make and model
    matrices: tuple[StatedMatrix, ...]
    noise: tuple[float, float] | None  # slope and intercept of the noise variance, with signals from 0 (black) to 1 (white)
    iso: float | None
    pitch_um: float | None
    focal_length_mm: float | None
    f_number: float | None


@dataclass(frozen=True)
class CaptureFolder:
    """The measurement files in a folder, with paths relative to the folder."""

    folder: Path
    frames: tuple[str, ...]
    tables: tuple[str, ...]
    notes: tuple[str, ...]  # one message for each type of file that is not used


@dataclass(frozen=True)
class RawFile:
    """A raw frame with the metadata in its file. Missing metadata are None."""

    values: NDArray[np.uint16]  # (row, col) DN as stored, without any processing
    seconds: float | None  # exposure time in s
    pattern: NDArray[np.int64] | None  # (row, col) colour codes of the CFA
    black_level: float | None  # DN
    white_level: float | None  # DN
    count: int = 1  # number of frames in the file; `values` is the first frame
