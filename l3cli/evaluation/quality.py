"""Metrics for the difference between a rendered frame and its target (docs/method.md#quality-metrics).

XYZ outputs are compared as displayed pictures, all other outputs as spectra. The noise of pictures is measured separately in
uniform patches, because averages over all pixels would hide it.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import correlate1d, find_objects, gaussian_filter, label, maximum_filter1d, minimum_filter1d

from l3cli.errors import RecipeError
from l3cli.physics.display import LUMA, daylight, delta_e_2000, displayed, displayed_xyz, lab, srgb_curve, white_luminance
from l3cli.physics.stokes import angle_difference, aolp, behind, dolp, luminance_name, stokes_of

Array = NDArray[np.floating]
BLUR = 4.0  # pixels; σ of the Gaussian that removes grain but keeps blotches
PATCH_MARGIN_PIXELS = 6  # patches exclude pixels this close to an edge, because rendered edges are blurred
MAX_UNIFORM_RANGE = 1.0  # a window is uniform if L*, a* and b* of the target each vary by at most this value
MIN_PATCH_AREA_PIXELS = 24 * 24  # smallest area of a patch
MAX_PATCHES = 64  # only this number of the largest patches in a frame is evaluated
# A patch is dark if its L* is below DARK_LIGHTNESS. Otherwise it is coloured if its C*ab is at least GREY_CHROMA. Otherwise
# it is white if its L* is at least WHITE_LIGHTNESS, and grey if not.
DARK_LIGHTNESS, WHITE_LIGHTNESS, GREY_CHROMA = 30.0, 85.0, 10.0
HUES = ((-30.0, "red"), (60.0, "yellow"), (120.0, "green"), (200.0, "blue"))  # lower limit of each hue, in degrees
# Weights for the standard deviations of L*, a* and b*. ISO 15739:2013 defines them for L*, u* and v*.
VISUAL = np.array([1.0, 0.852, 0.323])
PATCH_KINDS = ("white", "grey", "dark", *(name for _, name in HUES))


class PlainPatches:
    """Uniform patches of a target, in which the noise of pictures is measured.

    Parameters
    ----------
    target : ndarray, (row, col, 3)
        Displayed target in CIELAB.
    counted : ndarray of bool, (row, col), optional
        Mask of the pixels to evaluate. [default: all pixels]
    """

    def __init__(self, target: Array, counted: NDArray[np.bool_] | None = None) -> None:
        def extreme(of: Any) -> Array:
            window = 2 * PATCH_MARGIN_PIXELS + 1
            return np.asarray(of(of(target, window, axis=0, mode="nearest"), window, axis=1, mode="nearest"))

        self._target = target
        plain = (extreme(maximum_filter1d) - extreme(minimum_filter1d)).max(axis=2) <= MAX_UNIFORM_RANGE
        numbers, _ = label(plain if counted is None else plain & counted)
        sizes = np.bincount(numbers.ravel())
        sizes[0] = 0
        largest = np.argsort(-sizes, kind="stable")[:MAX_PATCHES]
        places = find_objects(numbers)
        self._patches = [
            (places[number - 1], numbers[places[number - 1]] == number)
            for number in largest
            if sizes[number] >= MIN_PATCH_AREA_PIXELS
        ]

    @property
    def kinds(self) -> list[str]:
        """Type of each patch, one of PATCH_KINDS."""
        return [kind_of(self._target[place][inside].mean(axis=0)) for place, inside in self._patches]

    def variances(self, shown: Array) -> Array:
        """Return a picture's colour variance in each patch: the variance of a* plus the variance of b*.

        `shown` (row, col, 3) is the displayed picture in CIELAB. The target is subtracted, so that its variation does not
        count, and the difference is blurred.
        """
        found = []
        for place, inside in self._patches:
            error = (shown[place] - self._target[place])[..., 1:] * inside[..., None]
            weight = gaussian_filter(inside.astype(np.float64), BLUR)
            blurred = gaussian_filter(error, (BLUR, BLUR, 0))[inside] / weight[inside][:, None]
            found.append(blurred.var(axis=0).sum())
        return np.array(found)

    def visual_noise(self, seen: Array, wanted: Array) -> float | None:
        """Return the visual noise: the weighted sum of the standard deviations of L*, a* and b*, averaged over the patches.

        `seen` and `wanted` (row, col, 3) are the picture and the target in CIELAB after the S-CIELAB blur. The result is
        None if there are no patches.
        """
        errors = [(seen[place] - wanted[place])[inside] for place, inside in self._patches]
        return float(np.mean([VISUAL @ each.std(axis=0) for each in errors])) if errors else None


def mottle(variances: Array) -> float | None:
    """Return the mottle, the RMS distance in (a*, b*) from the patch mean, or None if there are no patches.

    `variances` contains the colour variance of each patch, from `PlainPatches.variances`.
    """
    return float(np.sqrt(variances.mean())) if len(variances) else None


def kind_of(lab: Array) -> str:
    """Return the type of a patch, one of PATCH_KINDS, from its mean CIELAB."""
    chroma, hue = float(np.hypot(lab[1], lab[2])), float(np.degrees(np.arctan2(lab[2], lab[1])))
    if lab[0] < DARK_LIGHTNESS:
        return "dark"
    if chroma < GREY_CHROMA:
        return "white" if lab[0] >= WHITE_LIGHTNESS else "grey"
    return [name for start, name in HUES if start <= (hue - HUES[0][0]) % 360 + HUES[0][0]][-1]


CODES = 255  # 8-bit value of a perfect white, for the PSNR
MIN_SQUARE_ERROR = 1e-12  # lower limit of the mean square error, so that the PSNR of equal pictures is 120 dB
WINDOW_SIGMA, WINDOW_REACH = 1.5, 5  # pixels; σ and half width of the 11 × 11 Gaussian window of SSIM
MIN_NORM = float(np.finfo(np.float32).eps)  # target spectra below this fraction of the largest norm are rounding errors
STABILISERS = (0.01**2, 0.03**2)  # C1 and C2 of SSIM for values from 0 to 1
VIEWING = 50.0  # samples per degree of visual angle, for a monitor with 110 dots per inch at 66 cm
VIEWED = 2, 1000  # samples per degree; validity range of the S-CIELAB filters
OPPONENT_FROM_XYZ = np.array(
    [[0.2885613, 0.6597617, -0.1305654], [-0.4648864, 0.3262702, 0.0624200], [0.0798787, -0.5547976, 0.4814746]]
)
FILTERS = (  # sums of Gaussians (half width at half maximum in degrees, weight): luminance, red–green, blue–yellow
    ((0.05, 1.00327), (0.225, 0.114416), (7.0, -0.117686)),
    ((0.0685, 0.616725), (0.826, 0.383275)),
    ((0.0920, 0.567885), (0.6451, 0.432115)),
)


@dataclass(frozen=True)
class Quality:
    """Metrics of one XYZ frame.

    Except for `output_psnr`, picture and target are displayed with the exposure of the target and clipped to the sRGB gamut.
    """

    mean_delta_e: float  # mean CIEDE2000
    median_delta_e: float  # median of CIEDE2000
    p95_delta_e: float  # 95th percentile of CIEDE2000
    scielab: float  # mean CIEDE2000 after the S-CIELAB blur of both pictures
    mottle: float | None  # RMS C*ab of blotches in uniform patches; None if there are no such patches
    # Weighted sum of the σ of L*, a* and b* in uniform patches after the S-CIELAB blur; None if there are no such patches.
    visual_noise: float | None
    psnr: float  # dB; PSNR of the encoded sRGB values
    output_psnr: float  # dB; PSNR of XYZ before clipping, with display white as the peak of each output
    ssim: float  # SSIM of the luma of the encoded sRGB values


@dataclass(frozen=True)
class BandQuality:
    """Metrics of one frame with several outputs other than XYZ, such as the bands of a camera."""

    mean_angle: float  # degrees; mean spectral angle over all pixels with a non-zero target
    median_angle: float  # degrees; median of the spectral angle
    p95_angle: float  # degrees; 95th percentile of the spectral angle
    gfc: float  # goodness-of-fit coefficient: mean absolute cosine of the spectral angle
    rmse: float  # root mean square error over all outputs, as a fraction of a perfect white
    psnr: float  # dB; PSNR over all outputs in linear 8-bit values, with a perfect white at 255
    output_psnr: float  # dB; PSNR over all outputs before clipping, with white at the display exposure as each peak
    ssim: float  # mean SSIM over the outputs, as fractions of a perfect white clipped to 0…1


@dataclass(frozen=True)
class SingleQuality:
    """Metrics of one frame with a single output, such as luminance, for which no spectral angle exists."""

    mean_error: float  # mean absolute error, as a fraction of a perfect white
    rmse: float  # as in BandQuality, like all metrics below
    psnr: float
    output_psnr: float
    ssim: float


@dataclass(frozen=True)
class StokesQuality:
    """Metrics of one frame with Stokes parameters.

    DoLP and AoLP are the degree and angle of linear polarisation. S0 is 1 for a perfect white. The peak of all PSNRs is 1.
    """

    mean_dolp_error: float  # mean absolute error of the DoLP
    psnr_dolp: float  # dB; PSNR of the DoLP
    aolp_rmse: float | None  # degrees; RMS error of the AoLP where the target's DoLP exceeds 0.05; None without such pixels
    dolp_bias: float | None  # mean error of the DoLP where the target's DoLP is below 0.005; None without such pixels
    psnr_intensities: float  # dB; PSNR of the intensities behind ideal polarisers at 0°, 45°, 90° and 135°
    psnr_s0: float  # dB; PSNR of S0 / 2, which is the intensity of unpolarised light behind a polariser
    psnr_s1: float  # dB; PSNR of S1
    psnr_s2: float  # dB; PSNR of S2


class Target:
    """Target of an XYZ frame, prepared for comparison with several pictures.

    Parameters
    ----------
    target : ndarray, (3, row, col)
        XYZ planes.
    white : ndarray, (3,)
        XYZ of a perfect white.
    border : int
        Margin that is not evaluated, in pixels.
    viewing : float
        Picture samples per degree of visual angle, for S-CIELAB.
    counted : ndarray of bool, (row, col), optional
        Mask of the pixels to evaluate. [default: all pixels]
    """

    def __init__(
        self,
        target: Array,
        white: Array,
        border: int = 0,
        viewing: float = VIEWING,
        counted: NDArray[np.bool_] | None = None,
    ) -> None:
        self._white, self._border, self._viewing = white, border, viewing
        self._scale = white_luminance(of_counted(target[1], counted))
        self._counted = None if counted is None else cropped(counted, border)
        # Under deep red light, Z of white is 0 and cannot be a peak. Y of white is then the peak.
        self._peaks = self._scale * np.where(white > 0, white, white[1])[:, None, None] / white[1]
        self._target = cropped(target, border)
        linear = displayed(self._target, white, self._scale)
        self._curve, self._labs = srgb_curve(linear), self._labs_of(linear)
        self.patches = PlainPatches(self._labs[0], self._counted)

    def _labs_of(self, linear: Array) -> tuple[Array, Array]:
        """Convert a displayed picture to CIELAB, without and with the S-CIELAB blur: two arrays (row, col, 3)."""
        xyz = displayed_xyz(linear)
        return lab(xyz, daylight()), _blurred_lab(xyz, daylight(), self._viewing)

    def judge(self, rendered: Array) -> tuple[Quality, Array, Array]:
        """Compare a picture with the target.

        Parameters
        ----------
        rendered : ndarray, (3, row, col)
            XYZ planes of the picture, in the unit of the target.

        Returns
        -------
        quality : Quality
            Metrics of the frame.
        difference : ndarray, (row, col)
            ΔE00 between displayed picture and target, inside the border. NaN for pixels that are not evaluated.
        variances : ndarray, (patch,)
            Colour variance in each uniform patch.
        """
        rendered = cropped(rendered, self._border)
        linear = displayed(rendered, self._white, self._scale)
        curve = srgb_curve(linear)
        labs = self._labs_of(linear)
        counted = self._counted
        everywhere, seen = map(delta_e_2000, labs, self._labs)
        variances, difference = self.patches.variances(labs[0]), of_counted(everywhere, counted)
        curves = [of_counted(np.moveaxis(each, -1, 0), counted) for each in (curve, self._curve)]
        return (
            Quality(
                mean_delta_e=float(difference.mean()),
                median_delta_e=float(np.median(difference)),
                p95_delta_e=float(np.percentile(difference, 95)),
                scielab=float(of_counted(seen, counted).mean()),
                mottle=mottle(variances),
                visual_noise=self.patches.visual_noise(labs[1], self._labs[1]),
                psnr=psnr(*curves),
                output_psnr=psnr(*(of_counted(each / self._peaks, counted) for each in (rendered, self._target))),
                ssim=ssim(curve @ LUMA, self._curve @ LUMA, counted=counted),
            ),
            everywhere if counted is None else np.where(counted, everywhere, np.nan),
            variances,
        )


def quality(rendered: Array, target: Array, white: Array, border: int = 0, viewing: float = VIEWING) -> Quality:
    """Compare XYZ planes (3, row, col) with a target. The other parameters are as in `Target`."""
    return Target(target, white, border, viewing).judge(rendered)[0]


def judge_bands(
    rendered: Array, target: Array, white: Array, border: int = 0, counted: NDArray[np.bool_] | None = None
) -> tuple[BandQuality, Array]:
    """Compare rendered planes with a target, for outputs other than XYZ.

    Parameters
    ----------
    rendered, target : ndarray, (output, row, col)
        Rendered planes and target, in the same unit.
    white : ndarray, (output,)
        Outputs of a perfect white.
    border : int
        Margin that is not evaluated, in pixels.
    counted : ndarray of bool, (row, col), optional
        Mask of the pixels to evaluate. [default: all pixels]

    Returns
    -------
    quality : BandQuality
        Metrics of the frame. If the whole target is black, all spectral angles are 0.
    angles : ndarray, (row, col)
        Spectral angle in degrees, inside the border. NaN for pixels with a black target or that are not evaluated.
    """
    angles = spectral_angle(cropped(rendered, border), cropped(target, border))
    whole, counted = counted, None if counted is None else cropped(counted, border)
    angles = angles if counted is None else np.where(counted, angles, np.nan)
    angle = angles[np.isfinite(angles)] if np.isfinite(angles).any() else np.zeros(1)
    linear, shares = _linear_and_shares(rendered, target, white, border, whole)
    error = of_counted(cropped(rendered - target, border) / _positive(white), counted)
    return BandQuality(
        mean_angle=float(angle.mean()),
        median_angle=float(np.median(angle)),
        p95_angle=float(np.percentile(angle, 95)),
        gfc=float(np.abs(np.cos(np.radians(angle))).mean()),
        rmse=float(np.sqrt(np.mean(error**2))),
        psnr=psnr(*(_rounded(of_counted(each, counted)) for each in shares)),
        output_psnr=psnr(*(of_counted(each, counted) for each in linear)),
        ssim=float(np.mean([ssim(*of_band, counted=counted) for of_band in zip(*shares, strict=True)])),
    ), angles


def judge_single(
    rendered: Array, target: Array, white: Array, border: int = 0, counted: NDArray[np.bool_] | None = None
) -> tuple[SingleQuality, Array]:
    """Compare a single rendered output (1, row, col) with a target. The parameters are as in `judge_bands`.

    Returns
    -------
    quality : SingleQuality
        Metrics of the frame.
    errors : ndarray, (row, col)
        Absolute error as a fraction of a perfect white, inside the border. NaN for pixels that are not evaluated.
    """
    whole, counted = counted, None if counted is None else cropped(counted, border)
    linear, shares = _linear_and_shares(rendered, target, white, border, whole)
    error = np.abs(cropped(rendered - target, border) / _positive(white))[0]
    counting = of_counted(error, counted)
    return SingleQuality(
        mean_error=float(counting.mean()),
        rmse=float(np.sqrt(np.mean(counting**2))),
        psnr=psnr(*(_rounded(of_counted(each, counted)) for each in shares)),
        output_psnr=psnr(*(of_counted(each, counted) for each in linear)),
        ssim=ssim(*(each[0] for each in shares), counted=counted),
    ), error if counted is None else np.where(counted, error, np.nan)


# The error of the AoLP is evaluated where the target's DoLP exceeds POLARISED. The bias of the DoLP is evaluated where the
# target's DoLP is below UNPOLARISED.
POLARISED, UNPOLARISED = 0.05, 0.005
ANGLES = (0.0, 45.0, 90.0, 135.0)  # degrees; polarisers for which intensities are compared


def judge_stokes(
    rendered: Array,
    target: Array,
    white: Array,
    outputs: tuple[str, ...],
    border: int = 0,
    counted: NDArray[np.bool_] | None = None,
) -> tuple[StokesQuality, Array]:
    """Compare rendered Stokes parameters with a target.

    Parameters
    ----------
    rendered, target : ndarray, (output, row, col)
        Rendered planes and target, in the same unit.
    white : ndarray, (output,)
        Outputs of a perfect white.
    outputs : tuple of str
        Names of the outputs, which must include S1 and S2.
    border : int
        Margin that is not evaluated, in pixels.
    counted : ndarray of bool, (row, col), optional
        Mask of the pixels to evaluate. [default: all pixels]

    Returns
    -------
    quality : StokesQuality
        Metrics of the frame.
    errors : ndarray, (row, col)
        Absolute error of the degree of linear polarisation, inside the border. NaN for pixels that are not evaluated.
    """
    unit = white[outputs.index(luminance_name(outputs))]
    inside = None if counted is None else cropped(counted, border)
    made, wanted = (stokes_of(cropped(each, border) / unit, outputs).astype(np.float64) for each in (rendered, target))
    error = np.abs(dolp(made) - dolp(wanted))
    errors = error if inside is None else np.where(inside, error, np.nan)
    made, wanted = (of_counted(each, inside) for each in (made, wanted))
    degree, true = dolp(made), dolp(wanted)
    turned = angle_difference(aolp(made), aolp(wanted))[true > POLARISED]
    plain = true < UNPOLARISED
    behind_each = (np.stack([behind(each, angle) for angle in ANGLES]) for each in (made, wanted))
    return StokesQuality(
        mean_dolp_error=float(np.abs(degree - true).mean()),
        psnr_dolp=psnr(degree, true),
        aolp_rmse=float(np.sqrt(np.mean(turned**2))) if turned.size else None,
        dolp_bias=float((degree - true)[plain].mean()) if plain.any() else None,
        psnr_intensities=psnr(*behind_each),
        psnr_s0=psnr(made[0] / 2, wanted[0] / 2),
        psnr_s1=psnr(made[1], wanted[1]),
        psnr_s2=psnr(made[2], wanted[2]),
    ), errors


def band_quality(rendered: Array, target: Array, white: Array, border: int = 0) -> BandQuality:
    """Compare rendered planes other than XYZ with a target. The parameters are as in `judge_bands`."""
    return judge_bands(rendered, target, white, border)[0]


def band_figures(
    rendered: Array, target: Array, white: Array, border: int = 0, counted: NDArray[np.bool_] | None = None
) -> list[dict[str, float]]:
    """Return psnr, output_psnr and ssim (see BandQuality) of each output. The parameters are as in `judge_bands`."""
    linear, shares = _linear_and_shares(rendered, target, white, border, counted)
    counted = None if counted is None else cropped(counted, border)
    return [
        {
            "psnr": psnr(*(_rounded(of_counted(each, counted)) for each in share)),
            "output_psnr": psnr(*(of_counted(each, counted) for each in of_band)),
            "ssim": ssim(*share, counted=counted),
        }
        for of_band, share in zip(zip(*linear, strict=True), zip(*shares, strict=True), strict=True)
    ]


def _linear_and_shares(
    rendered: Array, target: Array, white: Array, border: int, counted: NDArray[np.bool_] | None
) -> tuple[tuple[Array, Array], tuple[Array, Array]]:
    """Crop rendered and target planes, and return them in two units, each as a pair (rendered, target).

    The first pair contains fractions of the peak that `output_psnr` uses. The second pair contains fractions of a perfect
    white, clipped to 0…1.
    """
    positive = _positive(white)
    peaks = white_luminance(of_counted(target.mean(axis=0), counted)) * (positive / white.mean())
    rendered, target = cropped(rendered, border), cropped(target, border)
    shares = np.clip(rendered / positive, 0.0, 1.0), np.clip(target / positive, 0.0, 1.0)
    return (rendered / peaks, target / peaks), shares


def _positive(white: Array) -> Array:
    return np.asarray(np.where(white > 0, white, white.max())[:, None, None])


def _rounded(share: Array) -> Array:
    return np.rint(share * CODES) / CODES


def cropped(planes: NDArray[Any], border: int) -> NDArray[Any]:
    """Remove a margin of `border` pixels from planes (…, row, col)."""
    return planes[..., border : planes.shape[-2] - border, border : planes.shape[-1] - border]


def of_counted(planes: NDArray[Any], counted: NDArray[np.bool_] | None) -> NDArray[Any]:
    """Select the masked pixels of planes (…, row, col), as an array (…, pixel). Without a mask, return the planes."""
    return planes if counted is None else planes[..., counted]


# -------------------------------------------------------------------------------------------------- metrics of two arrays


def psnr(one: Array, other: Array) -> float:
    """Return the peak signal-to-noise ratio of two arrays in dB, for a peak of 1. For equal arrays, it is 120 dB."""
    return float(-10.0 * np.log10(max(float(np.mean((one - other) ** 2)), MIN_SQUARE_ERROR)))


def ssim(one: Array, other: Array, *, counted: NDArray[np.bool_] | None = None) -> float:
    """Return the mean structural similarity of two pictures (Wang et al. 2004).

    The window is a Gaussian of 11 × 11 pixels with σ = 1.5. Pixels with a window that extends beyond the picture are
    evaluated only if there are no other pixels.

    Parameters
    ----------
    one, other : ndarray, (row, col)
        The pictures, with values from 0 to 1.
    counted : ndarray of bool, (row, col), optional
        Mask of the pixels to evaluate. [default: all pixels]
    """

    def mean(values: Array) -> Array:
        return gaussian_filter(values, WINDOW_SIGMA, radius=WINDOW_REACH)

    mean_one, mean_other = mean(one), mean(other)
    variances = mean(one**2) - mean_one**2 + mean(other**2) - mean_other**2
    covariance = mean(one * other) - mean_one * mean_other
    luminance_term = (2 * mean_one * mean_other + STABILISERS[0]) / (mean_one**2 + mean_other**2 + STABILISERS[0])
    similarity = luminance_term * (2 * covariance + STABILISERS[1]) / (variances + STABILISERS[1])
    if min(similarity.shape) > 2 * WINDOW_REACH:
        inside = None if counted is None else cropped(counted, WINDOW_REACH)
        if inside is None or inside.any():
            similarity, counted = cropped(similarity, WINDOW_REACH), inside
    return float(of_counted(similarity, counted).mean())


def spectral_angle(rendered: Array, target: Array) -> Array:
    """Return the angle between rendered and target spectrum at each pixel (docs/method.md#quality-metrics).

    Parameters
    ----------
    rendered, target : ndarray, (band, row, col)
        Spectra.

    Returns
    -------
    ndarray, (row, col)
        Angle in degrees: NaN if the target spectrum is zero or negligible (below the float32 rounding error of the largest
        spectrum), and 90° if only the rendered spectrum is zero.
    """
    cubes = [cube.astype(np.float64) for cube in (rendered, target)]
    lengths = [np.sqrt((cube**2).sum(axis=0)) for cube in cubes]
    units = [cube / np.where(length > 0, length, 1.0) for cube, length in zip(cubes, lengths, strict=True)]
    # The chord between unit spectra is 2 sin(angle / 2). For small angles, arcsin is more precise than arccos.
    chord = np.sqrt(((units[0] - units[1]) ** 2).sum(axis=0))
    angle = np.where(lengths[0] > 0, np.degrees(2.0 * np.arcsin(np.minimum(chord / 2.0, 1.0))), 90.0)
    return np.where(lengths[1] > MIN_NORM * lengths[1].max(), angle, np.nan)


# -------------------------------------------------------------------------------------------------------------- S-CIELAB


def scielab(one: Array, other: Array, white: Array, viewing: float = VIEWING) -> Array:
    """Return the S-CIELAB difference (row, col) between two pictures (Zhang and Wandell 1996).

    Both pictures are converted to opponent colours (Poirson and Wandell), and each opponent plane is blurred with a sum of
    Gaussians. CIEDE2000 is then computed between the blurred pictures.

    Parameters
    ----------
    one, other : ndarray, (row, col, 3)
        XYZ of the two pictures.
    white : ndarray, (3,)
        XYZ of white.
    viewing : float
        Picture samples per degree of visual angle, in the range VIEWED.

    Raises
    ------
    RecipeError
        If `viewing` is outside VIEWED.

    Notes
    -----
    The constants are the defaults of ISETCam: the opponent transform for the 10° observer, and the "distribution" widths of
    Johnson and Fairchild. Unlike ISETCam, this function mirrors pictures at their edges instead of wrapping around, and its
    map of differences is not shifted by one pixel.
    """
    return delta_e_2000(*(_blurred_lab(picture, white, viewing) for picture in (one, other)))


def _blurred_lab(xyz: Array, white: Array, viewing: float) -> Array:
    if not VIEWED[0] <= viewing <= VIEWED[1]:
        raise RecipeError(f"‹viewing› is {viewing:g}; set a value from {VIEWED[0]} to {VIEWED[1]} samples per degree")
    return lab(np.maximum(blurred(xyz, viewing), 0.0), white)


def blurred(xyz: Array, viewing: float) -> Array:
    """Apply the S-CIELAB blur to XYZ (row, col, 3), with filters of about one degree for each opponent plane."""
    opponent = np.einsum("oc,rkc->ork", OPPONENT_FROM_XYZ, xyz)
    reach = np.arange(-half_size(viewing), half_size(viewing) + 1)
    total = np.zeros_like(opponent)
    for plane, seen, terms in zip(opponent, total, FILTERS, strict=True):
        for half_width, weight in terms:
            sigma = half_width * viewing / np.sqrt(2.0 * np.log(2.0))
            kernel = np.exp(-0.5 * (reach / sigma) ** 2)
            kernel /= kernel.sum()
            seen += weight * correlate1d(correlate1d(plane, kernel, axis=0), kernel, axis=1)
    return np.einsum("co,ork->rkc", np.linalg.inv(OPPONENT_FROM_XYZ), total)


def half_size(viewing: float) -> int:
    """Return the half width of the S-CIELAB filters in samples.

    As in ISETCam, the full width is one degree, rounded up to an integer and, if even, reduced by 1.
    """
    return (int(np.ceil(viewing)) - 1) // 2
