"""Draw plots as inline SVG. Coordinates are in pixels, and a drawing is 440 px wide.

l3 draws plots without a plotting library for two reasons. First, the plots use the page's colours and font, so the same plot
suits a light page, a dark page and print. Second, equal numbers always result in identical bytes.
"""

import itertools
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from markupsafe import Markup, escape
from numpy.typing import NDArray

from l3cli.report.parts import Data, Figure, Key
from l3cli.system.text import superscript

Array = NDArray[np.floating]
WIDTH, HEIGHT = 440, 300  # size of a plot in px
LEFT, RIGHT, TOP, BOTTOM = 58, 10, 10, 44  # margins around the axes in px
# SVG path of each mark, relative to the point
MARKS = {"dot": "h0", "plus": "m-3,0h6m-3,-3v6", "cross": "m-2.3,-2.3l4.6,4.6m0,-4.6l-4.6,4.6"}
DASHES = {"line": "", "dashed": ' stroke-dasharray="6 4"', "dotted": ' stroke-dasharray="2 3"'}
SERIES = ("var(--one)", "var(--two)", "var(--three)", "var(--four)")  # CSS colours of the series in `Plot.curves`
CHARACTER_WIDTH = 6.8  # mean width of a character in px, at a font size of 12 px
WIDE_CHARACTER_WIDTH = 7.7  # mean width of a character in px in a wide font, for labels that must fit in any font
ASCENT, DESCENT = 10.0, 3.5  # height of a text line above and below its baseline, in px
LABEL_CLEARANCE = 2.5  # minimum distance between a label and lines, marks or other labels, in px
SAMPLE_SPACING = 1.5  # spacing, in px, of the points with which lines are sampled to detect overlaps with labels
LABEL_DISTANCES = (5.0, 7.0, 10.0, 16.0, 24.0)  # distances of a label from its point in px, in order of preference
# Directions (right, down) from a point to its label, in order of preference
LABEL_DIRECTIONS = ((0, -1), (1, 0), (-1, 0), (0, 1), (1, -1), (-1, -1), (1, 1), (-1, 1))
ANCHORS = {0: "middle", 1: "start", -1: "end"}  # SVG text-anchor for each horizontal direction
Place = tuple[float, float, str]  # position of a text: x and y of its baseline, and its SVG text-anchor


@dataclass(frozen=True)
class Axis:
    """One axis of a plot: its label with the unit, its range and its scale."""

    label: str
    low: float
    high: float
    log: bool = False

    def place(self, values: Array | float) -> Array:
        """Convert values to positions along the axis, from 0 at the lower end to 1 at the upper end.

        On a logarithmic axis, values below a thousandth of the lower end, such as 0, are raised to this limit.
        """
        values = np.asarray(values, dtype=np.float64)
        if not self.log:
            return (values - self.low) / (self.high - self.low)
        least = np.maximum(values, self.low * 1e-3)
        return np.log(least / self.low) / np.log(self.high / self.low)

    def ticks(self) -> list[float]:
        """Return the tick values: round numbers within the range of the axis."""
        if not self.log:
            return _round_steps(self.low, self.high)
        decades = range(int(np.floor(np.log10(self.low))), int(np.ceil(np.log10(self.high))) + 1)
        for factors in ((1.0,), (1.0, 3.0), (1.0, 2.0, 5.0), range(1, 10)):
            ticks = [f * 10.0**d for d in decades for f in factors if self.low * 0.999 <= f * 10.0**d <= self.high * 1.001]
            if len(ticks) >= 4:
                return ticks[:: -(-len(ticks) // 9)]
        return _round_steps(self.low, self.high)


def spanning(label: str, values: Iterable[float] | Array, zero: bool = False, log: bool = False) -> Axis:
    """Create an axis whose range contains all finite values and a small margin.

    Parameters
    ----------
    label : str
        Label of the axis with its unit.
    values : iterable of float
        Values to draw. A logarithmic axis ignores values that are not positive. Without values, the range is 0…1, or 0.1…1
        for a logarithmic axis.
    zero : bool
        Whether to include zero. If no value is negative, the axis then starts at zero without a margin.
    log : bool
        Whether the scale is logarithmic.

    Returns
    -------
    Axis
        The axis.
    """
    array = np.asarray(values if isinstance(values, np.ndarray) else list(values), dtype=np.float64).ravel()
    array = array[np.isfinite(array) & ((array > 0) | (not log))]
    low, high = (float(array.min()), float(array.max())) if array.size else (0.1 if log else 0.0, 1.0)
    if log:
        factor = max((high / low) ** 0.04, 1.05)
        return Axis(label, low / factor, high * factor, True)
    low = min(low, 0.0) if zero else low
    margin = 0.04 * (high - low) or max(abs(high) * 0.1, 1e-9)
    return Axis(label, low if zero and low == 0 else low - margin, high + margin)


def _round_steps(low: float, high: float) -> list[float]:
    """Return about five equally spaced numbers in a range, with a spacing of 1, 2 or 5 times a power of ten."""
    raw = (high - low) / 5
    power = 10.0 ** np.floor(np.log10(raw))
    step = power * min((1, 2, 5, 10), key=lambda factor: abs(np.log(factor * power / raw)))
    first = int(np.ceil(low / step - 1e-9))
    return [round(index * step, 12) for index in range(first, int(np.floor(high / step + 1e-9)) + 1)]


def tick_text(value: float) -> str:
    """Format the number at a tick, with a power of ten if its magnitude is below 0.001 or at least 100 000."""
    if value and not 1e-3 <= abs(value) < 1e5:
        power = int(np.floor(np.log10(abs(value)) + 1e-9))
        factor = value / 10.0**power
        return ("" if abs(factor - 1) < 1e-9 else f"{factor:g}×") + f"10{superscript(power)}"
    return f"{value:g}".replace("-", "−")


class Plot:
    """An SVG plot with an x axis and a y axis. Lines and marks are clipped to the range of the axes.

    Most drawing methods have an optional argument `series`. Coordinates are added to the figure's data under this name. The
    reader of the report can save these data as CSV.
    """

    def __init__(self, x: Axis, y: Axis, height: int = HEIGHT, square: bool = False) -> None:
        self._x, self._y = x, y
        self._inner = WIDTH - LEFT - RIGHT, (WIDTH - LEFT - RIGHT if square else height - TOP - BOTTOM)
        self._items: list[str] = []
        self._labels: list[tuple[float, float, str]] = []
        self._places = Places(*self._inner)
        self._rows: list[tuple[str, float, float]] = []

    def line(
        self, x: Array, y: Array, colour: str, mark: str = "line", width: float = 2, series: str | None = None
    ) -> "Plot":
        """Draw a line through points. `mark` is a key of DASHES, and `width` is in pixels."""
        self._add_series(series, x, y)
        points = self._points(x, y)
        self._places.take(points, joined=True)
        path = "M" + "L".join(f"{a:.1f},{b:.1f}" for a, b in points)
        self._items.append(
            f'<path d="{path}" fill="none" stroke="{escape(colour)}" stroke-width="{width:g}" '
            f'stroke-linejoin="round"{DASHES[mark]}/>'
        )
        return self

    def steps(self, edges: Array, heights: Array, colour: str, mark: str = "line", series: str | None = None) -> "Plot":
        """Draw the outline of a histogram with the given bin edges (bin + 1,) and heights (bin,).

        The series' data contain the lower edge of each bin.
        """
        self._add_series(series, edges[:-1], heights)
        return self.line(np.repeat(edges, 2)[1:-1], np.repeat(heights, 2), colour, mark, 1.8)

    def band(self, x: Array, low: Array, high: Array, colour: str) -> "Plot":
        """Fill the area between the curves `low` and `high` with a translucent colour."""
        points = [*self._points(x, high), *self._points(x[::-1], low[::-1])]
        self._places.take(points, joined=True)
        path = "M" + "L".join(f"{a:.1f},{b:.1f}" for a, b in points) + "z"
        self._items.append(f'<path d="{path}" fill="{escape(colour)}" fill-opacity="0.25"/>')
        return self

    def dots(
        self, x: Array, y: Array, colour: str, mark: str = "dot", size: float = 5, opacity: float = 0.75,
        series: str | None = None,
    ) -> "Plot":  # fmt: skip
        """Draw marks at points. `mark` is a key of MARKS, and `size` is the diameter of dots in pixels."""
        self._add_series(series, x, y)
        points = self._points(x, y)
        self._places.take([(a + c * size / 2, b) for a, b in points for c in (-1, 1)], joined=False)
        path = "".join(f"M{a:.1f},{b:.1f}{MARKS[mark]}" for a, b in points)
        width = size if mark == "dot" else 1.4
        self._items.append(
            f'<path d="{path}" fill="none" stroke="{escape(colour)}" stroke-width="{width:g}" stroke-linecap="round" '
            f'stroke-opacity="{opacity:g}"/>'
        )
        return self

    def cells(self, x: Array, y: Array, width: float, height: float, colour: str, opacity: float) -> "Plot":
        """Draw boxes of equal size with the lower left corners `x`, `y`. Width and height are in units of the axes."""
        corners = list(zip(self._points(x, y), self._points(x + width, y + height), strict=True))
        self._places.take([corner for pair in corners for corner in pair], joined=False)
        path = "".join(f"M{a:.1f},{b:.1f}H{c:.1f}V{d:.1f}H{a:.1f}z" for (a, b), (c, d) in corners)
        self._items.append(f'<path d="{path}" fill="{escape(colour)}" fill-opacity="{opacity:g}"/>')
        return self

    def label(self, x: float, y: float, text: str) -> "Plot":
        """Add a label near a point, unless it would cover a line, a mark or another label in every position."""
        ((a, b),) = self._points(np.array([x]), np.array([y]))
        self._labels.append((a, b, text))
        return self

    def curves(
        self,
        series: Mapping[str, tuple[Array, Array]],
        marks: Sequence[str] = tuple(DASHES),
        size: float = 6,
        width: float = 2,
    ) -> tuple[Key, ...]:
        """Draw several series as lines with dots, and add them to the figure's data.

        Parameters
        ----------
        series : mapping of str to (ndarray, ndarray)
            Coordinates x and y of each series, by name. Empty series are skipped.
        marks : sequence of str
            Line styles (keys of DASHES), which repeat if there are more series.
        size : float
            Diameter of the dots in pixels, or 0 for no dots.
        width : float
            Width of the lines in pixels.

        Returns
        -------
        tuple of Key
            Legend entries of the drawn series.
        """
        keys = []
        styles = zip(itertools.cycle(SERIES), itertools.cycle(marks), series.items(), strict=False)
        for colour, mark, (name, (x, y)) in styles:
            if x.size:
                self.line(x, y, colour, mark, width, series=None if size else name)
                keys.append(Key(name, colour, mark))
            if x.size and size:
                self.dots(x, y, colour, size=size, series=name)
        return tuple(keys)

    def points(self, keys: Sequence[Key], x: Array, y: Array, used: NDArray[np.bool_]) -> None:
        """Draw points whose colours and marks indicate their channels.

        Parameters
        ----------
        keys : sequence of Key
            Legend entry of each channel.
        x, y : ndarray, (…, channel)
            Coordinates.
        used : ndarray of bool, (…, channel)
            Mask of the points to draw.
        """
        for channel, key in enumerate(keys):
            of_channel = used[..., channel]
            self.dots(x[..., channel][of_channel], y[..., channel][of_channel], key.colour, key.mark, series=key.label)

    def figure(self, title: str, finding: str, keys: tuple[Key, ...] = ()) -> Figure:
        """Convert the plot to a figure with the data of all series.

        Parameters
        ----------
        title : str
            Title of the figure.
        finding : str
            Caption, also used as the text for screen readers.
        keys : tuple of Key
            Legend entries.
        """
        data = Data(("series", self._x.label, self._y.label), tuple(self._rows))
        return Figure(title, self._svg(finding), finding, keys, data=data)

    def _svg(self, finding: str) -> Markup:
        width, height = self._inner
        drawn = "".join([*self._items, *self._placed_labels()])
        inner = f'<svg x="{LEFT}" y="{TOP}" width="{width}" height="{height}">{drawn}</svg>'
        return sheet(WIDTH, height + TOP + BOTTOM, self._frame() + inner, finding)

    def _placed_labels(self) -> list[str]:
        """Draw the labels. This must be the last step, because labels must not cover other parts of the drawing."""
        placed = ((self._places.place(x, y, text), text) for x, y, text in self._labels)
        return [
            f'<text class="mark" x="{place[0]:.1f}" y="{place[1]:.1f}" text-anchor="{place[2]}">{escape(text)}</text>'
            for place, text in placed
            if place is not None
        ]

    def _add_series(self, series: str | None, x: Array, y: Array) -> None:
        if series is not None:
            self._rows += zip(itertools.repeat(series), x.ravel().tolist(), y.ravel().tolist(), strict=False)

    def _points(self, x: Array, y: Array) -> list[tuple[float, float]]:
        """Convert values to pixel coordinates, clipped to two axis lengths outside the plot."""
        width, height = self._inner
        across = np.clip(self._x.place(x), -2, 3) * width
        down = (1 - np.clip(self._y.place(y), -2, 3)) * height
        return list(zip(across.ravel().tolist(), down.ravel().tolist(), strict=True))

    def _frame(self) -> str:
        """Draw the grid, the ticks and the labels of both axes."""
        width, height = self._inner
        bottom, items = TOP + height, []
        for value in self._x.ticks():
            at = LEFT + float(self._x.place(value)) * width
            items.append(f'<path class="grid" d="M{at:.1f},{TOP}V{bottom}"/>')
            items.append(f'<text x="{at:.1f}" y="{bottom + 16}" text-anchor="middle">{tick_text(value)}</text>')
        for value in self._y.ticks():
            at = bottom - float(self._y.place(value)) * height
            items.append(f'<path class="grid" d="M{LEFT},{at:.1f}H{LEFT + width}"/>')
            items.append(f'<text x="{LEFT - 6}" y="{at + 4:.1f}" text-anchor="end">{tick_text(value)}</text>')
        items.append(f'<path class="axis" d="M{LEFT},{TOP}V{bottom}H{LEFT + width}"/>')
        return "".join(items) + _axis_labels(
            self._x.label, self._y.label, LEFT + width / 2, f"{bottom + 36}", TOP + height / 2
        )


def _axis_labels(x_label: str, y_label: str, centre: float, below: str, middle: float) -> str:
    """Draw the x label at (`centre`, `below`), and the rotated y label at the height `middle`."""
    turned = f'transform="rotate(-90 13 {middle:.0f})"'
    return (
        f'<text x="{centre:.0f}" y="{below}" text-anchor="middle">{escape(x_label)}</text>'
        f'<text x="13" y="{middle:.0f}" text-anchor="middle" {turned}>{escape(y_label)}</text>'
    )


def sheet(width: float, height: float, inside: str, finding: str, fixed_size: bool = False) -> Markup:
    """Wrap SVG markup in an svg element.

    Parameters
    ----------
    width, height : float
        Size in pixels.
    inside : str
        SVG markup with escaped text.
    finding : str
        Text for screen readers.
    fixed_size : bool
        Whether to show the drawing at its size in pixels instead of scaling it to the column width.
    """
    label = escape(finding)
    size = f' width="{width:g}" height="{height:g}"' if fixed_size else ""
    return Markup(f'<svg viewBox="0 0 {width:g} {height:g}"{size} role="img" aria-label="{label}">{inside}</svg>')


def box(x: float, y: float, width: float, height: float, colour: str, opacity: float = 1.0, extra: str = "") -> str:
    """Draw a filled rectangle. `extra` is for additional SVG attributes, with a leading space."""
    return (
        f'<rect x="{x:g}" y="{y:g}" width="{width:g}" height="{height:g}" fill="{escape(colour)}"'
        f' fill-opacity="{opacity:g}"{extra}/>'
    )


def heat(shares: Array, rows: Sequence[str], columns: Sequence[str], x_label: str, y_label: str, finding: str) -> Markup:
    """Draw a matrix as a heat map, with opacities that represent the values.

    Parameters
    ----------
    shares : ndarray, (row, column)
        Opacity of each cell, from 0 (empty) to 1.
    rows, columns : sequence of str
        Names of the rows and columns. Only every n-th column name is shown if the names are too wide.
    x_label, y_label : str
        Labels of the axes.
    finding : str
        Text for screen readers.
    """
    side = max(30.0, 8 + CHARACTER_WIDTH * max(map(len, rows)))
    left = 18 + side
    width = (WIDTH - left - RIGHT) / shares.shape[1]
    height = min(max(width, 13.0), 22.0)
    bottom = TOP + height * shares.shape[0]
    items = []
    for share in np.unique(shares[shares > 0]):
        where = np.argwhere(shares == share)
        path = "".join(
            f"M{left + c * width:.1f},{TOP + r * height:.1f}h{width:.1f}v{height:.1f}h{-width:.1f}z" for r, c in where
        )
        items.append(f'<path d="{path}" fill="var(--one)" fill-opacity="{share:g}"/>')
    grid = "".join(f"M{left:.1f},{TOP + r * height:.1f}H{WIDTH - RIGHT}" for r in range(shares.shape[0] + 1))
    grid += "".join(f"M{left + c * width:.1f},{TOP}V{bottom:.1f}" for c in range(shares.shape[1] + 1))
    items.append(f'<path class="grid" d="{grid}"/>')
    for index, name in enumerate(rows):
        y = TOP + (index + 0.5) * height + 4
        items.append(f'<text x="{left - 5:.1f}" y="{y:.1f}" text-anchor="end">{escape(name)}</text>')
    every = max(1, int(np.ceil((CHARACTER_WIDTH * max(map(len, columns)) + 6) / width)))
    for index in range(0, len(columns), every):
        x = left + (index + 0.5) * width
        items.append(f'<text x="{x:.1f}" y="{bottom + 15:.1f}" text-anchor="middle">{escape(columns[index])}</text>')
    items.append(_axis_labels(x_label, y_label, (left + WIDTH - RIGHT) / 2, f"{bottom + 34:.1f}", (TOP + bottom) / 2))
    return sheet(WIDTH, round(bottom + BOTTOM - 2), "".join(items), finding)


# ---------------------------------------------------------------------------------------------------------- labels


class Places:
    """Finds free positions for labels, given the positions covered by lines, marks and other labels."""

    def __init__(self, width: float, height: float) -> None:
        self._width, self._height = width, height
        self._taken: list[Array] = []  # covered points (point, 2) in px

    def take(self, points: list[tuple[float, float]], joined: bool) -> None:
        """Mark points as covered, together with the straight lines between them if `joined` is true."""
        array = np.asarray(points, np.float64).reshape(-1, 2)
        if joined and len(array) > 1:
            array = np.concatenate([_between(start, end) for start, end in itertools.pairwise(array)])
        self._taken.append(array)

    def place(self, x: float, y: float, text: str) -> Place | None:
        """Find a free position for a label near a point, and mark it as covered.

        Parameters
        ----------
        x, y : float
            Coordinates of the point in pixels.
        text : str
            Text of the label.

        Returns
        -------
        tuple or None
            x and y of the text's baseline, and its text-anchor. None if no position near the point is free.
        """
        for reach in LABEL_DISTANCES:
            for across, down in LABEL_DIRECTIONS:
                left, top = self._corner(x, y, text, across * reach, down * reach)
                box = (left, top, left + WIDE_CHARACTER_WIDTH * len(text), top + ASCENT + DESCENT)
                if self._free(box):
                    self._take_box(box)
                    at = {0: (box[0] + box[2]) / 2, 1: box[0], -1: box[2]}[across]
                    return at, top + ASCENT, ANCHORS[across]
        return None

    def _corner(self, x: float, y: float, text: str, across: float, down: float) -> tuple[float, float]:
        """Return the upper left corner of a label at the offset (across, down) from the point (x, y)."""
        width, height = WIDE_CHARACTER_WIDTH * len(text), ASCENT + DESCENT
        left = x - width / 2 if across == 0 else x + across - (width if across < 0 else 0)
        top = y - height / 2 if down == 0 else y + down - (height if down < 0 else 0)
        return left, top

    def _free(self, box: tuple[float, float, float, float]) -> bool:
        """Whether a box (left, top, right, bottom) is inside the plot and far enough from all covered points."""
        left, top, right, bottom = box
        if min(left, top) < 0 or right > self._width or bottom > self._height - 1:
            return False
        for points in self._taken:
            x, y = points.T
            inside = (
                (x > left - LABEL_CLEARANCE)
                & (x < right + LABEL_CLEARANCE)
                & (y > top - LABEL_CLEARANCE)
                & (y < bottom + LABEL_CLEARANCE)
            )
            if inside.any():
                return False
        return True

    def _take_box(self, box: tuple[float, float, float, float]) -> None:
        left, top, right, bottom = box
        x, y = np.meshgrid(
            np.arange(left, right + SAMPLE_SPACING, SAMPLE_SPACING), np.arange(top, bottom + SAMPLE_SPACING, SAMPLE_SPACING)
        )
        self._taken.append(np.stack([x.ravel(), y.ravel()], axis=1))


def _between(start: Array, end: Array) -> Array:
    """Sample the line from `start` to `end` at points (point, 2) with a spacing of at most SAMPLE_SPACING."""
    count = int(np.ceil(np.hypot(*(end - start)) / SAMPLE_SPACING)) + 1
    return start + np.linspace(0.0, 1.0, count)[:, None] * (end - start)
