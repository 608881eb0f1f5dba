"""Direction: along which axis a neighbourhood varies, how strongly, and whether it varies along that axis alone
(docs/method.md#direction, with the formulas; coherence is none of them where a recipe does not ask for it). Whether
brightness grows or falls along its axis does not matter: transforms are linear.

A patch that is mirrored or turned varies along another axis: a quarter turn exchanges axes 0 and 2, and 1 and 3;
transposition exchanges 0 and 2; strength and coherence stay (`turned`). This holds to the last bit, since boxes lie
symmetrically, but for ties. Sites that share their training as mirror images therefore read one another's classes at the
turned direction (training/symmetry), and sums are averaged over those orientations only that leave every direction as it is.
"""

import math
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.camera import CameraModel
from l3cli.artifacts.class_rule import Axis, ClassRule, Window
from l3cli.artifacts.table import TransformTable
from l3cli.classes import contrast, level
from l3cli.classes.windows import Integers
from l3cli.errors import RecipeError
from l3cli.recipes.toml import Recipe, Share

SNIPPET = "features/direction.cl"
SCALE = 64  # of the larger of the multipliers m
SHARES = 16  # parts in which coherence is stored
HEAD = 5  # constants before the strength edges: m of axes 0 and 2, m of 1 and 3, orientations, strengths, coherence


class Options(Recipe):
    """[classes.direction] of a recipe."""

    orientations: Literal[4, 8] = 4
    strengths: tuple[float, ...] = (4.0,)  # edges of the largest difference over its noise
    coherence: Share | None = None  # the axis across may vary by this share of the largest difference; none: not asked


def fits(camera: CameraModel, patch: int) -> bool:
    """Return whether a patch has room for boxes of one period at distinct places."""
    return math.lcm(*camera.cfa.shape) < patch


def axis(keys: Options, camera: CameraModel, rule: ClassRule, dark: float, observed: NDArray[np.float64] | None) -> Axis:
    """Return windows, multipliers and strength edges by the camera's noise; RecipeError if the strengths cannot be."""
    if not keys.strengths or tuple(sorted(set(keys.strengths))) != keys.strengths or keys.strengths[0] <= 0:
        raise RecipeError("classes.direction.strengths must be there, be positive and increase")
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
    return Axis("direction", size, windows, np.array([*head, *edges.ravel().tolist()], np.int32))


def inner_span(span: int) -> int:
    """Return the distance, down and across, of equally symmetric boxes at a distance of about `span` along a diagonal."""
    return max(2 - span % 2, span - 2 * round((span - span / math.sqrt(2)) / 2))


def boxes(patch: int, period: int, inner: int) -> tuple[Window, ...]:
    """Return the boxes of the four differences. Where none lies in the middle, both of its neighbours are taken."""
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
    keys: Options, windows: tuple[Window, ...], multipliers: Integers, camera: CameraModel, rule: ClassRule, dark: float
) -> Integers:
    """Return (strength edge, level) of G: multiples of its root mean square by the camera's noise alone."""
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


def check(axis: Axis, rule: ClassRule) -> None:
    """Raise ValueError if the constants of an axis that has been read do not fit the formula."""
    if len(axis.constants) < HEAD or axis.sums != 4:
        raise ValueError(f"{len(axis.constants)} constants and {axis.sums} window sums")
    straight, diagonal, orientations, strengths, coherence = axis.constants[:HEAD].tolist()
    if not (1 <= straight <= SCALE and 1 <= diagonal <= SCALE and orientations in (4, 8) and 0 <= coherence <= SHARES):
        raise ValueError("constants out of range")
    size = 1 + strengths * (2 if coherence else 1) * orientations
    if strengths < 1 or size != axis.size or len(axis.constants) != HEAD + strengths * rule.levels:
        raise ValueError(f"{len(axis.constants)} constants for {axis.size} values")


def observe(axis: Axis, rule: ClassRule, sums: Integers, level: Integers) -> NDArray[np.float64]:
    """Return nothing: the camera's noise gives all edges."""
    return np.empty((*level.shape, 0))


def values(axis: Axis, rule: ClassRule, sums: Integers, level: Integers) -> Integers:
    """Return direction (…) by the four differences (…, axis) at `level` (…)."""
    straight, diagonal, orientations, strengths, coherence = axis.constants[:HEAD].tolist()
    size = np.abs(sums) * np.array([straight, diagonal, straight, diagonal])
    steepest = size.argmax(axis=-1)

    def at(places: Integers) -> Integers:
        return np.take_along_axis(size, places[..., None] % 4, axis=-1)[..., 0]

    edges = axis.constants[HEAD:].astype(np.int64).reshape(strengths, rule.levels)
    strength = (at(steepest) > edges[:, level]).sum(axis=0)
    orientation = steepest if orientations == 4 else 2 * steepest + (at(steepest + 1) > at(steepest + 3))
    group = strength - 1
    if coherence:
        group = 2 * group + (SHARES * at(steepest + 2) <= coherence * at(steepest))
    return np.where(strength > 0, 1 + group * orientations + orientation, 0)


def with_less_noise(axis: Axis, share: float | NDArray[np.float64]) -> Axis:
    """Return strength edges that are as many times the noise that is left."""
    constants = axis.constants.copy()
    edges = constants[HEAD:] * np.sqrt(np.resize(share, constants.size - HEAD))
    constants[HEAD:] = np.minimum(np.rint(edges), 2**31 - 1)
    return axis._replace(constants=constants)


def turned(axis: Axis, transposed: bool, turns: int) -> Integers:
    """Return the direction that each direction becomes when a patch is replaced by rot90(patch.T if transposed else
    patch, turns)."""
    orientations = int(axis.constants[2])
    quarter = orientations // 2
    orientation = np.arange(orientations)
    if transposed:
        orientation = (quarter + orientations // 8 - orientation) % orientations
    orientation = (orientation + turns * quarter) % orientations
    every = np.arange(axis.size - 1)
    return np.append(0, 1 + every - every % orientations + orientation[every % orientations])


def _described(axis: Axis, index: int) -> str:
    if index == 0:
        return "flat"
    _, _, orientations, strengths, coherence = axis.constants[:HEAD].tolist()
    group, orientation = divmod(index - 1, orientations)
    degrees = (orientation - (0.5 if orientations == 8 else 0)) * 180 / orientations % 180
    strength, coherent = divmod(group, 2) if coherence else (group, None)
    words = [f"along {degrees:g}°"]
    words += [f"strength {strength + 1}"] if strengths > 1 else []
    words += [("mixed", "coherent")[coherent]] if coherent is not None else []
    return " ".join(words)


def _axis_of(table: TransformTable) -> Axis:
    return next(axis for axis in table.first.rule.axes if axis.name == "direction")


def entry(table: TransformTable, index: int) -> dict[str, Any]:
    """Return the number of a direction, and the angle along which the neighbourhood varies, clockwise from the row."""
    return {"direction": index, "varies": _described(_axis_of(table), index)}


def heading(entry: dict[str, Any]) -> str:
    """Return an entry as a row of a table begins, such as "3: along 90°"."""
    return f"{entry['direction']}: {entry['varies']}"


def name(table: TransformTable, index: int) -> str:
    """Return a name such as "flat" or "along 45° strength 2"."""
    return _described(_axis_of(table), index)


def macros(axis: Axis, rule: ClassRule) -> dict[str, int]:
    """Return the macros that direction.cl is compiled with."""
    names = ("STRAIGHT", "DIAGONAL", "ORIENTATIONS", "STRENGTHS", "COHERENCE")
    head = {f"DIRECTION_{name}": value for name, value in zip(names, axis.constants[:HEAD].tolist(), strict=True)}
    return head | {"DIRECTION_HEAD": HEAD, "DIRECTION_SHARES": SHARES}
