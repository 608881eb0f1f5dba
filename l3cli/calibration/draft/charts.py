"""Places of the charts in a folder's captures."""

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from l3cli.calibration.draft.sorting import Group, Scale
from l3cli.charts.locate import locate
from l3cli.charts.perspective import corner_cells, through
from l3cli.physics import charts

GRID_NM = np.arange(400.0, 701.0, 10.0)
SEARCHED = 6  # brightest captures of one series in which the chart is searched
DIM = 0.05  # of the range: darker charts are not searched
Corners = list[tuple[float, float]]
Array = NDArray[np.floating]


def find_corners(mosaic: Array, period: tuple[int, int]) -> Corners | None:
    """Return col, row in pixels of the outer corners of patches 1, 6, 24, 19 of a ColorChecker in a mosaic of DN above
    black, each site a channel of its own; None if there is none."""
    sites = np.arange(period[0] * period[1], dtype=np.uint8).reshape(period)
    found = locate(mosaic, sites, charts.chart("classic", GRID_NM)[1], charts.CLASSIC)
    if found is None:
        return None
    return [(round(float(x), 1), round(float(y), 1)) for x, y in through(found.to_pixels, corner_cells(*charts.CLASSIC))]


def brightest(groups: Sequence[Group], scale: Scale) -> list[Group]:
    """Return the captures of a series in which the chart is best seen."""
    seen = [group for group in groups if scale.signal(group).max() > DIM * scale.range]
    return sorted(seen, key=lambda group: (scale.clipped(group), -float(scale.signal(group).max())))[:SEARCHED]


def corners_of_series(
    groups: Sequence[Group], scale: Scale, period: tuple[int, int], read: Callable[[str], Array]
) -> Corners | None:
    """Return the corners of a chart that stands still in all captures of a series: where most of those that show it agree,
    the median."""
    found = []
    for group in brightest(groups, scale):
        if corners := find_corners(read(group.first.name.path) - float(scale.black.mean()), period):
            found.append(corners)
    if not found:
        return None
    middle = np.median(np.array(found), axis=0)
    return [(round(float(x), 1), round(float(y), 1)) for x, y in middle]
