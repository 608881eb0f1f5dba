"""A class rule as kernels see it: the snippets of its features, macros for shapes, arrays for values."""

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.class_rule import Axis, ClassRule
from l3cli.classes import contrast
from l3cli.classes.features import BASIC, further_features


def snippets(rule: ClassRule) -> tuple[str, ...]:
    """Files of opencl/ with the formulas of a rule's features; `joined` follows them, then rule.cl."""
    return tuple(feature.SNIPPET for feature in (*BASIC, *(feature for feature, _ in further_features(rule))))


def joined(rule: ClassRule) -> str:
    """Return the further features as rule.cl asks for them: FURTHER values in one, from WINDOW_SUMS sums over the windows
    that EACH_WINDOW names, by `further_of`. Values past the end of an axis are its last. BOX_ROWS and BOX_COLUMNS are the
    size of the windows where all have one."""
    windows, values = [], []
    sums = constants = 0
    for axis in rule.axes:
        for window in axis.windows:
            top_left_size = f"{window.top}, {window.left}, {window.rows}, {window.columns}"
            windows.append(f"add({sums + window.sum}, {top_left_size}, {'+' if window.sign > 0 else '-'})")
        values += [
            f"    value = {axis.name}_of(sum + {sums}, level, constants + {constants});",
            f"    further = further * {axis.size} + (value > {axis.size - 1} ? (uints){axis.size - 1} : value);",
        ]
        sums, constants = sums + axis.sums, constants + len(axis.constants)
    lines = [f"#define FURTHER {rule.further}", f"#define WINDOW_SUMS {max(1, sums)}"]
    sizes = {(window.rows, window.columns) for axis in rule.axes for window in axis.windows}
    if len(sizes) == 1:
        lines += [f"#define BOX_{name} {size}" for name, size in zip(("ROWS", "COLUMNS"), *sizes, strict=True)]
    if rule.axes:
        lines += [
            f"#define EACH_WINDOW(add) {' '.join(windows)}",
            "INLINE uints further_of(const ints *sum, uints level, __global const int *constants) {",
            "    uints further = 0, value;",
            *values,
            "    return further;",
            "}",
        ]
    return "\n".join(lines)


def kernel_macros(rule: ClassRule) -> dict[str, int]:
    """Return the macros of the features' snippets and of rule.cl, which joins them."""
    basic = {key: value for feature in BASIC for key, value in feature.macros(rule).items()}
    further = {key: value for feature, axis in further_features(rule) for key, value in feature.macros(axis, rule).items()}
    return basic | further | {"KINDS": rule.kinds}


def kernel_arrays(rule: ClassRule, *others: ClassRule) -> tuple[NDArray, ...]:
    """Return the constants of the features, in the order in which kernels take them. After those that noise gives, edges of
    contrast and what further features read, lie those of `others`, which differ in nothing else."""
    basic = [
        np.concatenate([contrast.kernel_array(each) for each in (rule, *others)])
        if feature is contrast
        else feature.kernel_array(rule)
        for feature in BASIC
    ]
    return (*basic, *_further_constants(tuple(axis for each in (rule, *others) for axis in each.axes)))


def _further_constants(axes: tuple[Axis, ...]) -> tuple[NDArray[np.int32], ...]:
    return (np.concatenate([axis.constants for axis in axes]),) if axes else ()
