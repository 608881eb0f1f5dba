"""Saturation: the channels that clip near the centre of a neighbourhood (docs/method.md#saturation-cases).

    case = case_of_code[code]

Bit c of the code is set if a pixel of channel c within the saturation radius is at or above `saturation`, in DN.
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

MIN_FRACTION = 2e-4  # fraction of the training patches; rarer patterns join the nearest case
SNIPPET = "features/saturation.cl"


def choose_cases(occurrences: NDArray[np.int64], most: int, filters: Sequence[int] | None = None) -> NDArray[np.uint16]:
    """Choose the saturation cases of a rule.

    Code 0 is case 0. The most frequent other codes become cases. Every remaining code joins the nearest case, which is
    chosen by these criteria in turn:

    1. Code and case agree in whether they have lost a filter, which means that all channels of a filter clip.
    2. The case differs from the code in the fewest channels.
    3. The case clips all channels that the code clips.

    Codes join case 0 only if there is no other case.

    Parameters
    ----------
    occurrences : ndarray, (code,)
        Number of occurrences of each pattern of saturated channels.
    most : int
        Largest number of cases, including case 0.
    filters : sequence of int, optional
        Colour filter of each channel. [default: every channel has its own filter]

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
    """Return the number of consecutive cases, starting at case 1, in which no filter has lost all of its channels."""
    lost = lost_filters(np.arange(len(case_of_code)), filters) > 0
    return int(case_of_code[lost].min(initial=case_of_code.max() + 1)) - 1 if case_of_code.any() else 0


def lost_filters(codes: Integers, filters: Sequence[int]) -> Integers:
    """Return, for each code, the number of filters that have lost all of their channels to saturation.

    `filters` is the filter of each channel.
    """
    of_filter = [sum(1 << bit for bit, each in enumerate(filters) if each == one) for one in sorted(set(filters))]
    return np.sum([codes & mask == mask for mask in of_filter], axis=0)


def stored_threshold(recipe: BasicKeys, camera: CameraModel) -> int:
    """Return the lowest value, in DN, at which the rule counts a pixel as saturated."""
    return int(np.ceil(camera.black_level + recipe.saturation * (camera.white_level - camera.black_level)))


def saturation_codes(
    patches: NDArray[np.unsignedinteger], rule: ClassRule, neighbours: Neighbourhoods, site: int
) -> Integers:
    """Return the pattern of saturated channels near the centre of each patch (patch, tap)."""
    order = tap_order(rule, neighbours, site)
    return codes(patches.T[order.taps], rule, order)


def codes(values: NDArray[np.unsignedinteger], rule: ClassRule, order: TapOrder) -> Integers:
    """Return the saturation code (patch,) of values in DN (tap, patch), whose taps are sorted by `order`."""
    code = np.zeros(values.shape[1], np.int64)
    for bit, taps in enumerate(order.inner):
        if taps.stop > taps.start:
            code |= (np.maximum.reduce(values[taps], axis=0) >= rule.saturation).astype(np.int64) << bit
    return code


def code_of(saturated: NDArray[np.bool_]) -> Integers:
    """Return codes (…) from patterns of saturated channels (…, channel)."""
    return (saturated.astype(np.int64) << np.arange(saturated.shape[-1])).sum(axis=-1)


def cases(rule: ClassRule, code: Integers) -> Integers:
    """Return the saturation case (…) of each code."""
    return rule.case_of_code[code].astype(np.int64)


def entry(table: TransformTable, case: int) -> dict[str, Any]:
    """Return the number of a saturation case and the channels saturated in all its patterns, for reports and JSON."""
    codes = np.flatnonzero(table.first.rule.case_of_code == case)
    common = int(np.bitwise_and.reduce(codes)) if codes.size else 0
    return {"case": case, "saturated": _channels(table, common)}


def heading(entry: dict[str, Any]) -> str:
    """Return an entry as the first cell of a table row, such as "2: r g"."""
    return f"{entry['case']}: " + (" ".join(entry["saturated"]) or ("mixed" if entry["case"] else "none"))


def name(table: TransformTable, case: int) -> str:
    """Return "saturated A+B" with the most typical pattern of channels of the case."""
    codes = np.flatnonzero(table.first.rule.case_of_code == case)
    if not codes.size:
        return "no pattern"
    code = int(codes[::-1][np.argmin(_distances(codes, len(table.channels))[::-1])])
    return "saturated " + "+".join(_channels(table, code))


def _channels(table: TransformTable, code: int) -> list[str]:
    return [name for bit, name in enumerate(table.channels) if code >> bit & 1]


def _distances(codes: NDArray[np.int64], channels: int) -> NDArray[np.float64]:
    """Return the summed distance of each pattern to all others, measured as in choose_cases.

    The distance is the number of channels that differ, plus one half if the other pattern is not contained in this one.
    There may be 2¹⁶ patterns, too many to compare in pairs.
    """
    holds = codes[:, None] >> np.arange(channels) & 1
    often = holds.sum(axis=0)
    within = np.zeros(2**channels)
    within[codes] = 1
    for channel in range(channels):
        halves = within.reshape(-1, 2, 2**channel)
        halves[:, 1] += halves[:, 0]
    return np.where(holds, len(codes) - often, often).sum(axis=1) + 0.5 * (len(codes) - within[codes])


def macros(rule: ClassRule) -> dict[str, int]:
    """Return the macros with which saturation.cl and the statistics are compiled."""
    return {"SATURATION": min(rule.saturation, 1 << 16), "SATURATION_RADIUS": rule.saturation_radius}


def kernel_array(rule: ClassRule) -> NDArray[np.uint16]:
    """Return the case of each code."""
    return rule.case_of_code
