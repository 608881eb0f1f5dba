"""Training of additional sets of transforms for other noise levels or for single illuminants.

A table can contain several sets of transforms, for example for temporally filtered frames or for tungsten light. Each
combination of noise and illuminant is called a condition. All conditions of a table share its classes
(docs/method.md#noise-sets, docs/method.md#several-illuminants).
"""

import itertools
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.conditions import Condition, SceneLight
from l3cli.artifacts.table import TransformTable
from l3cli.artifacts.training_set import open_training_set
from l3cli.errors import InputFileError, suggestion
from l3cli.physics.correlated_lights import SAME_MIRED, mired_of
from l3cli.physics.display import XYZ
from l3cli.stages.training.passes import Execution, first_pass, learn_first, pass_of
from l3cli.stages.training.refinement_layers import learn_refinement_layers
from l3cli.stages.training.run import TrainingRun, TrainingSource
from l3cli.system.console import Silent
from l3cli.training.table import passes_of, with_noises
from l3cli.training.training_pass import TrainingPass, spread_patches

SAME_WHITE = 1e-3  # largest difference between two whites of one illuminant, on a scale on which Y is 1


def learn_conditions(run: TrainingRun, table: TransformTable, execution: Execution) -> TransformTable:
    """Train additional transforms for each illuminant and noise level in the recipe, and add them to the table."""
    table = _with_noises(run, pass_of(run, table), table, table, execution)
    for name, of_light in runs_by_light(run):
        execution.console.info(f"training transforms for {name} on {len(of_light.patches)} frames")
        # first_pass determines the white and the illuminant. Its class rule is replaced by the table's.
        pass_ = first_pass(of_light, replace(execution, console=Silent()))
        pass_ = replace(pass_, rule=table.first.rule, exposure=table.exposure)
        usual = learn_refinement_layers(of_light, learn_first(of_light, pass_, execution), execution, like=table)
        made = _with_noises(of_light, pass_, usual, table, execution)
        light = SceneLight(name, made.white_point, made.light)
        of_noises = (replace(each, light=light) for each in made.conditions)
        conditions = (*table.conditions, Condition.of(made.first, made.later, light, None), *of_noises)
        table = replace(table, conditions=conditions)
    return table


def _with_noises(
    run: TrainingRun, pass_: TrainingPass, usual: TransformTable, like: TransformTable, execution: Execution
) -> TransformTable:
    """Train transforms for each noise level in the recipe, with `like`'s class rules, and add them to the table `usual`."""
    made = []
    for noise, each in zip(run.recipe.learning.noises, passes_of(pass_, run.given)[1:], strict=True):
        execution.console.info(f"training transforms for {noise}")
        made.append(learn_refinement_layers(run, learn_first(run, each, execution), execution, like=like))
    return with_noises(usual, made, run.recipe.learning.noises)


def runs_by_light(run: TrainingRun) -> list[tuple[str, TrainingRun]]:
    """Return a training run for each illuminant in `learning.lights` of the recipe.

    Each run uses only the frames under its illuminant, but as many patches and mosaics as a run over all frames.

    Returns
    -------
    list of (str, TrainingRun)
        Name and run of each illuminant, beginning with the lowest colour temperature.

    Raises
    ------
    InputFileError
        If the targets are not XYZ values under the illuminant of each frame, if an illuminant has no frames, or if two
        illuminants have the same colour temperature.
    """
    if not (lights := run.recipe.learning.lights):
        return []
    named = ", ".join(str(source.path) for source in run.training)
    if run.head.outputs[:3] != XYZ or run.head.target_light is not None:
        raise InputFileError(
            f"{named}: the key learning.lights needs XYZ targets that were computed under the illuminant of each frame; "
            'remove learning.lights, or remove "illuminant" from [target] in the scene recipe and simulate again'
        )
    frames, mireds = _frames_by_light(run, named)
    for light in lights:
        if light not in frames:
            raise InputFileError(
                f'{named}: learning.lights contains "{light}", but no frame has this illuminant; {suggestion(light, frames)}'
            )
    order = sorted(dict.fromkeys(lights), key=lambda name: -mireds[name])
    for warm, cool in itertools.pairwise(order):
        if mireds[warm] - mireds[cool] < SAME_MIRED:
            raise InputFileError(
                f"{named}: the illuminants {warm} and {cool} in learning.lights have the same colour temperature, so l3 "
                "cannot distinguish them; remove one of the two"
            )
    return [(name, _chosen(run, frames[name])) for name in order]


def _frames_by_light(run: TrainingRun, named: str) -> tuple[dict[str, dict[int, list[int]]], dict[str, float]]:
    """Find the frames under each illuminant, without real pairs, because their illuminant is unknown.

    Returns
    -------
    dict
        Name of the illuminant → index of the training set → indices of the frames in the set.
    dict
        Name of the illuminant → reciprocal colour temperature in mired.

    Raises
    ------
    InputFileError
        If frames with the same illuminant name have different whites.
    """
    whites: dict[str, NDArray[np.float64]] = {}
    frames: dict[str, dict[int, list[int]]] = {}
    for place, source in enumerate(run.training):
        with open_training_set(source.path, unchanged=True) as reader:
            for index in range(reader.simulated):
                light = reader.light(index)
                white = light.white[:3] / light.white[1]
                if np.abs(whites.setdefault(light.illuminant, white) - white).max() > SAME_WHITE:
                    raise InputFileError(
                        f'{named}: frames with the illuminant name "{light.illuminant}" have different whites, but '
                        "learning.lights needs a different name for each illuminant; give each illuminant its own name in "
                        "SCENES.toml, or remove learning.lights"
                    )
                frames.setdefault(light.illuminant, {}).setdefault(place, []).append(index)
    return frames, {name: mired_of(white) for name, white in whites.items()}


def _chosen(run: TrainingRun, frames: dict[int, list[int]]) -> TrainingRun:
    """Restrict a run to some of its frames, given by their indices in each training set."""
    shares = None if run.shares is None else tuple(run.shares[place] for place in frames)
    sources: list[TrainingSource] = []
    for place, indices in frames.items():
        sources.append(replace(run.training[place], frames=len(indices), chosen=tuple(indices)))
    patches = spread_patches(run.recipe.learning.patches, [source.frames for source in sources], shares)
    return replace(run, training=tuple(sources), patches=patches, shares=shares)
