"""Settings that all frames of a simulation share."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from l3cli.artifacts.camera import CameraModel
from l3cli.simulation.light import Light
from l3cli.simulation.recipe import SceneRecipe
from l3cli.simulation.targets import Target


@dataclass(frozen=True)
class SimulationRun:
    """A camera, scenes and lights, checked and resolved."""

    recipe: SceneRecipe
    camera: CameraModel
    target: Target
    lights: Mapping[str, Light]  # of 1 cd/m²
    recorded: Mapping[str, Light]  # the lights that scenes were recorded under
    seed: int
    base: Path  # folder of the recipe
