"""Classes of pixels: the plain truth of docs/method.md#classes, in integers, shared by training and every renderer.

With v = DN >> shift over the p × p neighbourhood of a pixel, and n, S, Q the count, sum and sum of squares of one channel:

    mean        M = S · round(65536 / n) >> 16                       uint32 exact: v has 12 bits
    variance    V = min((Q − M (2 S − n M)) · round(512 / n), cap)   cap = (2³² − 1) // channels
    level       number of level edges ≤ Σ (S · round(65536 / n) >> 8) over the channels
    contrast    number of contrast edges (of that level) < Σ V over the channels
    case        case_of_code[bit c set if any pixel of channel c within the saturation radius is ≥ saturation (in DN)]
    chroma      the first k of least Σ max((S · round(65536 / n) >> 12) − chroma_black, 0) · weight[k] over the channels

With f the channel means above black over their sum and q a chroma centre, |f − q|² is least where |q|² Σ f − 2 Σ f q is:
hence the weights |q|² − 2 q, and no division (docs/method.md#chroma).
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.camera import CameraModel
from l3cli.artifacts.table import (
    CHROMA_FRACTION,
    CHROMA_SCALE,
    CLASS_BITS,
    CONTRAST_FRACTION,
    LEVEL_FRACTION,
    MAX_PATCH,
    ClassRule,
)
from l3cli.config import Count, CountOrNone, Recipe
from l3cli.errors import RecipeError
from l3cli.frame import pad_mosaic, shifted_cfa

Integers = NDArray[np.int64]
MEAN_TRUNCATED = 1 / 3  # what M, rounded down, adds to V on average: matters where noise is below a DN


class ClassRecipe(Recipe):
    """How pixels are sorted into classes (configs/classes)."""

    patch: Count = 9  # pixels, side of the neighbourhood
    levels: Count = 20
    spacing: Literal["logarithmic", "linear"] = "logarithmic"  # of the level edges, between …
    lowest_level: float = 0.001  # … the upper edge of the darkest level, share of full scale …
    highest_level: float = 0.95  # … and the lower edge of the brightest
    level_edges: tuple[float, ...] | None = None  # shares of full scale, in place of the four keys above
    contrasts: tuple[float, ...] = (1.4,)  # edges of √(signal variance / noise variance)
    saturation: float = 0.985  # share of full scale from which a pixel is saturated
    saturation_radius: CountOrNone = 2  # pixels
    chromas: CountOrNone = 8  # colours told apart where nothing is saturated; 0 or 1: none (docs/method.md#chroma)
    max_cases: Count = 12  # saturation patterns that get classes of their own, the unsaturated one included


@dataclass(frozen=True)
class Neighbourhoods:
    """The p × p windows of every site of a CFA, and the reciprocals of the class formulas."""

    channel: Integers  # (site, tap) channel of each tap
    count: Integers  # (site, channel) taps of each channel
    mean_reciprocal: Integers  # (site, channel) round(65536 / count)
    variance_reciprocal: Integers  # (site, channel) round(512 / count)


def neighbourhoods(cfa: NDArray[np.uint8], patch: int, channels: int) -> Neighbourhoods:
    """Windows of side `patch` about every site; RecipeError if one does not reach every channel."""
    rows, cols = cfa.shape
    reach = np.arange(patch) - patch // 2
    windows = [cfa[np.ix_((r + reach) % rows, (c + reach) % cols)].ravel() for r in range(rows) for c in range(cols)]
    channel = np.array(windows, dtype=np.int64)
    count = np.array([np.bincount(window, minlength=channels) for window in channel])
    if (count == 0).any():
        raise RecipeError(f"a {patch}×{patch} patch does not reach every channel of the {rows}×{cols} CFA; enlarge patch")
    fraction = 2**CONTRAST_FRACTION
    return Neighbourhoods(channel, count, _divided(65536, count), _divided(fraction, count))


def _divided(numerator: int, count: Integers) -> Integers:
    """round(numerator / count), halves up, in integers."""
    return (2 * numerator + count) // (2 * count)


def make_rule(
    recipe: ClassRecipe,
    camera: CameraModel,
    case_of_code: NDArray[np.uint16],
    chroma_centres: NDArray[np.float64] | None = None,
    dark: float = 0.0,
) -> ClassRule:
    """The integer rule for a camera: edges in DN, contrasts from its noise (docs/method.md#classes), for frames of which
    `dark` DN of dark current have been taken off.

    `chroma_centres` (chroma, channel) are shares of the channel means in their sum; without them there is one chroma.
    RecipeError if the recipe asks for what the camera cannot give, such as more levels than values.
    """
    if recipe.patch % 2 == 0 or not 1 <= recipe.patch <= MAX_PATCH:
        raise RecipeError(f"classes.patch is {recipe.patch}, not an odd number up to {MAX_PATCH}")
    neighbourhoods(camera.cfa, recipe.patch, len(camera.channels))
    if tuple(sorted(set(recipe.contrasts))) != recipe.contrasts or any(edge <= 0 for edge in recipe.contrasts):
        raise RecipeError("contrasts must be positive and increase")
    shift = max(0, camera.bits - CLASS_BITS)
    channels, span = len(camera.channels), camera.white - camera.black
    edges = _edges(recipe)
    truncated = (2**shift - 1) / 2  # a shift loses this much on average
    in_values = (camera.black + edges * span - truncated) / 2**shift
    level_edges = np.rint(in_values * 2**LEVEL_FRACTION * channels).astype(np.uint32)
    centres = np.concatenate([[edges[0] / 2], np.sqrt(edges[1:] * edges[:-1]), [(1 + edges[-1]) / 2]])
    variance = camera.noise_variance(centres * span, dark) / 4**shift + (1 / 12 if shift else 0.0) + MEAN_TRUNCATED
    limit = 2.0**32 - 1 - channels
    squared = np.array(recipe.contrasts, dtype=np.float64).reshape(-1, 1) ** 2
    contrast_edges = np.minimum(np.rint(squared * variance * channels * 2**CONTRAST_FRACTION), limit)
    try:
        return ClassRule(
            patch=recipe.patch,
            shift=shift,
            level_edges=level_edges,
            contrast_edges=contrast_edges.astype(np.uint32),
            saturation=int(np.ceil(camera.black + recipe.saturation * span)),
            saturation_radius=min(recipe.saturation_radius, recipe.patch // 2),
            case_of_code=case_of_code,
            chroma_black=int(np.rint((camera.black - truncated) / 2**shift * 2**CHROMA_FRACTION)),
            chroma_weights=chroma_weights(
                np.full((1, channels), 1 / channels) if chroma_centres is None else chroma_centres
            ),
        )
    except ValueError as error:
        raise RecipeError(f"classes: {error}") from error


def _edges(recipe: ClassRecipe) -> NDArray[np.float64]:
    """Level edges as shares of full scale, increasing; RecipeError if they cannot be."""
    if recipe.level_edges is not None:
        edges = np.array(recipe.level_edges)
        if not (edges.size and edges[0] > 0 and edges[-1] < 1 and (np.diff(edges) > 0).all()):
            raise RecipeError("classes.level_edges must increase and lie between 0 and 1")
        return edges
    if not (recipe.levels >= 2 and 0 < recipe.lowest_level < recipe.highest_level < 1):
        raise RecipeError("classes need levels ≥ 2 and 0 < lowest_level < highest_level < 1")
    spaced = np.geomspace if recipe.spacing == "logarithmic" else np.linspace
    return spaced(recipe.lowest_level, recipe.highest_level, recipe.levels - 1)


def chroma_weights(centres: NDArray[np.float64]) -> NDArray[np.int32]:
    """Integer weights (chroma, channel) by which the lowest score is that of the nearest of `centres` (chroma, channel)."""
    weights = (centres**2).sum(axis=1, keepdims=True) - 2 * centres
    return np.rint(weights * CHROMA_SCALE).astype(np.int32)


def decide(
    rule: ClassRule, near: Neighbourhoods, site: Integers, sums: Integers, squares: Integers, code: Integers
) -> Integers:
    """Class within the site from channel sums and squares (…, channel) and saturation codes (…) at `site` (…)."""
    scaled = sums * near.mean_reciprocal[site]
    mean = scaled >> 16
    level = np.searchsorted(rule.level_edges, (scaled >> (16 - LEVEL_FRACTION)).sum(axis=-1), side="right")
    deviation = squares - mean * (2 * sums - near.count[site] * mean)
    cap = (2**32 - 1) // sums.shape[-1]
    variance = np.minimum(deviation * near.variance_reciprocal[site], cap).sum(axis=-1)
    contrast = (variance[None] > rule.contrast_edges[:, level]).sum(axis=0)
    above_black = np.maximum((scaled >> (16 - CHROMA_FRACTION)) - rule.chroma_black, 0)
    # below 2⁵³: exact in float64, whose products BLAS does
    chroma = np.argmin(above_black.astype(np.float64) @ rule.chroma_weights.T.astype(np.float64), axis=-1)
    case = rule.case_of_code[code].astype(np.int64)
    kind = np.where(case > 0, rule.chromas - 1 + case, chroma)
    return (level * rule.contrasts + contrast) * rule.kinds + kind


def label_mosaic(
    values: NDArray[np.uint16], rule: ClassRule, cfa: NDArray[np.uint8], channels: int, phase: tuple[int, int] = (0, 0)
) -> Integers:
    """Class of every pixel of a mosaic (row, col) whose first pixel has CFA site `phase`."""
    rows, cols = values.shape
    near = neighbourhoods(cfa, rule.patch, channels)
    frame_cfa = shifted_cfa(cfa, phase)
    padded = pad_mosaic(values, rule.radius, cfa.shape).astype(np.int64)
    channel = _padded_channels(frame_cfa, rule.radius, rows, cols)
    shifted = padded >> rule.shift
    saturated = padded >= rule.saturation
    sums, squares, code = [], [], np.zeros((rows, cols), dtype=np.int64)
    for index in range(channels):
        here = channel == index
        sums.append(_box(shifted * here, rule.patch))
        squares.append(_box(shifted**2 * here, rule.patch))
        inner = _inner(saturated & here, rule)
        code |= (_box(inner.astype(np.int64), 2 * rule.saturation_radius + 1) > 0).astype(np.int64) << index
    site = sites(rows, cols, cfa.shape, phase)
    within = decide(rule, near, site, np.stack(sums, -1), np.stack(squares, -1), code)
    return site * rule.classes_per_site + within


@dataclass(frozen=True)
class TapOrder:
    """The taps of a site's window sorted by channel, those near the centre first in each: sums over the taps of a channel
    are then sums over neighbouring rows of an array (tap, patch), the fastest that numpy does."""

    taps: Integers  # (tap)
    channels: tuple[slice, ...]  # (channel) where its taps lie
    inner: tuple[slice, ...]  # (channel) where those lie that decide the saturation case


def tap_order(rule: ClassRule, near: Neighbourhoods, site: int) -> TapOrder:
    """The order for one site."""
    channel, channels = near.channel[site], near.count.shape[1]
    reach = np.abs(np.arange(rule.patch) - rule.radius)
    outer = np.maximum(reach[:, None], reach[None]).ravel() > rule.saturation_radius
    start = np.append(0, np.cumsum(near.count[site])).tolist()
    inner = np.bincount(channel[~outer], minlength=channels).tolist()
    return TapOrder(
        np.lexsort((outer, channel)),
        tuple(slice(start[index], start[index + 1]) for index in range(channels)),
        tuple(slice(start[index], start[index] + inner[index]) for index in range(channels)),
    )


def patch_statistics(
    values: NDArray[np.uint32], rule: ClassRule, order: TapOrder
) -> tuple[NDArray[np.uint32], NDArray[np.uint32], Integers]:
    """Channel sums and squares (channel, patch) and saturation codes (patch) of DN (tap, patch) in `order`, which are
    overwritten."""
    code = _saturation_codes(values, rule, order)
    if rule.shift:
        values >>= rule.shift
    sums = np.stack([np.add.reduce(values[taps], axis=0, dtype=np.uint32) for taps in order.channels])
    values *= values
    squares = np.stack([np.add.reduce(values[taps], axis=0, dtype=np.uint32) for taps in order.channels])
    return sums, squares, code


def label_patches(patches: NDArray[np.unsignedinteger], rule: ClassRule, near: Neighbourhoods, site: int) -> Integers:
    """Class within `site` of each patch (patch, tap) of DN."""
    order = tap_order(rule, near, site)
    return label_statistics(*patch_statistics(patches.T[order.taps].astype(np.uint32), rule, order), rule, near, site)


def label_statistics(
    sums: NDArray[np.uint32],
    squares: NDArray[np.uint32],
    code: Integers,
    rule: ClassRule,
    near: Neighbourhoods,
    site: int,
) -> Integers:
    """Class within `site` of each patch from its statistics."""
    return decide(rule, near, np.array([site]), sums.astype(np.int64).T, squares.astype(np.int64).T, code)


def saturation_codes(patches: NDArray[np.unsignedinteger], rule: ClassRule, near: Neighbourhoods, site: int) -> Integers:
    """Pattern of saturated channels near the centre of each patch (patch, tap)."""
    order = tap_order(rule, near, site)
    return _saturation_codes(patches.T[order.taps], rule, order)


def _saturation_codes(values: NDArray[np.unsignedinteger], rule: ClassRule, order: TapOrder) -> Integers:
    code = np.zeros(values.shape[1], np.int64)
    for bit, taps in enumerate(order.inner):
        if taps.stop > taps.start:
            code |= (np.maximum.reduce(values[taps], axis=0) >= rule.saturation).astype(np.int64) << bit
    return code


def sites(rows: int, cols: int, cfa_shape: tuple[int, ...], phase: tuple[int, int]) -> Integers:
    """CFA site (row, col) of every pixel of a frame."""
    row = (np.arange(rows) + phase[0]) % cfa_shape[0]
    col = (np.arange(cols) + phase[1]) % cfa_shape[1]
    return row[:, None] * cfa_shape[1] + col


def _padded_channels(frame_cfa: NDArray[np.uint8], radius: int, rows: int, cols: int) -> Integers:
    row = np.arange(-radius, rows + radius) % frame_cfa.shape[0]
    col = np.arange(-radius, cols + radius) % frame_cfa.shape[1]
    return frame_cfa[np.ix_(row, col)].astype(np.int64)


def _inner(padded: NDArray, rule: ClassRule) -> NDArray:
    """The padded array cut down to the margin that the saturation radius needs."""
    cut = rule.radius - rule.saturation_radius
    return padded[cut : padded.shape[0] - cut, cut : padded.shape[1] - cut]


def _box(padded: Integers, size: int) -> Integers:
    """Sum over every size × size window."""
    total = np.cumsum(np.pad(padded, ((1, 0), (0, 0))), axis=0)
    total = total[size:] - total[:-size]
    total = np.cumsum(np.pad(total, ((0, 0), (1, 0))), axis=1)
    return total[:, size:] - total[:, :-size]
