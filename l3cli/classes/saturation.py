"""Saturation cases: which channels clip near the centre of a patch (docs/method.md#saturation-cases).

    case = case_of_code[code]

The *saturation code* is a bit pattern. Bit c is set if a pixel of channel c within the saturation radius has a raw value of
at least `saturation` DN. Several codes can share a *case*, because most combinations of clipped channels are too rare for
training.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.camera import CameraModel
from l3cli.artifacts.class_rule import ClassRule
from l3cli.artifacts.table import TransformTable
from l3cli.classes.keys import BasicKeys
from l3cli.classes.windows import Integers, Neighbourhoods, TapOrder, tap_order

MIN_FRACTION = 2e-4  # smallest fraction of the training patches for which a saturation code becomes a case
SNIPPET = "features/saturation.cl"


def choose_cases(occurrences: NDArray[np.int64], most: int, filters: Sequence[int] | None = None) -> NDArray[np.uint16]:
    """Choose the saturation cases of a class rule, and assign each saturation code to a case.

    Code 0 (no channel clips) is case 0. The most frequent other codes become further cases. Every remaining code is assigned
    to the most similar case, by these criteria in order of priority:

    1. Either both the code and the case contain all channels of some colour filter, or neither does.
    2. The code and the case differ in as few channels as possible.
    3. The case contains all clipped channels of the code.

    If only code 0 is frequent, all codes are assigned to case 0.

    Parameters
    ----------
    occurrences : ndarray, (code,)
        Number of training patches with each saturation code.
    most : int
        Largest permitted number of cases, including case 0.
    filters : sequence of int, optional
        Index of the colour filter of each channel. [default: every channel has its own filter]

    Returns
    -------
    ndarray, (code,)
        Case of each code.
    """
    codes = np.arange(len(occurrences))
    lost = lost_filters(codes, filters or range(int(codes[-1]).bit_length())) > 0
    frequent = np.argsort(-occurrences[1:], kind="stable")[: most - 1] + 1
    chosen = np.sort(frequent[occurrences[frequent] > MIN_FRACTION * occurrences.sum()])
    chosen = np.concatenate([chosen[~lost[chosen]], chosen[lost[chosen]]])
    case_of_code = np.zeros(len(occurrences), dtype=np.uint16)
    if not chosen.size:
        return case_of_code
    differing = np.bitwise_count(codes[:, None] ^ chosen[None]).astype(np.float64)
    misses = (codes[:, None] & ~chosen[None]) != 0
    other = (lost[:, None] != lost[chosen]) * len(codes)
    case_of_code[:] = np.argmin(differing + 0.5 * misses + other, axis=1) + 1
    case_of_code[0] = 0
    return case_of_code


def spared_cases(case_of_code: NDArray[np.uint16], filters: Sequence[int]) -> int:
    """Count the saturation cases in which some channels clip, but not all channels of any colour filter.

    `choose_cases` numbers these cases from 1. `filters` contains the colour filter of each channel.
    """
    lost = lost_filters(np.arange(len(case_of_code)), filters) > 0
    return int(case_of_code[lost].min(initial=case_of_code.max() + 1)) - 1 if case_of_code.any() else 0


def lost_filters(codes: Integers, filters: Sequence[int]) -> Integers:
    """Count the colour filters with only clipped channels, for each saturation code.

    `filters` contains the filter of each channel.
    """
    of_filter = [sum(1 << bit for bit, each in enumerate(filters) if each == one) for one in sorted(set(filters))]
    return np.sum([codes & mask == mask for mask in of_filter], axis=0)


def stored_threshold(recipe: BasicKeys, camera: CameraModel) -> int:
    """Return the lowest raw value of a saturated pixel in DN."""
    return int(np.ceil(camera.black_level + recipe.saturation * (camera.white_level - camera.black_level)))


def saturation_codes(
    patches: NDArray[np.unsignedinteger], rule: ClassRule, neighbours: Neighbourhoods, site: int
) -> Integers:
    """Return the saturation code of each training patch.

    Parameters
    ----------
    patches : ndarray, (patch, tap)
        Raw values in DN.
    rule : ClassRule
        The class rule.
    neighbours : Neighbourhoods
        Result of `neighbourhoods` for the CFA.
    site : int
        CFA site at the centre of the patches.
    """
    order = tap_order(rule, neighbours, site)
    return codes(patches.T[order.taps], rule, order)


def codes(values: NDArray[np.unsignedinteger], rule: ClassRule, order: TapOrder) -> Integers:
    """Return the saturation code of each patch. `values` (tap, patch) are raw values in DN, with the taps in `order`."""
    code = np.zeros(values.shape[1], np.int64)
    for bit, taps in enumerate(order.inner):
        if taps.stop > taps.start:
            code |= (np.maximum.reduce(values[taps], axis=0) >= rule.saturation).astype(np.int64) << bit
    return code


def code_of(saturated: NDArray[np.bool_]) -> Integers:
    """Convert saturation flags (…, channel) to saturation codes (…)."""
    return (saturated.astype(np.int64) << np.arange(saturated.shape[-1])).sum(axis=-1)


def cases(rule: ClassRule, code: Integers) -> Integers:
    """Return the saturation case of each saturation code."""
    return rule.case_of_code[code].astype(np.int64)


def entry(table: TransformTable, case: int) -> dict[str, Any]:
    """Describe a saturation case for reports and JSON: its number, and the channels that clip in all codes of the case."""
    codes = np.flatnonzero(table.first.rule.case_of_code == case)
    common = int(np.bitwise_and.reduce(codes)) if codes.size else 0
    return {"case": case, "saturated": _channels(table, common)}


def heading(entry: dict[str, Any]) -> str:
    """Return a row label for a saturation case, such as "2: r g"."""
    return f"{entry['case']}: " + (" ".join(entry["saturated"]) or ("mixed" if entry["case"] else "none"))


def name(table: TransformTable, case: int) -> str:
    """Return the name of a saturation case, such as "saturated r+g".

    If several codes share the case, the name lists the clipped channels of the most typical code, which differs least from
    the other codes. If no code has this case, the name is "no pattern".
    """
    codes = np.flatnonzero(table.first.rule.case_of_code == case)
    if not codes.size:
        return "no pattern"
    code = int(codes[::-1][np.argmin(_distances(codes, len(table.channels))[::-1])])
    return "saturated " + "+".join(_channels(table, code))


def _channels(table: TransformTable, code: int) -> list[str]:
    return [name for bit, name in enumerate(table.channels) if code >> bit & 1]


def _distances(codes: NDArray[np.int64], channels: int) -> NDArray[np.float64]:
    """Return, for each saturation code, the sum of its distances to all codes.

    As in `choose_cases`, the distance is the number of channels that differ, plus one half if a channel clips only in the
    second code. Pairs are not compared one by one, because there may be 2¹⁶ codes.
    """
    clips = codes[:, None] >> np.arange(channels) & 1
    frequency = clips.sum(axis=0)
    subsets = np.zeros(2**channels)  # number of codes in `codes` that are subsets of each bit pattern
    subsets[codes] = 1
    for channel in range(channels):
        halves = subsets.reshape(-1, 2, 2**channel)
        halves[:, 1] += halves[:, 0]
    return np.where(clips, len(codes) - frequency, frequency).sum(axis=1) + 0.5 * (len(codes) - subsets[codes])


def macros(rule: ClassRule) -> dict[str, int]:
    """Return the compiler macros for saturation.cl and for the kernel that computes the patch statistics."""
    return {"SATURATION": min(rule.saturation, 1 << 16), "SATURATION_RADIUS": rule.saturation_radius}


def kernel_array(rule: ClassRule) -> NDArray[np.uint16]:
    """Return the constants for saturation.cl: the saturation case of each code."""
    return rule.case_of_code
