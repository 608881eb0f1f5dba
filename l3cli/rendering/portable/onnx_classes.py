"""Classes of pixels as ONNX graphs: the formulas of l3cli/classes on whole frames."""

from dataclasses import dataclass

import numpy as np

from l3cli.artifacts.class_rule import ClassRule
from l3cli.artifacts.layers import PlaneLayer
from l3cli.artifacts.structure_rule import GRADIENT, StructureRule
from l3cli.artifacts.table import TransformTable
from l3cli.artifacts.tree_rule import TreeRule
from l3cli.classes import direction
from l3cli.classes.features import further_features
from l3cli.classes.later import first_label_words
from l3cli.classes.planes import LUMINANCE
from l3cli.classes.structure import NOISE_TRACE, WINDOW
from l3cli.classes.tree import CHROMA_TOP, DARK, EVERY, NEAR, REACH, TOP, WIDE
from l3cli.classes.windows import neighbourhoods
from l3cli.rendering.portable.onnx_graph import END, Graph, Tensor


@dataclass(frozen=True)
class Frame:
    """The mosaic and where its pixels lie."""

    table: TransformTable
    graph: Graph
    padded: Tensor  # (row + 2 radius, col + 2 radius) DN
    rows: Tensor  # of the frame
    columns: Tensor
    phase: tuple[Tensor, Tensor]  # CFA row and column of its first pixel

    def sites(self, margin: int) -> Tensor:
        """CFA site (row, col), also of a margin about the frame."""
        cfa_rows, cfa_columns = self.table.cfa.shape
        down = self.graph.steps(-margin, self.rows + margin) + self.phase[0] + margin * cfa_rows
        across = self.graph.steps(-margin, self.columns + margin) + self.phase[1] + margin * cfa_columns
        return (down % cfa_rows * cfa_columns).shaped([-1, 1]) + across % cfa_columns


def mirrored(graph: Graph, length: Tensor, margin: int, period: int) -> Tensor:
    """`mirrored_indices` of l3cli/frame.py."""
    wanted = graph.steps(-margin, length + margin)
    last = length - 1
    mirror = (wanted < 0).where(0 - wanted, (wanted >= length).where(2 * last - wanted, wanted)).within(0, last)
    offset = (wanted - mirror) % period
    below, above = mirror + offset - period, mirror + offset
    prefer_below = (above >= length) | ((below >= 0) & (above - mirror >= mirror - below) & (offset > 0))
    return (length < period).where(wanted.within(0, last), prefer_below.where(below, above))


def padded(plane: Tensor, graph: Graph, rows: Tensor, columns: Tensor, margin: int) -> Tensor:
    """A plane (row, col) mirrored about its outermost pixels."""
    return plane.take(mirrored(graph, rows, margin, 1)).take(mirrored(graph, columns, margin, 1), axis=1)


def box(values: Tensor, rows: int, columns: int) -> Tensor:
    """Sums over boxes of the last two of three axes, from each place on where one fits."""
    for axis, length in ((1, rows), (2, columns)):
        behind = values.sums(axis, 0).cut(axis, length - 1)
        values = behind - values.sums(axis, 1).cut(axis, 0, 1 - length or END)
    return values


def _each(graph: Graph, values: np.ndarray) -> Tensor:
    """A number for each channel, to go with (channel, row, col)."""
    return graph.constant(values.reshape(-1, 1, 1))


def _above(value: Tensor, edges: list[Tensor] | list[float], graph: Graph, reached: bool = False) -> Tensor:
    """How many edges a value is above, or with `reached` not below."""
    count = graph.constant(0.0)
    for edge in edges:
        count = count + (value >= edge if reached else value > edge).to(np.float64)
    return count


def mosaic_labels(frame: Frame) -> Tensor:
    """Class (row, col) of the first layer."""
    graph, table, rule = frame.graph, frame.table, frame.table.first.rule
    near, channels = neighbourhoods(table.cfa, rule.patch, len(table.channels)), len(table.channels)
    site = frame.sites(0)
    channel = graph.constant(table.cfa.ravel(), np.int64).take(frame.sites(rule.radius))
    member = channel.equals(graph.constant(np.arange(channels).reshape(-1, 1, 1), np.int64)).to(np.float64)
    values = frame.padded.shifted(rule.shift)
    of_channel = values * member
    sums, squares = box(of_channel, rule.patch, rule.patch), box(of_channel * values, rule.patch, rule.patch)
    count, mean_of, variance_of = (
        graph.constant(each.T).take(site, axis=1) for each in (near.count, near.mean_reciprocal, near.variance_reciprocal)
    )
    scaled = sums * mean_of
    mean = scaled.shifted(16)
    variance = ((squares - mean * (2 * sums - mean * count)) * variance_of).least((2**32 - 1) // channels)
    level = _above(scaled.shifted(8).total(0), rule.level_edges.tolist(), graph, reached=True).to(np.int64)
    edges = [graph.constant(row).take(level) for row in rule.contrast_edges]
    contrast = _above(variance.total(0), edges, graph).to(np.int64)
    case = _cases(frame, member)
    chroma = _chromas(graph, rule, scaled)
    kind = (case > 0).where(case + (rule.chromas - 1), chroma)
    further = [_directions(frame, axis, level) for feature, axis in further_features(rule) if feature is direction]
    return rule.on_site(rule.join(level, contrast, kind, further=further[0] if further else 0), site)


def _cases(frame: Frame, member: Tensor) -> Tensor:
    graph, rule = frame.graph, frame.table.first.rule
    margin, side = rule.radius - rule.saturation_radius, 2 * rule.saturation_radius + 1
    saturated = (frame.padded >= rule.saturation).to(np.float64) * member
    for axis in (1, 2):
        saturated = saturated.cut(axis, margin, -margin or END)
    bits = (box(saturated, side, side) > 0).to(np.float64) * _each(graph, 2.0 ** np.arange(rule.channels))
    return graph.constant(rule.case_of_code, np.int64).take(bits.total(0).to(np.int64))


def _chromas(graph: Graph, rule: ClassRule, scaled: Tensor) -> Tensor:
    above_black = (scaled.shifted(12) - rule.chroma_black_level).within(0, 65535)
    scores = [(above_black * _each(graph, weights)).total(0) for weights in rule.chroma_weights]
    return graph.stacked(scores).lowest()


def _directions(frame: Frame, axis: object, level: Tensor) -> Tensor:
    """`direction` (row, col)."""
    graph, rule = frame.graph, frame.table.first.rule
    (known,) = rule.axes
    constant = direction.macros(known, rule)
    values = graph.stacked([frame.padded.shifted(rule.shift)])
    differences = [graph.constant(0.0)] * known.sums
    for window in known.windows:
        sums = box(values, window.rows, window.columns)
        for each, start, length in ((1, window.top, window.rows), (2, window.left, window.columns)):
            sums = sums.cut(each, start, start + length - rule.patch or END)
        differences[window.sum] = differences[window.sum] + window.sign * sums
    unit = [constant["DIRECTION_STRAIGHT"], constant["DIRECTION_DIAGONAL"]] * 2
    size = graph.joined([each.size() * unit[number] for number, each in enumerate(differences)])
    steepest = size.highest()

    def turned(steps: int) -> Tensor:
        index = graph.stacked([(steepest + steps) % 4])
        return graph.node("GatherElements", (size, index), size.dtype, axis=0).total(0)

    edges = known.constants[direction.HEAD :].reshape(-1, rule.levels)
    strength = _above(turned(0), [graph.constant(row).take(level) for row in edges], graph)
    group, orientation = strength - 1, steepest.to(np.float64)
    if constant["DIRECTION_COHERENCE"] > 0:
        coherent = turned(0) * constant["DIRECTION_COHERENCE"] >= turned(2) * constant["DIRECTION_SHARES"]
        group = 2 * group + coherent.to(np.float64)
    if constant["DIRECTION_ORIENTATIONS"] == 8:
        orientation = 2 * orientation + (turned(1) > turned(3)).to(np.float64)
    found = group * constant["DIRECTION_ORIENTATIONS"] + orientation + 1
    return (strength > 0).where(found, 0.0).to(np.int64)


def plane_labels(frame: Frame, layer: PlaneLayer, planes: list[Tensor], first: Tensor) -> Tensor:
    """Class (row, col) of a layer that reads planes, from the classes of the first."""
    graph, rule = frame.graph, layer.rule
    words = first_label_words(rule, frame.table.first.rule)
    lower, upper = (words & np.uint64(2**32 - 1)).astype(np.int64), (words >> np.uint64(32)).astype(np.int64)
    scale = np.ldexp((lower & 0x7F).astype(np.float64), -(lower >> 8 & 0x1F))  # factor · 2^−shift
    sees = _Neighbourhood(frame, graph.constant(scale).take(padded(first, graph, frame.rows, frame.columns, REACH - 1)))
    turn = [graph.constant(1.0 - 2 * (lower >> bit & 1)).take(first) for bit in (14, 15, 16)]  # −1 where the bit is set
    seen = _structures(sees, rule, planes, turn) if isinstance(rule, StructureRule) else _leaves(sees, rule, planes, turn)
    base, decided = (graph.constant(each, np.int64).take(first) for each in (upper & 0x7FFFFFFF, upper >> 31))
    return (decided > 0).where(base, base + seen)


@dataclass(frozen=True)
class _Neighbourhood:
    """How planes are read about each pixel."""

    frame: Frame
    scale: Tensor  # (row + 4, col + 4) of gradients

    def plane(self, values: Tensor) -> Tensor:
        return padded(values, self.frame.graph, self.frame.rows, self.frame.columns, REACH)

    def gradients(self, plane: Tensor, top: int) -> tuple[Tensor, Tensor]:
        across = _inner(plane, 1, 0, 2, 0) - _inner(plane, 1, 0, 0, 2)
        down = _inner(plane, 0, 1, 2, 0) - _inner(plane, 0, 1, 0, 2)
        return self.scaled(across, top), self.scaled(down, top)

    def scaled(self, difference: Tensor, top: int) -> Tensor:
        return (difference * self.scale).floor().within(-top, top)


def _inner(values: Tensor, down: int, across: int, first: int, last: int) -> Tensor:
    """(row + 4, col + 4) of a plane (row + 6, col + 6): along an axis whose margin, `down` or `across`, is 1, without a
    pixel on each side; along the other without the `first` and the `last`."""
    low, high = (first, -last or END) if not down else (1, -1), (first, -last or END) if not across else (1, -1)
    return values.cut(0, *low).cut(1, *high)


def _weighed(values: Tensor, weights: tuple[int, ...]) -> Tensor:
    for axis in (0, 1):
        parts = [values.cut(axis, i, i + 1 - len(weights) or END) * float(weight) for i, weight in enumerate(weights)]
        values = sum(parts[1:], parts[0])
    return values


def _centre(values: Tensor, margin: int) -> Tensor:
    return values.cut(0, margin, -margin).cut(1, margin, -margin)


def _structures(sees: _Neighbourhood, rule: StructureRule, planes: list[Tensor], turn: list[Tensor]) -> Tensor:
    gx, gy = sees.gradients(sees.plane(planes[LUMINANCE]), GRADIENT)
    xx, yy, xy = (_weighed(each, WINDOW) for each in (gx * gx, gy * gy, gx * gy))
    trace, a, b = xx + yy, (xx - yy).shifted(6) * turn[0], xy.shifted(5) * turn[1]
    width, height, graph = a.size(), b.size(), sees.frame.graph
    strength = _above(trace, rule.strength_edges.tolist(), graph)
    flat, steep = width * 5 > height * 12, height * 5 > width * 12
    zero = trace * 0
    diagonal = (b > 0).where((a > 0).where(zero + 1, 3.0), (a > 0).where(zero + 7, 5.0))
    upright = (b > 0).where(zero + 2, 6.0)
    found = flat.where((a > 0).where(zero, 4.0), steep.where(upright, diagonal))
    along = flat.where(width, steep.where(height, ((width + height) * 45).shifted(6)))
    within = (along * 64 > trace.shifted(6) * rule.coherence).where(found + 1, 0.0)
    return (strength > 0).where((strength - 1) * 9 + within + 1, 0.0).to(np.int64)


def _leaves(sees: _Neighbourhood, rule: TreeRule, planes: list[Tensor], turn: list[Tensor]) -> Tensor:
    graph = sees.frame.graph
    numerators, denominators = _evidence(sees, planes, turn)
    place = graph.shape_of(numerators[0])
    count = graph.node("ReduceProd", (place,), place.dtype, keepdims=0)
    flat = [graph.joined([each.to(np.float32).shaped([-1]) for each in parts]) for parts in (numerators, denominators)]
    pixel = graph.steps(0, count)
    node = pixel * 0
    of_test = np.array([each.denominator for each in EVERY])
    for _ in range(rule.depth):
        test = graph.constant(rule.test, np.int64).take(node)
        value = flat[0].take(test * count + pixel)
        unit = flat[1].take(graph.constant(of_test[rule.test], np.int64).take(node) * count + pixel)
        above = value > graph.constant(rule.threshold, np.float32).take(node) * unit
        branch = graph.constant(rule.branch, np.int64).take(node)
        node = (branch > 0).where(branch + above.to(np.int64), node)
    return graph.constant(rule.leaf, np.int64).take(node).shaped(place)


def _evidence(sees: _Neighbourhood, planes: list[Tensor], turn: list[Tensor]) -> tuple[list[Tensor], list[Tensor]]:
    """What the tests of a tree compare (l3cli/classes/tree.py), each pixel's in the orientation of its site."""
    u, luminance, v = (sees.plane(each) for each in planes)
    (gx, gy), (ux, uy), (vx, vy) = (
        sees.gradients(luminance, TOP),
        sees.gradients(u, CHROMA_TOP),
        sees.gradients(v, CHROMA_TOP),
    )
    twice = _inner(luminance, 1, 1, 0, 0) * 2
    bx = sees.scaled(_inner(luminance, 1, 0, 0, 2) - twice + _inner(luminance, 1, 0, 2, 0), TOP)
    by = sees.scaled(_inner(luminance, 0, 1, 0, 2) - twice + _inner(luminance, 0, 1, 2, 0), TOP)
    transposed, across, down = turn

    def swapped(one: Tensor, other: Tensor) -> tuple[Tensor, Tensor]:
        return (transposed < 0).where(other, one), (transposed < 0).where(one, other)

    def near(values: Tensor) -> Tensor:
        return _weighed(_centre(values, 1), NEAR)

    def squared(values: Tensor) -> Tensor:
        return values * values.size()

    xx, yy = swapped(_weighed(gx * gx, WIDE), _weighed(gy * gy, WIDE))
    chroma_xx, chroma_yy = swapped(_weighed(ux * ux + vx * vx, WIDE), _weighed(uy * uy + vy * vy, WIDE))
    diagonal = _weighed(gx * gy, WIDE) * across * down * 2
    trace, chroma, straight = xx + yy, chroma_xx + chroma_yy, xx - yy
    along = straight.size().most(diagonal.size()).most((straight.size() + diagonal.size()).shifted(6) * 45)
    curves, bends = swapped(near(bx * bx), near(by * by)), swapped(_centre(bx, 2), _centre(by, 2))
    slope_x, slope_y = swapped(near(gx), near(gy))
    colours = [_weighed(_centre(each, 2), NEAR) for each in (u, v, luminance)]
    numerators = [
        trace, straight, diagonal, straight + diagonal, straight - diagonal, along, near(gx * gx + gy * gy), chroma, chroma,
        chroma_xx - chroma_yy, _weighed(gx * ux + gy * uy, WIDE), _weighed(gx * vx + gy * vy, WIDE), *curves,
        *map(squared, bends), squared(slope_x * across), squared(slope_y * down), *colours,
    ]  # fmt: skip
    return numerators, [trace * 0 + 1, trace + NOISE_TRACE, chroma + NOISE_TRACE, colours[2].most(DARK)]
