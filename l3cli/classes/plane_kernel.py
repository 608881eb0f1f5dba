"""Convert class rules to the source files, macros and arrays for the OpenCL kernels."""

import bisect

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.class_rule import ClassRule
from l3cli.artifacts.layers import PlaneRule
from l3cli.artifacts.plane_rules import DIRECTIONS, GRADIENT, TESTS, StructureRule, TreeRule
from l3cli.classes import contrast, tree
from l3cli.classes.features import BASIC, features_of
from l3cli.classes.structure import NOISE_TRACE

PART_LEAVES = 16  # largest number of leaves in a part, a subtree in which all tests are evaluated together
UNREACHABLE_THRESHOLD = np.finfo(np.float32).max  # threshold that no value exceeds, for leaves in the node array


def rule_snippets(rule: PlaneRule) -> tuple[str, dict[str, str]]:
    """Return the OpenCL files that implement the class rule of a refinement layer.

    Returns
    -------
    formula : str
        File with the formula of the class rule.
    kernels : dict of str to str
        File with the kernel `structures` for each variant ("processor" and "graphics").
    """
    if isinstance(rule, StructureRule):
        return "common/structure.cl", {"processor": "cpu/structures.cl", "graphics": "gpu/structures.cl"}
    return "common/tree.cl", {"processor": "cpu/trees.cl", "graphics": "gpu/trees.cl"}


def rule_macros(rule: PlaneRule) -> dict[str, int]:
    """Return the compiler macros for the files from `rule_snippets`."""
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
    """Return the constant arrays for the kernel `structures` of a variant, in the order of its arguments."""
    if isinstance(rule, StructureRule):
        return (rule.strength_edges,)
    return (_tests(rule),) if variant == "processor" else (_nodes(rule), rule.leaf.astype(np.uint32))


def _tests(rule: TreeRule) -> NDArray[np.uint32]:
    """Return the tests of a tree in the layout that cpu/trees.cl describes."""
    first, end = _parts(rule), _leaf_ends(rule).tolist()
    words = -(-len(first) // 32)
    groups: list[list[tuple[int, int, int]]] = [[] for _ in range(words + len(first))]
    leaf, asked = rule.leaf.tolist(), _asked(rule, 8).tolist()
    for node in np.flatnonzero(rule.branch).tolist():
        part, next_leaf = bisect.bisect_right(first, leaf[node]) - 1, leaf[rule.branch[node] + 1]
        if end[node] <= [*first, rule.structures][part + 1]:  # the node is inside a part, and its test excludes leaves
            chosen = {words + part: range(leaf[node] - first[part], next_leaf - first[part])}
        else:  # the node is above the parts, and its test excludes parts
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
    """Divide a tree into its largest subtrees with at most PART_LEAVES leaves, and return each subtree's first leaf."""
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
    """Return, for each node, the index of the last leaf below the node, plus 1."""
    end = rule.leaf + 1
    for node in np.flatnonzero(rule.branch)[::-1].tolist():  # children have higher numbers than their parent
        end[node] = end[rule.branch[node] + 1]
    return end


def _nodes(rule: TreeRule) -> NDArray[np.uint32]:
    """Return the nodes of a tree in the layout that gpu/trees.cl describes: (node, 2)."""
    leaf = rule.branch == 0
    threshold = np.where(leaf, UNREACHABLE_THRESHOLD, rule.threshold).astype(np.float32)
    node = np.where(leaf, np.arange(len(leaf)), rule.branch).astype(np.uint32)
    return np.stack([threshold.view(np.uint32), _asked(rule, 6) | node << np.uint32(8)], axis=1)


def _asked(rule: TreeRule, place: int) -> NDArray[np.uint32]:
    """Pack each node's test into one integer: the numerator in the low bits, the denominator from bit `place` upwards."""
    denominator = np.array([test.denominator for test in tree.EVERY], np.uint32)
    return np.asarray(rule.test | denominator[rule.test] << np.uint32(place), np.uint32)


def snippets(rule: ClassRule) -> tuple[str, ...]:
    """Return the OpenCL files with the formulas of a class rule's features. Kernels include them before rule.cl."""
    return tuple(module.SNIPPET for module in (*BASIC, *(module for module, _ in features_of(rule))))


def joined(rule: ClassRule) -> str:
    """Return the OpenCL source that combines the values of the additional features. rule.cl includes it.

    The source defines the macros COMBINATIONS (number of combinations) and WINDOW_SUMS (number of window sums, at least 1).
    If all windows have the same size, it also defines BOX_ROWS and BOX_COLUMNS. If there are additional features, it also
    defines EACH_WINDOW (the list of windows) and the function `combination_of`.
    """
    windows = [f"add({w.sum}, {w.top}, {w.left}, {w.rows}, {w.columns}, {'+' if w.sign > 0 else '-'})" for w in rule.windows]
    lines = [f"#define COMBINATIONS {rule.combinations}", f"#define WINDOW_SUMS {max(1, rule.window_sums)}"]
    sizes = {(window.rows, window.columns) for window in rule.windows}
    if len(sizes) == 1:
        lines += [f"#define BOX_{name} {size}" for name, size in zip(("ROWS", "COLUMNS"), *sizes, strict=True)]
    if rule.feature_list:
        lines += [f"#define EACH_WINDOW(add) {' '.join(windows)}", combination_function(rule)]
    return "\n".join(lines)


def combination_function(rule: ClassRule) -> str:
    """Return the source of the OpenCL function `combination_of`, which numbers the combination of feature values.

    `combination_of` calls the function in each feature's snippet, and limits the result to the feature's last value.
    """
    lines = [
        "INLINE uints combination_of(const ints *sum, uints level, __global const int *constants) {",
        "    uints combination = 0, value;",
    ]
    sums = constants = 0
    for feature in rule.feature_list:
        last = feature.size - 1
        lines += [
            f"    value = {feature.name}_of(sum + {sums}, level, constants + {constants});",
            f"    combination = combination * {feature.size} + (value > {last} ? (uints){last} : value);",
        ]
        sums, constants = sums + feature.sums, constants + len(feature.constants)
    return "\n".join([*lines, "    return combination;", "}"])


def kernel_macros(rule: ClassRule) -> dict[str, int]:
    """Return the compiler macros for rule.cl and the features' snippets."""
    basic = {key: value for module in BASIC for key, value in module.macros(rule).items()}
    added = {key: value for module, feature in features_of(rule) for key, value in module.macros(feature, rule).items()}
    return basic | added | {"KINDS": rule.kinds}


def kernel_arrays(rule: ClassRule, *others: ClassRule) -> tuple[NDArray, ...]:
    """Return the arrays of constants for the features, in the order of the kernel arguments.

    `others` are the class rules for other noise levels (docs/method.md#noise-sets). They differ from `rule` only in the
    contrast edges and in the constants of additional features. Both are appended to the arrays of `rule`.
    """
    basic = [
        np.concatenate([contrast.kernel_array(each) for each in (rule, *others)])
        if module is contrast
        else module.kernel_array(rule)
        for module in BASIC
    ]
    stored = [each.features.constants for each in (rule, *others) if each.features]
    return (*basic, *([np.concatenate(stored)] if stored else []))
