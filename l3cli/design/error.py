"""Predict the error of a colour filter array without training a table (docs/method.md#designs).

The prediction needs only moments: mean products of the spectra and the ideal outputs in small patches of scenes. They are
computed once for each lens, pixel and illuminant. The error of any array, in each group of patches, then follows in closed
form. For errors in CIELAB, a patch with the luminance Y has the weight (Y + 0.02)^(-2/3), which is proportional to the slope
of CIELAB at a grey. An error of 1 is then about one ΔE00. For linear errors, all weights are 1. If a filter's mean signal
clips in a group of patches, the filter contributes no information in this group.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from l3cli.artifacts.camera import QUANTISATION, CameraModel
from l3cli.artifacts.design import GROUPS, KINDS, SHARP, SIDE, SOFT, WEIGHTINGS, LightMoments

Array = NDArray[np.floating]
Sums = dict[str, NDArray[np.float64]]  # "patches", "weight", "mean" and "moment", as in LightMoments

EDGE_CONTRAST = 0.25  # contrast above which patches count as edges
LEVEL_LIMITS = (0.06, 0.25)  # limits between the dark, middle and bright groups, as fractions of white
NEUTRAL = 5.0  # ratio of chroma to luminance below which patches count as neutral
CHROMA = np.array([[250, -250, 0], [0, 150, -150]]) / 3.0  # half of the derivative of (a*, b*) with respect to XYZ / white
LUMINANCE_OFFSET = 0.02  # added to the luminance, as a fraction of white, to limit the weights of dark patches
POWER = 2 / 3  # errors are weighted by luminance^(−POWER), because the slope of L* is proportional to Y^(−2/3)
KEPT_POWER = 0.9999  # fraction of the spectral power that the principal spectra represent
SOFTNESS = 2.0  # standard deviation of the chroma blur in pixels, as in S-CIELAB at about 50 pixels per degree
WINDOW = 2  # radius, in pixels, of the square that determines the group of a patch


def empty_sums(terms: int) -> Sums:
    """Create the sums to which `gather` adds the moments, filled with zeros. `terms` is the number of principal spectra."""
    kinds, taps = (len(WEIGHTINGS), len(GROUPS)), SIDE**2 * terms
    shapes = {"patches": kinds[1:], "weight": kinds, "mean": (*kinds, taps)}
    shapes["moment"] = (*kinds, taps + SOFT.stop + terms, taps + SOFT.stop + terms)
    return {name: np.zeros(shape) for name, shape in shapes.items()}


def spectral_power(reflectance: NDArray[np.floating], rate: NDArray[np.floating]) -> NDArray[np.float64]:
    """Compute a scene's mean product of the photon rates at each pair of wavelengths.

    The result is divided by the squared mean reflectance of the scene.

    Parameters
    ----------
    reflectance : ndarray, (row, col, band)
        The scene.
    rate : ndarray, (wavelength, band)
        Photons at each wavelength per unit of reflectance in each band.

    Returns
    -------
    ndarray, (wavelength, wavelength)
    """
    pixels = reflectance.reshape(-1, reflectance.shape[-1]).astype(np.float64)
    bands = pixels.T @ pixels / max(float(np.square(pixels.mean())), 1e-12) / len(pixels)
    return np.asarray(rate @ bands @ rate.T)


def principal_spectra(power: Array, white: Array) -> NDArray[np.float64]:
    """Compute the principal components of scene spectra that contain the fraction KEPT_POWER of the spectral power.

    There are at least three principal spectra.

    Parameters
    ----------
    power : ndarray, (wavelength, wavelength)
        Second moment of the photon spectra.
    white : ndarray, (wavelength,)
        Photon spectrum of a perfect white. The principal spectra are scaled by its mean.

    Returns
    -------
    ndarray, (wavelength, term)
        Principal spectra.
    """
    values, vectors = np.linalg.eigh(power)
    values, vectors = np.maximum(values[::-1], 0.0), vectors[:, ::-1]
    held = np.cumsum(values) / values.sum()
    terms = max(int(np.searchsorted(held, KEPT_POWER)) + 1, 3)
    signs = np.sign(vectors[np.abs(vectors).argmax(axis=0), np.arange(vectors.shape[1])])
    return np.asarray(vectors[:, :terms] * signs[:terms] * white.mean())


def gather(
    sums: Sums,
    planes: NDArray[np.float32],
    target: NDArray[np.float32],
    sharp: NDArray[np.float32],
    patches: int,
    rng: np.random.Generator,
) -> None:
    """Add the moments of patches at random positions in a scene to the sums.

    Parameters
    ----------
    sums : dict
        Sums, changed in place.
    planes : ndarray, (term, row, col)
        Coefficients of the principal spectra in the image on the sensor.
    target : ndarray, (3, row, col)
        XYZ relative to white.
    sharp : ndarray, (term, row, col)
        Coefficients of the principal spectra without lens blur.
    patches : int
        Number of patches.
    rng : numpy.random.Generator
        Random generator for the positions.
    """
    half, window = np.arange(-(SIDE // 2), SIDE // 2 + 1), np.arange(-WINDOW, WINDOW + 1)
    soft = np.stack([gaussian_filter(plane, SOFTNESS, mode="reflect") for plane in target])
    row, col = (rng.integers(SIDE // 2, length - SIDE // 2, patches) for length in planes.shape[1:])
    z = planes[:, row[:, None, None] + half[:, None], col[:, None, None] + half].transpose(1, 2, 3, 0).reshape(patches, -1)
    group = groups_of(target[:, row[:, None, None] + window[:, None], col[:, None, None] + window])
    entries = np.concatenate([z, target[:, row, col].T, soft[:, row, col].T, sharp[:, row, col].T], axis=1, dtype=np.float32)
    seen = (np.maximum(target[1][row, col], 0) + np.float32(LUMINANCE_OFFSET)) ** np.float32(-POWER)
    for number in np.unique(group):
        inside = group == number
        sums["patches"][number] += inside.sum()
        for place, weight in enumerate((seen[inside], np.ones(int(inside.sum()), np.float32))):
            rows = entries[inside] * weight[:, None]
            sums["moment"][place, number] += rows.T @ rows
            sums["mean"][place, number] += weight @ rows[:, : z.shape[1]]
            sums["weight"][place, number] += np.square(weight).sum()


def groups_of(around: NDArray[np.float32]) -> NDArray[np.intp]:
    """Classify patches into GROUPS by the contrast, luminance and hue around their centres.

    Parameters
    ----------
    around : ndarray, (3, patch, row, col)
        XYZ relative to white in a square around the centre of each patch.

    Returns
    -------
    ndarray, (patch,)
        Indices in GROUPS.
    """
    mean = around.mean(axis=(2, 3))
    contrast = around[1].std(axis=(1, 2)) / (mean[1] + 1e-4)
    a, b = CHROMA @ mean / (mean[1] + LUMINANCE_OFFSET)
    hue = np.where(np.hypot(a, b) < NEUTRAL, 0, np.where(b > 0, np.where(a > 0, 1, 2), np.where(a > 0, 4, 3)))
    kinds = (contrast > EDGE_CONTRAST).astype(np.intp), np.searchsorted(LEVEL_LIMITS, mean[1]), hue
    return np.ravel_multi_index(kinds, tuple(map(len, KINDS)))


def in_all_orientations(sums: Sums, terms: int) -> Sums:
    """Average the sums over the eight orientations of a patch. Rotated and mirrored arrays then have equal errors.

    Each orientation is a combination of three reflections. Averaging over one reflection after the other therefore gives the
    mean of all eight.
    """
    taps = np.arange(SIDE**2 * terms).reshape(SIDE, SIDE, terms)
    behind = np.arange(taps.size, taps.size + SOFT.stop + terms)
    reflections = [each.ravel() for each in (taps[::-1], taps[:, ::-1], taps.swapaxes(0, 1))]
    moment, mean = sums["moment"].copy(), sums["mean"].copy()
    for group in np.flatnonzero(sums["patches"]):  # one matrix at a time, which fits into the cache
        for of_patches, of_means in zip(moment[:, group], mean[:, group], strict=True):
            for reflected in reflections:
                order = np.concatenate([reflected, behind])
                of_patches += of_patches[order[:, None], order]
                of_means += of_means[reflected]
            of_patches /= 2 ** len(reflections)
            of_means /= 2 ** len(reflections)
    return sums | {"mean": mean, "moment": moment}


Cfa = NDArray[np.integer]  # (row, col): index of the filter at each site

OPPONENT = np.vstack([[[0, 116 / 3, 0]], CHROMA])  # derivative of (L*, a* / 2, b* / 2) with respect to XYZ / white
TAP_RIDGE = 1e-6  # ridge, as a fraction of the mean power of the taps
EMPTY_NOISE = 1.0  # noise variance added in groups without patches, so that their equations have a solution
CLIPPED_NOISE = 1e6  # noise variance of clipped taps, relative to their power, so that they contribute no information


@dataclass(frozen=True)
class Noise:
    """Noise parameters and full scale of a pixel in electrons."""

    floor: float  # variance of read noise, fixed offsets and quantisation, in (e-)²
    dark: float  # dark current in e-/s
    full: float  # full scale in e-
    uneven: float  # relative variance of the response between pixels, including rows and columns
    rows: float = 0.0  # row noise variance in (e-)², included in `floor`
    columns: float = 0.0  # column noise variance in (e-)², included in `floor`


def noise_of(camera: CameraModel) -> Noise:
    """Return a camera's noise parameters. Differences in exposure or gain between channels are ignored."""
    noise = camera.corrected_noise()
    floor = noise.temporal + noise.fixed + QUANTISATION / camera.gain**2
    rows, columns = (each / camera.gain**2 for each in camera.line_variances())
    return Noise(floor, noise.dark_current, camera.full_scale, noise.uneven, rows, columns)


@dataclass(frozen=True)
class Level:
    """A light level: an illuminant and an automatic or fixed exposure."""

    name: str
    light: int  # index of the illuminant in `Problem.seen`
    # target of automatic exposure: signal of white in the brightest filter, as a fraction of full scale; None if the
    # exposure is fixed
    share: float | None
    luminance: float = 1.0  # luminance of a perfect white in cd/m²
    seconds: float = 0.0  # exposure time in s if `share` is None


def exposure(level: Level, noise: Noise, white: float) -> tuple[float, float]:
    """Compute an array's exposure and exposure time at a light level.

    Parameters
    ----------
    level : Level
        The light level.
    noise : Noise
        Noise parameters and full scale of a pixel.
    white : float
        Signal of the array's brightest filter, in e-/s, for a white of 1 cd/m².

    Returns
    -------
    exposure : float
        Luminance of white × exposure time, in cd s/m².
    seconds : float
        Exposure time in s.
    """
    if level.share is None:
        return level.luminance * level.seconds, level.seconds
    dose = level.share * noise.full / white
    return dose, dose / level.luminance


@dataclass(frozen=True)
class Seen:
    """Moments of filter signals and outputs under one illuminant, for each group of patches.

    The moments are computed as if every filter were at every tap of a patch. For a given array, only the filter that is
    really at each tap is selected. `spectra_of` uses the class for moments of principal spectra, before filters are applied.
    The axis "filter" then contains the principal spectra, and `white` is empty.
    """

    signal: Array  # (filter, filter, group, tap, tap): second moments of the signals
    cross: Array  # (group, output, tap, filter): moments of outputs and signals
    mean: Array  # (group, tap, filter): mean signals
    target: Array  # (group,): sum of the mean squares of all outputs
    weight: Array  # (group,): mean square of the weights of the patches
    patches: Array  # (group,): number of patches
    white: Array  # (filter,): signal of a perfect white of 1 cd/m², in e-/s

    @property
    def share(self) -> Array:
        """Fraction of the patches in each group."""
        return np.asarray(self.patches / self.patches.sum())


def spectra_of(moments: LightMoments, output: str, counts: str, curves: Array) -> Seen:
    """Compute the moments of the principal spectra and of the outputs that a design recipe specifies.

    Parameters
    ----------
    moments : LightMoments
        Scene moments under one illuminant.
    output, counts : str
        Values of the keys `output` and `counts` in the design recipe.
    curves : ndarray, (filter, wavelength)
        Quantum efficiencies of the filters. They define the outputs if `output` is "bands". Otherwise, they are not used.
    """
    rows, weighting = wanted_outputs(moments, output, counts, curves)
    terms, number, place = moments.terms, np.maximum(moments.patches, 1.0), WEIGHTINGS.index(weighting)
    moment, taps = moments.moment[place] / number[:, None, None], SIDE**2 * terms
    inner = moment[:, :taps, :taps].reshape(-1, SIDE**2, terms, SIDE**2, terms).transpose(2, 4, 0, 1, 3)
    return Seen(
        signal=np.ascontiguousarray(inner),
        cross=(rows @ moment[:, taps:, :taps]).reshape(len(moment), len(rows), SIDE**2, terms),
        mean=(moments.mean[place] / number[:, None]).reshape(-1, SIDE**2, terms),
        target=np.einsum("yi,Kij,yj->K", rows, moment[:, taps:, taps:], rows, optimize=True),
        weight=moments.weight[place] / number,
        patches=moments.patches,
        white=np.zeros(0),
    )


def wanted_outputs(moments: LightMoments, output: str, counts: str, curves: Array) -> tuple[Array, str]:
    """Return the matrix that converts a patch's targets to outputs, and the weighting of the patches.

    Output errors are colour differences if `output` is "XYZ" and `counts` is not "linear". Otherwise they are in percent of
    white. The parameters are the same as for `spectra_of`.

    Returns
    -------
    ndarray, (output, target)
        The matrix.
    str
        The weighting, one of WEIGHTINGS.
    """
    count = SOFT.stop
    white = moments.basis.T @ moments.white_photons / np.square(moments.basis).sum(axis=0)
    if output == "reflectance":
        return 100 / np.linalg.norm(white) * np.eye(moments.terms, count + moments.terms, count), "linear"
    if output == "bands":
        bands = curves @ moments.basis
        shares = 100 * bands / np.abs(bands @ white)[:, None] / np.sqrt(len(bands))
        return np.hstack([np.zeros((len(bands), count)), shares]), "linear"
    rows = np.zeros((3, count + moments.terms))
    rows[:, SHARP] = 100 * np.eye(3) / np.sqrt(3) if counts == "linear" else OPPONENT
    if counts == "scielab":
        rows[1:, SHARP], rows[1:, SOFT] = 0, OPPONENT[1:]
    return rows[:1] if counts == "luminance" else rows, "linear" if counts == "linear" else "seen"


def seen_by(curves: Array, moments: LightMoments, spectra: Seen) -> Seen:
    """Convert moments of principal spectra to moments of filter signals.

    Parameters
    ----------
    curves : ndarray, (filter, wavelength)
        Quantum efficiencies of the filters.
    moments : LightMoments
        Scene moments under one illuminant.
    spectra : Seen
        Moments of the principal spectra, from `spectra_of`.
    """
    to = curves @ moments.basis
    signal = np.einsum("fi,gj,ijKpq->fgKpq", to, to, spectra.signal, optimize=True)
    white = curves @ moments.white_photons
    return replace(spectra, signal=signal, cross=spectra.cross @ to.T, mean=spectra.mean @ to.T, white=white)


def site_filters(cfa: Cfa) -> NDArray[np.intp]:
    """Return the filter at each tap of the patch around each site of an array: (site, tap)."""
    off = np.arange(SIDE) - SIDE // 2
    around = [np.ix_((row + off) % cfa.shape[0], (col + off) % cfa.shape[1]) for row, col in np.ndindex(*cfa.shape)]
    return np.array([cfa[each].ravel() for each in around])


def array_errors(seen: Seen, cfa: Cfa, noise: Noise, level: Level) -> NDArray[np.float64]:
    """Predict an array's error in each group of patches, averaged over its sites: (group,)."""
    filters, tap, weight = site_filters(cfa), np.arange(SIDE**2), seen.weight[:, None]
    matrix = seen.signal[filters[:, :, None], filters[:, None, :], :, tap[:, None], tap].transpose(0, 3, 1, 2)
    cross = seen.cross[:, :, tap, filters].transpose(2, 0, 3, 1)  # (site, group, tap, output)
    power, mean = np.einsum("sKpp->sKp", matrix), seen.mean[:, tap, filters].transpose(1, 0, 2)
    dose, seconds = exposure(level, noise, float(seen.white[np.unique(cfa)].max()))
    variance = (noise.floor + noise.dark * seconds) * weight / dose**2 + mean / dose + noise.uneven * power
    variance += TAP_RIDGE * power.mean(axis=2, keepdims=True) + EMPTY_NOISE * (seen.patches == 0)[:, None]
    clipped = mean / np.maximum(weight, 1e-12) * dose > noise.full
    matrix[..., tap, tap] += np.where(clipped, CLIPPED_NOISE * power, variance)
    if noise.rows or noise.columns:
        row, col = np.divmod(tap, SIDE)
        shared = noise.rows * (row[:, None] == row) + noise.columns * (col[:, None] == col)
        shared[tap, tap] = 0.0  # `variance` already contains these values
        both = ~(clipped[..., :, None] | clipped[..., None, :])
        matrix += np.where(both, shared * (weight / dose**2)[..., None], 0.0)
    explained = np.einsum("sKpy,sKpy->sK", cross, np.linalg.solve(matrix, cross))
    return np.asarray(np.sqrt(np.maximum(seen.target - explained, 0.0)).mean(axis=0))


def clips_everything(seen: Seen, level: Level, noise: Noise) -> bool:
    """Whether every filter's mean signal clips in every group of patches at a light level.

    If the exposure is automatic, it is computed for each filter as if the array consisted only of this filter.
    """
    doses, filled = np.array([exposure(level, noise, white)[0] for white in seen.white]), seen.patches > 0
    signals = seen.mean[filled].mean(axis=1) / seen.weight[filled, None] * doses  # (group, filter)
    return bool((signals > noise.full).all())
