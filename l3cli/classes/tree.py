"""Decision trees that classify pixels in a refinement layer (docs/method.md#trees).

Each test of a tree compares a numerator with a threshold times a denominator. Numerator and denominator are integers below
2³¹, computed from the planes around a pixel, and are converted to float32. The only floating-point operation is one
multiplication, which IEEE 754 defines exactly. The result is therefore the same on every device.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.plane_rules import TESTS, TreeRule
from l3cli.classes.planes import LUMINANCE
from l3cli.classes.structure import NEAR, NOISE_TRACE, WIDE
from l3cli.classes.structure import triangle_sums as sums
from l3cli.classes.windows import Integers

# Luminance gradients are clipped to ±TOP and chroma gradients to ±CHROMA_TOP, so that sums of 81 squares fit into 31 bits.
TOP, CHROMA_TOP = 2895, 2047
# Smallest value of the denominator LUMA, a weighted sum of luminances in units of PLANE_STEP. The weights add up to 16.
DARK = 512
BORDER_PIXELS = 3  # width of the mirrored margin, in pixels

ONE, TRACE, CHROMA, LUMA = range(4)  # indices of the denominators


class Test(NamedTuple):
    """A comparison in a decision tree: a numerator, divided by a denominator, is compared with a threshold."""

    name: str  # name of the numerator
    denominator: int  # index of the denominator


EVERY = (
    Test("strength", ONE),
    Test("across − down", TRACE),
    Test("diagonal", TRACE),
    Test("across − down + diagonal", TRACE),
    Test("across − down − diagonal", TRACE),
    Test("coherence", TRACE),
    Test("strength near", TRACE),
    Test("chroma strength / strength", TRACE),
    Test("chroma strength", ONE),
    Test("chroma across − down", CHROMA),
    Test("first chroma along luminance", TRACE),
    Test("second chroma along luminance", TRACE),
    Test("curvature across", TRACE),
    Test("curvature down", TRACE),
    Test("bend across", TRACE),
    Test("bend down", TRACE),
    Test("slope across", TRACE),
    Test("slope down", TRACE),
    Test("first chroma", LUMA),
    Test("second chroma", LUMA),
    Test("luminance", ONE),
    Test("chroma curvature across − down", CHROMA),
    Test("chroma curvature", CHROMA),
)
assert len(EVERY) == TESTS


@dataclass(frozen=True)
class Evidence:
    """Numerators and denominators for all tests of a decision tree at every pixel.

    In the shapes, … stands for the axes of the pixel array.
    """

    numerators: NDArray[np.float32]  # (test, …)
    denominators: NDArray[np.float32]  # (denominator, …)


def evidence(planes: Integers, factor: Integers, shift: Integers) -> Evidence:
    """Compute the numerators and denominators for all tests of a decision tree at every pixel.

    Parameters
    ----------
    planes : ndarray, (plane, row + 6, col + 6)
        Opponent planes of the previous layer's outputs, with a margin of 3 mirrored pixels.
    factor, shift : ndarray, (row + 4, col + 4)
        Gradients are multiplied by `factor` and shifted right by `shift` bits. Both arrays have a margin of 2 mirrored
        pixels.
    """
    luminance = planes[LUMINANCE]
    chroma = [plane for index, plane in enumerate(planes) if index != LUMINANCE]

    def scaled(difference: Integers, top: int) -> Integers:
        return np.clip(difference * factor >> shift, -top, top)

    def gradients(plane: Integers, top: int) -> tuple[Integers, Integers]:
        across, down = plane[1:-1, 2:] - plane[1:-1, :-2], plane[2:, 1:-1] - plane[:-2, 1:-1]
        return scaled(across, top), scaled(down, top)

    def bends(plane: Integers, top: int) -> tuple[Integers, Integers]:
        twice = 2 * plane[1:-1, 1:-1]
        across, down = plane[1:-1, :-2] - twice + plane[1:-1, 2:], plane[:-2, 1:-1] - twice + plane[2:, 1:-1]
        return scaled(across, top), scaled(down, top)

    gx, gy = gradients(luminance, TOP)
    (ux, uy), (vx, vy) = (gradients(plane, CHROMA_TOP) for plane in chroma)
    bx, by = bends(luminance, TOP)
    (ubx, uby), (vbx, vby) = (bends(plane, CHROMA_TOP) for plane in chroma)
    xx, yy, diagonal = sums(gx * gx, WIDE), sums(gy * gy, WIDE), 2 * sums(gx * gy, WIDE)
    chroma_xx, chroma_yy = sums(ux * ux + vx * vx, WIDE), sums(uy * uy + vy * vy, WIDE)
    chroma_bend_xx, chroma_bend_yy = sums(ubx * ubx + vbx * vbx, WIDE), sums(uby * uby + vby * vby, WIDE)
    trace, chroma_trace, straight = xx + yy, chroma_xx + chroma_yy, xx - yy
    both = np.abs(straight) + np.abs(diagonal)
    along = np.maximum(np.maximum(np.abs(straight), np.abs(diagonal)), (both >> 6) * 45)
    colours = [sums(_inner(plane, 2), NEAR) for plane in (*chroma, luminance)]
    numerators = (
        trace, straight, diagonal, straight + diagonal, straight - diagonal, along, _local(gx * gx + gy * gy),
        chroma_trace, chroma_trace, chroma_xx - chroma_yy, sums(gx * ux + gy * uy, WIDE), sums(gx * vx + gy * vy, WIDE),
        _local(bx * bx), _local(by * by), _signed_square(_inner(bx, 2)), _signed_square(_inner(by, 2)),
        _signed_square(_local(gx)), _signed_square(_local(gy)), *colours,
        chroma_bend_xx - chroma_bend_yy, chroma_bend_xx + chroma_bend_yy,
    )  # fmt: skip
    denominators = (np.ones_like(trace), trace + NOISE_TRACE, chroma_trace + NOISE_TRACE, np.maximum(colours[2], DARK))
    return Evidence(np.stack(numerators).astype(np.float32), np.stack(denominators).astype(np.float32))


def leaves(seen: Evidence, site: Integers, rule: TreeRule) -> Integers:
    """Return the leaf that each pixel reaches in the decision tree.

    A pixel's CFA site (`site`) determines the orientation to which its window is turned.
    """
    turned, sign = (np.array(each) for each in zip(*(turned_tests(turn) for turn in range(8)), strict=True))
    turn = rule.turns.astype(np.int64)[np.broadcast_to(site, seen.numerators.shape[1:]).ravel()]
    numerators, denominators = seen.numerators.reshape(-1), seen.denominators.reshape(-1)
    test, nodes = rule.test.astype(np.int64), len(rule.test)
    # offsets of numerators by orientation and node, and of denominators by node, in the flattened arrays
    numerator, signs = turned[:, test].reshape(-1) * turn.size, sign[:, test].reshape(-1)
    denominator = np.array([each.denominator for each in EVERY])[test] * turn.size
    node, pixel = np.zeros(turn.size, np.int64), np.arange(turn.size)
    while True:
        at = node.take(pixel)
        inner = np.flatnonzero(rule.branch.take(at))  # pixels that have not reached a leaf
        if not inner.size:
            return rule.leaf[node].reshape(seen.numerators.shape[1:])
        pixel, at = pixel.take(inner), at.take(inner)
        asked = turn.take(pixel) * nodes + at
        value = numerators.take(numerator.take(asked) + pixel) * signs.take(asked)
        above = value > rule.threshold.take(at) * denominators.take(denominator.take(at) + pixel)
        node[pixel] = rule.branch.take(at) + above


def turned_tests(turn: int) -> tuple[list[int], list[np.float32]]:
    """Return, for each test in a turned window, the index and the sign of its numerator in the original window.

    If a window is turned to the orientation `turn`, the numerators are only permuted, and their signs change.
    """
    transposed, across, down = turned_axes(turn)
    straight, diagonal = (-1 if transposed else 1), across * down
    total = [straight * each for each in ((3, 4) if straight == diagonal else (4, 3))]  # straight ± diagonal
    signed = [0, straight, 2 * diagonal, *total, 5, 6, 7, 8, 9 * straight, 10, 11]
    signed += [13, 12, 15, 14, across * 17, down * 16] if transposed else [12, 13, 14, 15, across * 16, down * 17]
    signed += [18, 19, 20, 21 * straight, 22]
    return [abs(each) for each in signed], [np.float32(-1 if each < 0 else 1) for each in signed]


def turned_axes(turn: int) -> tuple[bool, int, int]:
    """Return how an orientation changes the axes of a window.

    Parameters
    ----------
    turn : int
        Orientation from 0 to 7. The window is transposed if `turn` ≥ 4, and then rotated by `turn` % 4 quarter turns.

    Returns
    -------
    transposed : bool
        Whether rows and columns are exchanged.
    across, down : int
        −1 if the order of the columns (`across`) or rows (`down`) is reversed, otherwise 1.
    """
    taps = np.arange(9).reshape(3, 3)
    row, col = np.divmod(np.rot90(taps.T if turn >= 4 else taps, turn % 4), 3)
    down = int(row[2, 1] - row[1, 1]), int(col[2, 1] - col[1, 1])
    across = int(row[1, 2] - row[1, 1]), int(col[1, 2] - col[1, 1])
    transposed = down[0] == 0
    return transposed, (across[0] if transposed else across[1]), (down[1] if transposed else down[0])


def _local(values: Integers) -> NDArray[np.integer]:
    """Return triangle-weighted sums over 3 × 3 windows, without the outermost rows and columns of `values`."""
    return sums(_inner(values, 1), NEAR)


def _inner(values: Integers, margin: int) -> Integers:
    return values[margin:-margin, margin:-margin]


def _signed_square(values: NDArray[np.integer]) -> NDArray[np.integer]:
    return values * np.abs(values)
