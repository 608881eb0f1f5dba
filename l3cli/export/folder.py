"""Export a table as a folder with one little-endian file per array, and table.json, which describes the arrays."""

import json
from typing import Any

import numpy as np
from numpy.typing import NDArray

from l3cli import __version__
from l3cli.artifacts.layers import PLANE_STEP, PLANE_TOP, rule_fields
from l3cli.artifacts.plane_rules import GRADIENT
from l3cli.artifacts.schema import Spec, declared, is_stored
from l3cli.artifacts.table import TransformTable
from l3cli.classes import chroma, clipping
from l3cli.classes.coarse_chroma import ALIKE
from l3cli.classes.planes import COARSE, COARSE_TOP, FixedPoint, fixed_point, planes_basis, refined_fixed_point
from l3cli.classes.refinement import RATIO_DARKEST
from l3cli.classes.structure import NOISE_TRACE
from l3cli.classes.tree import CHROMA_TOP, DARK, EVERY, TOP, turned_tests
from l3cli.classes.windows import neighbourhoods
from l3cli.export.wordlengths import ENOUGH_PSNR_DB, SEED, SHAPE, Cost, Words, chosen_words, make_vector, word_costs
from l3cli.rendering.conditions import noise_limits
from l3cli.rendering.display import require_known_layers
from l3cli.rendering.reference import (
    CHROMA_NEIGHBOURS,
    FAR_CHROMA_NEIGHBOURS,
    FAR_LIKENESS,
    MAX_CONTRAST,
    SMOOTHING_DARKEST,
    least_black_level,
    raising_constants,
    white_scale,
)
from l3cli.system.text import printable

FORMAT, VERSION = "l3 table as arrays", 2
TABLE_FIELDS = ("bits", "black_level", "white_level", "outputs", "output_unit", "white_point", "channels", "cfa")
LEFT_OUT = ("samples", "condition")  # fields of layers that only document the training

FORMULAS = {
    "class": "(((site * levels + level) * contrasts + contrast) * combinations + combination) * kinds + kind",
    "site": "CFA row * CFA columns + CFA column",
    "statistics": "v = DN >> shift for every pixel of the patch around a pixel. n, S and Q of a channel are the number, the "
    "sum and the sum of squares of the values v of the channel",
    "level": "number of level_edges that are <= sum over channels of (S * mean_reciprocal >> 8)",
    "contrast": "M = S * mean_reciprocal >> 16; V = min((Q - M * (2 S - n M)) * variance_reciprocal, "
    "(2^32 - 1) // channels); contrast = number of contrast_edges of the level that are < sum over channels of V",
    "saturation": "case = case_of_code[code]. Bit c of code is set if a pixel of channel c within saturation_radius is >= "
    "saturation",
    "chroma": "a = clamp((S * mean_reciprocal >> 12) - chroma_black_level, 0, 65535) for each channel; score of k = sum "
    "over channels of a * chroma_weights[k]. The chroma is the first k with the lowest score. If chroma_dither is set, "
    "the k2 with the second lowest score replaces k if (score of k2) - (score of k) < ((sum of a >> 8) * chroma_widths[k] "
    ">> 8) * t. At site s, t = 2 * ((159 s + 79) & 255) - 255 if k < k2, and the negative of this if k > k2",
    "kind": "chroma if the case is 0, otherwise chromas - 1 + case",
    "borders": "outside the mosaic, the sample with the same CFA phase that is nearest to the mirror image. Planes are "
    "mirrored about the outermost pixels",
}
CONDITIONS_DOC = (
    "additional sets of transforms. A set with noise was trained for an analog gain, relative to the gain of the camera "
    "model, or for frames in which a temporal filter left the fraction noise_left of the noise variance. It applies to "
    "pixels with at most the fraction limit. A set with light was trained under this illuminant. The names of the arrays "
    "of a set begin with conditions/NUMBER/. If such an array is missing, the array without this prefix applies. Formulas "
    "and constants are the same for all sets. test_labels and test_outputs are computed with this set alone"
)
ONE_LAYER = {"output": "sum of weights * (DN - black_level) / (white_level - black_level) + intercept"}
CLIPPED_WHITE = {
    "clipped white": "if there is a clipped_white, the last step limits the luminance of the outputs to its Y, white_Y. If "
    "Y > white_Y, (X, Y, Z) <- (1 - f) * white_Y / Y * (X, Y, Z) + f * clipped_white, where "
    "f = min((Y / white_Y - 1) / (white_from - 1), 1)"
}
LAYERS = {
    "plane": "clamp((sum of fixed_weights * value + fixed_intercept + 2^(F - 1)) >> F, -plane_top, plane_top), where "
    "F = fraction[class]. value is the DN in the first layer, and clamp((plane + 2^(coarse - 1)) >> coarse, -coarse_top, "
    "coarse_top) in later layers",
    "output": "sum of weights of the last layer * plane * plane_step + intercept. The taps are stored plane by plane, and "
    "each plane row by row. If the layer has more taps, the next two are the colour ratios and the last two the bilateral "
    "chroma. If the table has components, the outputs of the first layer are added: sum of weights of the first layer * "
    "(DN - black_level) / (white_level - black_level) + intercept",
    "colour ratios": "for the first and the third plane: mean * clamp((Y - mean Y) / max(mean Y, ratio_darkest), -1, 1). "
    "The means are over the window",
    "bilateral chroma": "for the first and the third plane: sum of w * (difference from the pixel itself) / sum of w. The "
    "sums are over the window. w = max(0, mean of d + ratio_darkest^2 - d)^2, where d is the sum of the squared "
    "differences from the pixel itself in all planes",
    "coarse chroma": "if a layer has it, plane_step * d of the first and of the third plane is added to the outputs "
    "of these planes, which are the first and the third output, or S1 and S2 for the outputs X, Y, Z, S1 and S2. Blocks are "
    "means of 4 x 4 pixels of the planes, with the outermost pixels repeated. In each step, a block becomes the weighted "
    "mean of 3 x 3 blocks within the frame, with a spacing of 1, 2, 4 and 8 "
    "blocks. The weights are 1 2 1 in both directions, times max(0, 1 - sum over planes of difference^2 / (8 * 4 alike^2 "
    "v))^8. alike is the value of the step, and v is the sum of variance * max(Y, 0)^power at the Y of the middle block. "
    "d is the difference between the blocks after the last and before the first step, interpolated bilinearly from the "
    "four blocks nearest to the pixel. Outside the frame, the difference is 0",
    "clipping": "if a layer has it, the last step is output = (1 - w) * output + q. w and q are computed for blocks of "
    "clip_sides pixels. The last blocks are moved into the frame. w and q are interpolated bilinearly, at the middle of "
    "the group of 2 x 2 pixels that contains the pixel. w = f * S(max s; kept); q = w * (sum of response[0] * (s - h + g "
    "* white) + A(s) - A(h)); A(s) = sum over channels c of S(s[c]; corrected) * response[1 + c] * s; h = min(g * white, "
    "1); g = m + min S(s; begins) * (max (s / white) - m); m = mean of s / white, weighted by max(1 - S(s; begins), "
    "faintest); f = 1 - S(d; plain); S(x; a, b) = t^2 (3 - 2 t), t = (x - a) / (b - a) clamped to 0 and 1. s contains the "
    "means of the channels as fractions of full scale, at most 1, averaged over 3 x 3 blocks with the weights 1 2 1 in "
    "both directions, followed by a 1. d is the maximum, over the 3 x 3 blocks and the channels, of the range in a block "
    "and of the difference between the means of a block and of the middle block. The means of a block are 0 if no value "
    "reaches the fraction begins[0] of full scale, or if the block lacks a channel",
    "hue of clipped areas": 'after "clipping", X = (1 - c) * X + x * Y and Z = (1 - c) * Z + z * Y. c, x and z are '
    "computed for the same blocks as w and q and are interpolated in the same way. s contains the channel means of a "
    "block, not averaged over 3 x 3 blocks, and k = S(s; kept). Each block with max k > 0 and min k < 1 is compared with "
    "5 x 5 blocks around it, as far as they are inside the frame. The rows and columns of these blocks are hue_spacing "
    "blocks apart. A compared block has the means o, t = o / max(s, hue_darkest), r = sum of (1 - k) * t / (sum of (1 - k) "
    "* t^2 + faintest), e = 1 - r * t, the similarity l = max(0, 1 - sum of ((1 - k) * e^2 + k * max(e, 0)^2) / "
    "hue_difference) and the weight v = l^2 * (1 - max S(o; kept))^2 * b / 81, where b is the product of 1 2 3 2 1 in both "
    "directions. L is the sum of v, and l_0 is the similarity for o = white. The block gets the estimated signals E = M(sum "
    "of v * r * o / L), or s if L is 0, and the reliability p = (1 - min k) * max((1 - max k)^2, L / (L + hue_doubt[0] + "
    "hue_doubt[1] * l_0^2)). M(d) = (1 - k) * s + k * max(s, max(0, a - b * w) * d + b * white). <...> is the sum with the "
    "weights 1 - k, and d' and n' are d and white divided by max(s, hue_darkest). a = <d'> / (faintest + <d'^2>), w = <d' "
    "n'> / (faintest + <d'^2>) and b = max(0, <(n' - w d') * (1 - a d')>) / (hue_white_doubt + <(n' - w d')^2>). Then the "
    "estimates spread in as many passes as spread_spacing has pairs. In each pass, a block is compared with the eight "
    "blocks at a distance of the first number of the pair in rows, or of the second in columns of blocks. A compared "
    "block without a clipped channel has E = o and p = 1, and one that is too dark or in which all channels clip has "
    "p = 0. q = f * (1 - min k) * p * max(0, l - u / spread_change) with p, r and l of the compared E. f is the "
    'product of the f of "clipping" of both blocks and of the block halfway (half of the distance, rounded down), and '
    "u = sum of (1 - k) * (1 - o / max(s, hue_darkest))^2 / (faintest + sum of (1 - k)). The new E is M of the mean "
    "of the own E with the weight p and of r * E with the weights q / 2, or q / 4 on diagonals. The new p is the "
    "maximum of p and q. After the last pass, c = p * max k, x = c * X / Y and z = c * Z / Y, where X, Y, Z = sum of "
    "E * response[0], and both ratios are limited to 0 ... hue_most",
    "later class": "(site * levels + level // level_step) * kinds + kind, with the level and the case of the first layer. "
    "kind is the structure or the leaf if case <= spared_cases, otherwise structures - 1 + case - spared_cases. A layer "
    "with a tree has levels = 1",
}


SPECTRA_DOC = (
    "last step, which is also applied to test_outputs. Y is the mean of the outputs, p is a pixel, and q are the pixels "
    "of the window around p, mirrored at the borders. output_p <- mean of output_q * Y_p / mean of Y_q if Y_p > "
    "smoothing_darkest. The means are weighted by w = max(0, 1 - ((Y_q - Y_p) / (reach * Y_p))^2)^2"
)

CHROMA_DOC = (
    "last step, which is also applied to test_outputs. p is a pixel, and q are its neighbours at the offsets `neighbours` "
    "and `far_neighbours` (row, column), mirrored at the borders. With e_q = X_q Y_p - X_p Y_q, f_q the same for Z, t_p = "
    "Y_p + min(mean of |Y_q - Y_p| over `neighbours`, max_contrast * Y_p), and r_q = reach * t_p if Y_q > Y_p, otherwise "
    "min(reach * t_p, Y_p), the weights are "
    "w_q = max(0, 1 - ((Y_q - Y_p) / r_q)^2 - ((e_q / X_w)^2 + (f_q / Z_w)^2) / (l_q * Y_p * t_p)^2)^2, "
    "where l_q = likeness for neighbours, l_q = far_likeness * likeness for far neighbours, and X_w and Z_w are those of "
    "white_point with Y_w = 1. X_p <- X_p + sum(w_q e_q) / (Y_p + sum(w_q Y_q)) if "
    "Y_p > smoothing_darkest, and Z_p the same with f_q. Y does not change"
)

LEAST_DOC = (
    "after the smoothing of chroma, pixels that are darker than the raw values around them are raised. m_p is the smallest "
    "value of (DN - least_black_level) * white_scale[channel] in the window with the radius least_reach around p, without "
    "pixels outside the frame. L_p = least_of_positive * m_p if m_p > 0, otherwise least_of_negative * m_p. If Y_p < L_p: "
    "X_p <- X_p + clamp(L_p / max(sum of Y_q, L_p, smoothing_darkest) * (sum of X_q) - X_p, -c, c), and Z_p the same, with "
    "c = raised_chroma * (L_p - Y_p), where q are the four diagonal neighbours before smoothing. Then Y_p <- L_p"
)


def folder_files(table: TransformTable) -> dict[str, bytes]:
    """Convert a table to table.json and array files. Return each file's content by name.

    Raises RecipeError if the table has too many layers.
    """
    require_known_layers(table)
    arrays = _Arrays()
    content: dict[str, Any] = {
        "format": FORMAT,
        "version": VERSION,
        "made_by": f"l3cli {__version__}",
        "camera": printable(table.camera_name),
        "table": arrays.add_fields("", table, TABLE_FIELDS),
        **_set(arrays, table),
        "formulas": FORMULAS | CLIPPED_WHITE | (LAYERS if table.later else ONE_LAYER),
        "constants": _constants(table) | _clipped_white(table),
    }
    if table.spectra:
        content["spectra"] = {"doc": SPECTRA_DOC, **arrays.add_fields("spectra/", table.spectra)}
        content["constants"]["smoothing_darkest"] = SMOOTHING_DARKEST
    if table.chroma_smoothing:
        content["constants"]["max_contrast"] = MAX_CONTRAST
        keys = arrays.add_fields("chroma_smoothing/", table.chroma_smoothing)
        content["chroma_smoothing"] = {
            "doc": CHROMA_DOC,
            **keys,
            "neighbours": CHROMA_NEIGHBOURS,
            "far_neighbours": FAR_CHROMA_NEIGHBOURS,
            "far_likeness": FAR_LIKENESS,
        }
        content["constants"]["smoothing_darkest"] = SMOOTHING_DARKEST
        if table.white_signals is not None:
            content["least_luminance"] = {
                "doc": LEAST_DOC,
                "least_black_level": least_black_level(table),
                **raising_constants(table),
                **_white_scale(table),
            }
    if table.components:
        doc = "conversion from outputs to the planes of the refinement layer. fixed_weights of the first layer include it"
        content["components"] = {"doc": doc, **arrays.add_fields("components/", table.components)}
    if table.conditions:
        content["conditions"] = {"doc": CONDITIONS_DOC, "sets": []}
    for number, condition in enumerate(table.conditions):
        arrays.prefix = f"conditions/{number}/"
        entry: dict[str, Any] = {}
        if condition.noise:
            entry["noise"] = vars(condition.noise) | {"limit": noise_limits(table).get(condition.noise)}
        if condition.light:
            entry["light"] = {"name": condition.light.name, "white_point": condition.light.white_point.tolist()}
        under = table.under(condition)
        scale = _white_scale(under) if table.chroma_smoothing else {}
        content["conditions"]["sets"].append({**entry, **_clipped_white(under), **scale, **_set(arrays, under)})
    content["arrays"] = arrays.entries
    text = json.dumps(content, indent=1, ensure_ascii=False, allow_nan=False) + "\n"
    return {"table.json": text.encode(), **arrays.files}


def _set(arrays: "_Arrays", table: TransformTable) -> dict[str, Any]:
    """Add a set of transforms to `arrays`, and return its description for table.json.

    The description contains the scalar parameters of each layer, and the accuracy with short word lengths.
    """
    costs = word_costs(table)
    words = chosen_words(table, costs)
    layers = [_layer(arrays, number, layer) for number, layer in enumerate(table.layers)]
    _derived(arrays, table)
    _words(arrays, words, len(table.layers) - 1)
    for name, values in _vector(table).items():
        arrays.add(name, *values)
    return {"layers": layers, "word_lengths": _study(words, costs)}


class _Arrays:
    """Collects array files and their descriptions for table.json."""

    def __init__(self) -> None:
        self.files: dict[str, bytes] = {}
        self.entries: list[dict[str, Any]] = []
        # Prefix of array names in an additional set of transforms. An array is omitted if it is the same in the main set.
        self.prefix = ""

    def add(self, name: str, values: NDArray, axes: tuple[str, ...], unit: str, doc: str) -> None:
        little = values.astype(values.dtype.newbyteorder("<"))
        if self.prefix and self.files.get(_file(name)) == little.tobytes():
            return
        name = self.prefix + name
        file = _file(name)
        self.files[file] = little.tobytes()
        self.entries.append(
            {"name": name, "file": file, "dtype": values.dtype.name, "byte_order": "little", "shape": list(values.shape),
             "axes": list(axes), "unit": unit, "doc": doc}
        )  # fmt: skip

    def add_fields(self, prefix: str, instance: Any, names: tuple[str, ...] | None = None) -> dict[str, Any]:
        """Add a dataclass's arrays, and return its scalars and texts with their units and descriptions.

        `names` selects the fields. None selects all.
        """
        values = {}
        for name, spec in declared(type(instance)):
            if not isinstance(spec, Spec) or name in LEFT_OUT or (names is not None and name not in names):
                continue
            if not is_stored(instance, name, spec):
                continue
            value = getattr(instance, name)
            if isinstance(value, np.ndarray):
                self.add(prefix + name, value, spec.axes, spec.unit, spec.doc)
            else:
                values[name] = {"value": value, "unit": spec.unit, "doc": spec.doc}
        return values


def _file(name: str) -> str:
    return f"{name.replace('/', '_')}.bin"


def _layer(arrays: _Arrays, number: int, layer: Any) -> dict[str, Any]:
    """Add the arrays of a layer and of its class rule, and return the scalars for table.json."""
    prefix, rule = f"layer{number}/", layer.rule
    kind = next(iter(rule_fields(rule))) if number else "mosaic"
    entry: dict[str, Any] = {"reads": "planes" if number else "mosaic", "rule": kind}
    entry |= arrays.add_fields(prefix, layer) | arrays.add_fields(prefix, rule)
    names = (
        ("levels", "kinds", "structures") if number else ("levels", "contrasts", "combinations", "chromas", "cases", "kinds")
    )
    entry["sizes"] = {name: getattr(rule, name) for name in names} | {"classes": len(layer.weights)}
    if not number and rule.features:
        entry["features"] = arrays.add_fields(f"{prefix}features/", rule.features)
    if number and layer.coarse_chroma:
        entry["coarse_chroma"] = arrays.add_fields(f"{prefix}coarse_chroma/", layer.coarse_chroma)
    if number and layer.clipping:
        entry["clipping"] = arrays.add_fields(f"{prefix}clipping/", layer.clipping)
    if kind == "tree":
        arrays.add(f"{prefix}leaf", rule.leaf.astype(np.int32), ("node",), "1", "index of the leaf")
    return entry


def _derived(arrays: _Arrays, table: TransformTable) -> None:
    """Add arrays that l3 derives from a table before rendering, such as the number of taps per channel."""
    neighbours = neighbourhoods(table.cfa, table.first.rule.patch, len(table.channels))
    for name, values, doc in (
        ("count", neighbours.count, "number of taps of each channel in the patch of a site"),
        ("mean_reciprocal", neighbours.mean_reciprocal, "round(65536 / count)"),
        ("variance_reciprocal", neighbours.variance_reciprocal, "round(512 / count)"),
    ):
        arrays.add(f"layer0/{name}", values.astype(np.int32), ("site", "channel"), "1", doc)
    if table.first.rule.chroma_dither:
        widths = chroma.chroma_widths(table.first.rule)
        doc = "range of scores within which some sites use the second chroma"
        arrays.add("layer0/chroma_widths", widths, ("chroma",), "1", doc)
    if not table.later:
        return
    basis = planes_basis(table)
    for number, fixed in enumerate((fixed_point(table), *(refined_fixed_point(layer, basis) for layer in table.later[:-1]))):
        _fixed(arrays, f"layer{number}/", fixed, "per DN" if number == 0 else "per coarse step of a plane")
    tests = [turned_tests(turn) for turn in range(8)]
    if any(layer.tree for layer in table.later):
        axes = ("orientation", "test")
        arrays.add("turned_test", np.array([test for test, _ in tests], np.uint8), axes, "1", "index of the numerator")
        signs = np.array([sign for _, sign in tests]).astype(np.int8)
        arrays.add("turned_sign", signs, axes, "1", "sign of this numerator")


def _fixed(arrays: _Arrays, prefix: str, fixed: FixedPoint, unit: str) -> None:
    taps = ("class", "plane", "tap")
    doc = "weights times 2^fraction. Taps are stored plane by plane, and each plane row by row"
    arrays.add(f"{prefix}fixed_weights", fixed.weights, taps, unit, doc)
    arrays.add(f"{prefix}fixed_intercept", fixed.intercept, taps[:2], "1", "intercept times 2^fraction")
    arrays.add(f"{prefix}fraction", fixed.fraction, taps[:1], "bit", "number of fractional bits, F")


def _words(arrays: _Arrays, words: Words, last: int) -> None:
    axes, prefix = ("class", "output", "tap"), f"layer{last}/"
    doc = f"weights of the layer times 2^word_fraction, as signed integers of {words.bits} bits"
    arrays.add(f"{prefix}word_weights", words.whole, axes, "1", doc)
    arrays.add(f"{prefix}word_fraction", words.fraction, axes[:1], "bit", "number of fractional bits of a class")


def _study(words: Words, costs: tuple[Cost, ...]) -> dict[str, Any]:
    return {
        "doc": "accuracy of the outputs if the weights of the last layer are rounded to integers with the given number of "
        "bits. The binary point is the same for a class or for the whole table. psnr_db compares the outputs with the "
        "outputs of float weights for a random mosaic, with a peak of 1",
        "mosaic": {"rows": SHAPE[0], "columns": SHAPE[1], "seed": SEED},
        "costs": [{"bits": cost.bits, "binary_point_of": cost.scale, "psnr_db": round(cost.psnr, 1)} for cost in costs],
        "chosen": {"bits": words.bits, "binary_point_of": words.scale, "least_psnr_db": ENOUGH_PSNR_DB},
    }


def _clipped_white(table: TransformTable) -> dict[str, Any]:
    """Return the table.json entry for the XYZ of the darkest white that clips all channels, or {} if it is unknown."""
    return {} if table.clipped_white is None else {"clipped_white": table.clipped_white.tolist()}


def _white_scale(table: TransformTable) -> dict[str, Any]:
    """Return the table.json entry with `white_scale`: luminance of white per DN of each channel, or {} if it is unknown."""
    return {} if table.white_signals is None else {"white_scale": white_scale(table).tolist()}


def _constants(table: TransformTable) -> dict[str, Any]:
    values: dict[str, Any] = {
        "level_fraction_bits": 8,
        "variance_fraction_bits": 9,
        "chroma_fraction_bits": 4,
        "white_from": clipping.WHITE_FROM,
    }
    if table.later:
        values |= {"plane_step": PLANE_STEP, "plane_top": PLANE_TOP, "coarse": COARSE, "coarse_top": COARSE_TOP,
                   "ratio_darkest": RATIO_DARKEST, "alike": ALIKE.tolist(),
                   "clip_sides": list(clipping.block_sides(table.cfa)), "faintest": clipping.MIN_WEIGHT,
                   "begins": [clipping.BEGINS, clipping.CLIPS], "corrected": [clipping.CORRECTED_FROM, clipping.CLIPS],
                   "kept": [clipping.KEPT, clipping.REPLACED], "plain": [clipping.PLAIN, clipping.TEXTURED],
                   "hue_spacing": [clipping.hue_spacing(side) for side in clipping.block_sides(table.cfa)],
                   "spread_spacing": list(zip(*map(clipping.spread_spacings, clipping.block_sides(table.cfa)), strict=True)),
                   "spread_change": clipping.MAX_CHANGE,
                   "hue_darkest": clipping.MIN_SIGNAL, "hue_difference": clipping.MAX_DIFFERENCE,
                   "hue_white_doubt": clipping.WHITE_DOUBT,
                   "hue_doubt": [clipping.HUE_DOUBT, clipping.GREY_DOUBT], "hue_most": clipping.MAX_HUE,
                   "gradient_top": GRADIENT, "tree_gradient_top": TOP, "tree_chroma_gradient_top": CHROMA_TOP,
                   "tree_noise_trace": NOISE_TRACE, "tree_dark": DARK, "tree_tests": [test.name for test in EVERY],
                   "tree_denominators": [test.denominator for test in EVERY]}  # fmt: skip
    return values


def _vector(table: TransformTable) -> dict[str, tuple[NDArray, tuple[str, ...], str, str]]:
    vector = make_vector(table)
    doc = f"random mosaic. Its first pixel is at CFA row {vector.phase[0]}, column {vector.phase[1]}"
    outputs_doc = "outputs of test_raw with float weights"
    return {
        "test_raw": (vector.raw, ("row", "column"), "DN", doc),
        "test_labels": (vector.labels.astype(np.uint32), ("layer", "row", "column"), "1", "classes of test_raw"),
        "test_outputs": (vector.outputs, ("output", "row", "column"), "output_unit", outputs_doc),
    }
