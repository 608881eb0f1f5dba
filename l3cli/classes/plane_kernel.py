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
        "NODES": len(rule.branch),
        "DEPTH": rule.depth,
        "KINDS": rule.kinds,
        "GRADIENT_TOP": tree.TOP,
        "CHROMA_TOP": tree.CHROMA_TOP,
        "NOISE_TRACE": NOISE_TRACE,
        "DARKEST_LUMINANCE": tree.DARK,
    }


def rule_constants(rule: PlaneRule) -> tuple[NDArray[np.uint32], ...]:
    """The constants of the formula, in the order in which kernels take them."""
    if isinstance(rule, StructureRule):
        return (rule.strength_edges,)
    return _nodes(rule), rule.leaf.astype(np.uint32)


def _nodes(rule: TreeRule) -> NDArray[np.uint32]:
    """(site, node, word) as tree.cl has them, each site in the orientation that it is learned in."""
    number, leaf = np.arange(len(rule.branch), dtype=np.uint32), rule.branch == 0
    denominator = np.array([test.denominator for test in tree.EVERY], np.uint32)[rule.test]
    words = np.empty((len(rule.turns), len(number), 2), np.uint32)
    words[..., 0] = np.where(leaf, NEVER, rule.threshold).astype(np.float32).view(np.uint32)
    for site, turn in enumerate(rule.turns.tolist()):
        test, sign = (np.array(each)[rule.test] for each in tree.turned_tests(turn))
        node = np.where(leaf, number, rule.branch) + np.uint32(site * len(number))
        words[site, :, 1] = (
            test.astype(np.uint32) | (sign < 0).astype(np.uint32) << 5 | denominator << 6 | node.astype(np.uint32) << 8
        )
    return words
