"""Places for labels beside points of a plot, where nothing is drawn. Coordinates are pixels, y downwards."""

import itertools

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.floating]
GLYPH = 6.8  # px, mean width of a 12 px letter
WIDE = 7.7  # px, that of figures with a unit in a wide font
ABOVE, BELOW = 10.0, 3.5  # of a line of text about its baseline
CLEAR = 2.5  # between a label and what is drawn
SAMPLED = 1.5  # along curves
REACH = (5.0, 7.0, 10.0, 16.0, 24.0)  # of a label from its point
SIDES = ((0, -1), (1, 0), (-1, 0), (0, 1), (1, -1), (-1, -1), (1, 1), (-1, 1))  # tried in this order
ANCHORS = {0: "middle", 1: "start", -1: "end"}
Place = tuple[float, float, str]  # x, y of the baseline, text-anchor


class Places:
    """A plot of `width` × `height` pixels that fills with curves, dots and labels."""

    def __init__(self, width: float, height: float) -> None:
        self._width, self._height = width, height
        self._taken: list[Array] = []  # points (point, 2)

    def take(self, points: list[tuple[float, float]], joined: bool) -> None:
        """Note points that are drawn, `joined`: with straight lines between them."""
        array = np.asarray(points, np.float64).reshape(-1, 2)
        if joined and len(array) > 1:
            array = np.concatenate([_between(start, end) for start, end in itertools.pairwise(array)])
        self._taken.append(array)

    def place(self, x: float, y: float, text: str) -> Place | None:
        """Return the free place for `text` nearest to the point, and take it; None if none is near."""
        for reach in REACH:
            for across, down in SIDES:
                left, top = self._corner(x, y, text, across * reach, down * reach)
                box = (left, top, left + WIDE * len(text), top + ABOVE + BELOW)
                if self._free(box):
                    self._take_box(box)
                    at = {0: (box[0] + box[2]) / 2, 1: box[0], -1: box[2]}[across]
                    return at, top + ABOVE, ANCHORS[across]
        return None

    def _corner(self, x: float, y: float, text: str, across: float, down: float) -> tuple[float, float]:
        """Return the upper left corner of a label that lies so far beside and below its point."""
        width, height = WIDE * len(text), ABOVE + BELOW
        left = x - width / 2 if across == 0 else x + across - (width if across < 0 else 0)
        top = y - height / 2 if down == 0 else y + down - (height if down < 0 else 0)
        return left, top

    def _free(self, box: tuple[float, float, float, float]) -> bool:
        left, top, right, bottom = box
        if min(left, top) < 0 or right > self._width or bottom > self._height - 1:
            return False
        for points in self._taken:
            x, y = points.T
            inside = (x > left - CLEAR) & (x < right + CLEAR) & (y > top - CLEAR) & (y < bottom + CLEAR)
            if inside.any():
                return False
        return True

    def _take_box(self, box: tuple[float, float, float, float]) -> None:
        left, top, right, bottom = box
        x, y = np.meshgrid(np.arange(left, right + SAMPLED, SAMPLED), np.arange(top, bottom + SAMPLED, SAMPLED))
        self._taken.append(np.stack([x.ravel(), y.ravel()], axis=1))


def _between(start: Array, end: Array) -> Array:
    count = int(np.ceil(np.hypot(*(end - start)) / SAMPLED)) + 1
    return start + np.linspace(0.0, 1.0, count)[:, None] * (end - start)
