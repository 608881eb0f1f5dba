"""The error of an array in closed form, from moments of scenes, without training it (docs/method.md#designs).

It is about one ΔE00. A group that clips a filter on average gets no information from it.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.camera import QUANTISATION, CameraModel
from l3cli.artifacts.design import SHARP, SIDE, SOFT, WEIGHTINGS, LightMoments
from l3cli.design.moments import CHROMA

Array = NDArray[np.floating]
Cfa = NDArray[np.integer]  # (row, col) number of the filter of each site

OPPONENT = np.vstack([[[0, 116 / 3, 0]], CHROMA])  # d(L*, a*, b*) / d(XYZ over white), chroma halved
RIDGE = 1e-6  # of the mean power of a tap
EMPTY = 1.0  # power of a tap of a group without patches
NOTHING = 1e6  # of the power of a tap that clips: it is no information


@dataclass(frozen=True)
class Noise:
    """Noise of a pixel, e-."""

    floor: float  # e-², of reading, offsets and rounding
    dark: float  # e-/s
    full: float  # e-, full scale
    prnu: float  # relative


def noise_of(camera: CameraModel) -> Noise:
    """Return the noise of a camera's pixel; its channels are taken to be read alike."""
    noise = camera.noise
    floor = noise.read_noise**2 + noise.dsnu**2 + noise.column_noise**2 + QUANTISATION / camera.gain**2
    return Noise(floor, noise.dark_current, camera.full_scale, noise.prnu)


@dataclass(frozen=True)
class Level:
    """A light and an exposure."""

    name: str
    light: int  # of the moments
    share: float | None  # of full scale, that white gives the brightest filter of an array; None: exposed alike
    luminance: float = 1.0  # cd/m² of a perfect white
    seconds: float = 0.0  # of the exposure, without a share


def exposure(level: Level, noise: Noise, white: float) -> tuple[float, float]:
    """Return cd s/m² of white that an array is exposed with, whose brightest filter collects `white` e-/s at 1 cd/m², and
    the seconds that takes."""
    if level.share is None:
        return level.luminance * level.seconds, level.seconds
    dose = level.share * noise.full / white
    return dose, dose / level.luminance


@dataclass(frozen=True)
class Seen:
    """Means over the patches of each group under a light, and of the outputs that are wanted, as a library of filters sees
    them: an array only picks rows and columns of these. Of principal spectra, for any filters, `white` is empty."""

    signal: Array  # (filter, filter, group, tap, tap)
    cross: Array  # (group, output, tap, filter)
    mean: Array  # (group, tap, filter)
    target: Array  # (group) trace of the outputs' second moments: an error is the root of a sum over outputs
    weight: Array  # (group)
    patches: Array  # (group)
    white: Array  # (filter) e-/s of a perfect white of 1 cd/m²

    @property
    def share(self) -> Array:
        return np.asarray(self.patches / self.patches.sum())


def spectra_of(moments: LightMoments, output: str, counts: str, curves: Array) -> Seen:
    """Return the means by principal spectra, for the outputs of a recipe's keys: of XYZ those that `counts` names; all
    `curves` (filter, wavelength) in % of white; reflectance in % of white."""
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
    """Return the wanted outputs (output, target) of a patch's targets, and their weighting."""
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
    """Return the means as filters of quantum efficiency `curves` (filter, wavelength) see them."""
    to = curves @ moments.basis
    signal = np.einsum("fi,gj,ijKpq->fgKpq", to, to, spectra.signal, optimize=True)
    white = curves @ moments.white_photons
    return replace(spectra, signal=signal, cross=spectra.cross @ to.T, mean=spectra.mean @ to.T, white=white)


def site_filters(cfa: Cfa) -> NDArray[np.intp]:
    """Return the filters (site, tap) of the patch about each site of an array."""
    off = np.arange(SIDE) - SIDE // 2
    around = [np.ix_((row + off) % cfa.shape[0], (col + off) % cfa.shape[1]) for row, col in np.ndindex(*cfa.shape)]
    return np.array([cfa[each].ravel() for each in around])


def array_errors(seen: Seen, cfa: Cfa, noise: Noise, level: Level) -> NDArray[np.float64]:
    """Return the predicted error (group) of an array, the mean over its sites."""
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
    """Return whether every filter clips, on average, in every group of patches, exposed by itself."""
    doses, filled = np.array([exposure(level, noise, white)[0] for white in seen.white]), seen.patches > 0
    signals = seen.mean[filled].mean(axis=1) / seen.weight[filled, None] * doses  # (group, filter)
    return bool((signals > noise.full).all())
