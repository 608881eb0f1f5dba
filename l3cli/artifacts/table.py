"""The transform table: layers of class rules and weights, all that rendering needs (docs/method.md#classes)."""

import itertools
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.camera import CameraModel, check_cfa, check_sensor
from l3cli.artifacts.conditions import Condition, SceneLight, older_conditions
from l3cli.artifacts.layers import RATIO_TAPS, MosaicLayer, PlaneLayer
from l3cli.artifacts.schema import Artifact, check, data, group
from l3cli.artifacts.training_set import LightSpectrum

WINDOWS = (3, 5, 7, 9)  # sides that can be


@dataclass(frozen=True)
class SpectralSmoothing:
    """Every pixel takes the mean spectrum of the pixels of like brightness about it, and keeps its own brightness."""

    window: int = data("int64", unit="pixel", doc="side of the neighbourhood of a pixel")
    reach: float = data(
        "float64", doc="difference of brightness, a share of the pixel's own, from which others do not count"
    )

    def __post_init__(self) -> None:
        check(self)
        if self.window not in WINDOWS:
            raise ValueError(f"window is {self.window}, not one of {', '.join(map(str, WINDOWS))}")
        if not 0 < self.reach < 1:
            raise ValueError(f"reach is {self.reach:g}, not between 0 and 1")

    @property
    def radius(self) -> int:
        return self.window // 2


@dataclass(frozen=True)
class TransformTable(Artifact):
    """Local linear transforms for every class: of the mosaic and, in later layers, of what the layer before has made."""

    kind: ClassVar[str] = "transform table"
    version: ClassVar[int] = 5
    made_by: ClassVar[str] = '"l3 train"'

    camera_name: str = data("str", doc="the camera it was learned for")
    rows: int = data("int64", unit="pixel", doc="height of the camera's frames")
    cols: int = data("int64", unit="pixel", doc="width of the camera's frames")
    channels: tuple[str, ...] = data("str", "channel", doc="names of the spectral channels")
    cfa: NDArray[np.uint8] = data("uint8", "cfa_row", "cfa_col", doc="channel of each site of the super-pixel")
    bits: int = data("int64", unit="bit", doc="depth of the raw values")
    black_level: float = data("float64", unit="DN", doc="black level of the raw values the table expects", formerly="black")
    white_level: float = data("float64", unit="DN", doc="white level of the raw values the table expects", formerly="white")
    outputs: tuple[str, ...] = data("str", "output", doc="names of the outputs")
    target_description: str = data("str", doc="what the outputs are")
    output_unit: float = data(
        "float64", unit="cd s/m^2", doc="scene luminance × exposure time that an output of 1 stands for"
    )
    white_point: NDArray[np.float64] = data(
        "float64", "output", doc="output of a perfect white under the training light, Y = 1"
    )
    first: MosaicLayer = group(since=3)
    later: tuple[PlaneLayer, ...] = group(default=())
    exposure: float = data("float64", unit="s", doc="mean exposure time of the simulated training frames", default=0.0)
    light: LightSpectrum | None = group(default=None)  # mean of those that fell on the training scenes
    camera: CameraModel | None = group(default=None)  # it was learned for, without its fit; None: an older file
    conditions: tuple[Condition, ...] = group(default=(), older=older_conditions)  # other noise, then light by light
    spectra: SpectralSmoothing | None = group(
        default=None
    )  # of the outputs, the last step; None: they are as layers leave them

    def __post_init__(self) -> None:
        super().__post_init__()
        check_sensor(self.rows, self.cols, self.bits, self.black_level, self.white_level)
        check_cfa(self.cfa, self.channels)
        if self.camera and not (self.camera.channels == self.channels and np.array_equal(self.camera.cfa, self.cfa)):
            raise ValueError("camera has another CFA than the table")
        if not self.outputs or not self.output_unit > 0:
            raise ValueError("there must be an output, and its unit above zero")
        if not self.exposure >= 0:
            raise ValueError("exposure must not be negative")
        for layer in self.layers:
            sites, classes = self.cfa.size, layer.rule.classes_per_site
            if len(layer.weights) != sites * classes:
                raise ValueError(f"weights holds {len(layer.weights)} classes, the rule makes {sites} × {classes}")
        self.first.rule.check_fits(len(self.channels), self.bits)
        for later in self.later:
            self._check_refinement(later)
        if any(later.ratio_taps for later in self.later[:-1]):
            raise ValueError("a layer that another follows has colour ratios; only the last one may")
        if self.spectra and (len(self.outputs) == 1 or self.outputs[:3] == ("X", "Y", "Z")):
            raise ValueError(f"spectra of {', '.join(self.outputs)} cannot be smoothed; they must be bands")
        for index, condition in enumerate(self.conditions):
            condition.check_fits(f"conditions/{index}", self.later, self.first.rule.levels)
        there = [(None, None), *((each.light and each.light.name, each.noise) for each in self.conditions)]
        lights, noises = (dict.fromkeys(part) for part in zip(*there, strict=True))
        if there != list(itertools.product(lights, noises)):
            raise ValueError("conditions are not all lights, one after the other, with the same noises each")

    def _check_refinement(self, layer: PlaneLayer) -> None:
        """Raise ValueError if a layer does not fit the first one, whose levels, saturation cases and outputs it takes."""
        rule, below = layer.rule, self.first.rule
        if len(rule.turns) != self.cfa.size:
            raise ValueError(f"turns holds {len(rule.turns)} sites, the CFA {self.cfa.size}")
        if (len(rule.gradient_factor), rule.cases) != (below.levels, below.lost_cases):
            raise ValueError(
                f"a later layer is for {len(rule.gradient_factor)} levels and {rule.cases} saturation cases, "
                f"the first has {below.levels} and {below.lost_cases}"
            )
        taps = layer.side**2 * len(self.outputs)
        if layer.side % 2 == 0 or layer.weights.shape[2] not in (taps, taps + RATIO_TAPS):
            raise ValueError(f"weights has {layer.weights.shape[2]} taps, {len(self.outputs)} windows of odd side {taps}")

    @property
    def layers(self) -> tuple[MosaicLayer | PlaneLayer, ...]:
        """All layers in the order in which they render."""
        return (self.first, *self.later)

    def pictured(self) -> "TransformTable":
        """Return the table of X, Y, Z alone if other outputs follow them, which no picture shows; else the table itself."""
        if self.outputs[:3] != ("X", "Y", "Z") or len(self.outputs) == 3 or self.later:
            return self
        conditions = tuple(each.pictured() for each in self.conditions)
        first, white_point = self.first.pictured(), self.white_point[:3]
        return replace(self, outputs=self.outputs[:3], white_point=white_point, first=first, conditions=conditions)

    @property
    def noises(self) -> tuple[Condition, ...]:
        """Conditions of other noise than the camera's, under all lights."""
        return tuple(each for each in self.conditions if each.light is None)

    @property
    def lights(self) -> tuple[SceneLight, ...]:
        """Lights that there are conditions for."""
        return tuple(each.light for each in self.conditions if each.light and each.noise is None)

    def of_light(self, light: SceneLight | None) -> "TransformTable":
        """Return the table of the transforms for a light, at every noise; None: those for all lights in common."""
        if light is None:
            return replace(self, conditions=self.noises) if self.lights else self
        usual, *noises = (each for each in self.conditions if each.light and each.light.name == light.name)
        return replace(self.under(usual), conditions=tuple(replace(each, light=None) for each in noises))

    def under(self, condition: Condition) -> "TransformTable":
        """Return the table of the transforms of one of its conditions alone."""
        first, later, edges, light = self.first, self.later, condition.edges, condition.light
        if edges:
            first = replace(first, rule=edges.rule(first.rule))
            later = tuple(map(PlaneLayer.scaled_as, later, edges.gradients))
        return replace(
            self,
            first=replace(first, **vars(condition.first)),
            later=tuple(replace(layer, **vars(each)) for layer, each in zip(later, condition.later, strict=True)),
            white_point=self.white_point if light is None else light.white_point,
            light=self.light if light is None else light.spectrum,
            camera=self.camera and replace(self.camera, noise_scale=condition.noise or self.camera.noise_scale),
            conditions=(),
        )

    def dark_signal(self, exposure: float | None) -> float:
        """Return DN above black that dark current makes, on average, in `exposure` s; if that is unknown, in that of
        training. A table of before has no camera, and none."""
        return self.camera.dark_signal(self.exposure if exposure is None else exposure) if self.camera else 0.0
