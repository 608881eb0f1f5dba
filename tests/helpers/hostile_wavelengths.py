"""Hostile wavelength grids: cameras of one recipe but for the wavelengths they see, from X-rays to heat.

Whatever the grid, it is refused in one line, or the camera is shown the scenes of every other one, and sees finite light.
"""

import json
import shutil
from dataclasses import dataclass

import numpy as np

from l3cli.artifacts.training_set import TrainingFrame, open_training_set
from l3cli.frames.scene import shown_alike
from tests.helpers import hostile
from tests.helpers.hostile import Workshop
from tests.helpers.hostile_inputs import CAMERA
from tests.helpers.hostile_spoiling import Choices, one_of

USUAL = (400.0, 700.0, 10.0)
FIRST = (0.5, 5, 100, 299, 350, 370, 380, 385, 389.5, 390, 395, 400, 405, 450, 560, 701)
LAST = (300, 420, 650, 699, 700, 701, 705, 710, 715, 720, 780, 830, 1000, 1100, 2500)
STEPS = (1, 2.5, 5, 7, 10, 20, 45)
SOURCES = (
    'source = "dead leaves"\npatterned = 0.3\nsize = [24, 32]\n', 'source = "composition"\nsize = [36, 64]\n',
    'source = "skin"\nsize = [24, 36]\n', 'source = "surfaces"\nsize = [24, 36]\n', 'source = "munsell"\nsize = [32, 40]\n',
    'source = "dead leaves"\nsize = [48, 48]\nmotion = {frames = 2, size = [16, 16], leaves = {count = 2}}\n',
)  # fmt: skip
SIMULATE = "simulate {scenes} --camera {camera} -o {out}/{name}.h5 --seed 3 --quiet"


@dataclass(frozen=True)
class Grid:
    """A camera's wavelengths (first, last, step) in nm, and what it is shown."""

    wavelength: tuple[float, float, float]
    source: str

    def __str__(self) -> str:
        return f"wavelength_nm = {json.dumps(self.wavelength)}\n{self.source}"


@dataclass(frozen=True)
class WavelengthGrids:
    """Cameras of other wavelengths than the usual one beside it."""

    name: str = "wavelength grids"
    often: int = 1

    def draw(self, choices: Choices) -> Grid:
        """A grid and a scene."""
        return Grid((one_of(choices, FIRST), one_of(choices, LAST), one_of(choices, STEPS)), one_of(choices, SOURCES))

    def judge(self, shop: Workshop, grid: Grid) -> str | None:
        """What did not hold, or None."""
        out = shop.folder / "out"
        out.mkdir()
        scenes = out / "scenes.toml"
        scenes.write_text(f"exposure_share = [0.9]\n[[scene]]\n{grid.source}")
        try:
            for name, wavelength in {"usual": USUAL, "other": grid.wavelength}.items():
                camera = out / f"{name}.toml"
                camera.write_text(CAMERA.replace("[400, 700, 10]", json.dumps(wavelength)))
                command = SIMULATE.format(scenes=scenes, camera=camera, out=out, name=name)
                if wrong := hostile.verdict(command.split()):
                    return f"{name}: {wrong}"
            return self._compared(shop) if (out / "other.h5").exists() else None
        finally:
            shutil.rmtree(out)

    def _compared(self, shop: Workshop) -> str | None:
        frames = {}
        for name in ("usual", "other"):
            with open_training_set(shop.folder / "out" / f"{name}.h5") as reader:
                frames[name] = [frame for frame in reader if isinstance(frame, TrainingFrame)]
        for usual, other in zip(frames["usual"], frames["other"], strict=True):
            if not usual.shown or not other.shown or not shown_alike(vars(usual.shown), vars(other.shown)):
                return f"{usual.scene} is another scene"
            if not np.isfinite(other.electrons).all():
                return f"{usual.scene} gives electrons that are not finite"
            if (worst := float(abs(usual.target - other.target).max() / usual.luminance)) > 0.02:
                return f"{usual.scene} has another ideal picture, by {worst:.3f} of white"
        return None
