"""Figures of the difference between a rendered frame and its target: of pictures for CIE XYZ, of spectra for other
outputs; noise in plain patches, which means over all pixels hide (docs/method.md#quality-figures)."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from l3cli.errors import RecipeError
from l3cli.physics.display import LUMA, daylight, delta_e_2000, displayed, displayed_xyz, lab, srgb_curve, white_luminance

Array = NDArray[np.floating]
BLUR = 4.0  # pixels, σ of the Gaussian that leaves blotches and takes grain
CUT = 6  # pixels around a patch that do not belong to it: there edges have their say
EVEN = 1.0  # of L*, a* and b* of the target, from the least to the largest value that a plain window holds
LEAST = 24 * 24  # pixels of a patch
MOST = 64  # patches of a frame, the largest
DARK, WHITE, GREY = 30.0, 85.0, 10.0  # L* below and above which a patch is dark or white; C*ab below which it has no hue
HUES = ((-30.0, "red"), (60.0, "yellow"), (120.0, "green"), (200.0, "blue"))  # degrees from which on a patch is of a hue
VISUAL = np.array([1.0, 0.852, 0.323])  # weights of the standard deviations of L*, a*, b*: ISO 15739:2013, there of L*u*v*
KINDS = ("white", "grey", "dark", *(name for _, name in HUES))


class PlainPatches:
    """The patches of a target, CIELAB (row, col, 3) as displayed, that have one colour, in its `counted` pixels (row, col),
    None: in all."""

    def __init__(self, target: Array, counted: NDArray[np.bool_] | None = None) -> None:
        from scipy.ndimage import find_objects, label, maximum_filter1d, minimum_filter1d

        def extreme(of: Any) -> Array:
            window = 2 * CUT + 1
            return np.asarray(of(of(target, window, axis=0, mode="nearest"), window, axis=1, mode="nearest"))

        self._target = target
        plain = (extreme(maximum_filter1d) - extreme(minimum_filter1d)).max(axis=2) <= EVEN
        numbers, _ = label(plain if counted is None else plain & counted)
        sizes = np.bincount(numbers.ravel())
        sizes[0] = 0
        largest = np.argsort(-sizes, kind="stable")[:MOST]
        places = find_objects(numbers)
        self._patches = [
            (places[number - 1], numbers[places[number - 1]] == number) for number in largest if sizes[number] >= LEAST
        ]

    @property
    def kinds(self) -> list[str]:
        """Return the kind of each patch."""
        return [kind_of(self._target[place][inside].mean(axis=0)) for place, inside in self._patches]

    def variances(self, shown: Array) -> Array:
        """Return the variance of a* and b* (patch), together, of a picture, CIELAB (row, col, 3) as displayed, after the
        blur, about the mean of each patch; what the target itself varies by is taken off before."""
        from scipy.ndimage import gaussian_filter

        found = []
        for place, inside in self._patches:
            error = (shown[place] - self._target[place])[..., 1:] * inside[..., None]
            weight = gaussian_filter(inside.astype(np.float64), BLUR)
            blurred = gaussian_filter(error, (BLUR, BLUR, 0))[inside] / weight[inside][:, None]
            found.append(blurred.var(axis=0).sum())
        return np.array(found)

    def visual_noise(self, seen: Array, wanted: Array) -> float | None:
        """Return the weighted standard deviations of CIELAB, mean over the patches, of a picture (row, col, 3) after the
        eye's blur, less the target after the same; None without a patch."""
        errors = [(seen[place] - wanted[place])[inside] for place, inside in self._patches]
        return float(np.mean([VISUAL @ each.std(axis=0) for each in errors])) if errors else None


def mottle(variances: Array) -> float | None:
    """Return the root mean square, over patches, of C*ab about their mean; None without a patch."""
    return float(np.sqrt(variances.mean())) if len(variances) else None


def kind_of(lab: Array) -> str:
    """Return the kind of a patch of the CIELAB (3)."""
    chroma, hue = float(np.hypot(lab[1], lab[2])), float(np.degrees(np.arctan2(lab[2], lab[1])))
    if lab[0] < DARK:
        return "dark"
    if chroma < GREY:
        return "white" if lab[0] >= WHITE else "grey"
    return [name for start, name in HUES if start <= (hue - HUES[0][0]) % 360 + HUES[0][0]][-1]


CODES = 255  # of a white, in PSNR of codes
LEAST_ERROR = 1e-12  # mean square, of equal pictures: 120 dB
WINDOW_SIGMA, WINDOW_REACH = 1.5, 5  # pixels, of the 11 × 11 Gaussian window of SSIM
FAINTEST = float(np.finfo(np.float32).eps)  # spectra as much shorter than the picture's longest are rounding errors
STABILISERS = (0.01**2, 0.03**2)  # C1 and C2 of SSIM for values in 0…1
VIEWING = 50.0  # samples a degree: a monitor of 110 dots an inch at 66 cm
VIEWED = 2, 1000  # samples a degree that the filters are made for
OPPONENT_FROM_XYZ = np.array(
    [[0.2885613, 0.6597617, -0.1305654], [-0.4648864, 0.3262702, 0.0624200], [0.0798787, -0.5547976, 0.4814746]]
)
FILTERS = (  # (half width at half maximum in degrees, weight) of the Gaussians of light–dark, red–green, blue–yellow
    ((0.05, 1.00327), (0.225, 0.114416), (7.0, -0.117686)),
    ((0.0685, 0.616725), (0.826, 0.383275)),
    ((0.0920, 0.567885), (0.6451, 0.432115)),
)


@dataclass(frozen=True)
class Quality:
    """Figures of one XYZ frame, both pictures shown on the whole target's scale and clipped to the sRGB gamut."""

    mean_delta_e: float  # CIEDE2000
    median_delta_e: float
    p95_delta_e: float
    scielab: float  # mean CIEDE2000 after the eye's blur
    mottle: float | None  # C*ab of blotches in plain patches, root mean square; None: the target has no such patches
    visual_noise: float | None  # of plain patches after the eye's blur: σ of L*, a* and b*, weighted; None: as mottle
    psnr: float  # dB, of non-linear sRGB in 0…1
    output_psnr: float  # dB, of XYZ before clipping; 1 is the luminance shown white, times each output's share in the white
    ssim: float  # of the luma of non-linear sRGB


@dataclass(frozen=True)
class BandQuality:
    """Figures of one frame of bands, or of any outputs that are not XYZ."""

    mean_angle: float  # degrees, of the spectral angles of all pixels whose target has one; 0 of a single output
    median_angle: float
    p95_angle: float
    gfc: float  # goodness of fit coefficient: mean cosine of these angles, its sign left out
    rmse: float  # root mean square error over all outputs, 1 is a perfect white
    psnr: float  # dB over all outputs, of 8-bit codes linear in them: the frame's white is 255, what is brighter is cut
    output_psnr: float  # dB; 1 is the 99th percentile of the target's mean output, times each output's share in the white
    ssim: float  # mean over the outputs, each as for psnr before rounding


class Target:
    """The target of a frame as displayed, XYZ planes (3, row, col) of the light `white` (3), to which pictures of it are
    compared; a margin of `border` is left out. `viewing` is the samples a degree of S-CIELAB. `counted` (row, col): pixels
    whose errors count; None: all."""

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
        # Deep red has no Z at all.
        self._peaks = self._scale * np.where(white > 0, white, white[1])[:, None, None] / white[1]
        self._target = cropped(target, border)
        linear = displayed(self._target, white, self._scale)
        self._curve, self._labs = srgb_curve(linear), self._labs_of(linear)
        self.patches = PlainPatches(self._labs[0], self._counted)

    def _labs_of(self, linear: Array) -> tuple[Array, Array]:
        """Return L*a*b* (row, col, 3) as displayed, and after the eye's blur."""
        xyz = displayed_xyz(linear)
        return lab(xyz, daylight()), _blurred_lab(xyz, daylight(), self._viewing)

    def judge(self, rendered: Array) -> tuple[Quality, Array, Array]:
        """Return the figures of XYZ planes (3, row, col), their ΔE00 as displayed (row, col) within the border, NaN where it
        does not count, and the variance of colour in each plain patch."""
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
    """Compare XYZ planes (3, row, col) with a target; arguments as of Target."""
    return Target(target, white, border, viewing).judge(rendered)[0]


def judge_bands(
    rendered: Array, target: Array, white: Array, border: int = 0, counted: NDArray[np.bool_] | None = None
) -> tuple[BandQuality, Array]:
    """Return the figures of planes of any outputs (output, row, col) in one unit, and their spectral angle in degrees (row,
    col) within the border, NaN where the target has none or the pixel does not count; `white` (output), `border` and
    `counted` as of Target."""
    angles = spectral_angle(cropped(rendered, border), cropped(target, border))
    whole, counted = counted, None if counted is None else cropped(counted, border)
    angles = angles if counted is None else np.where(counted, angles, np.nan)
    angle = angles[np.isfinite(angles)] if np.isfinite(angles).any() else np.zeros(1)  # all of the target is black
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


def band_quality(rendered: Array, target: Array, white: Array, border: int = 0) -> BandQuality:
    """Compare planes of any outputs (output, row, col) in one unit; arguments as of `judge_bands`."""
    return judge_bands(rendered, target, white, border)[0]


def band_figures(
    rendered: Array, target: Array, white: Array, border: int = 0, counted: NDArray[np.bool_] | None = None
) -> list[dict[str, float]]:
    """Return psnr, output_psnr and ssim of each output, as in BandQuality; arguments as in `judge_bands`."""
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
    """Return both pictures over what a linear PSNR takes for 1, and as shares of white, cut to 0…1."""
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
    """Return the planes (…, row, col) without a margin of `border` pixels."""
    return planes[..., border : planes.shape[-2] - border, border : planes.shape[-1] - border]


def of_counted(planes: NDArray[Any], counted: NDArray[np.bool_] | None) -> NDArray[Any]:
    """Return the pixels (…, pixel) of planes (…, row, col) that count (row, col); the planes themselves if all do."""
    return planes if counted is None else planes[..., counted]


# ----------------------------------------------------------------------------------------------------- figures of arrays


def psnr(one: Array, other: Array) -> float:
    """Return the peak signal-to-noise ratio in dB of two arrays of one shape, peak 1; 120 dB where they are equal."""
    return float(-10.0 * np.log10(max(float(np.mean((one - other) ** 2)), LEAST_ERROR)))


def ssim(one: Array, other: Array, *, counted: NDArray[np.bool_] | None = None) -> float:
    """Return the mean structural similarity of two pictures (row, col) in 0…1 (Wang et al. 2004: 11 × 11 Gaussian window of
    σ 1.5).

    Only whole windows about `counted` pixels (row, col), None: about all, are taken, unless there are none.
    """
    from scipy.ndimage import gaussian_filter

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
    """Return the angle in degrees (row, col) between the spectra of two cubes (band, row, col).

    NaN where the target has no direction, since its spectrum is zero, or shorter than float32 resolves beside the longest of
    the picture; 90 where only the rendered spectrum is zero (docs/method.md#quality-figures).
    """
    cubes = [cube.astype(np.float64) for cube in (rendered, target)]
    lengths = [np.sqrt((cube**2).sum(axis=0)) for cube in cubes]
    units = [cube / np.where(length > 0, length, 1.0) for cube, length in zip(cubes, lengths, strict=True)]
    chord = np.sqrt(((units[0] - units[1]) ** 2).sum(axis=0))  # 2 sin(angle / 2): exact for small angles, unlike arccos
    angle = np.where(lengths[0] > 0, np.degrees(2.0 * np.arcsin(np.minimum(chord / 2.0, 1.0))), 90.0)
    return np.where(lengths[1] > FAINTEST * lengths[1].max(), angle, np.nan)


# -------------------------------------------------------------------------------------------------------------- S-CIELAB


def scielab(one: Array, other: Array, white: Array, viewing: float = VIEWING) -> Array:
    """Return CIEDE2000 (row, col) of two pictures of XYZ (row, col, 3) seen at `viewing` samples a degree under `white` (3):
    S-CIELAB (Zhang and Wandell 1996), as ISETCam computes it.

    Each picture goes to opponent colours (Poirson and Wandell), each of them is blurred by a sum of Gaussians, and CIEDE2000
    is taken of what comes back. The constants are ISETCam's defaults: the transform of the 10° observer and the
    "distribution" widths of Johnson and Fairchild. ISETCam wraps pictures around, drops a row and a column where that makes
    them odd, and returns maps displaced by a pixel; here pictures are mirrored at their edges and stay in place.
    RecipeError unless `viewing` is within VIEWED.
    """
    return delta_e_2000(*(_blurred_lab(picture, white, viewing) for picture in (one, other)))


def _blurred_lab(xyz: Array, white: Array, viewing: float) -> Array:
    if not VIEWED[0] <= viewing <= VIEWED[1]:
        raise RecipeError(f"‹viewing› {viewing:g} is not within {VIEWED[0]}…{VIEWED[1]} samples a degree")
    return lab(np.maximum(blurred(xyz, viewing), 0.0), white)


def blurred(xyz: Array, viewing: float) -> Array:
    """Return XYZ (row, col, 3) as blurred by the eye's three opponent filters, each a degree wide in all."""
    from scipy.ndimage import correlate1d

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
    """Return the samples from the centre to the end of a filter: a degree in all, made odd downwards as in ISETCam."""
    return (int(np.ceil(viewing)) - 1) // 2
