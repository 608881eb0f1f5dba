"""Export a table as C99 source.

The source consists of files from c/, and of macros and constant arrays with the table's numbers. The code for optional class
features is converted from OpenCL to C by renaming types.
"""

import json
import math
import re
import string
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.class_rule import ClassRule
from l3cli.artifacts.layers import PLANE_STEP, PLANE_TOP, CoarseChroma
from l3cli.artifacts.plane_rules import GRADIENT, StructureRule, TreeRule
from l3cli.artifacts.table import TransformTable
from l3cli.classes import chroma, clipping, saturation
from l3cli.classes.features import features_of
from l3cli.classes.plane_kernel import combination_function
from l3cli.classes.planes import COARSE, COARSE_TOP, LUMINANCE, raw_middle
from l3cli.classes.refinement import RATIO_DARKEST
from l3cli.classes.structure import NOISE_TRACE
from l3cli.classes.tree import CHROMA_TOP, DARK, EVERY, TOP
from l3cli.errors import InputFileError, RecipeError, shortened
from l3cli.export.c_arrays import TAP_GROUP, TYPES, Array, filled, table_arrays
from l3cli.export.wordlengths import (
    OUTPUT_TOP,
    ShortWords,
    Vector,
    make_vector,
    offset_of,
    output_fraction,
    short_cost,
    short_words,
    split_of,
    vector_steps,
)
from l3cli.io.raw.cfa_codes import channel_codes, code_of
from l3cli.physics.display import XYZ
from l3cli.physics.gamut import CONE_SHARE, LEAST_CONE, LEAST_LIGHTNESS, LIGHTNESS, MIN_DIVISOR, gamut_of
from l3cli.physics.spaces import SRGB, Curve
from l3cli.rendering.display import linear_matrix, require_known_layers, shown_adaptation
from l3cli.rendering.exposure import NOISE_WHERE_CLIPPED
from l3cli.rendering.opencl.layout import source_folder
from l3cli.rendering.opencl.smoothing import NEIGHBOUR_MACROS
from l3cli.rendering.reference import MAX_CONTRAST, SMOOTHING_DARKEST, least_black_level, raising_constants
from l3cli.rendering.white.scene_white import WhiteBalance, Whites
from l3cli.rendering.white.source import usual_balance
from l3cli.system.text import printable

PIECES = Path(__file__).parent / "c"
Words = Literal["float32", "int16"]  # type of the outputs, and of the last layer's weights and inputs
PREFIX = "l3"  # default prefix of symbols and file names
MIN_BLOCK = 128  # loops process at least this number of pixels per block
CODES = 256  # number of codes in an 8-bit picture
SUPERSCRIPTS = str.maketrans("0123456789", "⁰¹²³⁴⁵⁶⁷⁸⁹")
LINEAR_BINS = 4096  # bins of linear values; each contains at most one threshold between 8-bit sRGB codes
DATA = (
    "/* The arrays of a transform table. l3_table.h declares them. Long arrays are strings of their bytes. */",
    '#include "l3_table.h"',
    "",
    "#if defined(__BYTE_ORDER__) && __BYTE_ORDER__ != __ORDER_LITTLE_ENDIAN__",
    '#error "the strings contain little-endian numbers, but this processor is not little-endian"',
    "#endif",
    "",
)
C_OF_OPENCL = {"__global const int": "const int32_t", "uints": "uint32_t", "ints": "int32_t", "INLINE": "static inline"}
GUARD = ("#ifndef L3_TABLE_H", "#define L3_TABLE_H", "", "#include <stdint.h>", "")


def c_files(
    table: TransformTable, words: Words = "float32", balance: WhiteBalance | None = None, prefix: str = PREFIX
) -> dict[str, bytes]:
    """Convert a table to C source files. Return each file's content by name.

    Parameters
    ----------
    table : TransformTable
        Table to export.
    words : {"float32", "int16"}
        Type of the outputs.
    balance : WhiteBalance, optional
        White balance of pictures, for tables with the outputs X, Y, Z. [default: the table's white becomes neutral]
    prefix : str
        Prefix of C symbols and file names: a lower-case letter, and up to 30 lower-case letters, digits and "_".

    Raises
    ------
    InputFileError
        If `words` is int16, and the C source supports the table only with float32.
    RecipeError
        If the prefix is invalid, or if the table has too many layers.
    """
    require_known_layers(table)
    if not re.fullmatch(r"[a-z][a-z0-9_]{0,30}", prefix):
        raise RecipeError(
            f'prefix "{shortened(prefix)}" is invalid; use a letter from a to z, followed by up to 30 characters from a-z, '
            "0-9 and _"
        )
    if prefix == "test":
        raise RecipeError('prefix "test" is reserved for the test program; choose another prefix')
    floats = "smooths spectra" if table.spectra else "corrects bands" if _corrects(table) else ""
    if floats and words == "int16":
        raise InputFileError(
            f"the table {floats}, which the C source supports only in floating point; remove ‹words› int16, or export the "
            "table as a folder"
        )
    short = short_words(table) if words == "int16" else None
    arrays, layers = table_arrays(table, short)
    vector, shows = make_vector(table), table.outputs == XYZ
    sources = ["l3.c", "l3_table.c", *(["l3_picture.c"] if shows else [])]
    headers = ["l3.h", "l3_table.h", *(["l3_picture.h"] if shows else [])]
    built = {
        "sources": " ".join(sources),
        "objects": " ".join(name.replace(".c", ".o") for name in sources),
        "headers": " ".join(headers),
        "page": "l3_page.html l3_page.txt l3_page.wasm" if shows else "",
    }
    makefile = _piece("Makefile") + (_piece("Makefile_page") if shows else "")
    texts = {
        "l3.c": _computation(table, words),
        "l3.h": _piece("l3.h"),
        "l3_table.h": _header(table, vector, arrays, words),
        "l3_table.c": "\n".join([*DATA, *(line for array in arrays for line in (*array.lines(), "")), *layers]),
        "test.c": _piece("test.c"),
        "Makefile": string.Template(makefile).substitute(built),
        "CMakeLists.txt": string.Template(_piece("CMakeLists.txt")).substitute(built),
        "README.md": _readme(table, vector, arrays, short),
    }
    if shows:
        texts |= {"l3_picture.h": _piece("picture.h"), "l3_picture.c": _picture_source(table, balance, _piece("picture.c"))}
        texts |= {"page.html": _piece("page.html").replace("@TABLE@", _page_facts(table, balance))}
    return {_named(name, prefix): _named(text, prefix).encode() for name, text in texts.items()} | vector.files()


def _named(text: str, prefix: str) -> str:
    """Replace "l3" by the prefix in symbols, macros, types and file names.

    Lines that start with a string literal remain unchanged, because they contain the bytes of an array.
    """
    if prefix == PREFIX:
        return text
    lines = text.split("\n")
    for number, line in enumerate(lines):
        if not line.startswith('"'):
            line = re.sub(r"\bL3(?=_)", prefix.upper(), re.sub(r"\bl3(?=_|\.[cho]\b)", prefix, line))
            lines[number] = re.sub(r"\bL3(?=[A-Z])", prefix.title().replace("_", ""), line)
    return "\n".join(lines)


def _piece(name: str) -> str:
    return (PIECES / name).read_text(encoding="utf-8")


def _computation(table: TransformTable, words: Words) -> str:
    """Return the text of l3.c, concatenated from the files in c/ that the table needs."""
    coarse = "coarse_chroma.c" if _coarse_chroma(table) else "no_coarse_chroma.c"
    clips = "clipping.c" if table.later and table.later[-1].clipping else "no_clipping.c"
    corrections = "corrections.c" if _corrects(table) else "no_corrections.c"
    layer_files = (
        ("planes.c", corrections, coarse, clips, "structure.c", "tree.c", "several_layers.c")
        if table.later
        else ("one_layer.c",)
    )
    smoothing = "spectra.c" if table.spectra else "chroma.c" if table.chroma_smoothing else "no_smoothing.c"
    rest = ("classes.c", f"{words}.c", *layer_files, smoothing, "render.c")
    return _piece("head.c") + _features(table.first.rule) + "".join(map(_piece, rest))


def _features(rule: ClassRule) -> str:
    """Return the C code for a class rule's optional features, converted from OpenCL."""
    modules = features_of(rule)
    if not modules:
        return _piece("no_features.c")
    snippets = [(source_folder() / module.SNIPPET).read_text(encoding="utf-8") for module, _ in modules]
    text = "\n".join([*snippets, combination_function(rule), ""])
    text = re.sub(r"^ *#pragma unroll.*\n", "", text, flags=re.MULTILINE)
    for name, in_c in C_OF_OPENCL.items():
        text = re.sub(rf"\b{name}\b", in_c, text)
    names = "|".join({"LEVELS"}.union(*(module.macros(feature, rule) for module, feature in modules)))
    text = re.sub(rf"\b({names})\b", r"L3_\1", text)
    return _piece("features_head.c") + text + "\n" + _piece("features.c")


# ---------------------------------------------------------------------------------------------------------------- macros


def macros(table: TransformTable, words: Words) -> dict[str, int | str]:
    """Return the macros of l3_table.h by name, without the prefix. They are sizes of loops and arrays, and constants."""
    rule, columns = table.first.rule, table.cfa.shape[1]
    group = math.lcm(columns, TAP_GROUP)
    values: dict[str, int | str] = {
        "LAYERS": len(table.layers),
        "OUTPUTS": len(table.outputs),
        "CHANNELS": len(table.channels),
        "CFA_ROWS": table.cfa.shape[0],
        "CFA_COLUMNS": columns,
        "BLACK_LEVEL": _float(table.black_level),
        "WHITE_LEVEL": _float(table.white_level),
        "MOST_DN": 2**table.bits - 1,
        "PATCH": rule.patch,
        "RADIUS": rule.radius,
        "BLOCK": -(-MIN_BLOCK // group) * group,
        "SHIFT": rule.shift,
        "LEVELS": rule.levels,
        "CONTRASTS": rule.contrasts,
        "VARIANCE_CAP": f"UINT32_C({(2**32 - 1) // len(table.channels)})",
        **saturation.macros(rule),
        "CHROMAS": rule.chromas,
        "CHROMA_BLACK_LEVEL": rule.chroma_black_level,
        "DITHER": int(chroma.chroma_widths(rule).any()),
        "CHROMA_TURN": chroma.TURN,
        "COMBINATIONS": rule.combinations,
        "KINDS": rule.kinds,
        "CLASSES": len(table.first.weights),
    }
    for module, feature in features_of(rule):
        values |= module.macros(feature, rule)
    if rule.features:
        values |= {"WINDOWS": max(1, len(rule.windows)), "WINDOW_SUMS": max(1, rule.window_sums)}
    if table.spectra:
        reach, darkest = _float(table.spectra.reach), _float(SMOOTHING_DARKEST)
        values |= {"SPECTRAL_WINDOW": table.spectra.window, "SPECTRAL_REACH": reach, "DARKEST": darkest}
    if table.chroma_smoothing:
        smoothing, (white_x, white_z) = table.chroma_smoothing, table.white_point[::2] / table.white_point[1]
        factors = {"LUMINANCE": smoothing.reach, "X": smoothing.likeness * white_x, "Z": smoothing.likeness * white_z}
        values |= {f"BY_{name}": _float(1 / limit**2) for name, limit in factors.items()}
        values |= NEIGHBOUR_MACROS
        values["DARKEST"] = _float(SMOOTHING_DARKEST * (2 ** output_fraction(table) if words == "int16" else 1))
        raising = raising_constants(table)
        values |= {name.upper(): _float(at) if isinstance(at, float) else at for name, at in raising.items()}
        values |= {"LEAST_BLACK_LEVEL": _float(least_black_level(table))} if raising else {}
    if _coarse_chroma(table):
        values["PLANE_STEP"] = _float(PLANE_STEP)
    if table.later and table.later[-1].clipping:
        values |= {name.upper(): _float(at) if isinstance(at, float) else at for name, at in _clipping_known(table).items()}
    if words == "float32":
        values |= _clipped_white(table, 0) | {
            "OUTPUT_FRACTION": 0,
            "VALUE_OFFSET": "0.0f" if table.later else _float(table.black_level),
        }
    else:
        values |= _clipped_white(table, output_fraction(table))
        values |= {"OUTPUT_FRACTION": output_fraction(table), "OUTPUT_TOP": OUTPUT_TOP}
        values |= {"VALUE_OFFSET": offset_of(table), "SPLIT": split_of(table), "TEST_STEPS": _test_steps(table)}
    return values | (_plane_macros(table) if table.later else {"LAST_TAPS": filled(rule.patch**2)})


def _test_steps(table: TransformTable) -> int:
    """Return the largest permitted difference between a 16-bit output and the reference, in output steps.

    The smoothing of chroma and the limit of the luminance amplify rounding errors. For tables with one of these steps, the
    limit is twice the largest error that l3 finds for the test mosaic, because the C source can round a value differently.
    """
    words = short_words(table)
    if table.chroma_smoothing or table.clipped_white is not None:
        return 2 * max(1, vector_steps(table, words))
    return max(1, math.ceil(short_cost(table, words)[1]))


def _corrects(table: TransformTable) -> bool:
    return bool(table.later and table.components)


def _coarse_chroma(table: TransformTable) -> CoarseChroma | None:
    return table.later[-1].coarse_chroma if table.later else None


def _clipped_white(table: TransformTable, fraction: int) -> dict[str, int | str]:
    """Return the macros for limiting outputs to the clipped white, if the table contains it.

    `fraction` is the number of fractional bits of an output, or 0 for float outputs.
    """
    if table.clipped_white is None:
        return {}
    white = {f"WHITE_{name}": at for name, at in zip("XYZ", table.clipped_white.tolist(), strict=True)}
    slope = round(1 / (clipping.WHITE_FROM - 1))
    return {name: min(round(at * 2**fraction), OUTPUT_TOP) if fraction else _float(at) for name, at in white.items()} | {
        "WHITE_SLOPE": slope
    }


def _clipping_known(table: TransformTable) -> dict[str, float | int | str]:
    """Return the constants for clipped areas, by name."""
    rows, columns = clipping.block_sides(table.cfa)
    return {
        "clip_rows": rows,
        "clip_columns": columns,
        "clip_bright": clipping.first_bright(table.black_level, table.white_level),
        "clip_faintest": clipping.MIN_WEIGHT,
        "clip_begins": clipping.BEGINS,
        "clip_corrected": clipping.CORRECTED_FROM,
        "clip_clips": clipping.CLIPS,
        "clip_kept": clipping.KEPT,
        "clip_replaced": clipping.REPLACED,
        "clip_plain": clipping.PLAIN,
        "clip_textured": clipping.TEXTURED,
        "hue_steps": clipping.HUE_STEPS,
        "hue_weights": (clipping.HUE_STEPS + 1) ** 4,
        "hue_rows": clipping.hue_spacing(rows),
        "hue_columns": clipping.hue_spacing(columns),
        "hue_difference": clipping.MAX_DIFFERENCE,
        "hue_darkest": clipping.MIN_SIGNAL,
        "hue_doubt": clipping.HUE_DOUBT,
        "hue_grey_doubt": clipping.GREY_DOUBT,
        "hue_most": clipping.MAX_HUE,
        "hue_white_doubt": clipping.WHITE_DOUBT,
        "spreads": len(clipping.SPREAD_DISTANCES),
        "spread_rows": ", ".join(map(str, clipping.spread_spacings(rows))),
        "spread_columns": ", ".join(map(str, clipping.spread_spacings(columns))),
        "spread_change": clipping.MAX_CHANGE,
    }


def _plane_macros(table: TransformTable) -> dict[str, int | str]:
    most = max(layer.side for layer in table.later)
    return {
        "TAPS": filled(table.first.rule.patch**2),
        "RAW_MIDDLE": raw_middle(table.bits),
        "PLANE_TOP": PLANE_TOP,
        "LUMINANCE": LUMINANCE,
        **(dict(zip(("CHROMA_1", "CHROMA_2"), table.chroma_outputs, strict=True)) if _coarse_chroma(table) else {}),
        "COARSE": COARSE,
        "COARSE_TOP": COARSE_TOP,
        "GRADIENT_TOP": GRADIENT,
        "NOISE_TRACE": NOISE_TRACE,
        "TREE_TOP": TOP,
        "TREE_CHROMA_TOP": CHROMA_TOP,
        "DARK": DARK,
        "TESTS": len(EVERY),
        "LAST_TAPS": filled(3 * table.later[-1].side ** 2),
        "RATIO_TAPS": table.later[-1].ratio_taps,
        "RATIO_DARKEST": RATIO_DARKEST,
        "MOST_SIDE": max(most, table.first.rule.patch),
        "MOST_COLUMN": max(3 * most, table.first.rule.patch),
        "MOST_TAPS": max(filled(3 * most**2), filled(table.first.rule.patch**2)),
    }


def _float(value: float) -> str:
    return f"{float(np.float32(value))!r}f"


def _header(table: TransformTable, vector: Vector, arrays: list[Array], words: Words) -> str:
    rows, columns = vector.raw.shape
    test = {
        "TEST_ROWS": rows,
        "TEST_COLUMNS": columns,
        "TEST_PHASE_ROW": vector.phase[0],
        "TEST_PHASE_COLUMN": vector.phase[1],
    }
    lines = [f"#define L3_{name} {value}" for name, value in (macros(table, words) | test).items()]
    public = [line for array in arrays if not array.local for line in array.public()]
    types = (_piece("types.h") if table.later else "") + (_piece("window.h") if table.first.rule.features else "")
    extra = ["extern const L3PlaneLayer l3_layers[L3_LAYERS - 1];"] if table.later else []
    extra += ["extern const L3Window l3_windows[L3_WINDOWS];"] if table.first.rule.features else []
    start = "/* The constants of a transform table, and the declarations of its arrays. README.md explains them. */"
    lines += ["", f"typedef {TYPES[words]} L3Output;"]
    return "\n".join([start, *GUARD, *lines, "", types + "\n".join(public), *extra, "", "#endif", ""])


# ---------------------------------------------------------------------------------------------------------------- README


def _readme(table: TransformTable, vector: Vector, arrays: list[Array], short: ShortWords | None) -> str:
    rule = table.first.rule
    known: dict[str, object] = {
        "camera": printable(table.camera_name),
        "bits": table.bits,
        "black": f"{table.black_level:g}",
        "white": f"{table.white_level:g}",
        "outputs": ", ".join(map(printable, table.outputs)),
        "unit": f"{table.output_unit:g}",
        "layers": len(table.layers),
        "array": f"{table.cfa.shape[0]} × {table.cfa.shape[1]}",
        "channels": ", ".join(map(printable, table.channels)),
        "patch": rule.patch,
        "shift": rule.shift,
        "levels": rule.levels,
        "contrasts": rule.contrasts,
        "saturation": rule.saturation,
        "radius": rule.saturation_radius,
        "chromas": rule.chromas,
        "combinations": rule.combinations,
        "kinds": rule.kinds,
        "classes": len(table.first.weights),
        "cap": (2**32 - 1) // len(table.channels),
        "chroma_black": rule.chroma_black_level,
        "kilobytes": f"{sum(array.values.nbytes for array in arrays) / 1000:.0f}",
        "rows": vector.raw.shape[0],
        "columns": vector.raw.shape[1],
        "phase": "{}, {}".format(*vector.phase),
    }
    known |= {"ratio_darkest": RATIO_DARKEST, **_clipping_known(table)}
    known |= _words_known(table, short) if short else {"words": "float"}
    parts = ["readme.md", "readme_int16.md" if short else "readme_float32.md"]
    parts += [name for feature in rule.feature_list if (PIECES / (name := f"readme_{feature.name}.md")).exists()]
    parts += ["readme_planes.md"] if table.later else ["readme_one_layer.md"]
    parts += ["readme_corrections.md"] if _corrects(table) else []
    parts += ["readme_ratios.md"] if table.later and table.later[-1].ratio_taps else []
    parts += ["readme_coarse_chroma.md"] if _coarse_chroma(table) else []
    parts += ["readme_clipped_white.md"] if table.clipped_white is not None else []
    parts += ["readme_clipping.md"] if table.later and table.later[-1].clipping else []
    if table.spectra:
        parts += ["readme_spectra.md"]
        known |= {"spectral_window": table.spectra.window, "spectral_reach": f"{table.spectra.reach:g}"}
    if table.chroma_smoothing:
        parts += ["readme_smoothed_chroma.md"]
        white = table.white_point / table.white_point[1]
        known |= {"white_x": f"{white[0]:.6g}", "white_z": f"{white[2]:.6g}", "max_contrast": f"{MAX_CONTRAST:g}"}
        known |= {f"chroma_{name}": f"{of:g}" for name, of in vars(table.chroma_smoothing).items()}
        if table.white_signals is not None:
            parts += ["readme_raised.md"]
            raising = raising_constants(table)
            side, black = 2 * int(raising["least_reach"]) + 1, f"{least_black_level(table):.6g}"
            known |= raising | {"least_side": side, "least_black": black}
    parts += ["readme_structure.md"] if any(isinstance(layer.rule, StructureRule) for layer in table.later) else []
    parts += ["readme_picture.md"] if table.outputs == XYZ else []
    parts += ["readme_tree.md"] if any(isinstance(layer.rule, TreeRule) for layer in table.later) else []
    return "\n".join(string.Template(_piece(part)).substitute(known) for part in parts)


def _words_known(table: TransformTable, short: ShortWords) -> dict[str, str | int]:
    psnr, worst = short_cost(table, short)
    fraction, last = output_fraction(table), table.later[-1] if table.later else None
    places = {
        "where trees decide": any(isinstance(layer.rule, TreeRule) for layer in table.later),
        "in coarse chroma": last is not None and last.coarse_chroma is not None,
        "in clipped areas": last is not None and last.clipping is not None,
        "to smooth chroma": table.chroma_smoothing is not None,
    }
    uses = [place for place, used in places.items() if used]
    listed = " and ".join([", ".join(uses[:-1]), uses[-1]] if len(uses) > 1 else uses)
    return {
        "words": "int16_t", "top": OUTPUT_TOP, "split": short.split, "psnr": f"{psnr:.1f}", "worst": f"{worst:.2g}",
        "floats": f"l3.c uses floats only {listed}." if uses else "l3.c does not use floats.",
        "step": f"2⁻{str(fraction).translate(SUPERSCRIPTS)}", "range": 2 ** (15 - fraction),
        "rounding": f"{20 * math.log10(12**0.5 * 2**fraction):.1f}",
    }  # fmt: skip


def _picture_source(table: TransformTable, balance: WhiteBalance | None, text: str) -> str:
    """Insert the constants of a table with the outputs X, Y, Z into `text`, the template picture.c.

    If `balance` is None, the table's white becomes neutral.
    """
    balance = balance or usual_balance(table)
    matrix, gamut = linear_matrix(shown_adaptation(table, balance.adaptation), 1.0, SRGB), gamut_of(SRGB)
    assert SRGB.curve is not None
    least = _thresholds(SRGB.curve).astype(np.float32)
    codes = np.searchsorted(least, np.arange(LINEAR_BINS) / LINEAR_BINS, side="right")
    return string.Template(text).substitute(
        bins=LINEAR_BINS,
        noise=_float(NOISE_WHERE_CLIPPED),
        thresholds="\n".join(f"    {_floats(row)}," for row in np.array_split(np.append(least, 2.0), 32)),
        codes="\n".join(f"    {', '.join(map(str, row.tolist()))}," for row in np.array_split(codes, LINEAR_BINS // 32)),
        gains=", ".join(f"{gain!r}" for gain in balance.gains.tolist()),
        luminance=_floats(np.array([balance.luminance])),
        matrix=_rows(matrix),
        cones=_rows(gamut.cones),
        linear=_rows(gamut.linear),
        lightness=_floats(LIGHTNESS),
        y=_floats(gamut.luminance),
        least_cone=_float(LEAST_CONE),
        cone_share=_float(CONE_SHARE),
        least_lightness=_float(LEAST_LIGHTNESS),
        tiny=_float(MIN_DIVISOR),
        top=float(math.ceil(table.white_level)),
    )


def _page_facts(table: TransformTable, balance: WhiteBalance | None) -> str:
    """Return the properties of a table for the browser page, as JSON.

    `neutral` contains the signals of a grey surface under the training illuminant. The page uses them to apply the white
    balance that a file contains. If these signals are unknown, or if the user set a white for the export, `neutral` is null.
    """
    codes, trained = channel_codes(table.channels), Whites(table).trained
    facts = {
        "camera": printable(table.camera_name),
        "cfa": table.cfa.tolist(),
        "codes": codes.tolist(),  # TIFF/EP colour codes, and unused codes for channels without one
        "names": [code_of(name) for name in table.channels],  # TIFF/EP colour codes, and null for channels without one
        "black": table.black_level,
        "white": table.white_level,
        "layers": len(table.layers),
        "gains": (balance or usual_balance(table)).gains.tolist(),
        "neutral": None if balance or trained is None else trained.tolist(),
    }
    return json.dumps(facts).replace("<", "\\u003c")


def _thresholds(curve: Curve) -> NDArray[np.float64]:
    """Return, for each 8-bit code from 1 to 255, the smallest linear value that is encoded as this code."""
    encoded = (np.arange(1, CODES) - 0.5) / (CODES - 1)
    power = ((encoded + curve.offset) / curve.gain) ** (1 / curve.exponent)
    return np.where(encoded <= curve.slope * curve.knee, encoded / curve.slope, power)


def _rows(matrix: NDArray) -> str:
    return ", ".join(f"{{{_floats(row)}}}" for row in matrix)


def _floats(values: NDArray) -> str:
    return ", ".join(f"{value:.8e}f" for value in values.tolist())
