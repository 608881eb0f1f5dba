"""Smaller charts for the standard metrics that each evaluation and each report measure (l3cli.evaluation.standards).

Evaluating the real charts takes a second or more per table, which is longer than evaluating small frames.
tests/science/test_standards.py tests the metrics with the real charts.
"""

from collections.abc import Iterator

import numpy as np
import pytest

from l3cli.evaluation import standards

SMALL = {
    "OCTAVES": np.array([-6.0, -2.0, 2.0]),  # the range of the real charts, so that SNR10 is found
    "RAW_SIDE": 96,
    "GREY_SIDE": 80,
    "DRAWN": 1,
}
assert SMALL.keys() <= vars(standards).keys()


@pytest.fixture(autouse=True, scope="module")
def small_charts() -> Iterator[None]:
    """Evaluations and reports use the smaller charts. A conftest.py imports this fixture for the tests in its folder."""
    with pytest.MonkeyPatch.context() as patch:
        for name, value in SMALL.items():
            patch.setattr(standards, name, value)
        yield
