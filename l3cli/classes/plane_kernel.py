"""How kernels see the rule of a layer that reads planes: files of opencl/, macros for shapes, arrays for values."""

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.layers import PlaneRule
from l3cli.artifacts.structure_rule import DIRECTIONS, GRADIENT, StructureRule
from l3cli.artifacts.tree_rule import TESTS, TreeRule
from l3cli.classes import tree
from l3cli.classes.structure import NOISE_TRACE

NEVER = np.finfo(np.float32).max  # what nothing exceeds: the threshold of leaves


def rule_snippets(rule: PlaneRule) -> tuple[str, dict[str, str]]:
    """The file of a rule's formula, and by variant that of its kernel `structures`."""
    if isinstance(rule, StructureRule):
        return "structure.cl", {"processor": "structures.cl", "graphics": "structures_by_item.cl"}
    return "tree.cl", {"processor": "trees.cl", "graphics": "trees_by_item.cl"}


def rule_macros(rule: PlaneRule) -> dict[str, int]:
    """What formula and kernel are compiled with."""
    if isinstance(rule, StructureRule):
        return {
            "STRENGTHS": rule.strengths,
            "DIRECTIONS": DIRECTIONS,
            "COHERENCE": rule.coherence,
            "GRADIENT_TOP": GRADIENT,
        }
    return {
        "TESTS": TESTS,
        "LEAVES": rule.structures,
        "DEPTH": rule.depth,
        "GRADIENT_TOP": tree.TOP,
        "CHROMA_TOP": tree.CHROMA_TOP,
        "NOISE_TRACE": NOISE_TRACE,
        "DARKEST_LUMINANCE": tree.DARK,
    }


def rule_constants(rule: PlaneRule, variant: str) -> tuple[NDArray[np.uint32], ...]:
    """The constants of the formula, in the order in which the kernels of a variant take them."""
    if isinstance(rule, StructureRule):
        return (rule.strength_edges,)
    return (_tests(rule),) if variant == "processor" else (_nodes(rule), rule.leaf.astype(np.uint32))


def _tests(rule: TreeRule) -> NDArray[np.uint32]:
    """Where the tests of each 32 leaves begin, and where the last end, then three words a test, as trees.cl has them."""
    tests: list[list[tuple[int, int, int]]] = [[] for _ in range(-(-rule.structures // 32))]
    for node, asked in zip(np.flatnonzero(rule.branch).tolist(), _asked(rule, 8)[rule.branch > 0].tolist(), strict=True):
        first, end = rule.leaf[[rule.branch[node], rule.branch[node] + 1]].tolist()
        for word in range(first // 32, (end - 1) // 32 + 1):
            bits = range(max(first - 32 * word, 0), min(end - 32 * word, 32))
            tests[word].append((int(rule.threshold[node].view(np.uint32)), asked, sum(1 << bit for bit in bits)))
    start = np.cumsum([len(tests) + 1, *(3 * len(those) for those in tests)])
    return np.concatenate([start, np.array([test for those in tests for test in those]).reshape(-1)]).astype(np.uint32)


def _nodes(rule: TreeRule) -> NDArray[np.uint32]:
    """(node, word) as trees_by_item.cl has them."""
    leaf = rule.branch == 0
    threshold = np.where(leaf, NEVER, rule.threshold).astype(np.float32)
    node = np.where(leaf, np.arange(len(leaf)), rule.branch).astype(np.uint32)
    return np.stack([threshold.view(np.uint32), _asked(rule, 6) | node << np.uint32(8)], axis=1)


def _asked(rule: TreeRule, place: int) -> NDArray[np.uint32]:
    """Numerator (node) of each test and, from bit `place` on, its denominator."""
    denominator = np.array([test.denominator for test in tree.EVERY], np.uint32)
    return np.asarray(rule.test | denominator[rule.test] << np.uint32(place), np.uint32)
