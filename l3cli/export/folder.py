"""A table as plain arrays: little-endian files, and table.json, which describes each."""

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
from l3cli.rendering.reference import SPECTRA_DARKEST
from l3cli.system.text import printable

FORMAT, VERSION = "l3 table as arrays", 2
TABLE_FIELDS = ("bits", "black_level", "white_level", "outputs", "output_unit", "white_point", "channels", "cfa")
LEFT_OUT = ("samples", "condition")  # fields of layers that only document the training

FORMULAS = {
    "class": "(((site * levels + level) * contrasts + contrast) * combinations + combination) * kinds + kind",
    "site": "CFA row * CFA columns + CFA column",
    "statistics": "v = DN >> shift over the patch about a pixel; n, S, Q: number, sum, sum of squares of v of a channel",
    "level": "number of level_edges <= sum over channels of (S * mean_reciprocal >> 8)",
    "contrast": "M = S * mean_reciprocal >> 16; V = min((Q - M * (2 S - n M)) * variance_reciprocal, "
    "(2^32 - 1) // channels); number of contrast_edges (of the level) < sum over channels of V",
    "saturation": "code: bit c is set where a pixel of channel c within saturation_radius is >= saturation; "
    "case_of_code[code]",
    "chroma": "first k of least sum over channels of clamp((S * mean_reciprocal >> 12) - chroma_black_level, 0, 65535) * "
    "chroma_weights[k]; with chroma_dither, at site s the second least k2 where its score exceeds that of k by less than "
    "((sum of the clamped >> 8) * chroma_widths[k] >> 8) * t, t = 2 * ((159 s + 79) & 255) - 255, or -t if k > k2",
    "kind": "chroma where the case is 0, else chromas - 1 + case",
    "borders": "the sample of equal CFA phase nearest the mirror image; planes: mirrored about the outermost pixels",
}
CONDITIONS_DOC = (
    "further sets of transforms. noise: learned for an analog gain over the camera's, or for a share noise_left of a "
    "frame's noise variance, for pixels of which a filter in time has left no more than limit; light: learned under this "
    "light. Arrays are those of the same name behind conditions/NUMBER/; where there is none, those above. Formulas "
    "and constants are the same; test_labels and test_outputs are by this set alone"
)
ONE_LAYER = {"output": "sum of weights * (DN - black_level) / (white_level - black_level) + intercept"}
CLIPPED_WHITE = {
    "clipped white": "where there is one, X, Y, Z of a pixel with Y above white_Y, its Y, become, last of all, "
    "(1 - f) * white_Y / Y * (X, Y, Z) + f * clipped_white; f = min((Y / white_Y - 1) / (white_from - 1), 1)"
}
LAYERS = {
    "plane": "clamp(sum of fixed_weights * value + fixed_intercept + 2^(F - 1) >> F, -plane_top, plane_top); "
    "F = fraction[class]; value: DN in the first layer; in others clamp(plane + 2^(coarse - 1) >> coarse, "
    "-coarse_top, coarse_top)",
    "output": "sum of the last layer's weights * plane * plane_step + intercept; taps plane by plane, each row by row, "
    "behind them those of the colour ratios if it has two taps more, bilateral chroma if it has four; where the table has "
    "components, added to sum of the first layer's weights * (DN - black_level) / (white_level - black_level) + intercept",
    "colour ratios": "mean * clamp((Y - mean Y) / max(mean Y, ratio_darkest), -1, 1) of the first and of the third plane; "
    "means over the window",
    "bilateral chroma": "sum of w * (difference from the pixel's own) / sum of w, over the window, of the first and of the "
    "third plane; w = max(0, mean of d + ratio_darkest^2 - d)^2, d = sum of squared differences of all planes",
    "coarse chroma": "of a layer that has it, first and third output += plane_step * d of the plane of the same number; d = "
    "bilinear mean, of the four blocks nearest to the pixel, of what the last step differs by from the blocks, beyond the "
    "frame 0; blocks: means of 4 x 4 pixels, the outermost repeated; they pass steps over 3 x 3 of them, spaced 1, 2, 4, 8, "
    "within the frame, with the weights 1 2 1 * max(0, 1 - sum of difference^2 / (8 * 4 alike^2 v))^8, alike of the step, "
    "v = sum of variance * max(Y, 0)^power at the Y of the middle",
    "clipping": "of a layer that has it, at last output = (1 - w) * output + q, both read bilinearly at the middle of the "
    "pixel's 2 x 2 pixels from blocks of clip_sides pixels, the last ones within the frame; w = f * S(max s; kept), q = w * "
    "sum of response[0] * (s - h + g * white) + f * (A(s) - A(h)); A(s) = sum of S(s of channel c; begins) * "
    "response[1 + c] * s; h = min(g * white, 1), g = (mean of s / white, by max(1 - S(s; begins), faintest)) + "
    "min S(s; begins) * (max s / white - that mean); s: means of the channels over full scale, at most 1, over 3 x 3 blocks "
    "by 1 2 1, and 1 behind them; f = 1 - S(d; plain), d: largest range of a channel in one of these blocks, and difference "
    "of its means from the middle one's; S(x; a, b) = t^2 (3 - 2 t), t = (x - a) / (b - a) within 0 and 1; blocks without "
    "a value of begins of full scale, or that lack a channel, have means of 0",
    "later class": "(site * levels + level // level_step) * kinds + kind; level and case of the first layer; kind: "
    "structure or leaf where case - spared_cases is at most 0, else structures - 1 + that; of a tree levels = 1",
}


SPECTRA_DOC = (
    "what is done to the outputs at last, also to test_outputs: Y is the mean of the outputs, p a pixel, q those of the "
    "window about it, mirrored at the borders; w = max(0, 1 - ((Y_q - Y_p) / (reach * Y_p))^2)^2; output_p <- mean of "
    "output_q * Y_p / mean of Y_q, means weighed by w, where Y_p > spectra_darkest"
)


def folder_files(table: TransformTable) -> dict[str, bytes]:
    """Return the content of every file, by name."""
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
        content["constants"]["spectra_darkest"] = SPECTRA_DARKEST
    if table.components:
        doc = "what makes planes of outputs, as fixed_weights of the first layer do of the mosaic"
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
        content["conditions"]["sets"].append({**entry, **_clipped_white(under), **_set(arrays, under)})
    content["arrays"] = arrays.entries
    text = json.dumps(content, indent=1, ensure_ascii=False, allow_nan=False) + "\n"
    return {"table.json": text.encode(), **arrays.files}


def _set(arrays: "_Arrays", table: TransformTable) -> dict[str, Any]:
    """Add the transforms of a table to `arrays`, and return the other entries of its header.

    The entries contain the scalar parameters of each layer, and the loss of accuracy at short word lengths.
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
    """Collects files of arrays, and the entry of each in table.json."""

    def __init__(self) -> None:
        self.files: dict[str, bytes] = {}
        self.entries: list[dict[str, Any]] = []
        self.prefix = ""  # prefix of a further set's names; arrays equal to the first set's are left out

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
        """Add the arrays that a dataclass declares, and return its scalars and texts, each with unit and meaning."""
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
    """Add the arrays of a layer and of its rule, and return their scalars."""
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
        arrays.add(f"{prefix}leaf", rule.leaf.astype(np.int32), ("node",), "1", "number of the leaf")
    return entry


def _derived(arrays: _Arrays, table: TransformTable) -> None:
    """Add the arrays that l3 computes from a table before rendering."""
    neighbours = neighbourhoods(table.cfa, table.first.rule.patch, len(table.channels))
    for name, values, doc in (
        ("count", neighbours.count, "taps of each channel in the patch of a site"),
        ("mean_reciprocal", neighbours.mean_reciprocal, "round(65536 / count)"),
        ("variance_reciprocal", neighbours.variance_reciprocal, "round(512 / count)"),
    ):
        arrays.add(f"layer0/{name}", values.astype(np.int32), ("site", "channel"), "1", doc)
    if table.first.rule.chroma_dither:
        widths = chroma.chroma_widths(table.first.rule)
        arrays.add("layer0/chroma_widths", widths, ("chroma",), "1", "how far sites take a second chroma")
    if not table.later:
        return
    basis = planes_basis(table)
    for number, fixed in enumerate((fixed_point(table), *(refined_fixed_point(layer, basis) for layer in table.later[:-1]))):
        _fixed(arrays, f"layer{number}/", fixed, "per DN" if number == 0 else "per coarse step of a plane")
    tests = [turned_tests(turn) for turn in range(8)]
    if any(layer.tree for layer in table.later):
        axes = ("orientation", "test")
        arrays.add("turned_test", np.array([test for test, _ in tests], np.uint8), axes, "1", "numerator that a test reads")
        arrays.add("turned_sign", np.array([sign for _, sign in tests]).astype(np.int8), axes, "1", "and its sign")


def _fixed(arrays: _Arrays, prefix: str, fixed: FixedPoint, unit: str) -> None:
    taps = ("class", "plane", "tap")
    arrays.add(f"{prefix}fixed_weights", fixed.weights, taps, unit, "taps plane by plane, each row by row; times 2^fraction")
    arrays.add(f"{prefix}fixed_intercept", fixed.intercept, taps[:2], "1", "times 2^fraction")
    arrays.add(f"{prefix}fraction", fixed.fraction, taps[:1], "bit", "binary point F")


def _words(arrays: _Arrays, words: Words, last: int) -> None:
    axes, prefix = ("class", "output", "tap"), f"layer{last}/"
    doc = f"the layer's weights times 2^word_fraction, in {words.bits} bits with sign"
    arrays.add(f"{prefix}word_weights", words.whole, axes, "1", doc)
    arrays.add(f"{prefix}word_fraction", words.fraction, axes[:1], "bit", "binary point of a class")


def _study(words: Words, costs: tuple[Cost, ...]) -> dict[str, Any]:
    return {
        "doc": "weights of the last layer in words of so many bits, with a binary point for each class or for the table; "
        "psnr_db: outputs against those of float weights, of a full output 1, on a drawn mosaic",
        "mosaic": {"rows": SHAPE[0], "columns": SHAPE[1], "seed": SEED},
        "costs": [{"bits": cost.bits, "binary_point_of": cost.scale, "psnr_db": round(cost.psnr, 1)} for cost in costs],
        "chosen": {"bits": words.bits, "binary_point_of": words.scale, "least_psnr_db": ENOUGH_PSNR_DB},
    }


def _clipped_white(table: TransformTable) -> dict[str, Any]:
    """Return the limit of a set's outputs; empty if its light is unknown."""
    return {} if table.clipped_white is None else {"clipped_white": table.clipped_white.tolist()}


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
                   "begins": [clipping.BEGINS, clipping.CLIPS],
                   "kept": [clipping.KEPT, clipping.REPLACED], "plain": [clipping.PLAIN, clipping.TEXTURED],
                   "gradient_top": GRADIENT, "tree_gradient_top": TOP, "tree_chroma_gradient_top": CHROMA_TOP,
                   "tree_noise_trace": NOISE_TRACE, "tree_dark": DARK, "tree_tests": [test.name for test in EVERY],
                   "tree_denominators": [test.denominator for test in EVERY]}  # fmt: skip
    return values


def _vector(table: TransformTable) -> dict[str, tuple[NDArray, tuple[str, ...], str, str]]:
    vector = make_vector(table)
    start = f"first pixel at CFA row {vector.phase[0]}, column {vector.phase[1]}"
    return {
        "test_raw": (vector.raw, ("row", "column"), "DN", f"a drawn mosaic; {start}"),
        "test_labels": (vector.labels.astype(np.uint32), ("layer", "row", "column"), "1", "its classes"),
        "test_outputs": (vector.outputs, ("output", "row", "column"), "output_unit", "its outputs, of float weights"),
    }
