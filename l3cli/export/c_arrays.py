"""Write a table's constant arrays as C source, and the structs of its refinement layers."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.class_rule import Window
from l3cli.artifacts.layers import PlaneLayer
from l3cli.artifacts.plane_rules import StructureRule, TreeRule
from l3cli.artifacts.table import TransformTable
from l3cli.classes import chroma, contrast, level, saturation
from l3cli.classes.coarse_chroma import scales_of
from l3cli.classes.plane_kernel import rule_constants, rule_macros
from l3cli.classes.planes import fixed_point, planes_basis, refined_fixed_point
from l3cli.classes.refinement import first_label_words
from l3cli.classes.windows import neighbourhoods
from l3cli.export.wordlengths import ShortWords
from l3cli.rendering.opencl import layout
from l3cli.rendering.reference import white_scale

TAP_GROUP = 16  # taps are padded with zeros to a multiple of this number, so that loops have no remainder
TYPES = {  # dtype → C type
    "int8": "int8_t",
    "uint8": "uint8_t",
    "int16": "int16_t",
    "uint16": "uint16_t",
    "int32": "int32_t",
    "uint32": "uint32_t",
    "float32": "float",
}
PER_LINE = 20  # numbers per line of an array
PER_STRING = 4000  # bytes per string literal; C99 compilers must support 4095
# How each byte is written in a string literal: printable ASCII characters unchanged, all others as octal escapes. "?" is
# escaped, too, because two question marks start a trigraph.
CHARACTERS = tuple(chr(b) if 32 <= b < 127 and chr(b) not in '"\\?' else f"\\{b:03o}" for b in range(256))
SHORT_TOP = 2**15 - 1  # largest 16-bit weight


@dataclass(frozen=True)
class Array:
    """A constant array in l3_table.c."""

    name: str
    values: NDArray
    axes: str  # comment above the array: its meaning, and its axes in parentheses
    # Whether the array is flattened and written as string literals of its bytes. Compilers parse strings fifty times as fast
    # as numbers.
    packed: bool = False

    @property
    def local(self) -> bool:
        """Whether only l3_table.c uses the array, so that it is static."""
        return not self.name.startswith("l3_")

    @property
    def declaration(self) -> str:
        """C declaration. A packed array is a union of its bytes and its values."""
        kind = TYPES[self.values.dtype.name]
        if not self.packed:
            return f"const {kind} {self.name}{''.join(f'[{length}]' for length in self.values.shape)}"
        lines = -(-self.values.nbytes // PER_STRING)
        members = f"unsigned char bytes[{lines}][{PER_STRING}]; {kind} value[{self.values.size}];"
        return f"const union {self.name}_data {{ {members} }} {self.name}_data"

    @property
    def alias(self) -> list[str]:
        """Macro that maps the name of a packed array to its values. The list is empty for other arrays."""
        return [f"#define {self.name} {self.name}_data.value"] if self.packed else []

    def public(self) -> list[str]:
        """Return the lines for the array in l3_table.h."""
        return [f"extern {self.declaration};", *self.alias]

    def lines(self) -> Iterator[str]:
        yield f"/* {self.axes} */"
        declared = f"const union {self.name}_data {self.name}_data" if self.packed and not self.local else self.declaration
        yield f"{'static ' if self.local else ''}{declared} = {{{'{' if self.packed else ''}"
        yield from _strings(self.values) if self.packed else _rows(self.values)
        yield "}};" if self.packed else "};"
        if self.local:
            yield from self.alias


def filled(taps: int) -> int:
    """Round up to a multiple of TAP_GROUP."""
    return -(-taps // TAP_GROUP) * TAP_GROUP


def table_arrays(table: TransformTable, short: ShortWords | None) -> tuple[list[Array], list[str]]:
    """Return the arrays of l3_table.c, and the C lines that follow them.

    If `short` is None, the last layer has float weights. Otherwise, it has the 16-bit weights in `short`.
    """
    rule, neighbours = table.first.rule, neighbourhoods(table.cfa, table.first.rule.patch, len(table.channels))
    arrays = [
        Array("l3_cfa", table.cfa, "channel of each site (CFA row, CFA column)"),
        Array("l3_count", neighbours.count.astype(np.uint8), "taps of each channel in the patch of a site (site, channel)"),
        Array("l3_mean_reciprocal", neighbours.mean_reciprocal.astype(np.uint32), "round(65536 / count) (site, channel)"),
        Array(
            "l3_variance_reciprocal", neighbours.variance_reciprocal.astype(np.uint32), "round(512 / count) (site, channel)"
        ),
        Array("l3_level_tops", _some(level.kernel_array(rule)), "largest level sum below each level edge (edge)"),
        Array("l3_contrast_edges", _some(contrast.kernel_array(rule)), "contrast edges, times 512 (edge, level)"),
        Array("l3_case_of_code", saturation.kernel_array(rule), "saturation case for each set of saturated channels (code)"),
        Array("l3_chroma_weights", rule.chroma_weights, "weights in the score of a chroma (chroma, channel)"),
        Array("l3_chroma_widths", chroma.chroma_widths(rule), "range of scores for dither (chroma)"),
    ]
    lines = []
    if rule.features:
        arrays.append(Array("l3_feature_constants", _some(rule.features.constants), "constants of the other features"))
        windows = sorted(rule.windows, key=lambda window: (window.top, window.rows, window.sum))
        windows = windows or [Window(0, 0, 0, 0, 0, 1)]  # a window without pixels, because C has no empty arrays
        lines += ["/* sum, top, left, rows, columns, sign */", "const L3Window l3_windows[L3_WINDOWS] = {"]
        lines += [*(f"{{{', '.join(map(str, window))}}}," for window in windows), "};"]
    arrays += _last_words(table, short) if short else _last_floats(table)
    if table.later and table.later[-1].coarse_chroma:
        scales = scales_of(table.later[-1].coarse_chroma).astype(np.float32)
        arrays.append(Array("l3_coarse_scales", scales, "(step, plane, power of Y)", packed=True))
        if table.later[-1].clipping:
            response = table.later[-1].clipping.response.astype(np.float32)
            white = table.later[-1].clipping.white.astype(np.float32)
            arrays.append(
                Array("l3_clip_response", response, "responses of the outputs (clipped, signal, output)", packed=True)
            )
            arrays.append(Array("l3_clip_white", white, "signals of a white (channel)", packed=True))
    if table.chroma_smoothing and table.white_signals is not None:
        scale = white_scale(table).astype(np.float32)
        arrays.append(Array("l3_white_scale", scale, "luminance of a white per DN above black (channel)", packed=True))
    if table.later and table.components:
        first = layout.first_weights(table, table.first)
        arrays += [
            Array("l3_first_weights", _fill(first.taps), "(class, output, tap)", packed=True),
            Array("l3_first_intercept", first.intercept, "(class, output)", packed=True),
        ]
    if table.later:
        more, layers = _layers(table)
        return [*arrays, *more], [*lines, *layers, ""]
    return arrays, [*lines, ""]


def _last_floats(table: TransformTable) -> list[Array]:
    weights = layout.refinement_weights(table.later[-1]) if table.later else layout.first_weights(table, table.first)
    windows = weights.taps.shape[-1] - weights.ratio_taps
    return [
        Array("l3_last_weights", _fill(weights.taps[..., :windows]), "(class, output, tap)", packed=True),
        Array("l3_last_intercept", weights.intercept, "(class, output)", packed=True),
        *_ratio_weights(weights.taps[..., windows:]),
    ]


def _ratio_weights(taps: NDArray) -> list[Array]:
    """Return the weights of colour ratios and bilateral chroma, the taps that follow the window taps.

    If the layer has no such taps, the list is empty.
    """
    return [Array("l3_ratio_weights", taps, "(class, output, tap)", packed=True)] if taps.size else []


def _last_words(table: TransformTable, words: ShortWords) -> list[Array]:
    windows = table.later[-1].window_taps if table.later else words.whole.shape[-1]
    taps = _fill(layout.by_column(words.whole[..., :windows], layout.PLANES if table.later else 1))
    short = np.clip(taps, -SHORT_TOP, SHORT_TOP).astype(np.int16)
    rest = taps - short
    return [
        Array("l3_last_weights", short, "times 2^(shift + L3_SPLIT) (class, output, tap)", packed=True),
        Array("l3_last_intercept", words.intercept, "times 2^shift (class, output)", packed=True),
        Array("l3_last_shift", words.fraction, "right shift from sums to outputs (class, output)", packed=True),
        Array(
            "l3_last_rest",
            rest.sum(axis=-1, dtype=np.int32),
            "excess of the largest weight over 16 bits (class, output)",
            packed=True,
        ),
        Array(
            "l3_last_tap", np.abs(rest).argmax(axis=-1).astype(np.uint16), "tap of this weight (class, output)", packed=True
        ),
        *_ratio_weights(words.whole[..., windows:].astype(np.int16)),
    ]


def _layers(table: TransformTable) -> tuple[list[Array], list[str]]:
    """Return the arrays of the refinement layers, and the C lines with the structs that refer to them."""
    basis = planes_basis(table)
    arrays = _fixed("l3_", layout.first_plane_weights(fixed_point(table), table.bits))
    structs, entries = [], []
    for number, layer in enumerate(table.later, 2):
        prefix = f"layer{number}_"
        rule, last = layer.rule, number == len(table.layers)
        if not last:
            arrays += _fixed(prefix, layout.refinement_plane_weights(refined_fixed_point(layer, basis)))
        more, struct = _structure(prefix, rule) if isinstance(rule, StructureRule) else _tree(prefix, rule)
        label_words = first_label_words(rule, table.first.rule)
        arrays += [
            Array(
                f"{prefix}gradient",
                (label_words & 0xFFFFFFFF).astype(np.uint32),
                "scale of the gradients and orientation (class of the first layer)",
            ),
            Array(
                f"{prefix}first_class",
                (label_words >> 32).astype(np.uint32),
                "first class in this layer (class of the first layer)",
            ),
            *more,
        ]
        structs.append(struct)
        entries.append(_entry(layer, prefix, last))
    return arrays, [*structs, "", "const L3PlaneLayer l3_layers[L3_LAYERS - 1] = {", *entries, "};"]


def _entry(layer: PlaneLayer, prefix: str, last: bool) -> str:
    structured = isinstance(layer.rule, StructureRule)
    fields: dict[str, int | str] = {
        "side": layer.side,
        "taps": filled(3 * layer.side**2),
        "gradient": f"{prefix}gradient",
        "first_class": f"{prefix}first_class",
        "structure" if structured else "tree": f"&{prefix}rule",
    }
    if not last:
        fields |= {
            "fixed_weights": f"{prefix}weights",
            "fixed_intercept": f"{prefix}intercept",
            "fraction": f"{prefix}fraction",
        }
    return "    {" + ", ".join(f".{name} = {value}" for name, value in fields.items()) + "},"


def _structure(prefix: str, rule: StructureRule) -> tuple[list[Array], str]:
    values = f"{rule.strengths}, {rule.coherence}, {prefix}edges"
    arrays = [Array(f"{prefix}edges", _some(rule.strength_edges), "strength edges (edge)")]
    return arrays, f"static const L3Structure {prefix}rule = {{{values}}};"


def _tree(prefix: str, rule: TreeRule) -> tuple[list[Array], str]:
    """Return the arrays and the struct of a decision tree, with one array per quantity in opencl/cpu/trees.cl."""
    parts = int(rule_macros(rule)["PARTS"])
    (words,) = rule_constants(rule, "processor")
    groups = -(-parts // 32) + parts
    start, first, tests = np.split(words, [groups + 1, groups + 1 + parts])
    tests = tests.reshape(-1, 3)
    arrays = [
        Array(f"{prefix}start", (start - start[0]) // 3, "first test of each group, and number of tests (group + 1)"),
        Array(f"{prefix}first_leaf", first, "first leaf of a part of the tree (part)"),
        Array(f"{prefix}threshold", tests[:, 0].copy().view(np.float32), "(test)"),
        Array(f"{prefix}numerator", tests[:, 1].astype(np.uint8), "index of the numerator (test)"),
        Array(f"{prefix}denominator", (tests[:, 1] >> 8).astype(np.uint8), "index of the denominator (test)"),
        Array(f"{prefix}ruled_out", tests[:, 2], "leaves or parts that a passed test excludes, as bits (test)"),
    ]
    values = ", ".join([str(parts), *(array.name for array in arrays)])
    return arrays, f"static const L3Tree {prefix}rule = {{{values}}};"


def _fixed(prefix: str, whole: layout.WholeWeights) -> list[Array]:
    taps = _fill(whole.taps)
    return [
        Array(f"{prefix}weights", taps, "(class, plane, tap)", packed=True),
        Array(f"{prefix}intercept", whole.intercept, "(class, plane)", packed=True),
        Array(f"{prefix}fraction", whole.fraction.astype(np.uint8), "binary point (class)"),
    ]


def _fill(taps: NDArray) -> NDArray:
    return np.pad(taps, ((0, 0), (0, 0), (0, filled(taps.shape[-1]) - taps.shape[-1])))


def _some(edges: NDArray) -> NDArray:
    """Return `edges`, or one unused edge if there are none, because C has no empty arrays."""
    return edges if edges.size else np.zeros((1, *edges.shape[1:]), edges.dtype)


def _strings(values: NDArray) -> Iterator[str]:
    """Yield an array's little-endian bytes as C string literals of at most PER_STRING bytes."""
    data = np.ascontiguousarray(values, values.dtype.newbyteorder("<")).tobytes()
    for start in range(0, len(data), PER_STRING):
        yield f'"{"".join(map(CHARACTERS.__getitem__, data[start : start + PER_STRING]))}",'


def _rows(values: NDArray) -> Iterator[str]:
    """Yield C lines with the numbers of an array, without the outermost braces."""
    if values.ndim > 1:
        for each in values:
            rows = list(_rows(each))
            rows[0] = "{" + rows[0]
            rows[-1] = rows[-1].rstrip(",") + "},"
            yield from rows
        return
    if values.dtype.kind == "f":  # nine significant digits reproduce a float32 exactly
        numbers = [f"{value:.8e}f" if value else "0.0f" for value in values.astype(np.float32).tolist()]
    else:
        numbers = [f"{value}{'u' if values.dtype == np.uint32 else ''}" for value in values.tolist()]
    for start in range(0, len(numbers), PER_LINE):
        yield ", ".join(numbers[start : start + PER_LINE]) + ","
