"""Moments of spectral patches, and the error of any array computed from them (docs/method.md#designs).

Moments are gathered once for one lens, pixel and light. From them, the error of an array follows in closed form, without
training. Weights w are (Y + 0.02)^(-2/3), the slope of CIELAB around a grey, or 1. The sums of several scenes add up. An
error of 1 is about one ΔE00. A filter that clips on average in a group of patches contributes no information there.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.camera import QUANTISATION, CameraModel
from l3cli.artifacts.design import GROUPS, KINDS, SHARP, SIDE, SOFT, WEIGHTINGS, LightMoments

Array = NDArray[np.floating]
Sums = dict[str, NDArray[np.float64]]  # patches, weight, mean and moment as in LightMoments; sums of scenes add up

EDGE, LEVELS = 0.25, (0.06, 0.25)  # group limits: contrast of an edge; mean luminance relative to white
NEUTRAL = 5.0  # largest ratio of chroma to luminance of a neutral patch
CHROMA = np.array([[250, -250, 0], [0, 150, -150]]) / 3.0  # d(a*, b*) / d(XYZ over white), halved
DARKEST = 0.02  # offset relative to white, which limits the weights of dark patches
POWER = 2 / 3  # exponent of CIELAB's slope
KEPT = 0.9999  # fraction of the spectra's power that the principal spectra keep
SOFTNESS = 2.0  # pixels, standard deviation of the blur of chroma; that of S-CIELAB at about 50 pixels per degree
WINDOW = 2  # pixels to each side that determine the group


def empty_sums(terms: int) -> Sums:
    """Return sums over no patches, with `terms` terms per tap."""
    kinds, taps = (len(WEIGHTINGS), len(GROUPS)), SIDE**2 * terms
    shapes = {"patches": kinds[1:], "weight": kinds, "mean": (*kinds, taps)}
    shapes["moment"] = (*kinds, taps + SOFT.stop + terms, taps + SOFT.stop + terms)
    return {name: np.zeros(shape) for name, shape in shapes.items()}


def spectral_power(reflectance: NDArray[np.floating], rate: NDArray[np.floating]) -> NDArray[np.float64]:
    """Return the second moment (wavelength, wavelength) of the photons of a scene, relative to the scene's mean.

    Parameters
    ----------
    reflectance : ndarray, (row, col, band)
        The scene.
    rate : ndarray, (wavelength, band)
        Photons from unit reflectance in each band.
    """
    pixels = reflectance.reshape(-1, reflectance.shape[-1]).astype(np.float64)
    bands = pixels.T @ pixels / max(float(np.square(pixels.mean())), 1e-12) / len(pixels)
    return np.asarray(rate @ bands @ rate.T)


def principal_spectra(power: Array, white: Array) -> NDArray[np.float64]:
    """Return the basis (wavelength, term) that keeps the fraction KEPT of the power.

    Parameters
    ----------
    power : ndarray, (wavelength, wavelength)
        Second moment of the spectra.
    white : ndarray, (wavelength)
        Photons of a white. The basis is scaled to their mean.
    """
    values, vectors = np.linalg.eigh(power)
    values, vectors = np.maximum(values[::-1], 0.0), vectors[:, ::-1]
    held = np.cumsum(values) / values.sum()
    terms = max(int(np.searchsorted(held, KEPT)) + 1, 3)
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
    """Add patches at random positions of a scene to the sums.

    Parameters
    ----------
    sums : dict
        Sums, changed in place.
    planes : ndarray, (term, row, col)
        Coefficients of the principal spectra after the lens.
    target : ndarray, (XYZ, row, col)
        XYZ relative to white.
    sharp : ndarray, (term, row, col)
        Coefficients before the lens.
    patches : int
        Number of patches.
    rng : numpy.random.Generator
        Source of the positions.
    """
    from scipy.ndimage import gaussian_filter

    half, window = np.arange(-(SIDE // 2), SIDE // 2 + 1), np.arange(-WINDOW, WINDOW + 1)
    soft = np.stack([gaussian_filter(plane, SOFTNESS, mode="reflect") for plane in target])
    row, col = (rng.integers(SIDE // 2, length - SIDE // 2, patches) for length in planes.shape[1:])
    z = planes[:, row[:, None, None] + half[:, None], col[:, None, None] + half].transpose(1, 2, 3, 0).reshape(patches, -1)
    group = groups_of(target[:, row[:, None, None] + window[:, None], col[:, None, None] + window])
    entries = np.concatenate([z, target[:, row, col].T, soft[:, row, col].T, sharp[:, row, col].T], axis=1, dtype=np.float32)
    seen = (np.maximum(target[1][row, col], 0) + np.float32(DARKEST)) ** np.float32(-POWER)
    for number in np.unique(group):
        inside = group == number
        sums["patches"][number] += inside.sum()
        for place, weight in enumerate((seen[inside], np.ones(int(inside.sum()), np.float32))):
            rows = entries[inside] * weight[:, None]
            sums["moment"][place, number] += rows.T @ rows
            sums["mean"][place, number] += weight @ rows[:, : z.shape[1]]
            sums["weight"][place, number] += np.square(weight).sum()


def groups_of(around: NDArray[np.float32]) -> NDArray[np.intp]:
    """Return the group of each patch from XYZ relative to white (XYZ, patch, row, col) around its centre.

    Groups differ in contrast, luminance and hue, like classes. A patch has a hue if its colour is visible.
    """
    mean = around.mean(axis=(2, 3))
    contrast = around[1].std(axis=(1, 2)) / (mean[1] + 1e-4)
    a, b = CHROMA @ mean / (mean[1] + DARKEST)
    hue = np.where(np.hypot(a, b) < NEUTRAL, 0, np.where(b > 0, np.where(a > 0, 1, 2), np.where(a > 0, 4, 3)))
    kinds = (contrast > EDGE).astype(np.intp), np.searchsorted(LEVELS, mean[1]), hue
    return np.ravel_multi_index(kinds, tuple(map(len, KINDS)))


def in_all_orientations(sums: Sums, terms: int) -> Sums:
    """Average sums over the eight orientations of every patch, so that mirrored arrays have equal errors."""
    taps = np.arange(SIDE**2 * terms).reshape(SIDE, SIDE, terms)
    behind = np.arange(taps.size, taps.size + SOFT.stop + terms)
    moment, mean = np.zeros_like(sums["moment"]), np.zeros_like(sums["mean"])
    for turned in (np.rot90(each, turn) for each in (taps, taps.swapaxes(0, 1)) for turn in range(4)):
        order = np.concatenate([turned.ravel(), behind])
        moment += sums["moment"][:, :, order[:, None], order] / 8
        mean += sums["mean"][:, :, turned.ravel()] / 8
    return sums | {"mean": mean, "moment": moment}


Cfa = NDArray[np.integer]  # (row, col) number of the filter of each site

OPPONENT = np.vstack([[[0, 116 / 3, 0]], CHROMA])  # d(L*, a*, b*) / d(XYZ over white), chroma halved
RIDGE = 1e-6  # regularisation, as a fraction of the mean power of a tap
EMPTY = 1.0  # noise added in groups without patches, so that the equations can be solved
NOTHING = 1e6  # noise of a clipped tap relative to its power, so that it contributes no information


@dataclass(frozen=True)
class Noise:
    """Noise of a pixel, in electrons."""

    floor: float  # e-², variance of read noise, offsets and quantisation
    dark: float  # e-/s, dark current
    full: float  # e-, full scale
    prnu: float  # relative


def noise_of(camera: CameraModel) -> Noise:
    """Return the noise of a camera's pixel, assuming that all channels are read out alike."""
    noise = camera.noise
    floor = noise.read_noise**2 + noise.dsnu**2 + noise.column_noise**2 + QUANTISATION / camera.gain**2
    return Noise(floor, noise.dark_current, camera.full_scale, noise.prnu)


@dataclass(frozen=True)
class Level:
    """A light and an exposure."""

    name: str
    light: int  # index of the light in the moments
    share: float | None  # fraction of full scale of white in the brightest filter; None for a fixed exposure
    luminance: float = 1.0  # cd/m² of a perfect white
    seconds: float = 0.0  # s, fixed exposure time


def exposure(level: Level, noise: Noise, white: float) -> tuple[float, float]:
    """Return the exposure of white in cd s/m² and its time in seconds.

    `white` is the signal of the array's brightest filter, in e-/s, from a white of 1 cd/m².
    """
    if level.share is None:
        return level.luminance * level.seconds, level.seconds
    dose = level.share * noise.full / white
    return dose, dose / level.luminance


@dataclass(frozen=True)
class Seen:
    """Moments of the patches of each group under a light, as a library of filters sees them, and of the outputs.

    An array only picks rows and columns from them. In terms of principal spectra, before filters are chosen, `white` is
    empty.
    """

    signal: Array  # (filter, filter, group, tap, tap)
    cross: Array  # (group, output, tap, filter)
    mean: Array  # (group, tap, filter)
    target: Array  # (group) trace of the outputs' second moments; errors are root sums of squares over outputs
    weight: Array  # (group)
    patches: Array  # (group)
    white: Array  # (filter) e-/s from a perfect white of 1 cd/m²

    @property
    def share(self) -> Array:
        return np.asarray(self.patches / self.patches.sum())


def spectra_of(moments: LightMoments, output: str, counts: str, curves: Array) -> Seen:
    """Return the moments in terms of principal spectra, for the outputs that a recipe asks for.

    Parameters
    ----------
    moments : LightMoments
        Moments under a light.
    output, counts : str
        Keys of the design recipe.
    curves : ndarray, (filter, wavelength)
        Quantum efficiencies. They are the outputs if `output` is "bands".
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
    """Return the matrix (output, target) from a patch's targets to the outputs, and the name of the weighting.

    Outputs are colour differences for XYZ, otherwise percent of white.
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
    """Convert moments of principal spectra to moments as filters with efficiencies `curves` (filter, wavelength) see
    them.
    """
    to = curves @ moments.basis
    signal = np.einsum("fi,gj,ijKpq->fgKpq", to, to, spectra.signal, optimize=True)
    white = curves @ moments.white_photons
    return replace(spectra, signal=signal, cross=spectra.cross @ to.T, mean=spectra.mean @ to.T, white=white)


def site_filters(cfa: Cfa) -> NDArray[np.intp]:
    """Return the filters (site, tap) in the patch around each site of an array."""
    off = np.arange(SIDE) - SIDE // 2
    around = [np.ix_((row + off) % cfa.shape[0], (col + off) % cfa.shape[1]) for row, col in np.ndindex(*cfa.shape)]
    return np.array([cfa[each].ravel() for each in around])


def array_errors(seen: Seen, cfa: Cfa, noise: Noise, level: Level) -> NDArray[np.float64]:
    """Return the predicted error (group) of an array, averaged over its sites."""
    filters, tap, weight = site_filters(cfa), np.arange(SIDE**2), seen.weight[:, None]
    matrix = seen.signal[filters[:, :, None], filters[:, None, :], :, tap[:, None], tap].transpose(0, 3, 1, 2)
    cross = seen.cross[:, :, tap, filters].transpose(2, 0, 3, 1)  # (site, group, tap, output)
    power, mean = np.einsum("sKpp->sKp", matrix), seen.mean[:, tap, filters].transpose(1, 0, 2)
    dose, seconds = exposure(level, noise, float(seen.white[np.unique(cfa)].max()))
    variance = (noise.floor + noise.dark * seconds) * weight / dose**2 + mean / dose + noise.prnu**2 * power
    variance += RIDGE * power.mean(axis=2, keepdims=True) + EMPTY * (seen.patches == 0)[:, None]
    clipped = mean / np.maximum(weight, 1e-12) * dose > noise.full
    matrix[..., tap, tap] += np.where(clipped, NOTHING * power, variance)
    explained = np.einsum("sKpy,sKpy->sK", cross, np.linalg.solve(matrix, cross))
    return np.asarray(np.sqrt(np.maximum(seen.target - explained, 0.0)).mean(axis=0))


def clips_everything(seen: Seen, level: Level, noise: Noise) -> bool:
    """Whether every filter, exposed on its own, clips on average in every group of patches."""
    doses, filled = np.array([exposure(level, noise, white)[0] for white in seen.white]), seen.patches > 0
    signals = seen.mean[filled].mean(axis=1) / seen.weight[filled, None] * doses  # (group, filter)
    return bool((signals > noise.full).all())
