"""A simulation: the settings that all its frames share, and a frame of a scene as one of its shots wants it."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from l3cli.artifacts.camera import CameraModel
from l3cli.artifacts.training_set import TrainingFrame
from l3cli.errors import InputFileError
from l3cli.frames.scene import ChannelPicture, Scene
from l3cli.simulation.frame import Automatic, exposure_time, simulate
from l3cli.simulation.light import SCENE_LIGHT, Light, Target, automatic_exposure, scene_light
from l3cli.simulation.recipe import SceneRecipe, Shot
from l3cli.simulation.sensor import averaging_exposure, saturating_exposure


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

    @property
    def frame_bytes(self) -> int:
        """Return the size in bytes of the largest frame: electrons of every channel, raw mosaic, target."""
        return self.camera.rows * self.camera.cols * (4 * len(self.camera.channels) + 2 + 4 * len(self.target.outputs))

    def frame(self, scene: Scene | ChannelPicture, shot: Shot, seconds: float | None = None) -> TrainingFrame:
        """Return a frame, exposed for `seconds`; None: as the recipe says. InputFileError if an automatic exposure finds no
        light."""
        light = self._light(scene, shot)
        exposure = self._exposure(light, shot) if seconds is None else seconds
        noise, seed = self.recipe.sensor.noise_model or self.recipe.sensor.noise, (self.seed, shot.index)
        try:
            return simulate(self.camera, scene, light, exposure, self.recipe.lens, seed, self.target, noise)
        except ValueError as error:
            raise InputFileError(f"scene {scene.name}: {error}") from error

    def exposure_time(self, scene: Scene | ChannelPicture, shot: Shot) -> float:
        """Return the seconds that the recipe exposes a frame for; InputFileError as `frame`."""
        light = self._light(scene, shot)
        exposure = self._exposure(light, shot)
        if isinstance(exposure, float):
            return exposure
        try:
            return exposure_time(self.camera, scene, light, exposure, self.recipe.lens)
        except ValueError as error:
            raise InputFileError(f"scene {scene.name}: {error}") from error

    def _light(self, scene: Scene | ChannelPicture, shot: Shot) -> Light:
        if shot.illuminant == SCENE_LIGHT:
            assert isinstance(scene, Scene)
            return scene_light(scene, shot.luminance)
        return self.lights[shot.illuminant].at(shot.luminance)

    def _exposure(self, light: Light, shot: Shot) -> float | Automatic:
        """Return seconds, or how they follow from the frame."""
        control, _ = self.recipe.exposures()
        if control == "share":
            return automatic_exposure(self.camera, light, shot.exposure)
        if control == "saturated":
            return partial(saturating_exposure, share=shot.exposure)
        return partial(averaging_exposure, share=shot.exposure) if control == "mean" else shot.exposure
