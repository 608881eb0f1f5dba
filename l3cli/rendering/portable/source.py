"""A table as C99 source: fixed code, joined of the pieces in c/, and the table's numbers as macros and constant arrays."""

import math
import string
from pathlib import Path

import numpy as np

from l3cli.artifacts.layers import PLANE_TOP
from l3cli.artifacts.structure_rule import GRADIENT, StructureRule
from l3cli.artifacts.table import TransformTable
from l3cli.artifacts.tree_rule import TreeRule
from l3cli.classes import direction, saturation
from l3cli.classes.features import further_features
from l3cli.classes.planes import COARSE, COARSE_TOP, LUMINANCE, raw_middle
from l3cli.classes.structure import NOISE_TRACE
from l3cli.classes.tree import CHROMA_TOP, DARK, EVERY, TOP
from l3cli.columns import printable
from l3cli.errors import InputFileError
from l3cli.rendering.display import require_known_layers
from l3cli.rendering.portable.c_arrays import TAP_GROUP, Array, filled, table_arrays
from l3cli.rendering.portable.vector import Vector, make_vector

PIECES = Path(__file__).parent / "c"
LEAST_BLOCK = 128  # pixels that loops take at a time
DATA = ("/* The numbers of a transform table; l3_table.h says how many. */", '#include "l3_table.h"', "")
GUARD = ("#ifndef L3_TABLE_H", "#define L3_TABLE_H", "", "#include <stdint.h>", "")


def c_files(table: TransformTable) -> dict[str, bytes]:
    """Name → content of every file; InputFileError if the table is beyond what the C computes."""
    require_known_layers(table)
    for feature, axis in further_features(table.first.rule):
        if feature is not direction:
            raise InputFileError(f'C source has no class feature "{axis.name}"; export the table as a folder')
    arrays, layers = table_arrays(table)
    vector = make_vector(table)
    texts = {
        "l3.c": "".join(_piece(name) for name in _pieces(table)),
        "l3.h": _piece("l3.h"),
        "l3_table.h": _header(table, vector, arrays),
        "l3_table.c": "\n".join([*DATA, *(line for array in arrays for line in (*array.lines(), "")), *layers]),
        "test.c": _piece("test.c"),
        "Makefile": _piece("Makefile"),
        "README.md": _readme(table, vector, arrays),
    }  # fmt: skip
    return {name: text.encode() for name, text in texts.items()} | vector.files()


def _piece(name: str) -> str:
    return (PIECES / name).read_text(encoding="utf-8")


def _pieces(table: TransformTable) -> tuple[str, ...]:
    further = "direction.c" if table.first.rule.axes else "no_direction.c"
    behind = ("planes.c", "structure.c", "tree.c", "several_layers.c") if table.later else ("one_layer.c",)
    return ("head.c", further, "classes.c", *behind)


# ---------------------------------------------------------------------------------------------------------------- macros


def macros(table: TransformTable) -> dict[str, int | str]:
    """What the sizes of loops and arrays, and the formulas, depend on."""
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
        "TAPS": filled(rule.patch**2),
        "BLOCK": -(-LEAST_BLOCK // group) * group,
        "SHIFT": rule.shift,
        "LEVELS": rule.levels,
        "CONTRASTS": rule.contrasts,
        "VARIANCE_CAP": f"UINT32_C({(2**32 - 1) // len(table.channels)})",
        **saturation.macros(rule),
        "CHROMAS": rule.chromas,
        "SPARED": rule.spared_cases,
        "CHROMA_BLACK_LEVEL": rule.chroma_black_level,
        "FURTHER": rule.further,
        "KINDS": rule.kinds,
        "CLASSES": len(table.first.weights),
    }
    for feature, axis in further_features(rule):
        values |= feature.macros(axis, rule) | {"WINDOWS": len(axis.windows)}
    return values | (_plane_macros(table) if table.later else {})


def _plane_macros(table: TransformTable) -> dict[str, int | str]:
    most = max(layer.side for layer in table.later)
    return {
        "RAW_MIDDLE": raw_middle(table.bits),
        "PLANE_TOP": PLANE_TOP,
        "LUMINANCE": LUMINANCE,
        "COARSE": COARSE,
        "COARSE_TOP": COARSE_TOP,
        "GRADIENT_TOP": GRADIENT,
        "NOISE_TRACE": NOISE_TRACE,
        "TREE_TOP": TOP,
        "TREE_CHROMA_TOP": CHROMA_TOP,
        "DARK": DARK,
        "TESTS": len(EVERY),
        "LAST_TAPS": filled(3 * table.later[-1].side ** 2),
        "MOST_SIDE": max(most, table.first.rule.patch),
        "MOST_COLUMN": max(3 * most, table.first.rule.patch),
        "MOST_TAPS": max(filled(3 * most**2), filled(table.first.rule.patch**2)),
    }


def _float(value: float) -> str:
    return f"{float(np.float32(value))!r}f"


def _header(table: TransformTable, vector: Vector, arrays: list[Array]) -> str:
    rows, columns = vector.raw.shape
    test = {
        "TEST_ROWS": rows,
        "TEST_COLUMNS": columns,
        "TEST_PHASE_ROW": vector.phase[0],
        "TEST_PHASE_COLUMN": vector.phase[1],
    }
    lines = [f"#define L3_{name} {value}" for name, value in (macros(table) | test).items()]
    public = [f"extern {array.declaration};" for array in arrays if not array.local]
    types = (_piece("types.h") if table.later else "") + (_piece("window.h") if table.first.rule.axes else "")
    extra = ["extern const L3PlaneLayer l3_layers[L3_LAYERS - 1];"] if table.later else []
    extra += ["extern const L3Window l3_windows[L3_WINDOWS];"] if table.first.rule.axes else []
    start = "/* A transform table: its constants; its arrays stand in l3_table.c. README.md explains both. */"
    return "\n".join([start, *GUARD, *lines, "", types + "\n".join(public), *extra, "", "#endif", ""])


# ---------------------------------------------------------------------------------------------------------------- README


def _readme(table: TransformTable, vector: Vector, arrays: list[Array]) -> str:
    rule = table.first.rule
    known = {
        "camera": printable(table.camera_name),
        "array": f"{table.cfa.shape[0]} × {table.cfa.shape[1]}",
        "channels": ", ".join(map(printable, table.channels)),
        "bits": table.bits,
        "black": f"{table.black_level:g}",
        "white": f"{table.white_level:g}",
        "outputs": ", ".join(map(printable, table.outputs)),
        "unit": f"{table.output_unit:g}",
        "layers": len(table.layers),
        "patch": rule.patch,
        "shift": rule.shift,
        "levels": rule.levels,
        "contrasts": rule.contrasts,
        "saturation": rule.saturation,
        "radius": rule.saturation_radius,
        "chromas": rule.chromas,
        "further": rule.further,
        "kinds": rule.kinds,
        "classes": len(table.first.weights),
        "cap": (2**32 - 1) // len(table.channels),
        "chroma_black": rule.chroma_black_level,
        "kilobytes": f"{sum(array.values.nbytes for array in arrays) / 1000:.0f}",
        "rows": vector.raw.shape[0],
        "columns": vector.raw.shape[1],
        "phase": "{}, {}".format(*vector.phase),
    }
    parts = ["readme.md"]
    parts += ["readme_direction.md"] if rule.axes else []
    parts += ["readme_planes.md"] if table.later else ["readme_one_layer.md"]
    parts += ["readme_structure.md"] if any(isinstance(layer.rule, StructureRule) for layer in table.later) else []
    parts += ["readme_tree.md"] if any(isinstance(layer.rule, TreeRule) for layer in table.later) else []
    return "\n".join(string.Template(_piece(part)).substitute(known) for part in parts)
