"""Direction: the axis along which a patch changes most, and the strength and coherence of this change.

docs/method.md#direction contains the formulas. A change is coherent if the values hardly change perpendicular to this axis.
Coherence is used only if the class recipe sets it. Transforms are linear, so increasing and decreasing brightness along an
axis count as the same direction.

Differences are computed along four axes: horizontal (0), diagonal (1), vertical (2) and the other diagonal (3). A rotation
by 90° swaps axes 0 and 2, and axes 1 and 3. Transposition swaps axes 0 and 2. Strength and coherence do not change. These
rules are exact, because the boxes are placed symmetrically. The only exception is a patch in which the values change equally
along two axes. CFA sites that are mirror images of each other are trained together, with their classes swapped accordingly
(`turned`, training/symmetry).
"""

import math
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.camera import CameraModel
from l3cli.artifacts.class_rule import ClassRule, Feature, Window
from l3cli.artifacts.table import TransformTable
from l3cli.classes import contrast, level
from l3cli.classes.windows import Integers
from l3cli.errors import RecipeError
from l3cli.recipes.toml import Recipe, Share

SNIPPET = "features/direction.cl"
SCALE = 64  # larger one of the two multipliers that make differences along straight and diagonal axes comparable
SHARES = 16  # coherence is stored in units of 1/SHARES
# Number of constants before the strength edges: the multiplier of axes 0 and 2, the multiplier of axes 1 and 3, the number
# of orientations, the number of strengths, and the coherence.
HEAD = 5


class DirectionKeys(Recipe):
    """The [classes.direction] section of a class recipe."""

    orientations: Literal[4, 8] = 4  # number of distinguished orientations
    strengths: tuple[float, ...] = (4.0,)  # edges between strengths, as multiples of the noise in a difference
    # A change is coherent if the difference along the perpendicular axis is at most this fraction of the largest difference.
    # Without this key, coherence is not used.
    coherence: Share | None = None


def fits(camera: CameraModel, patch: int) -> bool:
    """Whether a patch is larger than one CFA period, so that boxes of one period fit at several positions."""
    return math.lcm(*camera.cfa.shape) < patch


def make_feature(
    keys: DirectionKeys, camera: CameraModel, rule: ClassRule, dark: float, observed: NDArray[np.float64] | None
) -> Feature:
    """Compute the boxes, the multipliers and the strength edges for a camera.

    The parameters are the same as for `features.FeatureModule.make_feature`. `observed` is not used. Raises RecipeError
    unless the strengths are positive and increase.
    """
    if not keys.strengths or tuple(sorted(set(keys.strengths))) != keys.strengths or keys.strengths[0] <= 0:
        raise RecipeError(
            f"classes.direction.strengths is {list(keys.strengths)}; write one or more positive numbers in increasing order"
        )
    period = math.lcm(*camera.cfa.shape)
    span = rule.patch - period
    inner = inner_span(span)
    windows = boxes(rule.patch, period, inner)
    responses = np.array([(1 + span % 2) * span, inner * math.sqrt(2)])
    multipliers = np.rint(SCALE * responses.min() / responses).astype(np.int64)
    edges = _strength_edges(keys, windows, multipliers, camera, rule, dark)
    coherence = 0 if keys.coherence is None else max(1, round(SHARES * keys.coherence))
    head = [*multipliers.tolist(), keys.orientations, len(keys.strengths), coherence]
    size = 1 + len(keys.strengths) * (2 if coherence else 1) * keys.orientations
    return Feature("direction", size, windows, np.array([*head, *edges.ravel().tolist()], np.int32))


def inner_span(span: int) -> int:
    """Return the offset, in rows and in columns, between the two boxes of a diagonal axis.

    The distance between the boxes is then about the same as on a straight axis (`span` pixels), and both boxes are equally
    far from the centre of the patch.
    """
    return max(2 - span % 2, span - 2 * round((span - span / math.sqrt(2)) / 2))


def boxes(patch: int, period: int, inner: int) -> tuple[Window, ...]:
    """Return the boxes between which the differences along the four axes are computed.

    If the ideal position of a box is halfway between two pixels, the box is replaced with two boxes at these pixels.
    """
    span = patch - period
    inner_edge, outer_edge = (span - inner) // 2, (span + inner) // 2
    middle = sorted({span // 2, (span + 1) // 2})
    pairs = [(0, at, span, at, 0) for at in middle] + [(2, span, at, 0, at) for at in middle]
    pairs += [(1, outer_edge, outer_edge, inner_edge, inner_edge), (3, outer_edge, inner_edge, inner_edge, outer_edge)]
    return tuple(
        Window(difference, top, left, period, period, sign)
        for difference, *boxes in pairs
        for top, left, sign in ((boxes[0], boxes[1], 1), (boxes[2], boxes[3], -1))
    )


def _strength_edges(
    keys: DirectionKeys,
    windows: tuple[Window, ...],
    multipliers: Integers,
    camera: CameraModel,
    rule: ClassRule,
    dark: float,
) -> Integers:
    """Return the integer edges between strengths: (strength edge, level).

    The edges are multiples of each level's RMS difference due to noise alone. Row noise and column noise affect some of the
    four differences more than others. If a camera has such noise, the edges are multiples of the RMS of the noisiest
    difference, so that noise is not mistaken for structure.
    """
    counts = np.zeros((4, rule.patch, rule.patch))
    for window in windows:
        down, across = slice(window.top, window.top + window.rows), slice(window.left, window.left + window.columns)
        counts[window.sum, down, across] += window.sign
    power = ((counts**2).sum(axis=(1, 2)) * multipliers[[0, 1, 0, 1]] ** 2).mean()
    means = level.centres(level.inner_bounds(rule, camera.black_level, camera.white_level))
    shares = level.unclipped_level(means, camera.sensitivity) / camera.sensitivity.mean()
    variance = contrast.noise_of_grey(shares, camera, dark) / 4**rule.shift + 1 / 12
    rows, columns = camera.line_variances(dark)
    scaled = counts * multipliers[[0, 1, 0, 1]][:, None, None]
    shared = rows * (scaled.sum(axis=2) ** 2).sum(axis=1) + columns * (scaled.sum(axis=1) ** 2).sum(axis=1)
    independent = variance - (rows + columns) / 4**rule.shift
    noisiest = independent * power + shared.max() / 4**rule.shift if shared.any() else variance * power
    edges = np.array(keys.strengths)[:, None] * np.sqrt(noisiest)
    return np.minimum(np.rint(edges), 2**31 - 1).astype(np.int64)


def check(feature: Feature, rule: ClassRule) -> None:
    """Raise ValueError if the number or the range of the stored constants is wrong."""
    if len(feature.constants) < HEAD or feature.sums != 4:
        raise ValueError(
            f"the direction has {len(feature.constants)} constants and {feature.sums} window sums, but needs at least "
            f"{HEAD} constants and 4 window sums"
        )
    straight, diagonal, orientations, strengths, coherence = feature.constants[:HEAD].tolist()
    if not (1 <= straight <= SCALE and 1 <= diagonal <= SCALE and orientations in (4, 8) and 0 <= coherence <= SHARES):
        raise ValueError(f"the direction constants {feature.constants[:HEAD].tolist()} are out of range")
    size = 1 + strengths * (2 if coherence else 1) * orientations
    if strengths < 1 or size != feature.size or len(feature.constants) != HEAD + strengths * rule.levels:
        raise ValueError(
            f"the direction has {len(feature.constants)} constants and {feature.size} values, but {strengths} strengths and "
            f"{rule.levels} levels need {HEAD + strengths * rule.levels} constants and {size} values"
        )


def observe(feature: Feature, rule: ClassRule, sums: Integers, level: Integers) -> NDArray[np.float64]:
    """Return no statistics (0 columns), because the constants depend only on the camera's noise."""
    return np.empty((*level.shape, 0))


def values(feature: Feature, rule: ClassRule, sums: Integers, level: Integers) -> Integers:
    """Return the direction of each pixel, as a number from 0 (flat) to `feature.size` − 1.

    Parameters
    ----------
    feature : Feature
        The stored feature.
    rule : ClassRule
        The class rule.
    sums : ndarray, (…, axis)
        Difference between the boxes of each axis.
    level : ndarray, (…)
        Level of each pixel.
    """
    straight, diagonal, orientations, strengths, coherence = feature.constants[:HEAD].tolist()
    size = np.abs(sums) * np.array([straight, diagonal, straight, diagonal])
    steepest = size.argmax(axis=-1)

    def at(places: Integers) -> Integers:
        return np.take_along_axis(size, places[..., None] % 4, axis=-1)[..., 0]

    edges = feature.constants[HEAD:].astype(np.int64).reshape(strengths, rule.levels)
    strength = (at(steepest) > edges[:, level]).sum(axis=0)
    orientation = steepest if orientations == 4 else 2 * steepest + (at(steepest + 1) > at(steepest + 3))
    group = strength - 1
    if coherence:
        group = 2 * group + (SHARES * at(steepest + 2) <= coherence * at(steepest))
    return np.where(strength > 0, 1 + group * orientations + orientation, 0)


def with_less_noise(feature: Feature, noise_fraction: float | NDArray[np.float64]) -> Feature:
    """Scale the strength edges for frames in which only the fraction `noise_fraction` of the noise variance remains."""
    constants = feature.constants.copy()
    edges = constants[HEAD:] * np.sqrt(np.resize(noise_fraction, constants.size - HEAD))
    constants[HEAD:] = np.minimum(np.rint(edges), 2**31 - 1)
    return feature._replace(constants=constants)


def turned(feature: Feature, transposed: bool, turns: int) -> Integers:
    """Return each direction's equivalent in the turned patch, rot90(patch.T if transposed else patch, turns)."""
    orientations = int(feature.constants[2])
    quarter = orientations // 2
    orientation = np.arange(orientations)
    if transposed:
        orientation = (quarter + orientations // 8 - orientation) % orientations
    orientation = (orientation + turns * quarter) % orientations
    every = np.arange(feature.size - 1)
    return np.append(0, 1 + every - every % orientations + orientation[every % orientations])


def _described(feature: Feature, index: int) -> str:
    if index == 0:
        return "flat"
    _, _, orientations, strengths, coherence = feature.constants[:HEAD].tolist()
    group, orientation = divmod(index - 1, orientations)
    degrees = (orientation - (0.5 if orientations == 8 else 0)) * 180 / orientations % 180
    strength, coherent = divmod(group, 2) if coherence else (group, None)
    words = [f"along {degrees:g}°"]
    words += [f"strength {strength + 1}"] if strengths > 1 else []
    words += [("mixed", "coherent")[coherent]] if coherent is not None else []
    return " ".join(words)


def _feature_of(table: TransformTable) -> Feature:
    return next(feature for feature in table.first.rule.feature_list if feature.name == "direction")


def entry(table: TransformTable, index: int) -> dict[str, Any]:
    """Describe a direction for reports and JSON: its number, and a text such as "along 90°".

    The values change along the axis at this angle, which is measured clockwise from the horizontal.
    """
    return {"direction": index, "varies": _described(_feature_of(table), index)}


def heading(entry: dict[str, Any]) -> str:
    """Return a row label for a direction, such as "3: along 90°"."""
    return f"{entry['direction']}: {entry['varies']}"


def name(table: TransformTable, index: int) -> str:
    """Return the name of a direction, such as "flat" or "along 45° strength 2"."""
    return _described(_feature_of(table), index)


def macros(feature: Feature, rule: ClassRule) -> dict[str, int]:
    """Return the compiler macros for direction.cl."""
    names = ("STRAIGHT", "DIAGONAL", "ORIENTATIONS", "STRENGTHS", "COHERENCE")
    head = {f"DIRECTION_{name}": value for name, value in zip(names, feature.constants[:HEAD].tolist(), strict=True)}
    return head | {"DIRECTION_HEAD": HEAD, "DIRECTION_SHARES": SHARES}
