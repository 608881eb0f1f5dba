"""Direction: the axis along which a neighbourhood varies most, how strongly, and whether it varies only along this axis.

The formulas are in docs/method.md#direction. Coherence is used only if the recipe asks for it. Rising and falling brightness
along an axis count as the same direction, because transforms are linear.

If a patch is mirrored or rotated, its axis changes (`turned`). Rotation by 90° exchanges axes 0 and 2 as well as 1 and 3.
Transposition exchanges 0 and 2. Strength and coherence do not change. The boxes are placed symmetrically, so this is exact
except for ties. Sites that share their training as mirror images therefore exchange classes according to the new direction
(training/symmetry). Sums are averaged only over orientations that leave every direction unchanged.
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
SCALE = 64  # value of the larger of the two multipliers m
SHARES = 16  # coherence is stored in units of 1/SHARES
HEAD = 5  # number of constants before the edges: m of axes 0 and 2, m of axes 1 and 3, orientations, strengths, coherence


class DirectionKeys(Recipe):
    """[classes.direction] of a recipe."""

    orientations: Literal[4, 8] = 4
    strengths: tuple[float, ...] = (4.0,)  # edges between strengths: largest difference divided by its noise
    # An edge is coherent if the difference across the axis is at most this fraction of the difference along it. Default:
    # coherence is not used.
    coherence: Share | None = None


def fits(camera: CameraModel, patch: int) -> bool:
    """Return whether patches are large enough for boxes of one CFA period at different positions."""
    return math.lcm(*camera.cfa.shape) < patch


def make_feature(
    keys: DirectionKeys, camera: CameraModel, rule: ClassRule, dark: float, observed: NDArray[np.float64] | None
) -> Feature:
    """Return the windows, multipliers and strength edges for a camera, as `features.FeatureModule.make_feature` describes.

    Raises RecipeError if the strengths are not positive and increasing.
    """
    if not keys.strengths or tuple(sorted(set(keys.strengths))) != keys.strengths or keys.strengths[0] <= 0:
        raise RecipeError("classes.direction.strengths must be one or more positive numbers that increase")
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
    """Return the distance, in rows and in columns, of two symmetric boxes on a diagonal that are about `span` apart."""
    return max(2 - span % 2, span - 2 * round((span - span / math.sqrt(2)) / 2))


def boxes(patch: int, period: int, inner: int) -> tuple[Window, ...]:
    """Return the boxes of the four differences.

    If a box cannot be placed exactly in the middle, both neighbouring positions are used.
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
    """Return the strength edges (strength edge, level) of G, as multiples of the RMS value that noise alone causes."""
    counts = np.zeros((4, rule.patch, rule.patch))
    for window in windows:
        down, across = slice(window.top, window.top + window.rows), slice(window.left, window.left + window.columns)
        counts[window.sum, down, across] += window.sign
    power = ((counts**2).sum(axis=(1, 2)) * multipliers[[0, 1, 0, 1]] ** 2).mean()
    means = level.centres(level.inner_bounds(rule, camera.black_level, camera.white_level))
    shares = level.unclipped_level(means, camera.sensitivity) / camera.sensitivity.mean()
    variance = contrast.noise_of_grey(shares, camera, dark) / 4**rule.shift + 1 / 12
    edges = np.array(keys.strengths)[:, None] * np.sqrt(variance * power)
    return np.minimum(np.rint(edges), 2**31 - 1).astype(np.int64)


def check(feature: Feature, rule: ClassRule) -> None:
    """Raise ValueError if the stored constants of the feature do not fit its formula."""
    if len(feature.constants) < HEAD or feature.sums != 4:
        raise ValueError(f"{len(feature.constants)} constants and {feature.sums} window sums")
    straight, diagonal, orientations, strengths, coherence = feature.constants[:HEAD].tolist()
    if not (1 <= straight <= SCALE and 1 <= diagonal <= SCALE and orientations in (4, 8) and 0 <= coherence <= SHARES):
        raise ValueError("constants out of range")
    size = 1 + strengths * (2 if coherence else 1) * orientations
    if strengths < 1 or size != feature.size or len(feature.constants) != HEAD + strengths * rule.levels:
        raise ValueError(f"{len(feature.constants)} constants for {feature.size} values")


def observe(feature: Feature, rule: ClassRule, sums: Integers, level: Integers) -> NDArray[np.float64]:
    """Return an array without columns, because the edges depend on the camera's noise and not on the pilot."""
    return np.empty((*level.shape, 0))


def values(feature: Feature, rule: ClassRule, sums: Integers, level: Integers) -> Integers:
    """Return the direction (…), given the four differences (…, axis) and `level` (…)."""
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
    """Return the feature with strength edges for frames with the given fraction of the noise variance."""
    constants = feature.constants.copy()
    edges = constants[HEAD:] * np.sqrt(np.resize(noise_fraction, constants.size - HEAD))
    constants[HEAD:] = np.minimum(np.rint(edges), 2**31 - 1)
    return feature._replace(constants=constants)


def turned(feature: Feature, transposed: bool, turns: int) -> Integers:
    """Return what each direction becomes if a patch is replaced by rot90(patch.T if transposed else patch, turns)."""
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
    """Return the number of a direction and its axis, for reports and JSON. The axis is an angle clockwise from the row."""
    return {"direction": index, "varies": _described(_feature_of(table), index)}


def heading(entry: dict[str, Any]) -> str:
    """Return an entry as the first cell of a table row, such as "3: along 90°"."""
    return f"{entry['direction']}: {entry['varies']}"


def name(table: TransformTable, index: int) -> str:
    """Return a name such as "flat" or "along 45° strength 2"."""
    return _described(_feature_of(table), index)


def macros(feature: Feature, rule: ClassRule) -> dict[str, int]:
    """Return the macros with which direction.cl is compiled."""
    names = ("STRAIGHT", "DIAGONAL", "ORIENTATIONS", "STRENGTHS", "COHERENCE")
    head = {f"DIRECTION_{name}": value for name, value in zip(names, feature.constants[:HEAD].tolist(), strict=True)}
    return head | {"DIRECTION_HEAD": HEAD, "DIRECTION_SHARES": SHARES}
