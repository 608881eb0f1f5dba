"""Renderers of a training set's frames: a table, mixed for the light of each frame where it has several
(docs/method.md#several-lights)."""

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.table import TransformTable
from l3cli.artifacts.training_set import TrainingPair
from l3cli.physics import spectra
from l3cli.rendering.renderer import Renderer, make_renderer
from l3cli.rendering.white.lights import Mix, described, mix_for, mixed
from l3cli.stages.console import Console

MOST_KEPT = 8  # renderers: frames of one scene under several lights follow one another


class FrameRenderers:
    """Makes the renderers of a backend that frames are judged by, and keeps the last ones."""

    def __init__(self, backend: str, table: TransformTable, console: Console) -> None:
        self._backend, self._table, self._console = backend, table, console
        self._made: dict[Mix | None, Renderer] = {}
        self._said: set[str] = set()

    def of(self, frame: TrainingPair) -> Renderer:
        """The renderer of a frame."""
        mix = mix_for(self._table, _white_of(frame)) if self._table.lights else None
        if mix and frame.illuminant not in self._said:
            self._said.add(frame.illuminant)
            self._console.info(f"frames under {frame.illuminant}: transforms of {described(self._table, mix)}")
        if mix not in self._made:
            if len(self._made) == MOST_KEPT:
                del self._made[next(iter(self._made))]
            self._made[mix] = make_renderer(self._backend, mixed(self._table, mix))
        return self._made[mix]


def _white_of(frame: TrainingPair) -> NDArray[np.floating]:
    """XYZ (3) of the light of a frame; of its target where the light is not known."""
    if frame.light is None:
        return frame.white[:3]
    return spectra.xyz_weights(frame.light.wavelength) @ frame.light.radiance
