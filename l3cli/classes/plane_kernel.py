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
        "RULED_OUT": len(_tests(rule)),
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
    """(test and 32 leaves, word) as trees.cl has them."""
    tests = []
    for node, asked in zip(np.flatnonzero(rule.branch).tolist(), _asked(rule)[rule.branch > 0].tolist(), strict=True):
        first, end = rule.leaf[[rule.branch[node], rule.branch[node] + 1]].tolist()
        for word in range(first // 32, (end - 1) // 32 + 1):
            bits = range(max(first - 32 * word, 0), min(end - 32 * word, 32))
            tests.append((rule.threshold[node].view(np.uint32), asked | word << 8, sum(1 << bit for bit in bits)))
    return np.array(tests, np.uint32).reshape(-1, 3)


def _nodes(rule: TreeRule) -> NDArray[np.uint32]:
    """(node, word) as trees_by_item.cl has them."""
    leaf = rule.branch == 0
    threshold = np.where(leaf, NEVER, rule.threshold).astype(np.float32)
    node = np.where(leaf, np.arange(len(leaf)), rule.branch).astype(np.uint32)
    return np.stack([threshold.view(np.uint32), _asked(rule) | node << np.uint32(8)], axis=1)


def _asked(rule: TreeRule) -> NDArray[np.uint32]:
    """Numerator (node) of each test and, from bit 6 on, its denominator."""
    denominator = np.array([test.denominator for test in tree.EVERY], np.uint32)
    return np.asarray(rule.test | denominator[rule.test] << 6, np.uint32)
