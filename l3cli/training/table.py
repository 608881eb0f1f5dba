"""The public functions of the training package, in the order in which `l3 train` calls them.

Training has these steps (docs/method.md#training):

1. **Pilot.** `take_pilot` samples a few patches from each frame. From these samples, `survey` determines the class rule, by
   which patches are assigned to classes.
2. **First pass.** Every patch is added to the sums of its class. Each class is then solved by least squares.
3. **Second pass.** The patches are summed again. Each sample now has a weight that depends on how visible its error was in
   the first pass (docs/method.md#second-pass). Without these weights, least squares would mainly reduce the few largest
   errors, although they are not the most visible ones.
4. **Refinement layers.** The layers are trained one after another, because each layer is trained on the output of the
   previous layers.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import msgspec
import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.camera import CameraModel, NoiseScale
from l3cli.artifacts.class_rule import ClassRule
from l3cli.artifacts.conditions import Condition
from l3cli.artifacts.layers import MosaicLayer, PlaneLayer, PlaneRule
from l3cli.artifacts.partial_sums import ClassSums, LayerSums
from l3cli.artifacts.schema import Stage
from l3cli.artifacts.table import ChromaSmoothing, LeadingComponents, SpectralSmoothing, TransformTable
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
from l3cli.physics.stokes import COLOUR_STOKES, STOKES, has_stokes
from l3cli.training.clipping import learned_clipping
from l3cli.training.goal import has_components, one_light
from l3cli.training.layers.coarse_chroma import measured_noise
from l3cli.training.layers.learn import LayerPass, learn_layer
from l3cli.training.lines import LineNoise
from l3cli.training.patches import expose_patches, levels_at, patches_of
from l3cli.training.plain_surfaces import false_colours, stripe_shares
from l3cli.training.recipe import LearningRecipe, TrainingRecipe, for_noise
from l3cli.training.solve import Solution, equal_responses, solve
from l3cli.training.sums import add, empty_sums, grid_steps, require_exact
from l3cli.training.symmetry import site_maps, turned_classes, turns_of
from l3cli.training.training_pass import TrainingPass, at_noise, brightness_of

PILOT_PATCHES = 4000  # number of pilot patches per site, over all frames


@dataclass(frozen=True)
class Pilot:
    """Statistics of a small sample of training patches. They determine the class rule."""

    occurrences: NDArray[np.int64]  # (code) number of patches with each saturation code (a bit per clipped channel)
    shares: NDArray[np.float64]  # (patch, channel) channel fractions
    whites: NDArray[np.float64]  # (frame, output) outputs of a perfect white under the frame's illuminant, with Y = 1
    # (frame, wavelength) radiance of a white of 1 cd/m² on spectra.light_grid, or NaN if the illuminant is unknown
    lights: NDArray[np.float64]
    exposures: NDArray[np.float64]  # (frame) in s; 0 for real pairs, because their dark signal is already subtracted
    observed: dict[str, NDArray[np.float64]]  # name of a class feature → (patch, …) measured values of this feature


def take_pilot(
    frames: Iterable[TrainingPair], first: int, patches: Sequence[int], head: TrainingSet, recipe: TrainingRecipe, seed: int
) -> Pilot:
    """Measure a small random sample of patches from training frames.

    Parameters
    ----------
    frames : iterable of TrainingPair
        Training frames.
    first : int
        Index of the first frame.
    patches : sequence of int
        Number of patches per site from each frame.
    head : TrainingSet
        Properties common to all training frames, such as the camera and the outputs.
    recipe : TrainingRecipe
        Class recipe.
    seed : int
        Random seed.

    Returns
    -------
    Pilot
    """
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
            pilot = patches_of(frame, head, neighbours, site, count, rng, recipe.learning.orientations(head.camera))
            patch_level = np.maximum(pilot.signal.mean(axis=1), 1e-3)
            scale = pilot.possible(levels_at(recipe.learning, rng.random(len(patch_level))) / patch_level)[:, None]
            carried = None if pilot.carried is None else (pilot.carried * scale**2).astype(np.float32)
            signal = (pilot.signal * scale).astype(np.float32)
            lines, offsets = LineNoise.of(camera, dark), None
            if lines is not None:
                lacking = pilot.lacking_share(scale[:, 0].astype(np.float32))
                offsets = lines.drawn_for_taps(np.arange(rule.patch**2), rule.patch, lacking, rng).transposed()
            values = expose_patches(signal, camera, rng, carried, dark, neighbours.channel[site], offsets)
            occurrences += np.bincount(saturation_codes(values, rule, neighbours, site), minlength=codes)
            shares.append(channel_shares(pilot.signal, neighbours, site))
            observed.append(observe_patches(values, rule, neighbours, site))
    about = np.array(whites), np.array(lights), np.array(exposures)
    return Pilot(occurrences, np.concatenate(shares), *about, _joined(observed))


def pilot_patches(patches: Sequence[int]) -> list[int]:
    """Divide the pilot patches per site among the frames, in proportion to each frame's number of training patches."""
    total = sum(patches)
    return [-(-PILOT_PATCHES * share // total) for share in patches]


def survey(
    pilots: Iterable[Pilot], patches: Sequence[int], head: TrainingSet, recipe: TrainingRecipe, seed: int
) -> tuple[ClassRule, NDArray[np.float64], float, LightSpectrum | None]:
    """Determine the class rule, the white and the illuminant from the pilot samples.

    Parameters
    ----------
    pilots : iterable of Pilot
        Samples of all frames, in the order of the frames.
    patches : sequence of int
        Number of training patches from each frame. Means over frames are weighted by this number.
    head : TrainingSet
        Properties common to all training frames, such as the camera and the outputs.
    recipe : TrainingRecipe
        Class recipe.
    seed : int
        Random seed.

    Returns
    -------
    rule : ClassRule
        Class rule for the camera, with its saturation cases and chroma centres.
    white : ndarray, (output)
        Mean outputs of a perfect white, with Y = 1.
    exposure : float
        Mean exposure time of the simulated frames, in s.
    light : LightSpectrum or None
        Mean illuminant of the frames, or None if any frame's illuminant is unknown.
    """
    every = list(pilots)
    filters = range(len(head.camera.channels)) if head.camera.readout is None else head.camera.readout.same_filter.tolist()
    occurrences = np.sum([pilot.occurrences for pilot in every], axis=0)
    case_of_code = choose_cases(occurrences, recipe.classes.max_cases, filters)
    light = _mean_light(np.concatenate([pilot.lights for pilot in every]), patches, head.camera)
    single = one_light(light) if head.outputs in (XYZ, STOKES) else None
    white = white_signal(single, head.camera) if single is not None else None
    centres = choose_chromas(np.concatenate([pilot.shares for pilot in every]), recipe.classes.chromas, seed, white)
    if centres is not None and white is not None and single is not None and head.outputs == XYZ:
        stripes = false_colours(head.camera, single.wavelength, single.radiance.astype(np.float64))
        centres = np.concatenate([stripe_shares(white, stripes), centres])
    whites = np.concatenate([pilot.whites for pilot in every])
    exposures = np.concatenate([pilot.exposures for pilot in every])
    counts = np.where(exposures > 0, patches, 0)
    exposure = float(exposures @ counts / max(counts.sum(), 1))
    observed = _joined([pilot.observed for pilot in every])
    dark, spared = head.camera.dark_signal(exposure), spared_cases(case_of_code, filters)
    rule = make_rule(recipe.classes, head.camera, case_of_code, centres, dark, observed, spared)
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
    """Return the sites to train. All other sites use rotated or mirrored copies of these sites' transforms."""
    neighbours = neighbourhoods(head.camera.cfa, rule.patch, len(head.camera.channels))
    maps = site_maps(neighbours.channel, rule.patch, recipe.orientations(head.camera))
    return sorted({site_map.canonical for site_map in maps})


def add_up(pass_: TrainingPass, parts: Iterable[ClassSums]) -> ClassSums:
    """Add up a pass's partial sums. Raises L3Error if a class has too many patches for exact addition."""
    outputs = len(pass_.head.outputs)
    sums = empty_sums(pass_.rule, outputs, pass_.head.camera)
    for part in parts:
        add(sums, part)
    require_exact(sums, pass_.rule, grid_steps(pass_.rule, pass_.head.camera, outputs))
    return sums


def learn_site(pass_: TrainingPass, parts: Iterable[ClassSums], site: int) -> Solution:
    """Add up one canonical site's partial sums, and solve its transforms.

    Parameters
    ----------
    pass_ : TrainingPass
        Settings of the pass.
    parts : iterable of ClassSums
        Partial sums of the site, in any order.
    site : int
        The canonical site.

    Returns
    -------
    Solution

    Raises
    ------
    L3Error
        If a class has too many patches for exact addition, or if no class has patches.
    """
    sums = add_up(pass_, parts)
    camera, rule = pass_.head.camera, pass_.rule
    window = neighbourhoods(camera.cfa, rule.patch, len(camera.channels)).channel[site]
    turns = turns_of(rule, window, pass_.recipe.orientations(camera))
    return solve(sums, rule, window, turns, pass_.recipe, pass_.goal)


def assemble(pass_: TrainingPass, solutions: dict[int, Solution], history: tuple[Stage, ...]) -> TransformTable:
    """Build a single-layer table from the solutions of the canonical sites.

    Parameters
    ----------
    pass_ : TrainingPass
        Settings of the pass.
    solutions : dict of int to Solution
        Solution of each canonical site.
    history : tuple of Stage
        Processing history to store in the table.

    Returns
    -------
    TransformTable
    """
    head, rule, camera = pass_.head, pass_.rule, pass_.head.camera
    neighbours = neighbourhoods(camera.cfa, rule.patch, len(camera.channels))
    maps = site_maps(neighbours.channel, rule.patch, pass_.recipe.orientations(camera))
    copies = [sum(site_map.canonical == site for site_map in maps) for site in solutions]
    equal = equal_responses(list(solutions.values()), copies, rule, pass_.recipe, pass_.goal)
    transforms = dict(zip(solutions, equal, strict=True))
    weights, intercept, samples, condition = [], [], [], []
    for site_map in maps:
        trained = transforms[site_map.canonical]
        turned = np.empty_like(trained.weights)
        turned[..., site_map.permutation] = trained.weights
        classes = turned_classes(rule, site_map.orientation)
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
        chroma_smoothing=_chroma_smoothing(head, pass_.recipe),
        components=_components(head, solutions, copies, pass_.white_point),
    )


def _spectra(head: TrainingSet, recipe: LearningRecipe) -> SpectralSmoothing | None:
    """Return the settings for smoothing spectra, or None if the outputs are not spectral or smoothing is disabled."""
    if not recipe.spectral_window or len(head.outputs) == 1 or not spectra.is_spectrum(head.outputs, head.camera.channels):
        return None
    return SpectralSmoothing(recipe.spectral_window, recipe.spectral_reach)


def _chroma_smoothing(head: TrainingSet, recipe: LearningRecipe) -> ChromaSmoothing | None:
    """Return the settings for smoothing chroma, or None if the outputs are not X, Y, Z or the recipe disables smoothing."""
    if not recipe.chroma_likeness or head.outputs != XYZ:
        return None
    return ChromaSmoothing(recipe.chroma_reach, recipe.chroma_likeness)


def _components(
    head: TrainingSet, solutions: dict[int, Solution], copies: list[int], white: NDArray[np.float64]
) -> LeadingComponents | None:
    """Compute the three leading components of a spectrum, or return None if `has_components` is false.

    The second component is the mean of all outputs, relative to white. The first and third components are the principal
    components of the targets without this mean. They are rounded, because eigenvectors differ slightly between machines.
    """
    if not has_components(head):
        return None
    if head.outputs == COLOUR_STOKES:
        return LeadingComponents(np.eye(len(COLOUR_STOKES))[:, [COLOUR_STOKES.index(name) for name in ("S1", "Y", "S2")]])
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
    """Return a frame's dark signal in DN. Raises InputFileError if dark current alone saturates the pixels."""
    dark = camera.dark_signal(frame.dark_time)
    if not dark < camera.white_level - camera.black_level:
        raise InputFileError(
            f"dark current alone saturates the pixels of scene {frame.scene} within its exposure time of "
            f"{frame.dark_time:.4g} s; use a shorter exposure"
        )
    return dark


def _unit_white(frame: TrainingPair, outputs: tuple[str, ...]) -> NDArray[np.float64]:
    """Return the target outputs of a perfect white in a frame, scaled to a brightness of 1 (see `brightness_of`).

    Raises InputFileError if the white is black or does not have one value per output.
    """
    size = float(brightness_of(frame.white, outputs))
    if frame.white.size != len(outputs) or size <= 0:
        raise InputFileError(
            f"the white of scene {frame.scene} must have a positive luminance and one value per output "
            f"({', '.join(outputs)}); simulate the training set again"
        )
    return frame.white / size


# ------------------------------------------------------------------------------- refinement layers, other noise levels


def layer_pass(table: TransformTable, recipe: TrainingRecipe, mosaics: tuple[int, ...], seed: int) -> LayerPass:
    """Prepare to train the next refinement layer of a table.

    Parameters
    ----------
    table : TransformTable
        Table with all previous layers.
    recipe : TrainingRecipe
        Class recipe, with the settings for training all layers.
    mosaics : tuple of int, (frame)
        Number of mosaics to draw from each training frame.
    seed : int
        Random seed.

    Returns
    -------
    LayerPass
    """
    assert table.camera is not None  # every table with layers has a camera
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
        chroma=table.chroma_outputs,
        pictures=table.outputs == XYZ,
        stokes=has_stokes(table.outputs),
        exposure=table.exposure,
        seed=seed,
    )


def finished_layer(layer: LayerPass, rule: PlaneRule, sums: dict[int, LayerSums], table: TransformTable) -> PlaneLayer:
    """Solve the next refinement layer of a table.

    If the recipe sets `coarse_chroma`, the layer also receives the noise level for the coarse chroma filter and, for X, Y,
    Z, the correction of clipped areas.

    Parameters
    ----------
    layer : LayerPass
        Settings for training the refinement layer, and the previous layers.
    rule : PlaneRule
        Class rule of the layer.
    sums : dict of int to LayerSums
        Sums over all frames, by canonical site.
    table : TransformTable
        Table with all previous layers.

    Returns
    -------
    PlaneLayer
    """
    learned = learn_layer(layer, rule, sums)
    if not layer.recipe.coarse_chroma:
        return learned
    clipping = learned_clipping(layer.camera, table.light, table.white_point) if layer.pictures else None
    return replace(learned, coarse_chroma=measured_noise(layer), clipping=clipping)


def passes_of(usual: TrainingPass, recipe: TrainingRecipe) -> list[TrainingPass]:
    """Return the pass `usual`, followed by a pass for each additional noise level in the recipe."""
    return [usual, *(at_noise(usual, noise, recipe.classes) for noise in recipe.learning.noises)]


def with_noises(usual: TransformTable, tables: Sequence[TransformTable], noises: Sequence[NoiseScale]) -> TransformTable:
    """Add the transforms of `tables`, which were trained for the noise levels `noises`, to the table `usual`."""
    conditions = (Condition.of(each.first, each.later, None, noise) for each, noise in zip(tables, noises, strict=True))
    return replace(usual, conditions=tuple(conditions))


def by_noise(table: TransformTable) -> list[TransformTable]:
    """Split a table into one table per noise level, starting with the camera model's noise.

    The table must not contain transforms for single illuminants.
    """
    return [replace(table, conditions=()), *map(table.under, table.conditions)]
