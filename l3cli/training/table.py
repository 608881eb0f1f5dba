"""The training room's front: what the command calls, in the order it calls it."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import msgspec
import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.camera import CameraModel, NoiseScale
from l3cli.artifacts.class_rule import ClassRule
from l3cli.artifacts.partial_sums import ClassSums, LayerSums
from l3cli.artifacts.schema import Stage
from l3cli.artifacts.table import (
    Condition,
    LeadingComponents,
    MosaicLayer,
    PlaneLayer,
    PlaneRule,
    SpectralSmoothing,
    TransformTable,
)
from l3cli.artifacts.training_set import LightSpectrum, TrainingPair, TrainingSet, white_signal
from l3cli.classes.chroma import channel_shares, choose_chromas
from l3cli.classes.decide import observe_patches
from l3cli.classes.planes import fixed_point, planes_basis
from l3cli.classes.rule import make_rule
from l3cli.classes.saturation import choose_cases, saturation_codes, spared_cases
from l3cli.classes.windows import neighbourhoods
from l3cli.errors import InputFileError
from l3cli.physics import spectra
from l3cli.physics.display import XYZ
from l3cli.training.clipping import learned_clipping
from l3cli.training.goal import has_components, one_light
from l3cli.training.layers.coarse_chroma import measured_noise
from l3cli.training.layers.learn import LayerPass, learn_layer
from l3cli.training.patches import expose_patches, levels_at, patches_of
from l3cli.training.plain_surfaces import false_colours, stripe_shares
from l3cli.training.recipe import LearningRecipe, TrainingRecipe, for_noise
from l3cli.training.solve import Solution, equal_responses, solve
from l3cli.training.sums import add, empty_sums, grid_steps, require_exact
from l3cli.training.symmetry import site_maps, turned_classes, turns_of
from l3cli.training.training_pass import TrainingPass, at_noise, brightness_of

PILOT_PATCHES = 4000  # patches a site over all frames that decide which saturation cases are kept


@dataclass(frozen=True)
class Pilot:
    """Sample of some frames from which the class rule is chosen."""

    occurrences: NDArray[np.int64]  # (code) of each saturation code
    shares: NDArray[np.float64]  # (patch, channel)
    whites: NDArray[np.float64]  # (frame, output) of their lights, each at Y = 1
    lights: NDArray[np.float64]  # (frame, wavelength) of a white of 1 cd/m², on spectra.light_grid; NaN: not known
    exposures: NDArray[np.float64]  # (frame) s; real pairs, whose dark current is off already: 0
    observed: dict[str, NDArray[np.float64]]  # (patch, …) what each further feature asks for


def take_pilot(
    frames: Iterable[TrainingPair], first: int, patches: Sequence[int], head: TrainingSet, recipe: TrainingRecipe, seed: int
) -> Pilot:
    """Return a pilot sample of `frames`, the first of which has the index `first`, of so many `patches` (frame)."""
    camera = head.camera
    codes = 2 ** len(camera.channels)
    rule = make_rule(recipe.classes, camera, np.zeros(codes, dtype=np.uint16))
    neighbours = neighbourhoods(camera.cfa, rule.patch, len(camera.channels))
    canonical = canonical_sites(head, rule, recipe.learning)
    occurrences = np.zeros(codes, dtype=np.int64)
    shares, whites, lights, exposures, observed = [], [], [], [], []
    for index, (frame, count) in enumerate(zip(frames, patches, strict=True), first):
        whites.append(_unit_white(frame, head.outputs))
        lights.append(_light_of(frame, camera))
        exposures.append(frame.dark_time)
        dark = _dark_signal(frame, camera)
        for site in canonical:
            rng = np.random.default_rng([seed, 0, index, site])
            pilot = patches_of(frame, head, neighbours, site, count, rng, recipe.learning.symmetry)
            patch_level = np.maximum(pilot.signal.mean(axis=1), 1e-3)
            scale = pilot.possible(levels_at(recipe.learning, rng.random(len(patch_level))) / patch_level)[:, None]
            carried = None if pilot.carried is None else (pilot.carried * scale**2).astype(np.float32)
            signal = (pilot.signal * scale).astype(np.float32)
            values = expose_patches(signal, camera, rng, carried, dark, neighbours.channel[site])
            occurrences += np.bincount(saturation_codes(values, rule, neighbours, site), minlength=codes)
            shares.append(channel_shares(pilot.signal, neighbours, site))
            observed.append(observe_patches(values, rule, neighbours, site))
    about = np.array(whites), np.array(lights), np.array(exposures)
    return Pilot(occurrences, np.concatenate(shares), *about, _joined(observed))


def pilot_patches(patches: Sequence[int]) -> list[int]:
    """Return patches (frame) a site of the pilot sample of frames that have `patches` (frame)."""
    total = sum(patches)
    return [-(-PILOT_PATCHES * share // total) for share in patches]


def survey(
    pilots: Iterable[Pilot], patches: Sequence[int], head: TrainingSet, recipe: TrainingRecipe, seed: int
) -> tuple[ClassRule, NDArray[np.float64], float, LightSpectrum | None]:
    """Return the class rule for `head.camera`, its saturation cases and chroma centres from the pilots of all frames in
    order, the mean white point (output) of their lights, the mean exposure time (s) of those that are simulated and the mean
    light, if all are known; frames count as they have `patches` (frame)."""
    every = list(pilots)
    filters = range(len(head.camera.channels)) if head.camera.readout is None else head.camera.readout.same_filter.tolist()
    occurrences = np.sum([pilot.occurrences for pilot in every], axis=0)
    case_of_code = choose_cases(occurrences, recipe.classes.max_cases, filters)
    light = _mean_light(np.concatenate([pilot.lights for pilot in every]), patches, head.camera)
    single = one_light(light) if head.outputs == XYZ else None
    white = white_signal(single, head.camera) if single is not None else None
    centres = choose_chromas(np.concatenate([pilot.shares for pilot in every]), recipe.classes.chromas, seed, white)
    if centres is not None and white is not None and single is not None:
        stripes = false_colours(head.camera, single.wavelength, single.radiance.astype(np.float64))
        centres = np.concatenate([stripe_shares(white, stripes), centres])
    whites = np.concatenate([pilot.whites for pilot in every])
    exposures = np.concatenate([pilot.exposures for pilot in every])
    counts = np.where(exposures > 0, patches, 0)
    exposure = float(exposures @ counts / max(counts.sum(), 1))
    observed = _joined([pilot.observed for pilot in every])
    dark, protected = head.camera.dark_signal(exposure), spared_cases(case_of_code, filters)
    rule = make_rule(recipe.classes, head.camera, case_of_code, centres, dark, observed, protected)
    return rule, np.average(whites, axis=0, weights=patches), exposure, light


def _mean_light(lights: NDArray[np.float64], patches: Sequence[int], camera: CameraModel) -> LightSpectrum | None:
    mean = np.average(lights, axis=0, weights=patches)
    if not np.isfinite(mean).all():
        return None
    spread = np.abs(lights - mean).sum(axis=1).max() / max(mean.sum(), 1e-30)
    return LightSpectrum(spectra.light_grid(camera.wavelength).astype(np.float64), mean.astype(np.float32), float(spread))


def _joined(observed: list[dict[str, NDArray[np.float64]]]) -> dict[str, NDArray[np.float64]]:
    return {name: np.concatenate([part[name] for part in observed]) for name in observed[0]}


def canonical_sites(head: TrainingSet, rule: ClassRule, recipe: LearningRecipe) -> list[int]:
    """Return the sites that are trained; all others are their rotations or mirror images."""
    neighbours = neighbourhoods(head.camera.cfa, rule.patch, len(head.camera.channels))
    return sorted({site_map.canonical for site_map in site_maps(neighbours.channel, rule.patch, recipe.symmetry)})


def add_up(pass_: TrainingPass, parts: Iterable[ClassSums]) -> ClassSums:
    """Return the sums of all parts; L3Error if a class has more patches than can be added exactly."""
    outputs = len(pass_.head.outputs)
    sums = empty_sums(pass_.rule, outputs)
    for part in parts:
        add(sums, part)
    require_exact(sums, pass_.rule, grid_steps(pass_.rule, pass_.head.camera, outputs))
    return sums


def learn_site(pass_: TrainingPass, parts: Iterable[ClassSums], site: int) -> Solution:
    """Return solutions of one canonical site from the sums of all parts of a pass, in whatever order; L3Error as add_up."""
    sums = add_up(pass_, parts)
    camera, rule = pass_.head.camera, pass_.rule
    window = neighbourhoods(camera.cfa, rule.patch, len(camera.channels)).channel[site]
    return solve(sums, rule, window, turns_of(rule, window, pass_.recipe.symmetry), pass_.recipe, pass_.goal)


# Long: a table has many fields, and each is named.
def assemble(pass_: TrainingPass, solutions: dict[int, Solution], history: tuple[Stage, ...]) -> TransformTable:
    """Return the table of all sites from the solutions of the canonical ones."""
    head, rule, camera = pass_.head, pass_.rule, pass_.head.camera
    neighbours = neighbourhoods(camera.cfa, rule.patch, len(camera.channels))
    maps = site_maps(neighbours.channel, rule.patch, pass_.recipe.symmetry)
    copies = [sum(site_map.canonical == site for site_map in maps) for site in solutions]
    equal = equal_responses(list(solutions.values()), copies, rule, pass_.recipe, pass_.goal)
    transforms = dict(zip(solutions, equal, strict=True))
    weights, intercept, samples, condition = [], [], [], []
    for site_map in maps:
        trained = transforms[site_map.canonical]
        turned = np.empty_like(trained.weights)
        turned[..., site_map.permutation] = trained.weights
        classes = turned_classes(rule, site_map.permutation)
        weights.append(turned[classes])
        intercept.append(trained.intercept[classes])
        samples.append(trained.samples[classes])
        condition.append(trained.condition[classes])
    return TransformTable(
        history=history,
        camera_name=camera.name,
        rows=camera.rows,
        cols=camera.cols,
        channels=camera.channels,
        cfa=camera.cfa,
        bits=camera.bits,
        black_level=camera.black_level,
        white_level=camera.white_level,
        outputs=head.outputs,
        output_unit=camera.output_unit,
        target_description=head.target_description,
        white_point=pass_.white_point,
        first=MosaicLayer(
            rule,
            np.concatenate(weights).astype(np.float32),
            np.concatenate(intercept).astype(np.float32),
            np.concatenate(samples),
            np.concatenate(condition).astype(np.float32),
        ),
        exposure=pass_.exposure,
        light=pass_.light,
        camera=replace(camera, fit=None),
        spectra=_spectra(head, pass_.recipe),
        components=_components(head, solutions, copies, pass_.white_point),
    )


def _spectra(head: TrainingSet, recipe: LearningRecipe) -> SpectralSmoothing | None:
    """Return the smoothing of spectra; None for other outputs."""
    if not recipe.spectral_window or len(head.outputs) == 1 or not spectra.is_spectrum(head.outputs, head.camera.channels):
        return None
    return SpectralSmoothing(recipe.spectral_window, recipe.spectral_reach)


def _components(
    head: TrainingSet, solutions: dict[int, Solution], copies: list[int], white: NDArray[np.float64]
) -> LeadingComponents | None:
    """Return the mean of the outputs over those of a white, and what else varies most of these, as the second plane and
    those beside it; None if they are no spectrum. Rounded: no two machines find the same vectors."""
    if not has_components(head):
        return None
    targets = np.average([each.outputs for each in solutions.values()], axis=0, weights=copies) / np.outer(white, white)
    without_mean = np.eye(white.size) - 1 / white.size
    vectors = np.linalg.eigh(without_mean @ targets @ without_mean)[1]
    first, second = (each * np.sign(each[np.abs(each).argmax()]) for each in (vectors[:, -1], vectors[:, -2]))
    basis = np.stack([first, np.full(white.size, white.size**-0.5), second], axis=1) * white.size**-0.5
    return LeadingComponents(np.rint(basis / white[:, None] * 2**20) / 2**20)


def _light_of(frame: TrainingPair, camera: CameraModel) -> NDArray[np.float64]:
    grid = spectra.light_grid(camera.wavelength)
    if frame.light is None:
        return np.full(grid.size, np.nan)
    return np.asarray(spectra.resample(frame.light.radiance.astype(np.float64), frame.light.wavelength, grid), np.float64)


def _dark_signal(frame: TrainingPair, camera: CameraModel) -> float:
    """Return DN of dark current in a frame; InputFileError if that fills its pixels."""
    dark = camera.dark_signal(frame.dark_time)
    if not dark < camera.white_level - camera.black_level:
        raise InputFileError(
            f"frame of scene {frame.scene}: in {frame.dark_time:.4g} s dark current alone fills a pixel; expose shorter"
        )
    return dark


def _unit_white(frame: TrainingPair, outputs: tuple[str, ...]) -> NDArray[np.float64]:
    """Return white (output) of a frame's light at Y = 1, or at a mean of 1 where no output is called Y."""
    size = float(brightness_of(frame.white, outputs))
    if frame.white.size != len(outputs) or size <= 0:
        raise InputFileError(f"white of scene {frame.scene} is not a positive white of the outputs {', '.join(outputs)}")
    return frame.white / size


# ------------------------------------------------------------------------------------------- further layers and noises


def layer_pass(table: TransformTable, recipe: TrainingRecipe, mosaics: tuple[int, ...], seed: int) -> LayerPass:
    """Return the pass that learns the next layer on a table."""
    assert table.camera is not None  # tables have had one since there are layers
    own = recipe.layer[len(table.later)]
    powers = {"brightness_power": own.brightness_power, "error_power": own.error_power}
    learning = for_noise(recipe, table.camera).learning
    learning = msgspec.structs.replace(learning, **{name: each for name, each in powers.items() if each is not None})
    return LayerPass(
        camera=table.camera,
        rule=table.first.rule,
        fixed=fixed_point(table),
        basis=planes_basis(table),
        outputs=table.first if table.components else None,
        white_point=table.white_point,
        grey=np.asarray(table.camera.sensitivity) if table.light is None else white_signal(table.light, table.camera),
        before=table.later,
        recipe=own,
        learning=learning,
        mosaics=mosaics,
        pictures=table.outputs == XYZ,
        exposure=table.exposure,
        seed=seed,
    )


def finished_layer(layer: LayerPass, rule: PlaneRule, sums: dict[int, LayerSums], table: TransformTable) -> PlaneLayer:
    """Return the layer that follows those of `table`, from the sums of all canonical sites; beside coarse chroma with the
    noise of what that compares, and with what plain clipped areas become."""
    learned = learn_layer(layer, rule, sums)
    if not layer.recipe.coarse_chroma:
        return learned
    clipping = learned_clipping(layer.camera, table.light, table.white_point) if layer.pictures else None
    return replace(learned, coarse_chroma=measured_noise(layer), clipping=clipping)


def passes_of(usual: TrainingPass, recipe: TrainingRecipe) -> list[TrainingPass]:
    """Return the usual pass, and those beside it for each other noise that the recipe wants."""
    return [usual, *(at_noise(usual, noise, recipe.classes) for noise in recipe.learning.noises)]


def with_noises(usual: TransformTable, tables: Sequence[TransformTable], noises: Sequence[NoiseScale]) -> TransformTable:
    """Return the usual table with others as its transforms for these noises."""
    conditions = (Condition.of(each.first, each.later, None, noise) for each, noise in zip(tables, noises, strict=True))
    return replace(usual, conditions=tuple(conditions))


def by_noise(table: TransformTable) -> list[TransformTable]:
    """Return the transforms of a table of no single lights at each noise, those for the camera's first, as tables."""
    return [replace(table, conditions=()), *map(table.under, table.conditions)]
