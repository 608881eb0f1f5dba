"""Calibration results, including the residuals of the fits. Camera models store them in the group `fit`."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.schema import data, group

# Messages list the most probable illuminants, until their probabilities add up to GUESSED_PROBABILITY or MAX_GUESSES
# illuminants are listed.
GUESSED_PROBABILITY, MAX_GUESSES = 0.9, 4


@dataclass(frozen=True)
class Nonuniformity:
    """Spectra, profiles and histograms of DSNU or PRNU, as in EMVA 1288, release 4.0.

    DSNU values are in e-, and PRNU values are fractions of the mean response. The mean of each CFA site is 0.
    """

    frequency: NDArray[np.float64] = data(
        "float64", "pattern_frequency", unit="1/pixel", doc="spatial frequency in cycles per pixel", coordinate=True
    )
    horizontal_spectrum: NDArray[np.float64] = data(
        "float64", "pattern_frequency", doc="square root of the power spectrum along rows, without temporal noise"
    )
    vertical_spectrum: NDArray[np.float64] = data(
        "float64", "pattern_frequency", doc="square root of the power spectrum along columns, without temporal noise"
    )
    column: NDArray[np.float64] = data(
        "float64", "pattern_column", unit="pixel", doc="position of the profile", coordinate=True
    )
    horizontal_profile: NDArray[np.float64] = data(
        "float64", "pattern_profile", "pattern_column", doc="mean, minimum and maximum over all rows, and the middle row"
    )
    row: NDArray[np.float64] = data("float64", "pattern_row", unit="pixel", doc="position of the profile", coordinate=True)
    vertical_profile: NDArray[np.float64] = data(
        "float64", "pattern_profile", "pattern_row", doc="mean, minimum and maximum over all columns, and the middle column"
    )
    histogram_edge: NDArray[np.float64] = data("float64", "pattern_edge", doc="edges of the histogram", coordinate=True)
    histogram_count: NDArray[np.int64] = data("int64", "pattern_bin", doc="number of pixels in each bin of the histogram")
    threshold: NDArray[np.float64] = data(
        "float64", "pattern_threshold", doc="absolute deviation, for the accumulated histogram", coordinate=True
    )
    exceeding: NDArray[np.int64] = data(
        "int64", "pattern_threshold", doc="number of pixels with at least this absolute deviation"
    )
    spread: float = data("float64", doc="standard deviation of the pixels in the histogram, without hot and dead pixels")

    def divided_by(self, unit: float) -> "Nonuniformity":
        """Convert the results to another unit."""
        keep = ("frequency", "column", "row", "histogram_count", "exceeding")
        return replace(self, **{name: value / unit for name, value in vars(self).items() if name not in keep})


@dataclass(frozen=True)
class NoiseFit:
    """Noise parameters of each channel as defined in EMVA 1288, measured in dark and white frames."""

    conversion_gain: NDArray[np.float64] = data("float64", "channel", unit="DN/e-", doc="overall system gain K")
    conversion_gain_error: NDArray[np.float64] = data(
        "float64", "channel", unit="DN/e-", doc="standard deviation of K, from the fit of the photon-transfer line"
    )
    read_noise: NDArray[np.float64] = data("float64", "channel", unit="e-", doc="temporal dark noise at zero exposure")
    dark_current: NDArray[np.float64] = data("float64", "channel", unit="e-/s", doc="dark current")
    dsnu: NDArray[np.float64] = data(
        "float64",
        "channel",
        unit="e-",
        doc="dark signal nonuniformity of the pixels, without fixed offsets of rows and columns",
    )
    prnu: NDArray[np.float64] = data(
        "float64", "channel", doc="photo response nonuniformity of pixels, rows and columns, as a fraction of the signal"
    )
    saturation_capacity: NDArray[np.float64] = data("float64", "channel", unit="e-", doc="electrons at saturation")
    linearity_error: NDArray[np.float64] = data(
        "float64", "channel", doc="mean relative deviation of the signal from a line over 5-95 % of saturation"
    )
    white_level_reached: bool = data(
        "bool", doc="whether a white frame saturates; if not, white_level is the top of the converter"
    )
    defects: NDArray[np.int64] = data(
        "int64",
        "defect",
        "coordinate",
        unit="pixel",
        doc="row and column of hot and dead pixels, which are excluded from all results",
    )
    exposure: NDArray[np.float64] = data(
        "float64", "white_exposure", unit="s", doc="exposure time of each white capture", coordinate=True
    )
    photon_transfer_mean: NDArray[np.float64] = data(
        "float64", "white_exposure", "channel", unit="DN", doc="mean signal above black of each white exposure"
    )
    photon_transfer_variance: NDArray[np.float64] = data(
        "float64", "white_exposure", "channel", unit="DN^2", doc="temporal variance of each white exposure"
    )
    row_temporal_noise: float = data(
        "float64",
        unit="e-",
        doc="part of the temporal dark noise that the pixels of a row share; 0: not significant",
        optional=0.0,
    )
    row_temporal_noise_error: float = data(
        "float64", unit="e-", doc="standard deviation of the measured row noise", optional=0.0
    )
    column_temporal_noise: float = data(
        "float64",
        unit="e-",
        doc="part of the temporal dark noise that the pixels of a column share; 0: not significant",
        optional=0.0,
    )
    column_temporal_noise_error: float = data(
        "float64", unit="e-", doc="standard deviation of the measured column noise", optional=0.0
    )
    pixel_noise: NDArray[np.float64] | None = data(
        "float64",
        "channel",
        unit="e-",
        doc="part of the temporal dark noise that pixels do not share with their row or column; None: as read_noise",
        optional=None,
    )
    dsnu_error: NDArray[np.float64] | None = data(
        "float64", "channel", unit="e-", doc="standard error of dsnu; None: unknown", optional=None
    )
    prnu_error: NDArray[np.float64] | None = data(
        "float64", "channel", doc="standard error of prnu; None: unknown", optional=None
    )
    row_noise: float = data(
        "float64", unit="e-", doc="standard deviation of the fixed offsets of rows; 0: not significant", optional=0.0
    )
    row_noise_error: float = data("float64", unit="e-", doc="standard error of row_noise", optional=0.0)
    column_noise: float = data(
        "float64", unit="e-", doc="standard deviation of the fixed offsets of columns; 0: not significant", optional=0.0
    )
    column_noise_error: float = data("float64", unit="e-", doc="standard error of column_noise", optional=0.0)
    row_prnu: float = data(
        "float64",
        doc="part of prnu that all pixels of a row have in common, as a fraction of the signal; 0: not significant",
        optional=0.0,
    )
    row_prnu_error: float = data("float64", doc="standard error of row_prnu", optional=0.0)
    column_prnu: float = data(
        "float64",
        doc="part of prnu that all pixels of a column have in common, as a fraction of the signal; 0: not significant",
        optional=0.0,
    )
    column_prnu_error: float = data("float64", doc="standard error of column_prnu", optional=0.0)
    blinking_frames: int = data(
        "int64", doc="number of dark frames in which blinking pixels were searched; 0: too few dark frames", optional=0
    )
    blinking: NDArray[np.int64] | None = data(
        "int64",
        "blinking_pixel",
        "coordinate",
        unit="pixel",
        doc="row and column of pixels that blink in dark frames; None: none were found",
        optional=None,
    )
    blinking_step: NDArray[np.float64] | None = data(
        "float64", "blinking_pixel", unit="e-", doc="difference between the two levels of each blinking pixel", optional=None
    )
    dark_current_variance: NDArray[np.float64] | None = data(
        "float64",
        "channel",
        unit="e-/s",
        doc="dark current from the increase of the temporal variance; None: unknown",
        optional=None,
    )
    dark_current_variance_error: NDArray[np.float64] | None = data(
        "float64", "channel", unit="e-/s", doc="standard error of dark_current_variance; None: unknown", optional=None
    )
    dark_pattern: Nonuniformity | None = group(default=None)  # DSNU in e-; None: not stored
    response_pattern: Nonuniformity | None = group(default=None)  # PRNU as a fraction; None: not stored

    @property
    def pixel_prnu(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Each channel's PRNU without row and column PRNU, and its standard error, which is 0 if it is unknown."""
        variance = self.prnu**2 - self.row_prnu**2 - self.column_prnu**2
        deviation = np.sqrt(np.maximum(variance, 0.0)) if self.row_prnu or self.column_prnu else self.prnu
        if self.prnu_error is None:
            return deviation, np.zeros_like(deviation)
        lines = ((self.row_prnu, self.row_prnu_error), (self.column_prnu, self.column_prnu_error))
        square = (self.prnu * self.prnu_error) ** 2 - sum((value * error) ** 2 for value, error in lines)
        error = np.sqrt(np.maximum(square, 0.0)) / np.where(deviation > 0, deviation, 1.0)
        return deviation, np.where(deviation > 0, error, 0.0)


@dataclass(frozen=True)
class SweepFit:
    """Fit of the responsivities to captures of monochromatic light (Eq. 1 in docs/method.md#responsivity)."""

    residual: NDArray[np.float64] = data(
        "float64", "channel", doc="RMS residual of Eq. 1, relative to the largest value of the channel"
    )
    left_out: tuple[str, ...] = data(
        "str", "left_out", doc="captures that were not used because they are saturated, and their saturated channels"
    )
    smoothing: NDArray[np.float64] = data(
        "float64", "trial", doc="smoothing parameters delta that were tried", coordinate=True
    )
    smoothing_error: NDArray[np.float64] = data(
        "float64", "trial", doc="cross-validated relative RMSE of chart values for each delta"
    )
    chosen_smoothing: float = data("float64", doc="smoothing parameter delta that was chosen")
    odd: tuple[str, ...] = data(
        "str", "odd", doc="captures whose values disagree with those of neighbouring captures, and by how much", default=()
    )


@dataclass(frozen=True)
class ChartFit:
    """Fit of gain and offset to captures of charts (docs/method.md#gain-and-offset), with measured and predicted values."""

    alpha: NDArray[np.float64] = data(
        "float64", "channel", unit="DN/photon", doc="slope of Eq. 2: response at the peak of the channel's responsivity"
    )
    alpha_error: NDArray[np.float64] = data(
        "float64", "channel", unit="DN/photon", doc="standard deviation of alpha, from its spread over the charts"
    )
    beta: NDArray[np.float64] = data("float64", "channel", unit="DN", doc="offset of Eq. 2: black level plus glare")
    r_squared: NDArray[np.float64] = data("float64", "channel", doc="R² of predicted against measured values")
    relative_rmse: NDArray[np.float64] = data(
        "float64", "channel", doc="RMSE of predicted values, relative to the mean signal"
    )
    illuminants: tuple[str, ...] = data("str", "chart", doc="illuminant of each chart capture")
    measured: NDArray[np.float64] = data("float64", "chart", "patch", "channel", unit="DN", doc="mean value of each patch")
    predicted: NDArray[np.float64] = data(
        "float64", "chart", "patch", "channel", unit="DN", doc="mean value of each patch that the model predicts"
    )


@dataclass(frozen=True)
class DriftFit:
    """Lamp drift, estimated from the charts. It is stored only if it exceeds the declared drift."""

    deviation: float = data("float64", doc="estimated relative standard deviation of the lamps from their measured spectra")
    declared: float = data("float64", doc="relative standard deviation that the measurement file states")


@dataclass(frozen=True)
class SeriesFit:
    """Fit of chart captures through narrow-band filters.

    Each patch value is predicted from the patch's values in the other exposures with the same filter.
    """

    lights: tuple[str, ...] = data("str", "band", doc="name of each band")
    light: NDArray[np.int64] = data("int64", "capture", doc="band of each capture")
    exposure: NDArray[np.float64] = data("float64", "capture", unit="s", doc="exposure time of each capture")
    response: NDArray[np.float64] = data(
        "float64", "band", "channel", doc="mean response per photon of the patches to each band, scaled to a peak of 1"
    )
    spread: NDArray[np.float64] = data(
        "float64", "band", "channel", doc="relative standard deviation of the response over patches"
    )
    linearity_error: NDArray[np.float64] = data(
        "float64", "channel", doc="mean relative deviation of the signal from proportionality over 5-95 % of saturation"
    )
    r_squared: NDArray[np.float64] = data("float64", "channel", doc="R² of predicted against measured values")
    relative_rmse: NDArray[np.float64] = data(
        "float64", "channel", doc="RMSE of predicted values, relative to the mean signal"
    )
    left_out: tuple[str, ...] = data(
        "str", "left_out", doc="captures with saturated patches, and the number of these patches"
    )
    used: NDArray[np.bool_] = data(
        "bool",
        "capture",
        "patch",
        "channel",
        doc="whether the patch was unsaturated, so that measured and predicted values can be compared",
    )
    measured: NDArray[np.float64] = data(
        "float64", "capture", "patch", "channel", unit="DN", doc="mean value of each patch, with the dark value subtracted"
    )
    predicted: NDArray[np.float64] = data(
        "float64", "capture", "patch", "channel", unit="DN", doc="value predicted from the other exposures; 0: not predicted"
    )


@dataclass(frozen=True)
class LightGuess:
    """Probability of each common illuminant for each photo, assuming that one of them lit the photo."""

    names: tuple[str, ...] = data("str", "usual_light", doc="names of the common illuminants")
    probability: NDArray[np.float64] = data("float64", "photo", "usual_light", doc="probability of each common illuminant")

    def of(self, photo: int) -> dict[str, float]:
        """Return the probability of each common illuminant for photo number `photo`, in descending order."""
        found = zip(self.names, map(float, self.probability[photo]), strict=True)
        return dict(sorted(found, key=lambda each: each[1], reverse=True))


def guessed_light(probable: Mapping[str, float]) -> str:
    """Describe the most probable illuminants in one line, with their probabilities in percent.

    `probable` contains the probabilities of all illuminants, in descending order.
    """
    parts, total = [], 0.0
    for name, probability in probable.items():
        parts.append(f"{name} {100 * probability:.0f} %")
        total += probability
        if total >= GUESSED_PROBABILITY or len(parts) == MAX_GUESSES:
            break
    return f"guessed: {', '.join(parts)}"


@dataclass(frozen=True)
class PhotoWindow:
    """The sensor area that each photo covers. It is stored only if a photo does not cover the whole sensor."""

    first_site: NDArray[np.int64] = data(
        "int64", "photo", "coordinate", doc="row and column of the CFA site of the first pixel"
    )
    size: NDArray[np.int64] = data("int64", "photo", "coordinate", unit="pixel", doc="rows, columns of each photo")

    def of(self, photo: int) -> tuple[tuple[int, int], tuple[int, int]]:
        """Return the CFA site (row, column) of a photo's first pixel and the size (rows, columns) of the photo."""
        (row, col), (rows, cols) = self.first_site[photo].tolist(), self.size[photo].tolist()
        return (row, col), (rows, cols)


@dataclass(frozen=True)
class PhotoFit:
    """Fit of the camera model to photos of charts with known reflectances."""

    names: tuple[str, ...] = data("str", "photo", doc="name of each photo")
    lights: tuple[str, ...] = data("str", "photo", doc="illuminant of each photo, as stated or guessed")
    guessed: NDArray[np.bool_] = data("bool", "photo", doc="whether the illuminant was guessed")
    nearest: tuple[str, ...] = data("str", "photo", doc="common illuminant under which the values are most probable")
    deficit: NDArray[np.float64] = data(
        "float64",
        "photo",
        doc="natural logarithm of a ratio: probability of the values under the illuminant in nearest, divided by their "
        "probability under the illuminant in lights",
    )
    charts: tuple[str, ...] = data("str", "photo", doc="chart of each photo")
    corners: NDArray[np.float64] = data(
        "float64",
        "photo",
        "corner",
        "coordinate",
        unit="pixel",
        doc="column and row of the chart's outer corners, clockwise",
    )
    prior: str = data(
        "str", doc="prior for the curves: similar to measured cameras, unlike measured cameras, or only smooth"
    )
    error: float = data("float64", doc="relative error of a patch due to reflectances and model, estimated from the misfit")
    illumination: NDArray[np.float64] = data(
        "float64",
        "photo",
        "term",
        doc="coefficients of the illumination over the chart, for the terms 1, x, y, x², xy, y²; x and y extend from −1 to "
        "1, and the means of x² and y² are subtracted",
    )
    glare: NDArray[np.float64] = data("float64", "photo", "channel", unit="DN", doc="offset that glare adds to every patch")
    noise_from_patches: bool = data("bool", doc="whether gain and dark noise come from the photon transfer of the patches")
    response_band: NDArray[np.float64] = data(
        "float64",
        "channel",
        doc="RMS half width of the 95 % band of responses to surfaces under other illuminants, relative to the largest "
        "response",
    )
    next_light: str = data("str", doc="illuminant under which one more photo would reduce the error of the responses most")
    next_share: float = data("float64", doc="fraction of the error of the responses that would remain after that photo")
    left_out: tuple[str, ...] = data(
        "str", "left_out", doc="patches and channels that were not used, because they are clipped, dusty or outliers"
    )
    used: NDArray[np.bool_] = data("bool", "photo", "photo_patch", "channel", doc="whether a patch was used")
    measured: NDArray[np.float64] = data(
        "float64", "photo", "photo_patch", "channel", unit="DN", doc="mean value above black of each patch"
    )
    predicted: NDArray[np.float64] = data(
        "float64", "photo", "photo_patch", "channel", unit="DN", doc="mean value above black that the model predicts"
    )
    likely: LightGuess | None = group(default=None)
    window: PhotoWindow | None = group(default=None)  # None: every photo covers the whole sensor

    @property
    def misfit(self) -> NDArray[np.float64]:
        """RMS error of the predicted values over all used patches, relative to the brightest patch: (photo, channel)."""
        left = np.where(self.used, self.measured - self.predicted, 0.0)
        count = np.maximum(self.used.sum(axis=1), 1)
        return np.asarray(np.sqrt((left**2).sum(axis=1) / count) / np.where(self.used, self.measured, 0.0).max(axis=1))


@dataclass(frozen=True)
class PolariserFit:
    """Fit of Malus's law to frames of a uniform light source behind a rotating polariser.

    A channel without a polariser has the angle 0 and the leakage 1, with standard deviations of 0.
    """

    light_angle: NDArray[np.float64] = data(
        "float64", "polariser_capture", unit="deg", doc="angle of the rotating polariser", coordinate=True
    )
    light_polarisation: float = data("float64", doc="degree of linear polarisation of the light")
    polarised: NDArray[np.bool_] = data("bool", "channel", doc="whether the channel has a polariser")
    angle: NDArray[np.float64] = data("float64", "channel", unit="deg", doc="angle of the transmission axis")
    angle_error: NDArray[np.float64] = data("float64", "channel", unit="deg", doc="standard deviation of the angle")
    leakage: NDArray[np.float64] = data("float64", "channel", doc="inverse of the extinction ratio")
    leakage_error: NDArray[np.float64] = data("float64", "channel", doc="standard deviation of the leakage")
    gain: NDArray[np.float64] = data(
        "float64", "channel", doc="response to the light if it were polarised along the axis, relative to the mean"
    )
    gain_error: NDArray[np.float64] = data("float64", "channel", doc="standard deviation of the gain")
    brightness: NDArray[np.float64] = data(
        "float64", "polariser_capture", doc="brightness of the light, relative to the monitor"
    )
    used: NDArray[np.bool_] = data("bool", "polariser_capture", "channel", doc="whether a signal was used")
    measured: NDArray[np.float64] = data("float64", "polariser_capture", "channel", unit="DN/s", doc="measured signal")
    predicted: NDArray[np.float64] = data("float64", "polariser_capture", "channel", unit="DN/s", doc="fitted signal")


@dataclass(frozen=True)
class Fit:
    """Calibration results of a camera. An attribute is None if the measurement file lacks the captures that it needs."""

    noise: NoiseFit | None = group(default=None)
    sweep: SweepFit | None = group(default=None)
    chart: ChartFit | None = group(default=None)
    series: SeriesFit | None = group(default=None)
    photo: PhotoFit | None = group(default=None)
    drift: DriftFit | None = group(default=None)  # None: the drift is not larger than declared
    polarisers: PolariserFit | None = group(default=None)

    @property
    def validation(self) -> ChartFit | SeriesFit | None:
        """The fit that compares measured and predicted chart values: `chart` or, if there is none, `series`."""
        return self.chart or self.series
