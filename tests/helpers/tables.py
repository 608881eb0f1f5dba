"""Tables of random weights for cameras with any colour filter array."""

import dataclasses
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from l3cli.artifacts.camera import CameraModel, NoiseScale
from l3cli.artifacts.conditions import Condition, SceneLight
from l3cli.artifacts.layers import COMPARED, PLANES, RATIO_TAPS, Clipping, CoarseChroma, MosaicLayer, PlaneLayer
from l3cli.artifacts.plane_rules import TESTS, GradientScale, StructureRule, TreeRule
from l3cli.artifacts.table import ChromaSmoothing, LeadingComponents, SpectralSmoothing, TransformTable
from l3cli.artifacts.training_set import LightSpectrum, white_signal
from l3cli.classes.decide import label_mosaic
from l3cli.classes.features import ClassRecipe
from l3cli.classes.planes import fixed_point
from l3cli.classes.refinement import plane_evidence
from l3cli.classes.rule import make_rule
from l3cli.classes.tree import EVERY, Evidence
from l3cli.classes.windows import window_channels
from l3cli.frames.frame import RawFrame
from l3cli.physics import spectra
from l3cli.physics.stokes import COLOUR_STOKES
from l3cli.rendering.reference import first_planes
from tests.helpers.cameras import random_camera


def random_case_of_code(channels: int, rng: np.random.Generator) -> np.ndarray:
    """Return a map from saturation codes to a few saturation cases. Code 0 has case 0."""
    cases = rng.integers(0, 4, 2**channels).astype(np.uint16)
    cases[0] = 0
    return cases


def with_first(table: TransformTable, **fields: Any) -> TransformTable:
    """Return the table with other values in `fields` of its first layer."""
    return dataclasses.replace(table, first=dataclasses.replace(table.first, **fields))


def with_refinement(table: TransformTable, *sides: int, seed: int = 1, ratios: int = 0) -> TransformTable:
    """Add refinement layers with random weights and windows of these sides.

    The last layer may have one or two kinds of additional taps (`ratios`).
    """
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
            cases=below.lost_cases,
        )
        classes = sites * rule.classes_per_site
        weights = (rng.normal(size=(classes, outputs, PLANES * side**2)) / side).astype(np.float32)
        samples = np.where(np.arange(classes) % 2, 10.0, 0.0)
        layers.append(PlaneLayer(side, weights, np.zeros((classes, outputs), np.float32), samples, rule))
    if ratios:
        layers[-1] = with_ratios(layers[-1], rng, ratios)
    return dataclasses.replace(table, later=tuple(layers))


def with_components(table: TransformTable, side: int = 5, seed: int = 3) -> TransformTable:
    """Add a layer with random weights that reads three mixtures of the table's outputs and corrects them."""
    basis = np.random.default_rng(seed).normal(size=(len(table.outputs), PLANES)) / len(table.outputs)
    return with_refinement(dataclasses.replace(table, components=LeadingComponents(basis)), side, ratios=True)


def with_stokes_layer(table: TransformTable, side: int = 5) -> TransformTable:
    """Add a layer with random weights and coarse chroma that corrects X, Y, Z, S1 and S2 from the planes S1, Y and S2."""
    basis = np.eye(len(COLOUR_STOKES))[:, [COLOUR_STOKES.index(name) for name in ("S1", "Y", "S2")]]
    components = LeadingComponents(basis)
    return with_coarse_chroma(with_refinement(dataclasses.replace(table, components=components), side, ratios=1))


def with_low_noise(table: TransformTable, *shares: float, seed: int = 9) -> TransformTable:
    """Add transforms with random weights and lower edges for these fractions of the noise."""
    rng, made = np.random.default_rng(seed), []
    rule, features = table.first.rule, table.first.rule.features
    least = np.arange(len(rule.contrast_edges), dtype=np.uint32)[:, None]
    edges = np.maximum((rule.contrast_edges * 0.02).astype(np.uint32), least)
    if features:
        constants = np.where(features.constants > 64, features.constants // 3, features.constants)
        features = dataclasses.replace(features, constants=constants)
    for share in shares or (0.125,):
        first = dataclasses.replace(
            table.first,
            rule=dataclasses.replace(rule, contrast_edges=edges, features=features),
            weights=rng.permutation(table.first.weights),
            intercept=rng.permutation(table.first.intercept),
        )
        scales = [GradientScale(each.rule.gradient_factor[::-1], each.rule.gradient_shift) for each in table.later]
        later = [
            dataclasses.replace(layer.scaled_as(scale), weights=rng.permutation(layer.weights))
            for layer, scale in zip(table.later, scales, strict=True)
        ]
        made.append(Condition.of(first, later, None, NoiseScale(noise_left=share)))
        edges = np.maximum(edges // 2, least)
    return dataclasses.replace(table, conditions=(*made, *table.conditions))


def with_spectra(table: TransformTable, window: int, reach: float) -> TransformTable:
    """Add smoothing of spectra, with positive weights so that the brightness does not depend on small differences."""
    weights, intercept = (np.abs(each) / table.first.rule.patch**2 for each in (table.first.weights, table.first.intercept))
    return dataclasses.replace(
        with_first(table, weights=weights, intercept=intercept), spectra=SpectralSmoothing(window, reach)
    )


def with_smoothed_chroma(table: TransformTable, reach: float = 0.6, likeness: float = 0.4) -> TransformTable:
    """Add smoothing of chroma."""
    return dataclasses.replace(table, chroma_smoothing=ChromaSmoothing(reach, likeness))


def with_lights(table: TransformTable, *lights: str, seed: int = 5) -> TransformTable:
    """Add transforms with random weights for each given illuminant."""
    rng = np.random.default_rng(seed)

    def changed(layer: Any) -> Any:
        return dataclasses.replace(layer, weights=rng.permutation(layer.weights), intercept=rng.permutation(layer.intercept))

    grid = np.arange(400.0, 701.0, 10.0)
    sets = []
    for name in lights:
        light = LightSpectrum(grid, spectra.illuminant(name, grid).astype(np.float32))
        white = np.append(spectra.white_point(name), np.ones(len(table.outputs) - 3))
        first, later = changed(table.first), tuple(map(changed, table.later))
        sets.append(Condition.of(first, later, SceneLight(name, white, light), None))
    return dataclasses.replace(table, conditions=(*table.conditions, *sets))


def with_coarse_chroma(table: TransformTable, variance: float = 0.05) -> TransformTable:
    """Add coarse chroma to the last layer. `variance` is the noise variance in the dark; bright areas have slightly more."""
    terms = variance * np.random.default_rng(8).uniform(0.3, 1, COMPARED) * (1.0, 0.2, 0.02)
    last = dataclasses.replace(table.later[-1], coarse_chroma=CoarseChroma(terms))
    return dataclasses.replace(table, later=(*table.later[:-1], last))


def with_clipping(table: TransformTable, seed: int = 9) -> TransformTable:
    """Add a random replacement of uniform clipped areas to a table with coarse chroma."""
    size = len(table.channels) + 1
    rng = np.random.default_rng(seed)
    clipping = Clipping(rng.uniform(-0.5, 1, (size, size, len(table.outputs))), rng.uniform(0.4, 1, size - 1))
    return dataclasses.replace(table, later=(*table.later[:-1], dataclasses.replace(table.later[-1], clipping=clipping)))


def with_clipped_white(table: TransformTable, luminance: float) -> TransformTable:
    """Return the table of a camera and illuminant whose clipped white has this luminance."""
    camera = random_camera(table.cfa, len(table.channels), table.bits, table.black_level)
    wavelength, radiance = camera.wavelength, np.ones(camera.wavelength.size, np.float32)
    weakest = white_signal(LightSpectrum(wavelength, radiance), camera, table.output_unit).min()
    light = LightSpectrum(wavelength, (radiance / (weakest * luminance)).astype(np.float32))
    camera = dataclasses.replace(camera, channels=table.channels)
    return dataclasses.replace(table, camera=camera, light=light)


def with_ratios(layer: PlaneLayer, rng: np.random.Generator, kinds: int = 1) -> PlaneLayer:
    """Add random weights for colour-ratio taps and, with two kinds, for bilateral-chroma taps."""
    after = (rng.normal(size=(*layer.weights.shape[:2], RATIO_TAPS[kinds])) / layer.side).astype(np.float32)
    return dataclasses.replace(layer, weights=np.concatenate([layer.weights, after], axis=2))


def with_tree(table: TransformTable, side: int = 3, leaves: int = 40, seed: int = 1, ratios: int = 0) -> TransformTable:
    """Add a second layer with random weights whose classes are the leaves of a random tree.

    The tree is built so that a random frame reaches its leaves. Sites are turned to random orientations.
    """
    rng = np.random.default_rng(seed)
    sites, outputs, below = table.cfa.size, len(table.outputs), table.first.rule
    factor = rng.integers(64, 128, below.levels).astype(np.uint8)
    shift = rng.integers(3, 12, below.levels).astype(np.uint8)
    frame = frame_of_all_levels(table, rng, (157, 190))
    label = label_mosaic(frame.values, below, table.cfa, len(table.channels), frame.phase)
    place = below.split(label)
    seen = plane_evidence(first_planes(frame, label, table, fixed_point(table)), place.level, factor, shift)
    free = below.case(place.kind) == 0
    tree = random_tree(Evidence(seen.numerators[:, free], seen.denominators[:, free]), leaves, rng)
    rule = TreeRule(factor, shift, *tree, rng.integers(0, 8, sites).astype(np.uint8), below.cases)
    classes = sites * rule.classes_per_site
    weights = (rng.normal(size=(classes, outputs, PLANES * side**2)) / side).astype(np.float32)
    samples = np.where(np.arange(classes) % 2, 10.0, 0.0)
    layer = PlaneLayer(side, weights, np.zeros((classes, outputs), np.float32), samples, tree=rule)
    return dataclasses.replace(table, later=(with_ratios(layer, rng, ratios) if ratios else layer,))


def frame_of_all_levels(
    table: TransformTable, rng: np.random.Generator, shape: tuple[int, int], phase: tuple[int, int] = (0, 0)
) -> RawFrame:
    """Return a frame with uniform areas and fine texture that is dark on the left and saturated on the right."""
    level = np.geomspace(0.002, 1.5, shape[1]) * (table.white_level - table.black_level)
    blocks = rng.normal(size=(shape[0] // 8 + 1, shape[1] // 8 + 1)).repeat(8, 0).repeat(8, 1)[: shape[0], : shape[1]]
    values = table.black_level + level * (1 + 0.2 * blocks + 0.2 * rng.normal(size=shape) * (blocks > 0))
    raw = np.clip(values, 0, 2**table.bits - 1).astype(np.uint16)
    return RawFrame("all levels", raw, table.black_level, table.white_level, phase)


def random_tree(
    seen: Evidence, leaves: int, rng: np.random.Generator
) -> tuple[NDArray[np.uint8], NDArray[np.float32], NDArray[np.int32]]:
    """Return tests, thresholds and branches (node) of a random tree.

    The leaf with the most pixels is split again and again, by a random test that some of its pixels pass. So no leaf is
    empty.
    """
    quotient = (seen.numerators / seen.denominators[[test.denominator for test in EVERY]]).reshape(TESTS, -1)
    test, threshold, branch, pixels = [0], [0.0], [0], [np.arange(quotient.shape[1])]
    while len(test) < 2 * leaves - 1:
        node = max(range(len(test)), key=lambda each: 0 if branch[each] else pixels[each].size)
        asked = int(rng.integers(TESTS))
        values = quotient[asked, pixels[node]]
        limit = np.quantile(values, rng.uniform(0.3, 0.7)).astype(np.float32)
        above = values > limit
        if above.all() or not above.any():
            continue
        test[node], threshold[node], branch[node] = asked, float(limit), len(test)
        for side in (~above, above):
            test, threshold, branch = [*test, 0], [*threshold, 0.0], [*branch, 0]
            pixels.append(pixels[node][side])
    return np.array(test, np.uint8), np.array(threshold, np.float32), np.array(branch, np.int32)


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
    **features: Any,
) -> TransformTable:
    """Return a table of random weights with outputs of about 0 to 1.

    With `wild`, contrast edges may have any 32-bit value. `features` maps names of features to their keys in the recipe.
    """
    rng = np.random.default_rng(seed)
    channels = int(np.max(cfa)) + 1
    camera = random_camera(cfa, channels, bits, black_level)
    case_of_code = rng.integers(0, 5, 2**channels).astype(np.uint16)
    case_of_code[0] = 0  # Classes depend on chroma, structure and leaf only in case 0, without clipping.
    recipe = ClassRecipe(
        patch=patch,
        levels=7,
        lowest_level=0.02,
        contrasts=contrasts,
        saturation_radius=min(2, patch // 2),
        **features,
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


def colorimetric_table(camera: CameraModel, light: str = "D65") -> TransformTable:
    """Return a table that renders uniform areas with one colour matrix at all levels.

    The matrix gives the best colours of surfaces under `light`, with exact white.
    """
    wavelength = camera.wavelength
    radiance = spectra.illuminant(light, wavelength)
    surfaces = spectra.reflectance_library(wavelength)[::10]
    surfaces = np.vstack([surfaces, np.ones(wavelength.size) * 100])  # white counts most
    signals, white = (surfaces * radiance) @ camera.electron_weights.T, camera.electron_weights @ radiance
    xyz = (surfaces * radiance) @ spectra.xyz_weights(wavelength).T / (spectra.xyz_weights(wavelength)[1] @ radiance)
    matrix = np.linalg.lstsq(signals / white.max(), xyz, rcond=None)[0].T
    table = random_table(camera.cfa, camera.bits, camera.black_level, 5)
    channel = window_channels(camera.cfa, 5)
    of_site = np.array([matrix[:, taps] / np.bincount(taps)[taps] for taps in channel]).astype(np.float32)
    case_of_code = np.maximum(table.first.rule.case_of_code, 1)
    case_of_code[0] = 0  # no channel clips
    saturation = int(camera.black_level + 0.98 * (camera.white_level - camera.black_level))
    rule = dataclasses.replace(table.first.rule, case_of_code=case_of_code, saturation=saturation)
    weights = np.repeat(of_site, rule.classes_per_site, axis=0)
    shown = matrix @ (white / white.max())
    spectrum = LightSpectrum(wavelength, radiance.astype(np.float32))
    made = dataclasses.replace(
        table, channels=camera.channels, camera_name=camera.name, white_level=camera.white_level, camera=camera,
        light=spectrum, white_point=shown / shown[1], exposure=0.01,
    )  # fmt: skip
    return with_first(made, rule=rule, weights=weights, intercept=np.zeros_like(table.first.intercept))
