"""Draw patches from training frames, scale them to random levels, and add noise.

See docs/method.md#patches and docs/method.md#level-rescaling.
"""

import functools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter

from l3cli.artifacts.camera import QUANTISATION, CameraModel
from l3cli.artifacts.training_set import TrainingFrame, TrainingPair, TrainingSet, white_signal
from l3cli.classes.windows import Neighbourhoods
from l3cli.errors import InputFileError
from l3cli.physics.display import XYZ
from l3cli.physics.stokes import STOKES
from l3cli.training.lines import Offsets
from l3cli.training.recipe import LearningRecipe
from l3cli.training.symmetry import EVERY_ORIENTATION, Allowed, orientations, orientations_of_scenes, site_maps

Floats = NDArray[np.float32]
Y = 1  # index of Y among the outputs X, Y, Z, and of S0 among the outputs S1, S0, S2


@dataclass(frozen=True)
class Patches:
    """Patches of one canonical site, with their targets. Simulated patches are free of noise and clipping."""

    signal: Floats  # (patch, tap) as a fraction of full scale
    target: Floats  # (patch, output) in the output unit of the table
    carried: Floats | None = None  # (patch, tap) variance of the noise in measured signals; None for 0
    colourless: NDArray[np.bool_] | None = None  # (patch) whether colours were replaced by greys; None if nowhere

    def possible(self, scale: NDArray[np.float64]) -> NDArray[np.float64]:
        """Limit the factors by which patches are scaled to other levels.

        Simulated patches may be scaled by any factor. A patch from a real frame may only be made darker, because noise can
        be added but not removed. If a tap of a real patch clips, the patch is not scaled.

        Parameters
        ----------
        scale : ndarray, (patch)
            Desired factors.

        Returns
        -------
        ndarray, (patch)
        """
        if self.carried is None:
            return scale
        followed = np.where((self.signal >= 1).any(axis=1), 1.0, np.minimum(scale, 1.0))
        return np.where(self.carried.any(axis=1), followed, scale)

    def lacking_share(self, scale: Floats) -> Floats:
        """Return the fraction of the signal-independent noise variance that is missing from patches after scaling.

        Noise-free patches contain none of this noise. In patches from real frames, noise is missing only if they are made
        darker.
        """
        if self.carried is None:
            return np.ones_like(scale)
        return np.where(self.carried.any(axis=1), np.clip(1 - scale**2, 0, None), np.ones_like(scale))

    @classmethod
    def concatenated(cls, parts: list["Patches"]) -> "Patches":
        """Concatenate sets of patches. Simulated patches get `carried` = 0 if other patches contain measured noise."""
        colourless = [np.zeros(len(p.signal), bool) if p.colourless is None else p.colourless for p in parts]
        carried = None
        if any(part.carried is not None for part in parts):
            carried = np.concatenate([np.zeros_like(p.signal) if p.carried is None else p.carried for p in parts])
        signal, target = (np.concatenate([getattr(part, name) for part in parts]) for name in ("signal", "target"))
        return cls(signal, target, carried, np.concatenate(colourless))


def patches_of(
    frame: TrainingPair,
    head: TrainingSet,
    neighbours: Neighbourhoods,
    site: int,
    count: int,
    rng: np.random.Generator,
    allowed: Allowed = EVERY_ORIENTATION,
    achromatic: float = 0.0,
    colourless: TrainingFrame | None = None,
) -> Patches:
    """Draw a canonical site's patches from a frame.

    Parameters
    ----------
    frame : TrainingPair
        A simulated frame (TrainingFrame), or a real pair.
    head : TrainingSet
        Properties common to all training frames, such as the camera and the outputs.
    neighbours : Neighbourhoods
        Windows of all sites.
    site : int
        The canonical site.
    count : int
        Number of patches.
    rng : numpy.random.Generator
        Random number generator.
    allowed : tuple of int
        Orientations in which patches from real pairs may be read, as in `site_maps`. Patches from simulated frames are read
        in all orientations of `orientations_of_scenes`, because their noise is added later.
    achromatic : float
        Fraction of the patches to draw from `colourless`.
    colourless : TrainingFrame, optional
        Result of `colourless_frame` for this frame. [default: all patches are in colour]

    Returns
    -------
    Patches

    Raises
    ------
    InputFileError
        If the frame is smaller than a patch.
    """
    side = int(np.sqrt(neighbours.channel.shape[1]))
    if frame.raw.shape[0] < side or frame.raw.shape[1] < side:
        rows, cols = frame.raw.shape
        raise InputFileError(
            f"the frame of scene {frame.scene} ({rows}×{cols} pixels) is smaller than a patch ({side}×{side} pixels); "
            "remove the scene from the recipe"
        )
    if isinstance(frame, TrainingFrame):
        grey = round(achromatic * count) if colourless is not None else 0
        how = head.camera.output_unit, neighbours.channel[site]
        turns = [orientations(side)[number] for number in orientations_of_scenes(head.camera)]
        patches = sample_patches(frame, head, *how, count - grey, turns, rng)
        if not grey or colourless is None:
            return patches
        without = sample_patches(colourless, head, *how, grey, turns, rng)
        return Patches.concatenated([patches, replace(without, colourless=np.ones(grey, bool))])
    return sample_pair(frame, head.camera, neighbours, site, count, rng, allowed)


def colourless_frame(frame: TrainingPair, head: TrainingSet) -> TrainingFrame | None:
    """Replace the colours of a simulated frame with greys, or return None if this is impossible.

    The illuminant must be known, and the outputs must begin with X, Y, Z or be Stokes parameters. The new Stokes parameters
    describe unpolarised light.
    """
    if not isinstance(frame, TrainingFrame) or frame.light is None or head.outputs[:3] not in (XYZ, STOKES):
        return None
    return without_colour(frame, head.camera)


def without_colour(frame: TrainingFrame, camera: CameraModel) -> TrainingFrame:
    """Replace every surface in a frame with a neutral grey of the same luminance.

    Raises ValueError if the illuminant of the frame is unknown.
    """
    if frame.light is None:
        raise ValueError(f"the illuminant of scene {frame.scene} is unknown; use a frame with a known illuminant")
    luminance = frame.target[Y]
    electrons = white_signal(frame.light, camera) * camera.full_scale / camera.channel_gains
    of_white = electrons * (frame.exposure / camera.output_unit)
    grey, white = (each.astype(np.float32)[:, None, None] * luminance for each in (of_white, frame.white / frame.white[Y]))
    return replace(frame, electrons=grey, target=white)


def sample_pair(
    pair: TrainingPair,
    camera: CameraModel,
    neighbours: Neighbourhoods,
    site: int,
    count: int,
    rng: np.random.Generator,
    allowed: Allowed = EVERY_ORIENTATION,
) -> Patches:
    """Draw patches at random positions from a real pair, a raw frame and a picture of the same scene.

    The CFA of a real frame cannot be moved or rotated. Patches are therefore drawn only at sites that a rotation or
    reflection maps to the canonical site, and are read in this orientation.

    Parameters
    ----------
    pair : TrainingPair
        The real pair.
    camera : CameraModel
        Camera that took the raw frame.
    neighbours : Neighbourhoods
        Windows of all sites.
    site : int
        The canonical site.
    count : int
        Number of patches.
    rng : numpy.random.Generator
        Random number generator.
    allowed : tuple of int
        Orientations in which patches may be read, as in `site_maps`.

    Returns
    -------
    Patches

    Raises
    ------
    InputFileError
        If the raw frame does not contain a complete patch around a site that is equivalent to `site`.
    """
    side = int(np.sqrt(neighbours.channel.shape[1]))
    radius, period = side // 2, camera.cfa.shape
    rows, cols = pair.raw.shape
    every = enumerate(site_maps(neighbours.channel, side, allowed))
    maps = [(other, site_map) for other, site_map in every if site_map.canonical == site]
    reach = np.arange(side) - radius
    offset = (reach[:, None] * cols + reach[None]).ravel()
    places, takes = [], []
    for part, (other, site_map) in enumerate(maps):
        number = (part + 1) * count // len(maps) - part * count // len(maps)
        down = np.arange(radius + (other // period[1] - radius) % period[0], rows - radius, period[0])
        across = np.arange(radius + (other % period[1] - radius) % period[1], cols - radius, period[1])
        if not (down.size and across.size):
            continue
        place = rng.choice(down, number) * cols + rng.choice(across, number)
        places.append(place)
        takes.append(place[:, None] + offset[site_map.permutation])
    if not places:
        raise InputFileError(
            f"the picture of pair {pair.scene} is too small to contain a patch of {side}×{side} pixels at each CFA site; "
            "use a larger picture"
        )
    values = pair.raw.reshape(-1)[np.concatenate(takes)].astype(np.float32)
    span = np.float32(camera.white_level - camera.black_level)
    signal = (values - np.float32(camera.black_level)) / span
    window = neighbours.channel[site]
    carried = (camera.noise_variance(signal * span, channel=window) / span**2).astype(np.float32)
    signal[values >= np.floor(camera.white_level)] = 1.0
    target = pair.target.reshape(len(pair.target), -1)[:, np.concatenate(places)].T
    scaled = target * np.float32(pair.exposure / camera.output_unit)
    return Patches(signal, np.ascontiguousarray(scaled, np.float32), carried)


def sample_patches(
    frame: TrainingFrame,
    head: TrainingSet,
    unit: float,
    window: NDArray[np.int64],
    count: int,
    orientations: Sequence[NDArray[np.int64]],
    rng: np.random.Generator,
) -> Patches:
    """Draw patches at random positions and in random orientations from a simulated frame.

    A simulated frame contains the electrons of all channels at every pixel. The CFA can therefore be placed at any offset
    and in any orientation. No patch contains an ignored pixel.

    Parameters
    ----------
    frame : TrainingFrame
        The simulated frame.
    head : TrainingSet
        Properties common to all training frames, such as the camera and the outputs.
    unit : float
        Output unit by which the targets are divided.
    window : ndarray, (tap)
        Channel of each tap.
    count : int
        Number of patches.
    orientations : sequence of ndarray, (tap)
        Tap permutations. Each is used equally often.
    rng : numpy.random.Generator
        Random number generator.

    Returns
    -------
    Patches
    """
    side = int(np.sqrt(window.size))
    radius = side // 2
    _, rows, cols = frame.electrons.shape
    row, col = _centres(frame, side, count, rng)
    turn = np.arange(count) * len(orientations) // count
    reach = np.arange(side) - radius
    offset = (reach[:, None] * cols + reach[None]).ravel()
    channel_start = window * (rows * cols)
    electrons = frame.electrons.reshape(-1)
    signal = np.empty((count, window.size), dtype=np.float32)
    for index, permutation in enumerate(orientations):
        chosen = np.flatnonzero(turn == index)
        place = (row[chosen] * cols + col[chosen])[:, None] + (offset[permutation] + channel_start)[None]
        signal[chosen] = electrons[place]
    signal *= (head.camera.channel_gains / head.camera.full_scale).astype(np.float32)[window]
    target = frame.target[:, row, col].T * np.float32(frame.exposure / unit)
    return Patches(signal, np.ascontiguousarray(target))


def _centres(frame: TrainingFrame, side: int, count: int, rng: np.random.Generator) -> NDArray[np.int64]:
    """Choose centres (row and col, patch) of patches without ignored pixels.

    Raises InputFileError if every possible patch contains an ignored pixel.
    """
    rows, cols = frame.raw.shape[0] - side + 1, frame.raw.shape[1] - side + 1
    if frame.ignored is None:
        return (even_places(count, 2, rng) * (rows, cols)).astype(np.int64).T + side // 2
    free = maximum_filter(frame.ignored.mask, side, mode="nearest")[side // 2 :, side // 2 :][:rows, :cols] == 0
    if not free.any():
        raise InputFileError(
            f"every {side}×{side} window in the frame of scene {frame.scene} contains ignored pixels; remove the scene from "
            "the recipe"
        )
    places = np.flatnonzero(free)[(even_places(count, 1, rng)[:, 0] * np.count_nonzero(free)).astype(np.int64)]
    return np.stack(np.unravel_index(places, free.shape)) + side // 2


def levels_at(recipe: LearningRecipe, places: NDArray[np.float64]) -> NDArray[np.float64]:
    """Map uniform random numbers to random levels (docs/method.md#level-rescaling).

    Each level is drawn from one of three ranges, log-uniformly within the range:

    1. with the probability `highlight_share`, from `highlight_from` to `brightest`,
    2. with the probability `dark_share`, from half of `darkest` to `darkest`,
    3. otherwise, from `darkest` to `brightest`.

    Parameters
    ----------
    recipe : LearningRecipe
        The [learning] section of the class recipe.
    places : ndarray
        Random numbers between 0 and 1.

    Returns
    -------
    ndarray
        Levels as fractions of full scale.
    """
    others = max(1 - recipe.highlight_share - recipe.dark_share, 0.0)
    ends = np.cumsum([0.0, recipe.highlight_share, others, recipe.dark_share])
    part = np.searchsorted(ends[1:-1], places, side="right")
    within = (places - ends[part]) / np.maximum(np.diff(ends)[part], 1e-9)
    low = np.array([recipe.highlight_from, recipe.darkest, recipe.darkest / 2])[part]
    high = np.array([recipe.brightest, recipe.brightest, recipe.darkest])[part]
    return np.asarray(low * (high / low) ** within)


def even_places(count: int, axes: int, rng: np.random.Generator) -> NDArray[np.float64]:
    """Return a low-discrepancy sequence of points in the unit cube (docs/method.md#patches).

    The points are an additive recurrence (Kronecker sequence) from a random start. The step along axis k is g^−k, where
    g^(axes + 1) = g + 1.

    Returns
    -------
    ndarray, (point, axis)
        Coordinates between 0 and 1.
    """
    ratio = 2.0
    for _ in range(40):
        ratio = (1 + ratio) ** (1 / (axes + 1))
    return np.asarray((rng.random(axes) + np.arange(count)[:, None] * ratio ** -np.arange(1.0, axes + 1)) % 1)


@functools.cache
def _normal_deviates() -> Floats:
    return np.random.default_rng(0).standard_normal(1 << 20, dtype=np.float32)


def _normal(shape: tuple[int, ...], rng: np.random.Generator) -> Floats:
    """Return consecutive values from a table of 2²⁰ standard normal deviates, starting at a random position.

    This is twenty times as fast as drawing new deviates. Reuse does no harm, because the deviates affect only the class to
    which a patch is assigned.
    """
    pool, size = _normal_deviates(), math.prod(shape)
    start = rng.integers(max(pool.size - size, 0), endpoint=True)
    run = pool[start : start + size]
    return (run if run.size == size else np.resize(run, size)).reshape(shape)


def expose_patches(
    signal: Floats,
    camera: CameraModel,
    rng: np.random.Generator,
    carried: Floats | None = None,
    dark: float = 0.0,
    channel: NDArray[np.integer] | None = None,
    offsets: Offsets | None = None,
) -> NDArray[np.uint32]:
    """Convert signals to noisy raw values, which determine the classes of the patches.

    Parameters
    ----------
    signal : ndarray, (patch, tap) or (tap, patch)
        Signals as fractions of full scale.
    camera : CameraModel
        Camera with the noise model and the levels.
    rng : numpy.random.Generator
        Random number generator.
    carried : ndarray, optional
        Variance of the noise that measured signals already contain. Only the rest of the camera's noise is added.
        [default: 0]
    dark : float
        Dark signal that was subtracted from the frame, in DN.
    channel : ndarray, optional
        Channel of each signal, broadcast against `signal`.
    offsets : Offsets, optional
        Random row and column offsets (line noise). Required if the camera has line noise.

    Returns
    -------
    ndarray of uint32
        Raw values in DN, clipped at the white level.
    """
    noisy = _variance(signal, camera, carried, dark, QUANTISATION, channel)
    if offsets is not None:
        gain = np.float32(1) if channel is None else camera.channel_gains.astype(np.float32)[channel]
        noisy -= offsets.variance * gain**2
        np.maximum(noisy, 0, out=noisy)
    elif camera.has_line_noise:
        raise ValueError("the camera has row or column noise; pass `offsets` with random offsets")
    np.sqrt(noisy, out=noisy)
    noisy *= _normal(signal.shape, rng)
    if offsets is not None:
        noisy += offsets.values * gain
    noisy += signal
    noisy *= np.float32(camera.white_level - camera.black_level)
    noisy += np.float32(camera.black_level + 0.5)  # rounds to the nearest DN, because the cast truncates
    return np.clip(noisy, 0.0, np.floor(camera.white_level), out=noisy).astype(np.uint32)


def lacking_variance(
    signal: Floats,
    camera: CameraModel,
    carried: Floats | None = None,
    dark: float = 0.0,
    channel: NDArray[np.integer] | None = None,
) -> Floats:
    """Return the noise variance that must be added to signals, as fractions of full scale, to match the camera's raw values.

    It is 0 for clipped signals. The parameters are the same as for `expose_patches`.
    """
    variance = _variance(signal, camera, carried, dark, channel=channel)
    variance *= signal < 1
    return variance


def _variance(
    signal: Floats,
    camera: CameraModel,
    carried: Floats | None,
    dark: float,
    later: float = 0.0,
    channel: NDArray[np.integer] | None = None,
) -> Floats:
    """Return the variance of the noise to add to each signal. Signals are fractions of full scale.

    Two variances are subtracted from the camera's noise variance: `carried`, which the signals already contain, and `later`,
    which rounding will add (in DN²). All other parameters are the same as for `expose_patches`.
    """
    if carried is not None:  # only measured signals can be negative
        signal = np.clip(signal, 0.0, np.inf)
    span = camera.white_level - camera.black_level
    constant, linear, quadratic = camera.noise_terms(dark, channel)
    variance = signal * np.float32(quadratic)
    variance += np.asarray(linear / span, np.float32)
    variance *= signal
    variance += np.asarray((constant - later) / span**2, np.float32)
    return variance if carried is None else np.clip(variance - carried, 0.0, np.inf)
