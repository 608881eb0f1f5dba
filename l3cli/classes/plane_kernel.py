"""Class rules in the form that OpenCL kernels need: source files, macros for sizes, and arrays of values."""

import bisect

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.class_rule import Axis, ClassRule
from l3cli.artifacts.plane_rules import DIRECTIONS, GRADIENT, TESTS, StructureRule, TreeRule
from l3cli.artifacts.table import PlaneRule
from l3cli.classes import contrast, tree
from l3cli.classes.features import BASIC, further_features
from l3cli.classes.structure import NOISE_TRACE

PART_LEAVES = 16  # most leaves in a part of a tree, all of which are decided at once
NEVER = np.finfo(np.float32).max  # threshold of leaves, which no value exceeds


def rule_snippets(rule: PlaneRule) -> tuple[str, dict[str, str]]:
    """Return the file with a rule's formula, and for each variant the file with its kernel `structures`."""
    if isinstance(rule, StructureRule):
        return "common/structure.cl", {"processor": "cpu/structures.cl", "graphics": "gpu/structures.cl"}
    return "common/tree.cl", {"processor": "cpu/trees.cl", "graphics": "gpu/trees.cl"}


def rule_macros(rule: PlaneRule) -> dict[str, int]:
    """Return the macros that the formula and the kernel are compiled with."""
    if isinstance(rule, StructureRule):
        return {"STRENGTHS": rule.strengths, "DIRECTIONS": DIRECTIONS, "COHERENCE": rule.coherence, "GRADIENT_TOP": GRADIENT}
    return {
        "TESTS": TESTS,
        "TESTS_USED": sum(1 << test for test in set(rule.test[rule.branch > 0].tolist())),
        "PARTS": len(_parts(rule)),
        "DEPTH": rule.depth,
        "GRADIENT_TOP": tree.TOP,
        "CHROMA_TOP": tree.CHROMA_TOP,
        "NOISE_TRACE": NOISE_TRACE,
        "DARKEST_LUMINANCE": tree.DARK,
    }


def rule_constants(rule: PlaneRule, variant: str) -> tuple[NDArray[np.uint32], ...]:
    """Return the constants of the formula, in the order of the arguments of a variant's kernels."""
    if isinstance(rule, StructureRule):
        return (rule.strength_edges,)
    return (_tests(rule),) if variant == "processor" else (_nodes(rule), rule.leaf.astype(np.uint32))


def _tests(rule: TreeRule) -> NDArray[np.uint32]:
    """Return the tests of a tree, grouped by its parts, in the layout that cpu/trees.cl describes."""
    first, end = _parts(rule), _leaf_ends(rule).tolist()
    words = -(-len(first) // 32)
    groups: list[list[tuple[int, int, int]]] = [[] for _ in range(words + len(first))]
    leaf, asked = rule.leaf.tolist(), _asked(rule, 8).tolist()
    for node in np.flatnonzero(rule.branch).tolist():
        part, next_leaf = bisect.bisect_right(first, leaf[node]) - 1, leaf[rule.branch[node] + 1]
        if end[node] <= [*first, rule.structures][part + 1]:  # a test within a part excludes leaves
            chosen = {words + part: range(leaf[node] - first[part], next_leaf - first[part])}
        else:  # a test above the parts excludes parts
            parts = range(part, bisect.bisect_left(first, next_leaf))
            chosen = {
                word: range(max(parts.start - 32 * word, 0), min(parts.stop - 32 * word, 32))
                for word in range(parts.start // 32, (parts.stop - 1) // 32 + 1)
            }
        for group, bits in chosen.items():
            groups[group].append((int(rule.threshold[node].view(np.uint32)), asked[node], sum(1 << bit for bit in bits)))
    start = np.cumsum([len(groups) + 1 + len(first), *(3 * len(group) for group in groups)])
    tests = np.array([test for group in groups for test in group], np.int64).reshape(-1)
    return np.concatenate([start, first, tests]).astype(np.uint32)


def _parts(rule: TreeRule) -> list[int]:
    """Return the first leaf of each part of a tree, from left to right. A part is a largest branch of at most PART_LEAVES
    leaves.
    """
    leaf, end = rule.leaf, _leaf_ends(rule)
    first, above = [], [0]
    while above:
        node = above.pop()
        if end[node] - leaf[node] <= PART_LEAVES:
            first.append(int(leaf[node]))
        else:
            above += [int(rule.branch[node]) + 1, int(rule.branch[node])]
    return first


def _leaf_ends(rule: TreeRule) -> NDArray[np.int64]:
    """Return, for each node, the number of the leaf after the last leaf below it."""
    end = rule.leaf + 1
    for node in np.flatnonzero(rule.branch)[::-1].tolist():  # branches follow their node
        end[node] = end[rule.branch[node] + 1]
    return end


def _nodes(rule: TreeRule) -> NDArray[np.uint32]:
    """Return (node, word) as trees_by_item.cl has them."""
    leaf = rule.branch == 0
    threshold = np.where(leaf, NEVER, rule.threshold).astype(np.float32)
    node = np.where(leaf, np.arange(len(leaf)), rule.branch).astype(np.uint32)
    return np.stack([threshold.view(np.uint32), _asked(rule, 6) | node << np.uint32(8)], axis=1)


def _asked(rule: TreeRule, place: int) -> NDArray[np.uint32]:
    """Return the numerator (node) of each test, combined with its denominator from bit `place` on."""
    denominator = np.array([test.denominator for test in tree.EVERY], np.uint32)
    return np.asarray(rule.test | denominator[rule.test] << np.uint32(place), np.uint32)


def snippets(rule: ClassRule) -> tuple[str, ...]:
    """Return the files below opencl/ with the formulas of a rule's features. `joined` and rule.cl follow them."""
    return tuple(feature.SNIPPET for feature in (*BASIC, *(feature for feature, _ in further_features(rule))))


def joined(rule: ClassRule) -> str:
    """Return C source that combines the further features, for rule.cl.

    It defines FURTHER, the number of combined values; WINDOW_SUMS, the number of sums; EACH_WINDOW, which lists the
    windows; and the function `further_of`. Values beyond the end of a feature are replaced by its last value. If all
    windows have the same size, BOX_ROWS and BOX_COLUMNS give it.
    """
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
    """Return the macros of the features' snippets and of rule.cl."""
    basic = {key: value for feature in BASIC for key, value in feature.macros(rule).items()}
    further = {key: value for feature, axis in further_features(rule) for key, value in feature.macros(axis, rule).items()}
    return basic | further | {"KINDS": rule.kinds}


def kernel_arrays(rule: ClassRule, *others: ClassRule) -> tuple[NDArray, ...]:
    """Return the constants of the features, in the order of the kernels' arguments.

    `others` are rules that differ only in what depends on noise: contrast edges and constants of further features. Their
    values follow those of `rule`.
    """
    basic = [
        np.concatenate([contrast.kernel_array(each) for each in (rule, *others)])
        if feature is contrast
        else feature.kernel_array(rule)
        for feature in BASIC
    ]
    return (*basic, *_further_constants(tuple(axis for each in (rule, *others) for axis in each.axes)))


def _further_constants(axes: tuple[Axis, ...]) -> tuple[NDArray[np.int32], ...]:
    return (np.concatenate([axis.constants for axis in axes]),) if axes else ()
