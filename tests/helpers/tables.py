"""Tables of random weights, for cameras of any colour filter array."""

import dataclasses
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from l3cli.artifacts.layers import MosaicLayer, PlaneLayer
from l3cli.artifacts.structure_rule import StructureRule
from l3cli.artifacts.table import TransformTable
from l3cli.classes.recipe import ClassRecipe
from l3cli.classes.rule import make_rule
from tests.helpers.cameras import random_camera


def random_case_of_code(channels: int, rng: np.random.Generator) -> np.ndarray:
    """A saturation-case map with a few cases, code 0 being case 0."""
    cases = rng.integers(0, 4, 2**channels).astype(np.uint16)
    cases[0] = 0
    return cases


def with_first(table: TransformTable, **fields: Any) -> TransformTable:
    """The table with other values in `fields` of its first layer."""
    return dataclasses.replace(table, first=dataclasses.replace(table.first, **fields))


def with_later(table: TransformTable, *sides: int, seed: int = 1) -> TransformTable:
    """The table with later layers of random weights, whose windows have these sides."""
    rng = np.random.default_rng(seed)
    sites, outputs, below = table.cfa.size, len(table.outputs), table.first.rule
    layers = []
    for step, side in enumerate(sides, 1):
        rule = StructureRule(
            level_step=step,
            gradient_factor=rng.integers(64, 128, below.levels).astype(np.uint8),
            gradient_shift=rng.integers(4, 16, below.levels).astype(np.uint8),
            strength_edges=np.arange(1, 3 + step, dtype=np.uint32) * 1000,
            coherence=24,
            turns=rng.choice([-1, 1], (sites, 2)).astype(np.int8),
            cases=below.cases,
        )
        classes = sites * rule.classes_per_site
        weights = (rng.normal(size=(classes, outputs, outputs * side**2)) / side).astype(np.float32)
        samples = np.where(np.arange(classes) % 2, 10.0, 0.0)
        layers.append(PlaneLayer(side, weights, np.zeros((classes, outputs), np.float32), samples, rule))
    return dataclasses.replace(table, later=tuple(layers))


XYZ = ("X", "Y", "Z")


def random_table(
    cfa: ArrayLike,
    bits: int = 12,
    black_level: float = 0.0,
    patch: int = 5,
    outputs: tuple[str, ...] = XYZ,
    contrasts: tuple[float, ...] = (1.4,),
    wild: bool = False,
    seed: int = 1,
    **further: Any,
) -> TransformTable:
    """A table of random weights with outputs of about 0…1; `wild`: contrast edges anywhere in 32 bits; `further`: keys of
    further features by their names."""
    rng = np.random.default_rng(seed)
    channels = int(np.max(cfa)) + 1
    camera = random_camera(cfa, channels, bits, black_level)
    case_of_code = rng.integers(0, 5, 2**channels).astype(np.uint16)
    recipe = ClassRecipe(
        patch=patch,
        levels=7,
        lowest_level=0.02,
        contrasts=contrasts,
        saturation_radius=min(2, patch // 2),
        **further,
    )
    centres = rng.dirichlet(np.ones(channels), int(rng.integers(1, 9)))
    rule = make_rule(recipe, camera, case_of_code, centres)
    if wild:
        edges = np.exp2(rng.uniform(8, 32, rule.contrast_edges.shape)).astype(np.uint32)
        rule = dataclasses.replace(rule, contrast_edges=np.sort(edges, axis=0))
    classes = camera.cfa.size * rule.classes_per_site
    return TransformTable(
        camera_name=camera.name,
        rows=camera.rows,
        cols=camera.cols,
        channels=camera.channels,
        cfa=camera.cfa,
        bits=bits,
        black_level=camera.black_level,
        white_level=camera.white_level,
        outputs=outputs,
        target_description="",
        output_unit=1.0,
        white_point=np.array([0.9505, 1.0, 1.089, *np.ones(16)])[: len(outputs)],
        first=MosaicLayer(
            rule=rule,
            weights=((1 + rng.normal(size=(classes, len(outputs), patch**2))) / patch**2).astype(np.float32),
            intercept=rng.normal(scale=0.05, size=(classes, len(outputs))).astype(np.float32),
            samples=np.ones(classes),
            condition=np.ones(classes, np.float32),
        ),
    )
