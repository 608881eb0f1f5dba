"""Select or derive the transforms for a frame.

They depend on the scene illuminant (docs/method.md#several-illuminants), the analog gain (docs/method.md#gains), and the
noise that remains in each pixel after the temporal filter (docs/method.md#noise-sets).
"""

import functools
import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.camera import CameraModel, NoiseScale
from l3cli.artifacts.class_rule import ClassRule, StoredFeatures
from l3cli.artifacts.conditions import Condition
from l3cli.artifacts.layers import Clipping, CoarseChroma, MosaicLayer, PlaneLayer, PlaneRule
from l3cli.artifacts.plane_rules import GradientScale
from l3cli.artifacts.table import TransformTable
from l3cli.artifacts.training_set import LightSpectrum
from l3cli.classes import contrast, level
from l3cli.classes.features import features_of
from l3cli.classes.plane_kernel import kernel_macros
from l3cli.classes.planes import FixedPoint, fixed_point
from l3cli.errors import InputFileError
from l3cli.frames.frame import RawFrame
from l3cli.physics.correlated_lights import mired_of

MIN_VARIANCE = 1e-30  # noise variance in DN² that is assumed where all channels clip
# At another gain, refinement layers reuse the transforms of levels with at least this signal-to-noise ratio. Transforms of
# darker levels would leave more noise.
DARKEST_REFINED = 2.0
# Fractions of the noise variance that may remain after the temporal filter. For each fraction, a low-noise set is prepared
# from the transforms of a correspondingly lower gain.
LEFT = (1 / 16, 1 / 4)
GAINS_PER_DOUBLING = 12  # transforms are computed for this number of gains per octave
SAME_GAIN = 0.01  # gains with a smaller relative difference count as equal
FAR_GAIN = 1.5  # l3 warns if a gain is outside the range of known analog gains by more than this factor
CLEARLY_LESS = 0.75  # transforms of a lower gain are used only if this gain is below 0.75 times the frame's gain

Layers = TypeVar("Layers", TransformTable, Condition)
Float = TypeVar("Float", np.float32, np.float64)


# ------------------------------------------------------------------------------------------- illuminant of the frame


@dataclass(frozen=True)
class Mix:
    """Mixture of two of a table's illuminants."""

    warm: int  # index of the illuminant with the lower colour temperature
    cool: int  # index of the illuminant with the higher colour temperature
    share: float  # weight of the cool illuminant, 0 to 1


def mix_for(table: TransformTable, white: NDArray[np.floating]) -> Mix | None:
    """Find the mixture of a table's illuminants that matches the scene illuminant.

    It consists of the two illuminants with the nearest lower and higher colour temperatures, weighted linearly in reciprocal
    colour temperature. If the scene is warmer or cooler than all illuminants, only the nearest illuminant has a weight.

    Parameters
    ----------
    table : TransformTable
        Table with transforms for several illuminants.
    white : ndarray, (3,)
        XYZ of the scene's white.

    Returns
    -------
    Mix or None
        None if the table has no transforms for single illuminants.
    """
    if not table.lights:
        return None
    mireds = [mired_of(light.white_point[:3]) for light in table.lights]
    order = sorted(range(len(mireds)), key=lambda index: -mireds[index])
    wanted = mired_of(white)
    cooler = next((place for place, index in enumerate(order) if mireds[index] <= wanted), len(order) - 1)
    warm, cool = order[max(cooler - 1, 0)], order[cooler]
    span = mireds[warm] - mireds[cool]
    return Mix(warm, cool, float(np.clip((mireds[warm] - wanted) / span, 0.0, 1.0)) if span > 0 else 1.0)


def nearest_for(table: TransformTable, white: NDArray[np.floating]) -> Mix | None:
    """Find the table's illuminant that is closest to the scene illuminant, as a mixture with a weight of 0 or 1.

    l3 renders pictures with the transforms for this illuminant, and the white balance corrects the remaining difference. If
    the table has no transforms for single illuminants, the result is None.
    """
    mix = mix_for(table, white)
    return None if mix is None else replace(mix, share=float(mix.share >= 0.5))


def mixed(table: TransformTable, mix: Mix | None) -> TransformTable:
    """Interpolate the transforms of a table between two illuminants.

    Parameters
    ----------
    table : TransformTable
        Table with transforms for several illuminants.
    mix : Mix or None
        Mixture of illuminants, or None for the transforms trained on all illuminants together.

    Returns
    -------
    TransformTable
        Table without separate transforms for single illuminants.
    """
    common = table.of_light(None)
    if mix is None:
        return common
    share, (warm, cool) = mix.share, (table.of_light(table.lights[index]) for index in (mix.warm, mix.cool))
    light = None
    if warm.light and cool.light and np.array_equal(warm.light.wavelength, cool.light.wavelength):
        light = LightSpectrum(warm.light.wavelength, _between(warm.light.radiance, cool.light.radiance, share))

    pairs = zip(common.conditions, warm.conditions, cool.conditions, strict=True)
    return replace(
        _mixed_layers(common, warm, cool, [share] * len(table.layers)),
        white_point=_between(warm.white_point, cool.white_point, share),
        light=light,
        conditions=tuple(_mixed_layers(*pair, [share] * len(table.layers)) for pair in pairs),
    )


def described(table: TransformTable, mix: Mix) -> str:
    """Describe a mixture for users, such as "62 % A, 38 % D65" or "A"."""
    warm, cool, percent = table.lights[mix.warm].name, table.lights[mix.cool].name, round(100 * mix.share)
    if percent in (0, 100):
        return cool if percent else warm
    return f"{100 - percent} % {warm}, {percent} % {cool}"


def _mixed_layers(common: Layers, warm: Layers, cool: Layers, shares: Sequence[NDArray[np.float64] | float]) -> Layers:
    """Return `common` with transforms interpolated between `warm` and `cool`.

    `shares` contains, for each layer, the weight of `cool`: one number, or one number per class.
    """

    def layer(of: Any, one: Any, other: Any, share: NDArray[np.float64] | float) -> Any:
        names = ("weights", "intercept")
        made = replace(of, **{name: _between(getattr(one, name), getattr(other, name), share) for name in names})
        if getattr(one, "clipping", None) is None or getattr(other, "clipping", None) is None:
            return made
        names = ("response", "white")
        parts = (_between(getattr(one.clipping, name), getattr(other.clipping, name), share) for name in names)
        return replace(made, clipping=Clipping(*parts))

    later = tuple(map(layer, common.later, warm.later, cool.later, shares[1:]))
    return replace(common, first=layer(common.first, warm.first, cool.first, shares[0]), later=later)


def _between(warm: NDArray[Float], cool: NDArray[Float], share: NDArray[np.float64] | float) -> NDArray[Float]:
    """Interpolate between two arrays. `share` is the weight of `cool`: one number, or one per element of the first axis.

    Values that are equal in both arrays remain exactly the same.
    """
    one, other = warm.astype(np.float64), cool.astype(np.float64)
    share = np.asarray(share).reshape(-1, *[1] * (one.ndim - 1))
    return np.where(one == other, one, (1 - share) * one + share * other).astype(warm.dtype)


# ------------------------------------------------------------------------------------------ analog gain of the frame


def known_gains(table: TransformTable) -> tuple[float, float]:
    """Return the smallest and largest analog gains at which the noise of the table's camera is known.

    Gains are relative to the camera model. If the table does not contain its camera, the result is (1, 1).
    """
    known = [1.0, *(table.camera.gains.analog_gain.tolist() if table.camera and table.camera.gains else ())]
    return min(known), max(known)


def gain_of_frames(table: TransformTable, camera: CameraModel) -> float:
    """Return the analog gain of frames from another camera model, relative to the table's camera.

    It is the ratio of the two full scales, because raw values are scaled to the table's black and white levels before
    rendering. Differences below 1 % are ignored. If the table does not contain its camera, the result is 1.
    """
    gain = table.camera.full_scale / camera.full_scale if table.camera else 1.0
    return 1.0 if abs(gain - 1) < SAME_GAIN else gain


def nearest_step(gain: float) -> float:
    """Round a gain to 1/12 of an octave, so that a sequence with varying gain needs only a few renderers.

    The noise at the rounded gain differs by at most 3 %.
    """
    return float(2.0 ** (round(GAINS_PER_DOUBLING * np.log2(gain)) / GAINS_PER_DOUBLING))


def at_gain(table: TransformTable, gain: float) -> TransformTable:
    """Adapt a table to frames with another analog gain (docs/method.md#gains).

    Transforms for temporally filtered frames are kept if they apply at this gain. A table that does not contain its camera
    is returned unchanged.

    Parameters
    ----------
    table : TransformTable
        Table for the gain of its camera.
    gain : float
        Analog gain of the frames, relative to the table's camera.

    Returns
    -------
    TransformTable
        Table for the new gain.
    """
    if gain == 1 or table.camera is None:
        return table
    common, *lit = (_at_gain(table.of_light(light), gain) for light in (None, *table.lights))
    conditions = list(common.conditions)
    for light, each in zip(table.lights, lit, strict=True):
        conditions.append(Condition.of(each.first, each.later, light, None))
        conditions += [replace(condition, light=light) for condition in each.conditions]
    return replace(common, conditions=tuple(conditions))


def _at_gain(table: TransformTable, gain: float) -> TransformTable:
    """Adapt a table to another analog gain. The table must not have transforms for single illuminants."""
    usual, known = replace(table, conditions=()), [(each.noise, each) for each in table.noises if each.noise]
    less = []
    for at in (1.0, *(gain * left for left in LEFT if gain * left > 1)):
        if at < CLEARLY_LESS * gain:
            each = _equivalent(usual, at)
            less.append(Condition.of(each.first, each.later, None, NoiseScale(noise_left=at / gain)))
    filtered = ((noise.noise_left / gain, each) for noise, each in known if noise.noise_left < min(1, gain))
    less += [replace(each, noise=NoiseScale(noise_left=left)) for left, each in filtered]
    return replace(_equivalent(usual, gain), conditions=tuple(less))


def _equivalent(table: TransformTable, gain: float) -> TransformTable:
    """Return a table with a single set of transforms for the given gain.

    Each class uses the transforms of the level that has the same signal-to-noise ratio at the camera model's gain. Classes
    of clipped pixels keep their own transforms.
    """
    if gain == 1:
        return table
    assert table.camera is not None
    camera, exposure, span = table.camera.at_gain(gain), table.exposure, table.white_level - table.black_level

    def noise(of: CameraModel, seconds: float, at: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.maximum(contrast.noise_of_grey(at, of, of.dark_signal(seconds)), MIN_VARIANCE)

    means = level.centres(level.inner_bounds(table.first.rule, table.black_level, table.white_level))
    levels = level.unclipped_level(means, camera.sensitivity) / camera.sensitivity.mean()
    ours, usual = noise(camera, exposure / gain, levels), noise(table.camera, exposure, levels)
    dark = (noise(camera, exposure / gain, np.zeros(1)) / noise(table.camera, exposure, np.zeros(1)))[0]
    numbers, ratios = np.arange(levels.size), np.sqrt([ours, usual]) / levels
    place = np.interp(-ratios[0], -ratios[1], numbers)
    first = replace(table.first, rule=_with_edges(table.first.rule, ours / usual))
    first = _at_levels(first, table.cfa.size, place)
    place = np.maximum(place, np.interp(-span / DARKEST_REFINED, -ratios[1], numbers))
    later = []
    for layer in table.later:
        scale = np.sqrt(usual) * layer.rule.gradient_factor / 2.0**layer.rule.gradient_shift
        scale = np.exp(np.interp(place, numbers, np.log(scale))) / np.sqrt(ours)
        if layer.coarse_chroma:
            layer = replace(layer, coarse_chroma=CoarseChroma(layer.coarse_chroma.variance * [dark, gain, 1.0]))
        later.append(_at_levels(layer, table.cfa.size, place).scaled_as(GradientScale.of(scale)))
    return replace(
        table,
        first=first,
        later=tuple(later),
        camera=camera,
        output_unit=table.output_unit / gain,
        exposure=exposure / gain,
        conditions=(),
    )


def _at_levels(layer: Any, sites: int, place: NDArray[np.float64]) -> Any:
    """Return a layer in which unclipped classes use the transforms of other levels.

    This is possible because transforms of unclipped classes have no intercept. `place` contains, for each level of the first
    layer, the index of the level that provides the transforms. Fractional indices interpolate between levels. `sites` is
    the number of CFA sites.
    """
    rule, first = layer.rule, isinstance(layer, MosaicLayer)
    every, numbers = np.arange(len(layer.weights)), np.arange(place.size)
    there, own = rule.split(every), numbers if first else np.asarray(rule.level_of(numbers))
    middle, to = (np.bincount(own, each) / np.bincount(own) for each in (numbers, place))
    clips = np.asarray(there.kind) >= (rule.chromas if first else rule.structures)
    to = np.where(clips, there.level, np.interp(to, middle, np.arange(middle.size))[there.level])
    low, step = to.astype(np.int64), every.size // (sites * middle.size)  # each level has `step` consecutive classes
    darker, brighter = (layer.weights[every + step * (each - there.level)] for each in (low, np.ceil(to).astype(np.int64)))
    return replace(layer, weights=_between(darker, brighter, to - low))


# ------------------------------------------------------------------------------------------------ noise of the pixel


def noise_limits(table: TransformTable) -> dict[NoiseScale, float]:
    """Return the largest noise fraction at which each low-noise set of transforms in a table is used.

    Low-noise sets are for temporally filtered frames. A noise fraction is the noise variance divided by the camera's noise
    variance. A set that was trained for the fraction a is used up to a^¾ · b^¼, where b is the fraction of the next noisier
    set.

    Returns
    -------
    dict of NoiseScale to float
        Limit of each set, in order of decreasing noise.
    """
    lower = sorted((each.noise for each in table.noises if each.noise and each.noise.shot < 1), key=lambda each: -each.shot)
    return {each: each.shot**0.75 * above.shot**0.25 for above, each in itertools.pairwise([NoiseScale(), *lower])}


class NoiseSets:
    """A table's sets of transforms. Renderers choose a set for each pixel by its noise fraction after the temporal filter.

    The first set is for the camera's full noise, and the others are for lower noise. The arrays of all sets are
    concatenated. Classes are numbered consecutively over all sets, as if each set had its own CFA sites.

    Parameters
    ----------
    table : TransformTable
        Table with one or more sets of transforms.
    by_noise : bool
        Whether to include the sets for lower noise.

    Raises
    ------
    InputFileError
        If the class rules of the sets differ in more than their thresholds.
    """

    def __init__(self, table: TransformTable, by_noise: bool) -> None:
        limits = noise_limits(table) if by_noise else {}
        of_noise = {each.noise: each for each in table.noises}
        self.tables = (table, *(table.under(of_noise[noise]) for noise in limits))
        self._limits = list(limits.values())
        macros = [kernel_macros(each.first.rule) for each in self.tables[:2]]
        if macros[0] != macros[-1]:
            raise InputFileError(
                "the table's transforms for low noise have a different class rule than the other transforms; train the "
                "table again"
            )

    def __len__(self) -> int:
        return len(self.tables)

    def share(self, frame: RawFrame) -> float:
        """Return the noise variance of a frame, divided by the noise variance of the camera model.

        With a single set of transforms, the ratio is not needed, and the result is 1.
        """
        return frame.noise_share if self._limits else 1.0

    def chosen(self, frame: RawFrame) -> NDArray[np.uint8]:
        """Choose a set of transforms for each pixel in a frame. Return the indices of the sets: (row, col)."""
        if frame.noise_left is None:
            return np.zeros(frame.values.shape, np.uint8)
        return frame.noise_left.below(self._limits, frame.values.shape)

    @functools.cached_property
    def first(self) -> MosaicLayer:
        """The first layers of all sets, concatenated, with the class rule of the first set."""
        names = ("weights", "intercept", "samples", "condition")
        return self._joined(names, [table.first for table in self.tables])

    @functools.cached_property
    def later(self) -> tuple[PlaneLayer, ...]:
        """The refinement layers of all sets, concatenated like `first`."""
        layers = zip(*(table.later for table in self.tables), strict=True)
        return tuple(self._joined(("weights", "intercept", "samples"), parts) for parts in layers)

    @functools.cached_property
    def first_fixed_point(self) -> FixedPoint:
        """The first layers of all sets in fixed point, concatenated like `first`."""
        return self._joined(("weights", "intercept", "fraction"), [fixed_point(table) for table in self.tables])

    def refinement_rules(self, number: int) -> tuple[PlaneRule, ...]:
        """Return each table's class rule for refinement layer `number`, counted from 0."""
        return tuple(table.later[number].rule for table in self.tables)

    @staticmethod
    def _joined(names: tuple[str, ...], parts: Sequence[Any]) -> Any:
        if len(parts) == 1:
            return parts[0]
        return replace(parts[0], **{name: np.concatenate([getattr(part, name) for part in parts]) for name in names})


def with_edges_for(table: TransformTable, share: float) -> TransformTable:
    """Adapt the class thresholds of a table to frames with less noise, without changing the transforms.

    The thresholds of noise-dependent features, such as contrast and strength, are scaled with the noise. They then separate
    texture from uniform areas as reliably as at the camera's full noise.

    Parameters
    ----------
    table : TransformTable
        Table for the full noise of its camera.
    share : float
        Noise variance of the frames, as a fraction of the camera's noise variance.

    Returns
    -------
    TransformTable
        Table with a single set of transforms.
    """
    first = _with_edges(table.first.rule, share)

    def scaled(layer: PlaneLayer) -> PlaneLayer:
        layer = layer.with_noise(share)
        if layer.structure is None:
            return layer
        edges = _scaled(layer.structure.strength_edges, share)
        return replace(layer, structure=replace(layer.structure, strength_edges=edges))

    later = tuple(map(scaled, table.later))
    return replace(table, first=replace(table.first, rule=first), later=later, conditions=())


def _with_edges(rule: ClassRule, share: float | NDArray[np.float64]) -> ClassRule:
    """Scale the noise-dependent class thresholds by `share`, the ratio of the new to the old noise variance.

    `share` is one number, or one number per level.
    """
    features = tuple(module.with_less_noise(feature, share) for module, feature in features_of(rule))
    stored = StoredFeatures.of(features) if features else None
    return replace(rule, contrast_edges=_scaled(rule.contrast_edges, share), features=stored)


def _scaled(edges: NDArray[np.uint32], share: float | NDArray[np.float64]) -> NDArray[np.uint32]:
    """Multiply class thresholds by `share`, and keep them distinct."""
    least = np.arange(len(edges)).reshape(-1, *[1] * (edges.ndim - 1))
    return np.clip(np.rint(edges * share), least, 2**32 - 1).astype(np.uint32)
