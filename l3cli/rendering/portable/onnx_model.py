"""A table as an ONNX graph of standard operators: for verification and interchange, not for speed.

Inputs: raw (row, column), uint16; phase (2), int64, CFA row and column of the first pixel. Outputs: labels (layer, row,
column), int64; outputs (output, row, column), float32. Frames may be of any size.
"""

import string
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.layers import PLANE_STEP, PLANE_TOP, PlaneLayer
from l3cli.artifacts.spectral_smoothing import SpectralSmoothing
from l3cli.artifacts.table import TransformTable
from l3cli.classes import direction
from l3cli.classes.features import further_features
from l3cli.classes.planes import COARSE, COARSE_TOP, LUMINANCE, FixedPoint, fixed_point, later_fixed_point, opponent_basis
from l3cli.classes.ratios import DARKEST
from l3cli.columns import printable
from l3cli.errors import InputFileError
from l3cli.rendering.display import require_known_layers
from l3cli.rendering.portable.facts import table_facts
from l3cli.rendering.portable.onnx_classes import Frame, mirrored, mosaic_labels, padded, plane_labels
from l3cli.rendering.portable.onnx_graph import END, OPSET, Graph, Tensor, model_bytes
from l3cli.rendering.portable.vector import make_vector
from l3cli.rendering.smoothing import DARKEST as SPECTRA_DARKEST

README = Path(__file__).parent / "onnx_readme.md"


def onnx_files(table: TransformTable) -> dict[str, bytes]:
    """Name → content of every file; InputFileError if the table is beyond what the graph computes, RecipeError if onnx is
    not installed."""
    require_known_layers(table)
    for feature, axis in further_features(table.first.rule):
        if feature is not direction:
            raise InputFileError(f'the ONNX graph has no class feature "{axis.name}"; export the table as a folder')
    vector = make_vector(table)
    known = table_facts(table) | {
        "opset": OPSET,
        "count": len(table.outputs),
        "rows": vector.raw.shape[0],
        "columns": vector.raw.shape[1],
        "phase": "{}, {}".format(*vector.phase),
    }
    readme = string.Template(README.read_text(encoding="utf-8")).substitute(known)
    return {"table.onnx": _model(table), "README.md": readme.encode()} | vector.files()


def _model(table: TransformTable) -> bytes:
    graph = Graph()
    raw, phase = graph.input("raw", np.uint16), graph.input("phase", np.int64)
    frame = _frame(table, graph, raw, phase)
    labels, outputs = _render(frame)
    if table.spectra:
        outputs = _smoothed(frame, outputs, table.spectra)
    size: list[str | int] = ["rows", "columns"]
    return model_bytes(
        graph,
        {"raw": (raw, size), "phase": (phase, [2])},
        {
            "labels": (graph.stacked(labels), [len(labels), *size]),
            "outputs": (outputs.to(np.float32), [len(table.outputs), *size]),
        },
        f"transform table of {printable(table.camera_name)}: raw mosaic to {', '.join(map(printable, table.outputs))}",
    )


def _frame(table: TransformTable, graph: Graph, raw: Tensor, phase: Tensor) -> Frame:
    rows, columns = (graph.shape_of(raw).take(axis) for axis in (0, 1))
    radius, (cfa_rows, cfa_columns) = table.first.rule.radius, table.cfa.shape
    values = raw.to(np.float64).least(2**table.bits - 1)
    down, across = mirrored(graph, rows, radius, cfa_rows), mirrored(graph, columns, radius, cfa_columns)
    return Frame(table, graph, values.take(down).take(across, axis=1), rows, columns, (phase.take(0), phase.take(1)))


def _render(frame: Frame) -> tuple[list[Tensor], Tensor]:
    """Classes of every layer, and outputs."""
    table, graph = frame.table, frame.graph
    labels = [mosaic_labels(frame)]
    if not table.later:
        signal = (frame.padded - table.black_level) * (1 / (table.white_level - table.black_level))
        return labels, _transformed(graph, [signal], labels[0], table.first.weights, table.first.intercept)
    planes = _planes(graph, [frame.padded], labels[0], fixed_point(table))
    basis = opponent_basis(table.white_point)
    for layer in table.later[:-1]:
        labels.append(plane_labels(frame, layer, planes, labels[0]))
        coarse = [((each + 2 ** (COARSE - 1)) * 2.0**-COARSE).floor().within(-COARSE_TOP, COARSE_TOP) for each in planes]
        planes = _planes(graph, _windows(frame, layer, coarse), labels[-1], later_fixed_point(layer, basis))
    last = table.later[-1]
    labels.append(plane_labels(frame, last, planes, labels[0]))
    signal_planes = _windows(frame, last, [each * PLANE_STEP for each in planes])
    outputs = _transformed(graph, signal_planes, labels[-1], last.weights[..., : last.window_taps], last.intercept)
    if last.ratio_taps:
        for tap, values in enumerate(_shaded_chroma(signal_planes, last.side), last.window_taps):
            outputs = outputs + _weights(graph, last.weights[..., tap], labels[-1]) * values
    return labels, outputs


def _shaded_chroma(planes: list[Tensor], side: int) -> list[Tensor]:
    """As l3cli/classes/ratios.py, of padded planes in output units."""
    first, luminance, second = (_box_mean(each, side) for each in planes)
    reach = side // 2
    own = planes[LUMINANCE].cut(0, reach, -reach or END).cut(1, reach, -reach or END)
    share = ((own - luminance) / luminance.most(DARKEST * PLANE_STEP)).within(-1.0, 1.0)
    return [first * share, second * share]


def _box_mean(plane: Tensor, side: int) -> Tensor:
    """Means (row, col) of a padded plane over side × side."""
    total = plane.graph.constant(0.0)
    for place in range(side**2):
        row, column = divmod(place, side)
        total = total + plane.cut(0, row, row + 1 - side or END).cut(1, column, column + 1 - side or END)
    return total * (1 / side**2)


def _smoothed(frame: Frame, outputs: Tensor, smoothing: SpectralSmoothing) -> Tensor:
    """As l3cli/rendering/smoothing.py."""
    graph, reach = frame.graph, smoothing.radius
    down, across = (mirrored(graph, length, reach, 1) for length in (frame.rows, frame.columns))
    wide = outputs.take(down, axis=1).take(across, axis=2)
    count = len(frame.table.outputs)
    brightness, around = (each.total(0) * (1 / count) for each in (outputs, wide))
    inverse = graph.constant(1.0) / (brightness.most(SPECTRA_DARKEST) * smoothing.reach)
    total, brighter, change = graph.constant(1.0), graph.constant(0.0), graph.constant(0.0)
    for row, column in np.ndindex(smoothing.window, smoothing.window):
        if row == column == reach:
            continue
        cuts = ((row, row + 1 - smoothing.window or END), (column, column + 1 - smoothing.window or END))
        difference = around.cut(0, *cuts[0]).cut(1, *cuts[1]) - brightness
        share = difference * inverse
        left = (1 - share * share).most(0.0)
        weight = left * left
        total, brighter = total + weight, brighter + weight * difference
        change = change + weight * (wide.cut(1, *cuts[0]).cut(2, *cuts[1]) - outputs)
    lit = brightness > SPECTRA_DARKEST
    kept = brightness / lit.where(brightness + brighter / total, 1.0)
    return lit.where((outputs + change / total) * kept, outputs)


def _windows(frame: Frame, layer: PlaneLayer, planes: list[Tensor]) -> list[Tensor]:
    return [padded(each, frame.graph, frame.rows, frame.columns, layer.radius) for each in planes]


def _planes(graph: Graph, sources: list[Tensor], labels: Tensor, fixed: FixedPoint) -> list[Tensor]:
    """What a layer in fixed point makes of padded planes."""
    sums = _transformed(graph, sources, labels, fixed.weights, fixed.intercept)
    half, unit = 1 << fixed.fraction.astype(np.int64) >> 1, 2.0 ** -fixed.fraction.astype(np.float64)
    made = ((sums + graph.constant(half).take(labels)) * graph.constant(unit).take(labels)).floor()
    return [made.within(-PLANE_TOP, PLANE_TOP).take(plane) for plane in range(fixed.weights.shape[1])]


def _transformed(graph: Graph, sources: list[Tensor], labels: Tensor, weights: NDArray, intercept: NDArray) -> Tensor:
    """Sums (output, row, col) of padded planes (row, col) weighed by the classes' weights (class, output, tap), one tap of
    all pixels after the other: the weights of every pixel at once would fill gigabytes."""
    side = round((weights.shape[2] / len(sources)) ** 0.5)
    total = graph.constant(intercept.T).take(labels, axis=1)
    for tap in range(weights.shape[2]):
        source, row, column = np.unravel_index(tap, (len(sources), side, side))
        rows = sources[source].cut(0, int(row), int(row) + 1 - side or END)
        values = rows.cut(1, int(column), int(column) + 1 - side or END)
        total = total + _weights(graph, weights[:, :, tap], labels) * values
    return total


def _weights(graph: Graph, weights: NDArray, labels: Tensor) -> Tensor:
    """Weights (class, output) of a tap at every pixel (output, row, col)."""
    return graph.constant(weights.T, weights.dtype).to(np.float64).take(labels, axis=1)
