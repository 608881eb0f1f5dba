"""The camera model, which `l3 calibrate` writes and `l3 simulate` reads (docs/method.md#camera-model)."""

import dataclasses
import functools
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.fit import Fit
from l3cli.artifacts.schema import LARGEST_VALUE, Artifact, data, group
from l3cli.errors import InputFileError, raised_as
from l3cli.physics import lens, spectra
from l3cli.physics.mosaic import tiled
from l3cli.system.limits import most_pixels

# Types of defective pixels. In a "row" or "column" defect, the whole line is defective.
DEFECTS = ("hot", "dead", "blinking", "row", "column")
MAX_SHADING = 16.0  # largest gain of a flat field
MAX_COLOUR_SHADING = 0.5  # largest relative difference between a channel's gain and the mean gain of all channels
MIN_EXPOSURE = 1e-4  # shortest channel exposure time, as a fraction of the longest
MAX_GAIN = 1e3  # largest channel gain, relative to the camera gain
MAX_CHANNELS = 16  # maximum number of channels; a saturation case is stored in 16 bits, one bit per channel
MAX_CFA = 8  # maximum width and height of the super-pixel, in pixels
MAX_BITS = 16  # maximum bit depth of raw values
ROUNDING = 1e-6  # rounding errors may push a quantum efficiency above 1 by this amount
MAX_WAVELENGTHS = 10_000  # maximum number of samples in a spectrum
QUANTISATION = 1 / 12  # DN²; variance of the error from rounding to whole DN
# DN²; mean error variance of a dithered line offset, which is rounded up in some pixels and down in the others
DITHER = 1 / 6
# Without masked pixels, offsets are estimated from the picture (docs/method.md#offsets-from-the-picture).
MIN_LINE_PIXELS = 64  # minimum number of pixels in a row or column whose offset is estimated
MAX_LINE_PIXELS = 2048  # longer lines are sampled, because more pixels hardly improve the estimate
SMOOTHED_LINES = 33  # number of lines over which slow changes are averaged and attributed to the scene
PICTURE_SIGNAL = 0.02  # fraction of full scale; signal of a dark picture, in which offsets are visible
PICTURE_CHANGE = 0.008  # standard deviation of the change of a scene's mean from row to row, divided by the signal
PICTURE_VOTES = 0.8  # usual fraction of a row's pixels that differ from the next row by no more than the noise allows
MAX_MASKED = 4096  # maximum number of masked rows or columns on each side of the sensor


def sensitivity_threshold(read_noise: Any, gain: Any) -> Any:
    """Compute the absolute sensitivity threshold of EMVA 1288, the signal in e- at which the signal-to-noise ratio is 1.

    `read_noise` is in e- and `gain` in DN/e-. Both can be numbers or arrays.
    """
    return np.sqrt(read_noise**2 + QUANTISATION / gain**2) + 0.5


@dataclass(frozen=True)
class DefectMap:
    """Positions and types of a sensor's defective pixels. l3 ignores the values of these pixels."""

    position: NDArray[np.int64] = data(
        "int64",
        "bad_pixel",
        "coordinate",
        unit="pixel",
        doc="row and column of each defective pixel; each pixel occurs once",
    )
    pixel_kind: tuple[str, ...] = data(
        "str",
        "bad_pixel",
        doc="type of each defect: hot, dead, blinking, row or column; row and column: the whole line is defective",
    )

    def __post_init__(self) -> None:
        if self.position.ndim != 2 or self.position.shape[1] != 2 or self.position.min(initial=0) < 0:
            raise ValueError("defects: position must contain a row and a column, counted from 0, for each pixel")
        if len(np.unique(self.position, axis=0)) < len(self.position):
            raise ValueError("defects: position contains a pixel twice")
        if odd := sorted(set(self.pixel_kind) - set(DEFECTS)):
            raise ValueError(f'defects: pixel_kind contains "{odd[0]}"; known types are {", ".join(DEFECTS)}')


@dataclass(frozen=True)
class FlatField:
    """Shading correction: gains that make the image of an evenly lit white target uniform.

    Each channel has its own gain map, relative to the centre of the frame. The map is sampled on a grid that covers the
    whole sensor, and l3 interpolates linearly between the grid points.
    """

    grid_row: NDArray[np.float64] = data(
        "float64", "grid_row", unit="pixel", doc="row of each grid line on the sensor", coordinate=True
    )
    grid_col: NDArray[np.float64] = data(
        "float64", "grid_col", unit="pixel", doc="column of each grid line on the sensor", coordinate=True
    )
    shading_gain: NDArray[np.float64] = data(
        "float64",
        "channel",
        "grid_row",
        "grid_col",
        doc="gain that corrects the shading, relative to the gain in the middle of the frame",
    )

    def __post_init__(self) -> None:
        for name, lines in (("grid_row", self.grid_row), ("grid_col", self.grid_col)):
            if not (lines.size > 1 and (np.diff(lines) > 0).all()):
                raise ValueError(f"flat field: {name} must contain at least two increasing values")
        gain = self.shading_gain
        if not (gain.size and gain.min() >= 1 / MAX_SHADING and gain.max() <= MAX_SHADING):
            raise ValueError(
                f"flat field: all gains must be between {1 / MAX_SHADING:g} and {MAX_SHADING:g}; use white frames "
                "of an evenly lit white target"
            )
        if np.abs(gain / gain.mean(axis=0) - 1.0).max() > MAX_COLOUR_SHADING:
            raise ValueError(
                f"flat field: the gain of a channel differs by more than {MAX_COLOUR_SHADING:.0%} from the mean gain of all "
                "channels; use white frames of an evenly lit white target"
            )

    def covers(self, rows: int, cols: int) -> bool:
        """Return whether the grid extends from the first pixel to the last pixel of a sensor."""
        ends = (*self.grid_row[[0, -1]], *self.grid_col[[0, -1]])
        return bool(np.allclose(ends, (0, rows - 1, 0, cols - 1), rtol=0, atol=0.5))


@dataclass(frozen=True)
class Readout:
    """Exposure time, gain and read noise of each channel. Channels with the same filter may have different values."""

    channel_exposure: NDArray[np.float64] = data(
        "float64",
        "channel",
        doc="exposure time, as a fraction of the longest exposure time (the exposure time of the frame)",
    )
    channel_gain: NDArray[np.float64] = data(
        "float64", "channel", doc="conversion gain, relative to the conversion gain of the camera"
    )
    channel_read_noise: NDArray[np.float64] = data(
        "float64", "channel", unit="e-", doc="standard deviation of one reading in the dark, at the gain of the channel"
    )
    same_filter: NDArray[np.int64] = data("int64", "channel", doc="index of the first channel with the same filter")

    def __post_init__(self) -> None:
        exposure, gain, first = self.channel_exposure, self.channel_gain, self.same_filter
        if not (exposure.min() >= MIN_EXPOSURE and exposure.max() == 1.0):
            raise ValueError(f"channel_exposure must be between {MIN_EXPOSURE:g} and 1, and its largest value must be 1")
        if not (gain.min() >= 1.0 and gain.max() <= MAX_GAIN):
            raise ValueError(f"channel_gain must be between 1 and {MAX_GAIN:g}")
        if not (self.channel_read_noise.min() >= 0 and np.isfinite(self.channel_read_noise).all()):
            raise ValueError("channel_read_noise must be finite and must not be negative")
        if not ((first >= 0) & (first <= np.arange(first.size))).all() or not (first[first] == first).all():
            raise ValueError(
                "same_filter must contain, for each channel, the index of the first channel with the same filter"
            )

    @property
    def sensitivity(self) -> NDArray[np.float64]:
        """Exposure time × gain of each channel, relative to the most sensitive channel."""
        product = self.channel_exposure * self.channel_gain
        return np.asarray(product / product.max())


@dataclass(frozen=True)
class Polarisers:
    """Linear polarisers in front of the pixels (docs/method.md#polarisers).

    A channel without a polariser transmits all polarisations equally: its leakage is 1, and its angle is set to 0.
    """

    polariser_deg: NDArray[np.float64] = data(
        "float64",
        "channel",
        unit="deg",
        doc="angle of the transmission axis, counter-clockwise from the horizontal axis of the frame",
    )
    leakage: NDArray[np.float64] = data(
        "float64",
        "channel",
        "wavelength",
        doc="transmission across the axis, relative to the transmission along the axis; 0: ideal; 1: no polariser",
    )

    def __post_init__(self) -> None:
        if not ((self.polariser_deg >= 0) & (self.polariser_deg < 180)).all():
            raise ValueError("polariser_deg must be at least 0 and less than 180")
        if not (self.leakage.size and self.leakage.min() >= 0 and self.leakage.max() <= 1):
            raise ValueError("leakage, the inverse of the extinction ratio, must be between 0 and 1")

    @property
    def present(self) -> NDArray[np.bool_]:
        """Whether each channel has a polariser."""
        return np.asarray((self.leakage < 1).any(axis=1))

    @property
    def extinction(self) -> NDArray[np.float64]:
        """Extinction ratio, (channel, wavelength): transmission along the axis divided by transmission across the axis.

        An ideal polariser has an infinite ratio.
        """
        with np.errstate(divide="ignore"):
            return np.asarray(1.0 / self.leakage)

    @property
    def stokes_response(self) -> NDArray[np.float64]:
        """Response of each channel to the Stokes parameters S0, S1 and S2, relative to the transmission along the axis.

        Returns
        -------
        ndarray, (channel, stokes, wavelength)
            First row of each polariser's Mueller matrix: ½ (1 + k), ½ (1 − k) cos 2θ and ½ (1 − k) sin 2θ, where k is the
            leakage and θ the angle. For a channel without a polariser, this row is (1, 0, 0).
        """
        angle = 2 * np.radians(self.polariser_deg)[:, None]
        modulation = 0.5 * (1.0 - self.leakage)
        return np.stack([0.5 * (1.0 + self.leakage), modulation * np.cos(angle), modulation * np.sin(angle)], axis=1)


@dataclass(frozen=True)
class PolariserField:
    """Deviations of single pixels from their channels, in polarised light (docs/method.md#polarisers-of-single-pixels).

    Angle, extinction ratio and gain of a pixel determine its response to S0, S1 and S2.
    """

    response_deviation: NDArray[np.int16] = data(
        "int16",
        "sensor_row",
        "sensor_col",
        "stokes",
        unit="2^-15",
        doc="response of each pixel to S0, S1 and S2, minus the mean response of its channel, divided by the mean response "
        "to S0; 0: not measured",
    )


@dataclass(frozen=True)
class Noise:
    """Noise of the sensor, referred to the photodiode (docs/method.md#sensor)."""

    read_noise: float = data("float64", unit="e-", doc="standard deviation of one reading in the dark")
    dark_current: float = data("float64", unit="e-/s", doc="mean dark current")
    dsnu: float = data("float64", unit="e-", doc="dark signal nonuniformity: standard deviation over pixels")
    prnu: float = data(
        "float64",
        unit="1",
        doc="photo response nonuniformity: relative standard deviation over pixels, excluding row and column components",
    )
    well_capacity: float = data("float64", unit="e-", doc="electrons at which a pixel saturates")
    column_noise: float = data("float64", unit="e-", doc="standard deviation of the fixed offsets of columns", default=0.0)
    row_temporal_noise: float = data(
        "float64",
        unit="e-",
        doc="standard deviation of the random offset of each row, which changes from frame to frame",
        optional=0.0,
    )
    column_temporal_noise: float = data(
        "float64",
        unit="e-",
        doc="standard deviation of the random offset of each column, which changes from frame to frame",
        optional=0.0,
    )
    row_noise: float = data("float64", unit="e-", doc="standard deviation of the fixed offsets of rows", optional=0.0)
    row_prnu: float = data(
        "float64", unit="1", doc="relative standard deviation of the response of rows, in addition to prnu", optional=0.0
    )
    column_prnu: float = data(
        "float64", unit="1", doc="relative standard deviation of the response of columns, in addition to prnu", optional=0.0
    )

    def __post_init__(self) -> None:
        if not (min(dataclasses.astuple(self)) >= 0 and self.well_capacity > 0):
            raise ValueError("noise values must not be negative, and the well capacity must be positive")

    @property
    def lines(self) -> float:
        """Total variance of the temporal row noise and the temporal column noise, in (e-)²."""
        return self.row_temporal_noise**2 + self.column_temporal_noise**2

    @property
    def temporal(self) -> float:
        """Temporal noise variance in the dark, in (e-)²: read noise, temporal row noise and temporal column noise."""
        return self.read_noise**2 + self.lines

    @property
    def dark_noise(self) -> float:
        """Temporal dark noise of EMVA 1288: a dark pixel's standard deviation over time, in e-."""
        return float(np.sqrt(self.temporal)) if self.lines else self.read_noise

    @property
    def fixed(self) -> float:
        """Fixed-pattern noise variance in the dark, in (e-)²: DSNU, fixed row offsets and fixed column offsets."""
        return self.dsnu**2 + self.column_noise**2 + self.row_noise**2

    @property
    def uneven(self) -> float:
        """Variance of the relative response, due to pixel, row and column PRNU."""
        return self.prnu**2 + self.row_prnu**2 + self.column_prnu**2


@dataclass(frozen=True)
class MaskedPixels:
    """Rows and columns of optically black pixels around the light-sensitive pixels (docs/method.md#masked-pixels).

    The camera's frames contain these pixels in addition to the `rows` × `cols` light-sensitive pixels.
    """

    left: int = data("int64", unit="pixel", doc="masked columns to the left of the first light-sensitive column", default=0)
    right: int = data("int64", unit="pixel", doc="masked columns to the right of the last light-sensitive column", default=0)
    top: int = data("int64", unit="pixel", doc="masked rows above the first light-sensitive row", default=0)
    bottom: int = data("int64", unit="pixel", doc="masked rows below the last light-sensitive row", default=0)

    def __post_init__(self) -> None:
        sides = dataclasses.astuple(self)
        if not (min(sides) >= 0 and 0 < max(sides) <= MAX_MASKED):
            raise ValueError(
                f"the numbers of masked lines on the four sides are {', '.join(map(str, sides))}; each must be between 0 "
                f"and {MAX_MASKED}, and at least one must be positive"
            )

    def around(self, rows: int, cols: int) -> tuple[int, int]:
        """Return the frame size (rows, columns) that includes the masked pixels around `rows` × `cols` sensitive pixels."""
        return rows + self.top + self.bottom, cols + self.left + self.right


def variance_left(lines: float, pixel: float, masked: int) -> float:
    """Return the row or column offset variance that remains after the correction with masked pixels.

    All variances have the same unit.

    Parameters
    ----------
    lines : float
        Variance of the row or column offsets before the correction.
    pixel : float
        Noise variance of a masked pixel, not including the offset of its line.
    masked : int
        Number of masked pixels in each line.

    Notes
    -----
    The mean of a line's n masked pixels estimates its offset with an error variance of pixel / n. The correction multiplies
    this mean by lines / (lines + pixel / n), the weight with the smallest mean square error, and subtracts the product. The
    remaining variance is lines · (pixel / n) / (lines + pixel / n).
    """
    return lines * pixel / (lines * masked + pixel) if lines and masked else lines


def variance_left_by_picture(lines: float, pixel: float, signal: float, count: int) -> float:
    """Return the row or column offset variance that remains after the correction with the picture itself.

    All variances are in (e-)².

    Parameters
    ----------
    lines : float
        Variance of the row or column offsets before the correction.
    pixel : float
        Noise variance of a pixel, not including the offset of its line and the shot noise of the signal.
    signal : float
        Signal of a pixel in e-.
    count : int
        Number of pixels in each line.

    Notes
    -----
    Between neighbouring lines, the mean of the scene changes with the variance (PICTURE_CHANGE · signal)², and the noise of
    the pixels adds 2 (pixel + signal) / (PICTURE_VOTES · count). Let V be the sum of both variances. If V is the error
    variance of the measured differences between adjacent offsets, the posterior variance of an offset is
    lines / √(1 + 4 lines / V). The correction also keeps the slow part of the offsets. This part has a fraction
    of 1 / SMOOTHED_LINES of their variance. The two remaining variances are combined as the root of the sum of squares.
    """
    if count < MIN_LINE_PIXELS or not lines:
        return lines
    change = (PICTURE_CHANGE * signal) ** 2 + 2 * (pixel + signal) / (PICTURE_VOTES * min(count, MAX_LINE_PIXELS))
    return lines * float(np.hypot(1 / np.sqrt(1 + 4 * lines / change), 1 / SMOOTHED_LINES))


@dataclass(frozen=True)
class NoiseScale:
    """Noise of a frame, relative to the calibrated camera.

    The noise depends on the analog gain. If a temporal filter has reduced it, `noise_left` is the remaining fraction of the
    temporal noise variance.
    """

    gain: float = data("float64", doc="analog gain, relative to the gain of the camera model", default=1.0)
    noise_left: float = data(
        "float64", doc="fraction of the temporal noise variance that remains after a temporal filter", default=1.0
    )

    def __post_init__(self) -> None:
        if not self.gain > 0:
            raise ValueError(f"the analog gain is {self.gain:g}, but must be positive")
        if not self.noise_left > 0:
            raise ValueError(f"noise_left is {self.noise_left:g}, but must be positive")

    @property
    def shot(self) -> float:
        """Shot-noise variance, divided by the shot-noise variance of the calibrated camera at the same signal in DN."""
        return self.gain * self.noise_left

    def __str__(self) -> str:
        at = [f"gain {self.gain:g}"] if self.gain != 1 else []
        left = [f"{self.noise_left:.3g} of the temporal noise"] if self.noise_left != 1 else []
        return ", ".join(at + left) or "the camera's noise"


@dataclass(frozen=True)
class AnalogGains:
    """Read noise of a camera at additional analog gains (docs/method.md#gains)."""

    analog_gain: NDArray[np.float64] = data(
        "float64", "analog_gain", doc="analog gain, relative to the gain of the camera model", coordinate=True
    )
    gain_read_noise: NDArray[np.float64] = data("float64", "analog_gain", unit="e-", doc="read noise at each analog gain")
    iso: float = data("float64", unit="1", doc="ISO speed at the gain of the camera model; 0: unknown", default=0.0)

    def __post_init__(self) -> None:
        gain = self.analog_gain
        if not ((gain > 0).all() and (np.diff(gain) > 0).all() and (gain != 1).all()):
            raise ValueError(
                "analog_gain must contain positive, increasing values and must not contain 1, which is the gain of the "
                "camera model"
            )
        if not (self.gain_read_noise >= 0).all():
            raise ValueError("gain_read_noise must not contain negative values")
        if not self.iso >= 0:
            raise ValueError(f"the ISO speed is {self.iso:g}, but must not be negative")


@dataclass(frozen=True)
class Optics:
    """Focal length, f-number and focus distance of the lens (docs/method.md#optics).

    The lens transmittance is included in the camera's responsivity.
    """

    focal_length: float = data("float64", unit="m", doc="focal length")
    f_number: float = data("float64", unit="1", doc="focal length / aperture diameter")
    object_distance: float = data("float64", unit="m", doc="distance of the scene; 0: infinity")

    def __post_init__(self) -> None:
        close = self.object_distance != 0 and self.object_distance <= self.focal_length
        if not (self.focal_length > 0 and self.f_number > 0) or close:
            raise ValueError(
                "focal_length and f_number must be positive, and object_distance must be 0 or larger than focal_length"
            )

    @property
    def image_distance(self) -> float:
        """Distance between the lens and the sensor when the scene is in focus, in m."""
        return lens.image_distance(self.focal_length, self.object_distance)

    @property
    def irradiance_per_radiance(self) -> float:
        """Ratio of sensor irradiance to scene radiance on the optical axis, in sr (docs/method.md#optics)."""
        return lens.irradiance_per_radiance(self.f_number, lens.magnification(self.focal_length, self.object_distance))


def check_sensor(rows: int, cols: int, bits: int, black_level: float, white_level: float) -> None:
    """Raise ValueError if the sensor's size, bit depth or levels (in DN) are not supported or contradict each other."""
    if not (rows > 0 and cols > 0 and rows * cols <= most_pixels() and 1 <= bits <= MAX_BITS):
        sensor = f"the sensor has {rows} rows, {cols} columns and {bits} bits"
        raise ValueError(
            f"{sensor}; all three must be positive, and at most {most_pixels()} pixels and {MAX_BITS} bits are supported"
        )
    if not 0 <= black_level < white_level <= 2**bits - 1:
        raise ValueError(
            f"the black level is {black_level:g} and the white level is {white_level:g}; the white level must be larger "
            f"than the black level, and both must be between 0 and {2**bits - 1}"
        )


def check_cfa(cfa: NDArray[np.uint8], channels: tuple[str, ...]) -> None:
    """Raise ValueError if the CFA is empty or too large, or contains the index of a nonexistent channel."""
    if not (cfa.size > 0 and max(cfa.shape) <= MAX_CFA and 0 < len(channels) <= MAX_CHANNELS):
        raise ValueError(
            f"cfa has the shape {cfa.shape} and {len(channels)} channels; 1×1 to {MAX_CFA}×{MAX_CFA} sites and 1 to "
            f"{MAX_CHANNELS} channels are supported"
        )
    if cfa.max() >= len(channels):
        raise ValueError(f"cfa contains the channel index {cfa.max()}, but there are only {len(channels)} channels")


def check_wavelengths(wavelength: NDArray[np.float64]) -> None:
    """Raise ValueError unless the wavelengths (nm) increase, and their number and range are supported."""
    if not (1 < wavelength.size <= MAX_WAVELENGTHS and (np.diff(wavelength) > 0).all()):
        raise ValueError(f"wavelength must contain 2 to {MAX_WAVELENGTHS} increasing values")
    if not (wavelength[0] > 0 and wavelength[-1] <= spectra.LONGEST_NM):
        raise ValueError(f"wavelength must contain only values between 0 and {spectra.LONGEST_NM} nm")


@dataclass(frozen=True, repr=False)
class CameraModel(Artifact):
    """A camera: geometry, colour filter array, responsivities, analog chain, noise and optics.

    Attributes
    ----------
    name : str
        Name of the camera.
    rows, cols : int
        Size of the sensor in pixels.
    pixel_pitch : float
        Distance between pixel centres in m.
    bits : int
        Bit depth of the analog-to-digital converter.
    channels : tuple of str
        Names of the channels.
    cfa : ndarray, (cfa_row, cfa_col)
        Index of the channel at each site of the super-pixel.
    wavelength : ndarray, (wavelength,)
        Wavelengths of the responsivities in nm.
    responsivity : ndarray, (channel, wavelength)
        Quantum efficiency in e-/photon, including lens, filters and fill factor. If `absolute` is false, the
        responsivities are relative, with a peak of 1.
    responsivity_band : ndarray, (channel, wavelength)
        Half width of the 95 % confidence band of `responsivity`, or 0 if the band is unknown.
    absolute : bool
        Whether `responsivity` is a quantum efficiency.
    gain : float
        Conversion gain in DN/e-.
    black_level, white_level : float
        Mean value in the dark, and value at saturation, in DN.
    fixed_pattern_seed : int
        Seed for the camera's random PRNU and DSNU maps.
    noise : Noise
        Noise of the sensor.
    optics : Optics
        The lens.
    declared : tuple of str
        Quantities with values from a data sheet instead of a measurement.
    fit : Fit or None
        Measurements and residuals of the calibration. None if the model was computed from a recipe.
    defects : DefectMap or None
        Defective pixels. None if l3 has not searched for defects.
    flat_field : FlatField or None
        Shading correction. None if shading was not measured.
    readout : Readout or None
        Exposure time and gain of each channel. None if they are the same for all channels.
    gains : AnalogGains or None
        Read noise at other analog gains. None if the read noise is assumed to be the same at all gains.
    polarisers : Polarisers or None
        Polarisers in front of the pixels. None if no channel has a polariser. If a channel has a polariser, its
        `responsivity` applies to light polarised along the transmission axis.
    polariser_field : PolariserField or None
        Deviations of single pixels' polarisers. None if they were not measured.
    masked : MaskedPixels or None
        Masked pixels around the light-sensitive pixels. None if the frames contain no masked pixels.
    noise_left : float
        Fraction of the temporal noise variance that remains after a temporal filter. It is set by the method `under` and is
        not stored in files.
    lines_corrected : bool
        Whether `noise` already is the noise after the correction of row and column offsets. It is set by the method
        `as_corrected` and is not stored in files.
    """

    kind: ClassVar[str] = "camera model"
    made_by: ClassVar[str] = '"l3 calibrate"'

    name: str = data("str", doc="name of the camera")
    rows: int = data("int64", unit="pixel", doc="rows of the sensor")
    cols: int = data("int64", unit="pixel", doc="columns of the sensor")
    pixel_pitch: float = data("float64", unit="m", doc="distance between the centres of neighbouring pixels")
    bits: int = data("int64", unit="bit", doc="bit depth of the analog-to-digital converter")
    channels: tuple[str, ...] = data("str", "channel", doc="names of the spectral channels")
    cfa: NDArray[np.uint8] = data(
        "uint8", "cfa_row", "cfa_col", doc="index of the channel at each site, for one period of the colour filter array"
    )
    wavelength: NDArray[np.float64] = data("float64", "wavelength", unit="nm", doc="wavelengths of the responsivities")
    responsivity: NDArray[np.float64] = data(
        "float64",
        "channel",
        "wavelength",
        unit="e-/photon",
        doc="quantum efficiency, including lens, filters and fill factor; if absolute is false: relative, with a peak of 1",
    )
    responsivity_band: NDArray[np.float64] = data(
        "float64", "channel", "wavelength", unit="e-/photon", doc="half width of the 95 % confidence band; 0: not measured"
    )
    absolute: bool = data("bool", doc="whether responsivity contains quantum efficiencies; otherwise it is relative")
    gain: float = data("float64", unit="DN/e-", doc="conversion gain K")
    black_level: float = data("float64", unit="DN", doc="mean value in the dark at zero exposure")
    white_level: float = data(
        "float64",
        unit="DN",
        doc="value at which a pixel saturates, because its well is full or the converter reaches its limit",
    )
    fixed_pattern_seed: int = data("int64", doc="seed of the random PRNU and DSNU maps of this camera")
    noise: Noise = group()
    optics: Optics = group()
    declared: tuple[str, ...] = data(
        "str", "declared", doc="quantities from a data sheet, which the calibration did not measure", default=()
    )
    fit: Fit | None = group(default=None)
    defects: DefectMap | None = group(default=None)
    flat_field: FlatField | None = group(default=None)
    readout: Readout | None = group(default=None)
    gains: AnalogGains | None = group(default=None)
    polarisers: Polarisers | None = group(default=None)
    polariser_field: PolariserField | None = group(default=None)
    masked: MaskedPixels | None = group(default=None)
    noise_left: float = 1.0
    lines_corrected: bool = False

    def __post_init__(self) -> None:
        super().__post_init__()
        check_sensor(self.rows, self.cols, self.bits, self.black_level, self.white_level)
        check_cfa(self.cfa, self.channels)
        check_wavelengths(self.wavelength)
        if not (self.pixel_pitch > 0 and self.gain > 0 and self.responsivity.max() > 0 and self.fixed_pattern_seed >= 0):
            raise ValueError(
                "pixel_pitch, gain and the peak of responsivity must be positive, and fixed_pattern_seed must not be "
                "negative"
            )
        if self.absolute and not self.responsivity.max() <= 1.0 + ROUNDING:
            raise ValueError(f"the peak quantum efficiency is {self.responsivity.max():.4g}, but cannot exceed 1")
        if self.defects and (self.defects.position >= (self.rows, self.cols)).any():
            raise ValueError(f"defects contains positions outside the {self.rows}×{self.cols} pixels of the sensor")
        if self.masked and self.readout:
            raise ValueError(
                "masked pixels cannot be combined with channels that differ in exposure time, gain or read noise; remove "
                "one of the two"
            )
        if self.flat_field and not self.flat_field.covers(self.rows, self.cols):
            raise ValueError(f"the flat field does not cover the {self.rows}×{self.cols} pixels of the sensor")
        if self.polariser_field and self.polariser_field.response_deviation.shape != (self.rows, self.cols, 3):
            raise ValueError(f"the polariser field does not cover the {self.rows}×{self.cols} pixels of the sensor")

    @property
    def summary(self) -> str:
        array = f"{self.cfa.shape[0]}×{self.cfa.shape[1]} CFA of {', '.join(self.channels)}"
        return f'"{self.name}", {self.rows}×{self.cols} pixels of {self.bits} bits, {array}'

    @property
    def full_scale(self) -> float:
        """Range between the black level and the white level, in electrons."""
        return (self.white_level - self.black_level) / self.gain

    def resized(self, rows: int, cols: int) -> "CameraModel":
        """Return the camera model with another sensor size in pixels, and without the maps of its pixels.

        The maps are the defect map, the flat field and the polariser field.
        """
        return replace(self, rows=rows, cols=cols, defects=None, flat_field=None, polariser_field=None)

    def at_gain(self, gain: float) -> "CameraModel":
        """Return the camera model at a different analog gain.

        The black and white levels stay unchanged. Between the gains with a known read noise, the read-noise variance is
        interpolated linearly in 1/gain². Outside this range, the nearest known value applies (docs/method.md#gains). The
        temporal row and column noise scales with the read noise.

        Parameters
        ----------
        gain : float
            Analog gain, relative to this camera model.
        """
        if gain == 1:
            return self
        known, further = self.gains, {1.0: self.noise.read_noise}
        if known is not None:
            further |= dict(zip(known.analog_gain.tolist(), known.gain_read_noise.tolist(), strict=True))
        places = sorted(further, reverse=True)
        squares = [further[each] ** 2 for each in places]
        read_noise = float(np.sqrt(np.interp(gain**-2, [each**-2 for each in places], squares)))
        others = sorted(each for each in further if each != gain)
        gains, readout, own = None, self.readout, self.noise.read_noise
        if known is not None:
            over, noises = np.array(others) / gain, np.array([further[each] for each in others])
            gains = AnalogGains(over, noises, known.iso * gain)
        if readout is not None and own > 0:
            readout = replace(readout, channel_read_noise=readout.channel_read_noise * (read_noise / own))
        noise = replace(self.noise, read_noise=read_noise)
        if own > 0 and noise.lines:
            times = read_noise / own
            noise = replace(
                noise,
                row_temporal_noise=noise.row_temporal_noise * times,
                column_temporal_noise=noise.column_temporal_noise * times,
            )
        return replace(self, gain=self.gain * gain, noise=noise, readout=readout, gains=gains)

    def gain_at(self, iso: float) -> float | None:
        """Convert an ISO speed to an analog gain, relative to the gain of this camera model.

        Returns None if `iso` is not positive, or if the camera model has no known ISO speed.
        """
        return iso / self.gains.iso if iso > 0 and self.gains and self.gains.iso > 0 else None

    def under(self, noise: NoiseScale) -> "CameraModel":
        """Return the camera model at the gain and with the remaining temporal noise that `noise` specifies."""
        return replace(self.at_gain(noise.gain), noise_left=noise.noise_left)

    def channel_map(self, shape: tuple[int, ...]) -> NDArray[np.uint8]:
        """Return the channel index of each pixel in a frame that begins at CFA site (0, 0)."""
        return tiled(self.cfa, shape)

    @property
    def sensitivity(self) -> NDArray[np.float64]:
        """Exposure time × gain of each channel, relative to the most sensitive channel.

        All values are 1 if the channels have the same readout.
        """
        return np.ones(len(self.channels)) if self.readout is None else self.readout.sensitivity

    @property
    def channel_gains(self) -> NDArray[np.float64]:
        """Conversion gain of each channel, relative to `gain`. All values are 1 if the channels have the same readout."""
        return np.ones(len(self.channels)) if self.readout is None else self.readout.channel_gain

    @property
    def stokes_response(self) -> NDArray[np.float64]:
        """Response of each channel to the Stokes parameters S0, S1 and S2, relative to the channel's responsivity.

        The shape is (channel, stokes, wavelength). A channel without a polariser has the response (1, 0, 0).
        """
        if self.polarisers is not None:
            return self.polarisers.stokes_response
        response = np.zeros((len(self.channels), 3, self.wavelength.size))
        response[:, 0] = 1.0
        return response

    @property
    def relative_stokes_response(self) -> NDArray[np.float64]:
        """Response (channel, stokes) to S0, S1 and S2, divided by the response to S0.

        It applies to light with the same number of photons per nm at all wavelengths.
        """
        total = self.stokes_weights.sum(axis=2)
        return np.asarray((total / total[0]).T)

    @property
    def electron_weights(self) -> NDArray[np.float64]:
        """Matrix (channel, wavelength) that converts unpolarised radiance to photo-electrons per second of exposure.

        The radiance is in photons/s/sr/m²/nm (docs/method.md#sensor).
        """
        weights = self._axis_weights
        return weights if self.polarisers is None else weights * self.stokes_response[:, 0]

    @property
    def stokes_weights(self) -> NDArray[np.float64]:
        """Matrices (stokes, channel, wavelength) that convert S0, S1 and S2 to photo-electrons per second of exposure.

        The Stokes parameters are radiances in photons/s/sr/m²/nm. The contributions of S0, S1 and S2 add up to the total
        number of photo-electrons. The first matrix, for S0, equals `electron_weights`.
        """
        return np.moveaxis(self._axis_weights[:, None] * self.stokes_response, 1, 0)

    @property
    def _axis_weights(self) -> NDArray[np.float64]:
        """Matrix (channel, wavelength) that converts radiance polarised along each polariser's axis to photo-electrons.

        Units are as in `electron_weights`.
        """
        photons = self.optics.irradiance_per_radiance * self.pixel_pitch**2 * spectra.bin_widths(self.wavelength)
        if self.readout is not None:
            return self.responsivity * photons * self.readout.channel_exposure[:, None]
        return self.responsivity * photons

    @property
    def signal_weights(self) -> NDArray[np.float64]:
        """`electron_weights` of each channel, multiplied by the channel's relative gain.

        Multiplied by `gain`, this matrix (channel, wavelength) converts radiance in photons/s/sr/m²/nm to the signal in DN
        per second of exposure.
        """
        weights = self.electron_weights
        return weights if self.readout is None else weights * self.readout.channel_gain[:, None]

    @functools.cached_property
    def saturation_exposure(self) -> float:
        """Luminance × exposure time (cd s/m²) at which a perfect D65 white just saturates the most sensitive channel.

        Raises
        ------
        InputFileError
            If the camera is almost insensitive to this white, or if none of its wavelengths is visible.
        """
        with raised_as(InputFileError, f"camera {self.name}", InputFileError):
            white = spectra.at_luminance(spectra.illuminant("D65", self.wavelength), self.wavelength, 1.0)
        electrons = float((self.signal_weights @ white).max())
        exposure = self.full_scale / electrons if electrons > 0 else np.inf
        if not exposure <= LARGEST_VALUE:
            raise InputFileError(
                f"camera {self.name}: pixels saturate only at {exposure:.3g} cd s/m² of daylight, which is implausible; "
                "check the responsivity, the pixel pitch and the f-number"
            )
        return exposure

    @property
    def output_unit(self) -> float:
        """Luminance × exposure time, in cd s/m², at which the tables for this camera output 1.

        If the channel sensitivities differ by at most a factor of 4, this is `saturation_exposure`. Otherwise it is a
        quarter of the exposure that saturates the least sensitive channel (docs/method.md#exposures).
        """
        return self.saturation_exposure * max(1.0, 0.25 / float(self.sensitivity.min()))

    def dark_signal(self, exposure: float | None) -> float:
        """Return the mean dark signal after `exposure` seconds, in DN (docs/method.md#dark-current).

        If the exposure time is unknown (None), the result is 0.
        """
        return 0.0 if exposure is None else self.gain * self.noise.dark_current * exposure

    def noise_variance(
        self, signal: NDArray[np.floating], dark: float = 0.0, channel: NDArray[np.integer] | None = None
    ) -> NDArray[np.floating]:
        """Return the noise variance at a given signal in DN², including quantisation noise (docs/method.md#noise).

        Parameters
        ----------
        signal : ndarray
            Mean signal above black in DN, in a frame that `RawFrame.at_levels` has rescaled. The variance at a negative
            signal equals the variance at 0.
        dark : float
            Dark signal that was subtracted from the frame, in DN.
        channel : ndarray of int, optional
            Channel of each value of `signal`, as in `noise_terms`.
        """
        constant, linear, quadratic = self.noise_terms(dark, channel)
        signal = np.maximum(signal, 0.0)
        return constant + (linear + quadratic * signal) * signal

    def noise_terms(self, dark: float = 0.0, channel: NDArray[np.integer] | None = None) -> tuple[Any, Any, float]:
        """Return the coefficients of the polynomial that describes the noise variance as a function of the signal.

        The signal is in DN above black. The coefficients apply to frames after dark correction, which subtracts the mean
        dark signal and stretches the remaining range to full scale. These frames still contain the shot noise and the
        nonuniformity of the dark signal. `noise_left` scales the temporal noise, but not the quantisation noise. The
        quadratic coefficient consists only of fixed-pattern noise (PRNU), and the temporal filter relies on this.

        Parameters
        ----------
        dark : float
            Dark signal, in DN, of a channel with the full exposure time and the gain `gain`.
        channel : ndarray of int, optional
            Channel of each pixel, required if the channels differ in exposure time or gain. [default: a channel with the
            full exposure time and the gain `gain`]

        Returns
        -------
        constant, linear, quadratic
            Coefficients in DN², DN and 1. If the channels differ and `channel` is set, `constant` and `linear` are arrays
            with the shape of `channel`. Otherwise all coefficients are numbers.

        Raises
        ------
        ValueError
            If the dark current alone saturates a pixel.
        """
        noise, left, span = self.corrected_noise(dark), self.noise_left, self.white_level - self.black_level
        if not dark < span:
            raise ValueError(
                f"camera {self.name}: the dark current alone saturates the pixels, with a dark signal of {dark:.4g} DN at a "
                f"full scale of {span:.4g} DN; check the exposure time"
            )
        stretch, prnu = span / (span - dark), noise.uneven
        gain: Any = self.gain
        temporal: Any = noise.temporal
        channel_dark: Any = dark
        if self.readout is not None and channel is not None:
            gain = self.gain * self.readout.channel_gain[channel]
            rounding = noise.read_noise**2 - self.noise.read_noise**2  # variance from rounding the corrected values
            temporal = self.readout.channel_read_noise[channel] ** 2 + rounding + noise.lines
            channel_dark = dark * (self.readout.channel_exposure * self.readout.channel_gain)[channel]
        constant = gain**2 * (left * temporal + noise.fixed) + QUANTISATION
        constant += (left * gain + prnu * channel_dark) * channel_dark
        return stretch**2 * constant, stretch * (left * gain + 2 * prnu * channel_dark), prnu

    def pixel_variance(self, dark: float = 0.0) -> float:
        """Return the noise variance of a masked pixel in (e-)², not including row and column offsets.

        Quantisation noise is included. `dark` is the dark signal in DN, as in `noise_terms`.
        """
        return self.noise.read_noise**2 + self.noise.dsnu**2 + QUANTISATION / self.gain**2 + dark / self.gain

    def corrected_noise(self, dark: float = 0.0) -> Noise:
        """Return the noise that remains after row and column offsets have been corrected.

        The offsets are measured with masked pixels (see `variance_left`) or, if the camera has none, with the picture itself
        (see `variance_left_by_picture`). The correction raises the read noise, because corrected values are rounded to whole
        DN. If the camera has no row and column noise, the result is `noise`. `dark` is the dark signal in DN, as in
        `noise_terms`.
        """
        noise, masked = self.noise, self.masked
        if self.lines_corrected or not self.has_line_noise:
            return noise
        pixel = self.pixel_variance(dark)
        by_row = noise.row_temporal_noise**2 + noise.row_noise**2
        by_column = noise.column_temporal_noise**2 + noise.column_noise**2
        if masked is None:
            signal = PICTURE_SIGNAL * self.full_scale
            rows = variance_left_by_picture(by_row, pixel + by_column, signal, self.cols)
            columns = variance_left_by_picture(by_column, pixel + by_row, signal, self.rows)
        else:
            rows = variance_left(by_row, pixel, masked.left + masked.right)
            columns = variance_left(by_column, pixel, masked.top + masked.bottom)
        down = float(np.sqrt(rows / by_row)) if by_row else 1.0
        across = float(np.sqrt(columns / by_column)) if by_column else 1.0
        rounded = (rows, columns) != (by_row, by_column)
        return replace(
            noise,
            read_noise=float(np.sqrt(noise.read_noise**2 + rounded * DITHER / self.gain**2)),
            row_temporal_noise=noise.row_temporal_noise * down,
            row_noise=noise.row_noise * down,
            column_temporal_noise=noise.column_temporal_noise * across,
            column_noise=noise.column_noise * across,
        )

    @property
    def offset_noise(self) -> float:
        """Standard deviation in e- of the row and column offsets, fixed and temporal, that remain after their correction."""
        noise = self.corrected_noise()
        return float(np.sqrt(noise.lines + noise.row_noise**2 + noise.column_noise**2))

    def as_corrected(self) -> "CameraModel":
        """Return the camera model that applies to frames after the correction of row and column offsets.

        It has no masked pixels, and its noise is `corrected_noise`.
        """
        if self.masked is None and not self.has_line_noise:
            return self
        noise, readout = self.corrected_noise(), self.readout
        if readout is not None:
            rounding = noise.read_noise**2 - self.noise.read_noise**2
            readout = replace(readout, channel_read_noise=np.sqrt(readout.channel_read_noise**2 + rounding))
        return replace(self, noise=noise, readout=readout, masked=None, lines_corrected=True)

    @property
    def has_line_noise(self) -> bool:
        """Whether the camera has row or column noise, fixed or temporal."""
        return bool(self.noise.lines or self.noise.column_noise or self.noise.row_noise)

    def line_variances(self, dark: float = 0.0) -> tuple[float, float]:
        """Return the variance of the row offsets and of the column offsets. Temporal and fixed offsets are included.

        All pixels of a row share the row offset, and all pixels of a column share the column offset. The result is what
        remains after the correction of the offsets (see `corrected_noise`). The constant term of `noise_terms` includes both
        variances. They apply to a channel with a relative gain of 1. In other channels, the offsets are multiplied by the
        relative gain.

        Parameters
        ----------
        dark : float
            Dark signal in DN, as in `noise_terms`.

        Returns
        -------
        rows, columns : float
            Variances in DN².
        """
        noise, span = self.corrected_noise(dark), self.white_level - self.black_level
        unit = (self.gain * span / (span - dark)) ** 2
        rows = self.noise_left * noise.row_temporal_noise**2 + noise.row_noise**2
        return unit * rows, unit * (self.noise_left * noise.column_temporal_noise**2 + noise.column_noise**2)
