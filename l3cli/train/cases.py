"""Which saturation patterns get classes of their own (METHOD 3.3)."""

import numpy as np
from numpy.typing import NDArray

SMALLEST_SHARE = 2e-4  # of the training patches: rarer patterns join the nearest kept one


def choose_cases(occurrences: NDArray[np.int64], most: int) -> NDArray[np.uint16]:
    """Case of every saturation code (code) from how often each occurred (code).

    Code 0 is case 0. The most frequent others are kept, `most` cases in all. Every other code goes to the kept one that
    differs in the fewest channels, one that also clips its clipped channels before others; to case 0 only if none is kept.
    """
    codes = np.arange(len(occurrences))
    frequent = np.argsort(-occurrences[1:], kind="stable")[: most - 1] + 1
    kept = np.sort(frequent[occurrences[frequent] > SMALLEST_SHARE * occurrences.sum()])
    case_of_code = np.zeros(len(occurrences), dtype=np.uint16)
    if not kept.size:
        return case_of_code
    differing = np.bitwise_count(codes[:, None] ^ kept[None]).astype(np.float64)
    misses = (codes[:, None] & ~kept[None]) != 0
    case_of_code[:] = np.argmin(differing + 0.5 * misses, axis=1) + 1
    case_of_code[0] = 0
    return case_of_code
