"""The error of an array in closed form, from moments of scenes, without training it (docs/method.md#designs).

It is about one ΔE00. A group that clips a filter on average gets no information from it.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.camera import QUANTISATION, CameraModel
from l3cli.artifacts.design import SHARP, SOFT, WEIGHTINGS, LightMoments
from l3cli.design.moments import SIDE

Array = NDArray[np.floating]
Cfa = NDArray[np.integer]  # (row, col) number of the filter of each site

OPPONENT = np.array([[0, 116, 0], [250, -250, 0], [0, 150, -150]]) / 3.0  # d(L*, a*, b*) / d(XYZ over white), chroma halved
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


@dataclass(frozen=True)
class Wanted:
    """Outputs that are wanted of a patch's targets: errors are roots of the sum over `rows`."""

    rows: Array  # (output, target)
    weighting: int  # of WEIGHTINGS


def wanted_outputs(output: str, counts: str, moments: LightMoments, curves: Array) -> Wanted:
    """Return the outputs of a recipe's keys: of XYZ those that `counts` names; all `curves` (filter, wavelength) in % of
    white; reflectance in % of white."""
    linear, count = WEIGHTINGS.index("linear"), SOFT.stop
    white = moments.basis.T @ moments.white_photons / np.square(moments.basis).sum(axis=0)
    if output == "reflectance":
        return Wanted(100 / np.linalg.norm(white) * np.eye(moments.terms, count + moments.terms, count), linear)
    if output == "bands":
        bands = curves @ moments.basis
        shares = 100 * bands / np.abs(bands @ white)[:, None] / np.sqrt(len(bands))
        return Wanted(np.hstack([np.zeros((len(bands), count)), shares]), linear)
    rows = np.zeros((3, count + moments.terms))
    if counts == "linear":
        rows[:, SHARP] = 100 * np.eye(3) / np.sqrt(3)
        return Wanted(rows, linear)
    rows[:, SHARP] = OPPONENT
    if counts == "scielab":
        rows[1:, SHARP], rows[1:, SOFT] = 0, OPPONENT[1:]
    return Wanted(rows[:1] if counts == "luminance" else rows, WEIGHTINGS.index("seen"))


@dataclass(frozen=True)
class Seen:
    """The moments of a light as a library of filters sees them: an array only picks rows and columns of these."""

    signal: Array  # (filter, filter, group, tap, tap)
    cross: Array  # (group, output, tap, filter)
    mean: Array  # (group, tap, filter)
    target: Array  # (group) tr C_yy
    weight: Array  # (group)
    patches: Array  # (group)
    white: Array  # (filter) e-/s of a perfect white of 1 cd/m²

    @property
    def share(self) -> Array:
        return np.asarray(self.patches / self.patches.sum())


def seen_by(moments: LightMoments, curves: Array, wanted: Wanted) -> Seen:
    """Return the moments, over the patches of each group, as filters of quantum efficiency `curves` (filter, wavelength) see
    them."""
    count, terms = SIDE**2, moments.terms
    taps, to = count * terms, curves @ moments.basis
    number = np.maximum(moments.patches, 1.0)
    moment = moments.moment[wanted.weighting] / number[:, None, None]
    parts = moment[:, :taps, :taps].reshape(-1, count, terms, count, terms)
    half = np.einsum("gi,Kpiqj->gKpqj", to, parts, optimize=True)
    signal = np.einsum("gKpqj,fj->gfKpq", half, to, optimize=True)
    cross = wanted.rows @ moment[:, taps:, :taps]
    target = np.einsum("yi,Kij,yj->K", wanted.rows, moment[:, taps:, taps:], wanted.rows, optimize=True)
    mean = (moments.mean[wanted.weighting] / number[:, None]).reshape(-1, count, terms) @ to.T
    cross = cross.reshape(len(cross), -1, count, terms) @ to.T
    return Seen(
        signal=signal,
        cross=cross,
        mean=mean,
        target=target,
        weight=moments.weight[wanted.weighting] / number,
        patches=moments.patches,
        white=curves @ moments.white_photons,
    )


def exposure(level: Level, noise: Noise, white: float) -> tuple[float, float]:
    """Return cd s/m² of white that an array is exposed with, whose brightest filter collects `white` e-/s at 1 cd/m², and
    the seconds that takes."""
    if level.share is None:
        return level.luminance * level.seconds, level.seconds
    dose = level.share * noise.full / white
    return dose, dose / level.luminance


def site_filters(cfa: Cfa) -> NDArray[np.intp]:
    """Return the filters (site, tap) of the patch about each site of an array."""
    off = np.arange(SIDE) - SIDE // 2
    around = [np.ix_((row + off) % cfa.shape[0], (col + off) % cfa.shape[1]) for row, col in np.ndindex(*cfa.shape)]
    return np.array([cfa[each].ravel() for each in around])


def array_errors(seen: Seen, cfa: Cfa, noise: Noise, levels: list[Level]) -> NDArray[np.float64]:
    """Return the predicted error (level, group) of an array, the mean over its sites."""
    filters, tap = site_filters(cfa), np.arange(SIDE**2)
    matrix = seen.signal[filters[:, :, None], filters[:, None, :], :, tap[:, None], tap].transpose(0, 3, 1, 2)
    cross = seen.cross[:, :, tap, filters].transpose(2, 0, 3, 1)  # (site, group, tap, output)
    power = np.einsum("sKpp->sKp", matrix)
    mean = seen.mean[:, tap, filters].transpose(1, 0, 2)
    weight = seen.weight[:, None]
    diagonal = np.eye(len(tap), dtype=bool)
    errors = []
    for level in levels:
        dose, seconds = exposure(level, noise, float(seen.white[np.unique(cfa)].max()))
        floor = noise.floor + noise.dark * seconds
        variance = floor * weight / dose**2 + mean / dose + noise.prnu**2 * power + RIDGE * power.mean(axis=2, keepdims=True)
        clipped = mean / np.maximum(weight, 1e-12) * dose > noise.full
        noisy = matrix + EMPTY * (seen.patches == 0)[:, None, None] * diagonal
        noisy[..., diagonal] += np.where(clipped, NOTHING * power, variance)
        explained = np.einsum("sKpy,sKpy->sK", cross, np.linalg.solve(noisy, cross))
        errors.append(np.sqrt(np.maximum(seen.target - explained, 0.0)).mean(axis=0))
    return np.array(errors)


def clips_everything(seen: Seen, level: Level, noise: Noise) -> bool:
    """Return whether every filter clips, on average, in every group of patches, exposed by itself."""
    doses = np.array([exposure(level, noise, white)[0] for white in seen.white])
    filled = seen.patches > 0
    signals = seen.mean[filled].mean(axis=1) / seen.weight[filled, None] * doses  # (group, filter)
    return bool((signals > noise.full).all())
