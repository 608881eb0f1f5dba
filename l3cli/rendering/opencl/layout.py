"""Convert a table to source texts, macros and arrays for the kernels (opencl/**/*.cl)."""

import functools
import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.class_rule import ClassRule
from l3cli.artifacts.layers import PLANE_STEP, PLANE_TOP, PLANES, MosaicLayer, PlaneLayer
from l3cli.artifacts.table import TransformTable
from l3cli.classes import clipping, plane_kernel
from l3cli.classes.coarse_chroma import SPACINGS
from l3cli.classes.planes import COARSE, COARSE_TOP, LUMINANCE, FixedPoint, planes_basis, raw_middle, refined_fixed_point
from l3cli.classes.refinement import RATIO_DARKEST, first_label_words
from l3cli.classes.windows import Integers, neighbourhoods
from l3cli.physics.display import TONE_LIMIT
from l3cli.physics.gamut import CONE_SHARE, LEAST_CONE, LEAST_LIGHTNESS, LIGHTNESS, MIN_DIVISOR, gamut_of
from l3cli.physics.spaces import Curve, Space
from l3cli.rendering.conditions import NoiseSets
from l3cli.rendering.display import Display
from l3cli.rendering.reference import raising_constants, white_scale

EXTRA_CFA_COLUMNS = 31  # repeated columns per CFA row, so that two vectors of 16 can be loaded at any phase
SIDE_BY_SIDE_OUTPUTS = (3, 4)  # numbers of floating-point outputs for which side_by_side.cl is used
SIDE_BY_SIDE_TAPS = 25  # maximum number of taps for which side_by_side.cl is used
FOLDERS = {"processor": "cpu", "graphics": "gpu"}  # variant → folder inside opencl/
SHARED = ("common/rule.cl", "common/encoding.cl")
TRANSFORM = ("common/ratios.cl", "cpu/folding.cl", "cpu/floating_point.cl", "cpu/side_by_side.cl", "cpu/transform.cl")


@functools.cache
def curve_macros(curve: Curve, steps: int, degree: int) -> dict[str, int | str]:
    """Approximate a transfer curve by a polynomial, and return the macros for encoding.cl.

    Above the linear part of the curve, the polynomial is a function of the fourth root of the linear value, fitted at
    Chebyshev nodes.

    Parameters
    ----------
    curve : Curve
        Transfer curve.
    steps : int
        Number of Newton steps with which the kernel computes the fourth root.
    degree : int
        Degree of the polynomial.
    """
    lowest = curve.knee**0.25
    root = lowest + (1 - lowest) * (np.cos(np.linspace(0, np.pi, 1001)) + 1) / 2
    terms = np.polynomial.polynomial.polyfit(root, curve.encoded(root**4), degree)
    return {
        "CURVE_KNEE": _literal(curve.knee),
        "CURVE_SLOPE": _literal(curve.slope),
        "CURVE_STEPS": steps,
        "CURVE_DEGREE": degree,
        "CURVE_TERMS": ",".join(_literal(term) for term in terms),
    }


@functools.cache
def curve_pieces(curve: Curve, top: int) -> dict[str, int | str]:
    """Approximate a transfer curve by 32 parabolas, and return the macros for encoding.cl.

    For a linear value x, the parabolas are functions of u = 2^-8 + CURVE_SHARE · x. There are four parabolas per octave of
    u, and the upper bits of u (as a float) select one of them. The result is the code from 0 to `top`, plus one half for
    rounding. The parabolas are fitted at Chebyshev nodes, with errors of up to 3e-5 of `top`.
    """
    start, share = 2.0**-8, 1 - 2.0**-8 - 2.0**-22
    octave, quarter = np.divmod(np.arange(32), 4)
    half = start * 2.0**octave / 8
    middle = start * 2.0**octave * (1 + quarter / 4) + half
    node = np.cos(np.linspace(0, np.pi, 101))
    codes = top * curve.encoded((middle + half * node[:, None] - start) / share) + 0.5
    c, b, a = np.polynomial.polynomial.polyfit(node, codes, 2) / half ** np.arange(3)[:, None]
    terms = np.array([c - b * middle + a * middle**2, b - 2 * a * middle, a])
    first = int(np.float32(start).view(np.int32)) >> 21 & 31
    numbered = np.roll(terms, first, axis=1).ravel()
    return {"CURVE_SHARE": _literal(share), "CURVE_PIECES": ",".join(_literal(term) for term in numbered)}


@functools.cache
def gamut_macros(space: Space) -> dict[str, int | str]:
    """Return the macros for gamut mapping into a colour space in encoding.cl."""
    gamut = gamut_of(space)
    arrays = {"CONES": gamut.cones, "LINEAR": gamut.linear, "LUMINANCE": gamut.luminance, "LIGHTNESS": LIGHTNESS}
    return {
        **{f"GAMUT_{name}": ",".join(_literal(value) for value in array.flat) for name, array in arrays.items()},
        "GAMUT_TINY": _literal(MIN_DIVISOR),
        "LEAST_CONE": _literal(LEAST_CONE),
        "CONE_SHARE": _literal(CONE_SHARE),
        "LEAST_LIGHTNESS": _literal(LEAST_LIGHTNESS),
    }


def _literal(value: float) -> str:
    """Format a number as a single-precision literal in OpenCL C."""
    return f"{value:.8e}f"


Macros = dict[str, int | str]


@dataclass(frozen=True)
class Cut:
    """Division of a band of rows into tiles, one per work-group."""

    tile: int  # columns per tile
    band: int  # rows per tile
    group: tuple[int, int]  # work-group size
    lanes: int  # pixels or taps that a work-item processes in parallel; 0: chosen by lanes.cl

    @property
    def macros(self) -> Macros:
        return {"TILE": self.tile, "BAND": self.band, **({"LANES": self.lanes} if self.lanes else {})}


def source_folder() -> Path:
    """Return the folder of the .cl files. It is inside an installed package, or next to the package in a repository."""
    package = Path(__file__).parents[2]
    inside = package / "opencl"
    return inside if inside.is_dir() else package.parent / "opencl"


def first_source(variant: str, rule: ClassRule) -> str:
    """Return the source of the first layer's kernels, including the code for its class features.

    Because of its #line directives, compiler messages refer to the original files and lines.
    """
    features = [
        joined_files("common/vectors.cl", *plane_kernel.snippets(rule)),
        f'#line 1 "joined features"\n{plane_kernel.joined(rule)}',
    ]
    return "\n".join([*features, joined_files(*VARIANTS[variant].sources)])


def refinement_source(variant: str, layer: PlaneLayer) -> str:
    """Return the source of a refinement layer's kernels, including the code for its class rule."""
    formula, kernels = plane_kernel.rule_snippets(layer.rule)
    chroma = ("common/coarse_chroma.cl", "common/quads.cl") if layer.coarse_chroma else ()
    shared = ("common/vectors.cl", "common/encoding.cl", "common/gradient.cl", formula, *chroma)
    return joined_files(*shared, *VARIANTS[variant].refinement_sources, kernels[variant])


def encoder_source(variant: str) -> str:
    """Return the source of the kernel that encodes outputs as pictures."""
    return joined_files("common/lanes.cl", "common/vectors.cl", "common/encoding.cl", *VARIANTS[variant].encoder_sources)


def encoding_source(variant: str, name: str, *shared: str) -> str:
    """Return the source of a kernel that processes outputs and then encodes them as a picture.

    The kernel consists of two files with the same `name`, in opencl/common/ and in the folder of the variant. The encoder
    and the files `shared` precede them.
    """
    encoding = [each for each in VARIANTS[variant].encoder_sources if not each.endswith("encode.cl")]
    return joined_files(
        "common/lanes.cl", "common/vectors.cl", "common/encoding.cl", *encoding, *shared, f"common/{name}",
        f"{FOLDERS[variant]}/{name}",
    )  # fmt: skip


def joined_files(*names: str) -> str:
    """Concatenate files from opencl/, with #line directives."""
    folder = source_folder()
    return "\n".join(f'#line 1 "{name}"\n{(folder / name).read_text(encoding="utf-8")}' for name in names)


def paired_source(variant: str, name: str, *shared: str) -> str:
    """Return the source of a kernel that consists of two files with the same `name`.

    One of them is in opencl/common/, the other in the folder of the variant. The files `shared` precede them.
    """
    return joined_files("common/vectors.cl", *shared, f"common/{name}", f"{FOLDERS[variant]}/{name}")


def table_macros(table: TransformTable, sets: int = 1) -> Macros:
    """Return the macros for a table's first layer, with the given number of transform sets."""
    rule = table.first.rule
    constants = sum(len(feature.constants) for feature in rule.feature_list)
    return {
        **({"SETS": sets, "SET_SITES": table.cfa.size, "FEATURE_CONSTANTS": constants} if sets > 1 else {}),
        "PATCH": rule.patch,
        "RADIUS": rule.radius,
        "SOURCES": 1,
        "CHANNELS": len(table.channels),
        "OUTPUTS": len(table.outputs),
        "CFA_ROWS": table.cfa.shape[0],
        "CFA_COLUMNS": table.cfa.shape[1],
        "PERIOD": table.cfa.shape[1] + EXTRA_CFA_COLUMNS,
        "SHIFT": rule.shift,
        "MAX_RAW": 2**table.bits - 1,
        "RAW_MIDDLE": raw_middle(table.bits),
        **({} if table.later else white_macros(table)),  # only the last layer limits its outputs
        **plane_kernel.kernel_macros(rule),
    }


def white_macros(table: TransformTable) -> Macros:
    """Return the macros for limiting outputs to the white that clips all channels, if the table contains this white."""
    return {} if table.clipped_white is None else {"WHITE_FROM": _literal(clipping.WHITE_FROM)}


def least_macros(table: TransformTable) -> Macros:
    """Return the macros for raising the luminance of pixels that are too dark.

    The result is empty if the table does not contain the channel signals of white.
    """
    if table.white_signals is None:
        return {}
    constants = raising_constants(table).items()
    return {
        **{name.upper(): _literal(value) if isinstance(value, float) else value for name, value in constants},
        "CFA_ROWS": table.cfa.shape[0],
        "CFA_COLUMNS": table.cfa.shape[1],
        "MAX_RAW": 2**table.bits - 1,
        "SCALE_PERIOD": table.cfa.shape[1] + EXTRA_CFA_COLUMNS,
    }


def site_scale(table: TransformTable) -> NDArray[np.float64]:
    """Return the factor from raw values to the luminance of white (`white_scale`) at each CFA site: (CFA row, column).

    `EXTRA_CFA_COLUMNS` further columns repeat the CFA, so that kernels can load whole vectors from any column.
    """
    columns = np.arange(table.cfa.shape[1] + EXTRA_CFA_COLUMNS) % table.cfa.shape[1]
    return np.asarray(white_scale(table)[table.cfa[:, columns]])


def display_constants(table: TransformTable, matrix: NDArray | None) -> NDArray[np.float64]:
    """Return the constants with which kernels encode pictures.

    Parameters
    ----------
    table : TransformTable
        Table that renders the outputs.
    matrix : ndarray, (3, 3), or None
        Matrix from X, Y, Z to the linear values of a picture, or None for unencoded outputs.

    Returns
    -------
    ndarray, (12,)
        The matrix, row by row, and the XYZ of the white that clips all channels, in output units. Constants that do not
        apply are zero.
    """
    white = table.clipped_white
    return np.concatenate([np.zeros(9) if matrix is None else matrix.ravel(), np.zeros(3) if white is None else white])


COARSE_MARGIN = max(SPACINGS)  # margin around a band, in blocks
UNLIKE_ANY = 1e12  # value of margin blocks, so large that no block in the frame is similar
COARSE_MACROS: Macros = {"MARGIN": COARSE_MARGIN}


def clipping_macros(table: TransformTable) -> Macros:
    """Return the macros for correcting clipped areas."""
    rows, columns = clipping.block_sides(table.cfa)
    steps = {
        "BEGINS": clipping.BEGINS,
        "CORRECTED_FROM": clipping.CORRECTED_FROM,
        "CLIPS": clipping.CLIPS,
        "KEPT_UP_TO": clipping.KEPT,
        "REPLACED_FROM": clipping.REPLACED,
        "PLAIN_UP_TO": clipping.PLAIN,
        "TEXTURED_FROM": clipping.TEXTURED,
        "FAINTEST": clipping.MIN_WEIGHT,
        "MAX_DIFFERENCE": clipping.MAX_DIFFERENCE,
        "MIN_SIGNAL": clipping.MIN_SIGNAL,
        "HUE_DOUBT": clipping.HUE_DOUBT,
        "GREY_DOUBT": clipping.GREY_DOUBT,
        "MAX_HUE": clipping.MAX_HUE,
        "MAX_CHANGE": clipping.MAX_CHANGE,
        "WHITE_DOUBT": clipping.WHITE_DOUBT,
    }
    return {
        "CHANNELS": len(table.channels),
        "CFA_ROWS": table.cfa.shape[0],
        "CFA_COLUMNS": table.cfa.shape[1],
        "MAPS": clipping.MAPS,
        "HUE_STEPS": clipping.HUE_STEPS,
        "HUE_WEIGHTS": (clipping.HUE_STEPS + 1) ** 4,
        "HUE_ROWS": clipping.hue_spacing(rows),
        "HUE_COLUMNS": clipping.hue_spacing(columns),
        "BLOCK_ROWS": rows,
        "BLOCK_COLUMNS": columns,
        "MAX_RAW": 2**table.bits - 1,
        **{name: _literal(value) for name, value in steps.items()},
    }


# Macros for the transforms of all layers except the last. They compute planes for the next layer.
TO_PLANES: Macros = {
    "OUTPUTS": PLANES,
    "FIXED_POINT": 1,
    "PLANE_TOP": PLANE_TOP,
    "COARSE": COARSE,
    "COARSE_TOP": COARSE_TOP,
    "CODE": "int",
}


def _coarse_macros(table: TransformTable) -> Macros:
    """Return the macros for adding coarse chroma in the last layer."""
    first, second = table.chroma_outputs
    step = _literal(PLANE_STEP)
    return {"COARSE_CHROMA": 1, "PLANE_STEP": step, "CHROMA_1": first, "CHROMA_2": second, **COARSE_MACROS}


def refinement_macros(table: TransformTable, layer: PlaneLayer) -> Macros:
    """Return the macros for one of a table's refinement layers."""
    return {
        "PATCH": layer.side,
        "RADIUS": layer.radius,
        "SOURCES": PLANES,
        "LUMINANCE": LUMINANCE,
        "OUTPUTS": len(table.outputs),
        "CFA_COLUMNS": table.cfa.shape[1],
        "MAX_RAW": 0,
        **({"RATIO_TAPS": layer.ratio_taps, "DARKEST": RATIO_DARKEST} if layer.ratio_taps else {}),
        **(_coarse_macros(table) if layer.coarse_chroma else {}),
        **({"CLIPPING": 1, "MAPS": clipping.MAPS} if layer.clipping else {}),
        **({"CORRECTS": 1} if table.components else {}),
        **white_macros(table),
        **plane_kernel.rule_macros(layer.rule),
    }


OUTPUTS_AS_THEY_ARE: Macros = {"PLANES": 1, "CODE": "float"}  # write outputs without encoding
NOT_ENCODED: Macros = {"NOT_ENCODED": 1, "CODE": "float"}  # write one number per pixel, to time the transforms alone


def display_macros(display: Display) -> Macros:
    """Return the macros for encoding pictures with given display settings."""
    macros: Macros = {"CODE": {8: "uchar", 16: "ushort"}[display.bits], "TOP": display.top, **gamut_macros(display.space)}
    if display.tone is not None:
        terms = {**vars(display.tone), "limit": TONE_LIMIT}
        macros = macros | {f"TONE_{name.upper()}": _literal(value) for name, value in terms.items()}
    # For 8 bits, the approximation error is up to 8e-5, which changes one code in 200 by 1. For 16 bits, it is up to 1.2e-6,
    # as small as the rounding error of float32.
    if display.bits == 8:
        return macros | curve_macros(display.curve, 2, 5) | curve_pieces(display.curve, display.top)
    return macros | curve_macros(display.curve, 3, 8)


def class_arrays(table: TransformTable, *others: TransformTable) -> tuple[NDArray, ...]:
    """Return the constant arguments of the kernel `classes`.

    If the kernel chooses between several sets of transforms, `others` are the tables with the sets for lower noise.
    """
    rule, channels = table.first.rule, len(table.channels)
    neighbours = neighbourhoods(table.cfa, rule.patch, channels)
    period = np.arange(table.cfa.shape[1] + EXTRA_CFA_COLUMNS) % table.cfa.shape[1]
    cfa = table.cfa[:, period].astype(np.uint16)
    member = np.where(cfa == np.arange(channels, dtype=np.uint16)[:, None, None], np.uint16(0xFFFF), np.uint16(0))

    def by_channel(site_values: Integers) -> NDArray[np.uint32]:
        return site_values.reshape(*table.cfa.shape, channels).transpose(2, 0, 1)[:, :, period].astype(np.uint32)

    return (
        member,
        np.uint16(1) << cfa,
        by_channel(neighbours.count),
        by_channel(neighbours.mean_reciprocal),
        by_channel(neighbours.variance_reciprocal),
        period.astype(np.uint32),
        *plane_kernel.kernel_arrays(rule, *(other.first.rule for other in others)),
    )


@dataclass(frozen=True)
class Weights:
    """A layer's transforms in floating point, with the taps in the order of the kernels."""

    taps: NDArray[Any]  # (class, output, tap); window taps are sorted by column, then row, then plane
    intercept: NDArray[Any]  # (class, output)
    ratio_taps: int = 0  # number of ratio taps, which follow the window taps


@dataclass(frozen=True)
class WholeWeights:
    """A layer's transforms in fixed point, which compute three planes."""

    taps: NDArray[np.int16]  # (class, plane, tap); taps are sorted as in `Weights`
    intercept: NDArray[np.int32]  # (class, plane)
    fraction: NDArray[np.int32]  # (class) number of fractional bits


def first_weights(table: TransformTable, first: MosaicLayer) -> Weights:
    """Return the weights with which the first layer computes outputs from raw values in DN above black."""
    taps = by_column(first.weights, 1) / (table.white_level - table.black_level)
    return Weights(taps.astype(np.float32), first.intercept)


def first_plane_weights(fixed: FixedPoint, bits: int) -> WholeWeights:
    """Return the fixed-point weights with which the first layer computes planes from raw values minus `raw_middle`."""
    intercept = fixed.intercept + raw_middle(bits) * fixed.weights.sum(axis=-1, dtype=np.int64)
    return WholeWeights(by_column(fixed.weights, 1), intercept.astype(np.int32), fixed.fraction)


def refinement_plane_weights(fixed: FixedPoint) -> WholeWeights:
    """Return the fixed-point weights with which a refinement layer computes the planes for the next layer."""
    return WholeWeights(by_column(fixed.weights, PLANES), fixed.intercept.astype(np.int32), fixed.fraction)


def refinement_weights(layer: PlaneLayer) -> Weights:
    """Return the weights with which a refinement layer computes outputs from planes in steps of `PLANE_STEP`."""
    windows = by_column(layer.weights[..., : layer.window_taps], PLANES)
    taps = np.concatenate([windows, layer.weights[..., layer.window_taps :]], axis=-1)
    return Weights((taps * PLANE_STEP).astype(np.float32), layer.intercept, layer.ratio_taps)


@dataclass(frozen=True)
class PlaneStep:
    """Constant buffers for computing a refinement layer's input planes and class map."""

    weights: Any  # weights of the previous layer, which computes the planes
    rule: tuple[Any, ...]  # constants of the kernel `structures` (gradient.cl, structure.cl, tree.cl)
    nothing: Any  # buffer of zeros in place of the display constants, which are not needed for planes


def table_buffers(
    sets: NoiseSets, variant: str, lanes: int, constant: Callable[..., Any]
) -> tuple[list[Any], Any, list[PlaneStep]]:
    """Copy a table's class rules and transforms to the device.

    Parameters
    ----------
    sets : NoiseSets
        All sets of transforms of the table.
    variant : str
        A key of VARIANTS.
    lanes : int
        Vector length.
    constant : callable
        Copies an array to a device buffer.

    Returns
    -------
    classes : list
        Buffers with the class rule of the first layer.
    weights : buffer
        Weights of the last layer, in the format of the variant.
    steps : list of PlaneStep
        Buffers of each refinement layer.
    """
    table, later, steps = sets.tables[0], sets.later, []
    for number in range(len(later)):
        if number:
            whole = refinement_plane_weights(refined_fixed_point(later[number - 1], planes_basis(table)))
        else:
            whole = first_plane_weights(sets.first_fixed_point, table.bits)
        rule, *others = sets.refinement_rules(number)
        constants = first_label_words(rule, table.first.rule, *others), *plane_kernel.rule_constants(rule, variant)
        before = constant(VARIANTS[variant].pack_whole(whole, lanes))
        steps.append(PlaneStep(before, tuple(map(constant, constants)), constant(np.zeros(9, np.float32))))
    last = refinement_weights(later[-1]) if later else first_weights(table, sets.first)
    return [*map(constant, class_arrays(*sets.tables))], constant(VARIANTS[variant].pack(last, lanes)), steps


def by_column(weights: NDArray, planes: int) -> NDArray:
    """Reorder the taps of weights (class, output, tap) from plane, row, column to column, row, plane."""
    classes, outputs, taps = weights.shape
    side = math.isqrt(taps // planes)
    square = weights.reshape(classes, outputs, planes, side, side)
    return square.transpose(0, 1, 4, 3, 2).reshape(classes, outputs, taps)


def pack_in_vectors(layer: Weights, lanes: int) -> NDArray:
    """Pack floating-point weights for the CPU kernels.

    Layers with few outputs and taps are packed by `_side_by_side`, for side_by_side.cl. All other layers are packed for
    floating_point.cl, as an array (class, group, number). A group contains the weights of up to four outputs:

    1. all window taps except the last one, as vectors (vector, output, lane),
    2. the last window tap of each output,
    3. the intercept of each output,
    4. the ratio taps (tap, output),
    5. zeros that pad the group to a multiple of 16 numbers.
    """
    classes, outputs, taps = layer.taps.shape
    taps, ratios = taps - layer.ratio_taps, layer.ratio_taps
    if outputs in SIDE_BY_SIDE_OUTPUTS and taps <= SIDE_BY_SIDE_TAPS and not ratios:
        return _side_by_side(layer.taps, layer.intercept, 4)
    groups = -(-outputs // 4)
    group = -(-outputs // groups)
    vectors = -(-(taps - 1) // lanes)
    last = vectors * group * lanes
    packed = np.zeros((classes, groups, -(-(last + 8 + 4 * ratios) // 16) * 16), layer.taps.dtype)
    for g in range(groups):
        chosen = slice(g * group, min((g + 1) * group, outputs))
        count = chosen.stop - chosen.start
        in_lanes = np.zeros((classes, group, vectors * lanes), layer.taps.dtype)
        in_lanes[:, :count, : taps - 1] = layer.taps[:, chosen, : taps - 1]
        ordered = in_lanes.reshape(classes, group, vectors, lanes).transpose(0, 2, 1, 3)
        packed[:, g, :last] = ordered.reshape(classes, last)
        packed[:, g, last : last + count] = layer.taps[:, chosen, taps - 1]
        packed[:, g, last + 4 : last + 4 + count] = layer.intercept[:, chosen]
        for tap in range(ratios):
            start = last + 8 + 4 * tap
            packed[:, g, start : start + count] = layer.taps[:, chosen, taps + tap]
    return packed


def pack_whole_in_vectors(layer: WholeWeights, lanes: int) -> NDArray[np.int16]:
    """Pack fixed-point weights for side_by_side.cl. The number of fractional bits is the intercept of a fourth output."""
    intercept = np.column_stack([layer.intercept, layer.fraction])
    return _side_by_side(layer.taps, intercept, 8)


def _side_by_side(taps: NDArray, intercept: NDArray, once: int) -> NDArray:
    """Pack the weights of each class for side_by_side.cl.

    Each class begins with a header of sixteen 32-bit numbers, which contains the intercepts of the four outputs at a stride
    of 4. The taps follow in blocks (output, tap) of four outputs and `once` taps. Missing outputs and taps are zero.
    """
    classes, outputs, count = taps.shape
    first = np.zeros((classes, 4, 4), intercept.dtype)
    first[:, : intercept.shape[1], 0] = intercept
    filled = np.zeros((classes, 4, -(-count // once) * once), taps.dtype)
    filled[:, :outputs, :count] = taps
    interleaved = filled.reshape(classes, 4, -1, once).transpose(0, 2, 1, 3)
    return np.concatenate([first.reshape(classes, 16).view(taps.dtype), interleaved.reshape(classes, -1)], axis=1)


def pack_in_fours(layer: Weights, lanes: int) -> NDArray:
    """Pack floating-point weights for gpu/frame.cl, as an array (class, 1 + tap, output).

    The intercept precedes the taps, and the outputs are padded with zeros to a multiple of four.
    """
    classes, outputs, taps = layer.taps.shape
    packed = np.zeros((classes, 1 + taps, -(-outputs // 4) * 4), layer.taps.dtype)
    packed[:, 0, :outputs] = layer.intercept
    packed[:, 1:, :outputs] = layer.taps.transpose(0, 2, 1)
    return packed


def pack_whole_in_fours(layer: WholeWeights, lanes: int) -> NDArray[np.int32]:
    """Pack fixed-point weights for gpu/frame.cl, as an array (class, 1 + tap, 4).

    The three intercepts and the number of fractional bits precede the taps.
    """
    classes, planes, taps = layer.taps.shape
    packed = np.zeros((classes, 1 + taps, 4), np.int32)
    packed[:, 0] = np.column_stack([layer.intercept, layer.fraction])
    packed[:, 1:, :planes] = layer.taps.transpose(0, 2, 1)
    return packed


def _cut_for_graphics(table: TransformTable, lanes: int) -> Cut:
    tile = 64 // table.cfa.shape[1] * table.cfa.shape[1]
    return Cut(tile, 4, (tile, 4), 1)


@dataclass(frozen=True)
class Variant:
    """Source files, division of the work, and format of the weights for one type of device."""

    sources: tuple[str, ...]  # files in opencl/ for the first layer, after the files for the class features
    refinement_sources: tuple[str, ...]  # files for a refinement layer
    encoder_sources: tuple[str, ...]  # files for encoding outputs as pictures
    encoder_cut: Cut  # tiles of the encoder
    chroma_cut: Cut  # tiles of chroma smoothing
    joins: bool  # whether one kernel can compute both classes and transforms of the first layer
    cut: Callable[[TransformTable, int], Cut]  # table, vector length → tiles of all other kernels
    pack: Callable[[Weights, int], NDArray]  # floating-point weights, vector length → array for the kernels
    pack_whole: Callable[[WholeWeights, int], NDArray]  # fixed-point weights, vector length → array for the kernels


VARIANTS = {
    # Each work-item renders many pixels. Vectors contain pixels for the classes, and taps for the transforms.
    "processor": Variant(
        (*SHARED, "cpu/ingest.cl", "cpu/statistics.cl", "cpu/classes.cl", "cpu/rows.cl", *TRANSFORM, "cpu/joined.cl"),
        ("cpu/ingest.cl", "cpu/rows.cl", *TRANSFORM, "cpu/plane_rows.cl"),
        ("cpu/rows.cl", "cpu/encode.cl"),
        Cut(256, 48, (1, 1), 0),
        Cut(128, 96, (1, 1), 0),
        True,
        lambda table, lanes: Cut(256, 48, (1, 1), lanes),
        pack_in_vectors,
        pack_whole_in_vectors,
    ),
    # Each work-item renders one pixel.
    "graphics": Variant(
        (*SHARED, "gpu/frame.cl"),
        ("gpu/frame.cl",),
        ("gpu/encode.cl",),
        Cut(64, 4, (64, 4), 1),
        Cut(64, 4, (64, 4), 1),
        False,
        _cut_for_graphics,
        pack_in_fours,
        pack_whole_in_fours,
    ),
}
