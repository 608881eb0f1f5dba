"""The transform table: layers of class rules and weights, all that rendering needs (docs/method.md#classes).

Conditions have transforms of their own: lights (docs/method.md#several-lights), and other noise than the camera's
(docs/method.md#noise-sets). Class rules are shared, but for edges that follow the noise.
"""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, ClassVar

import h5py
import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.camera import CameraModel, NoiseScale, check_cfa, check_sensor
from l3cli.artifacts.class_rule import ClassRule
from l3cli.artifacts.plane_rules import GradientScale, StructureRule, TreeRule
from l3cli.artifacts.schema import Artifact, check, data, group
from l3cli.artifacts.store import read_fields
from l3cli.artifacts.training_set import LightSpectrum, white_signal

PlaneRule = StructureRule | TreeRule
LUMINANCE = ("Y",)  # outputs of a table that shows luminance alone
GREY = ("Y", "Y", "Y")  # its outputs as pictures are made from them
PLANE_STEP = 2.0**-18  # of the output unit: what a plane's integers count, far below the noise of any sensor
RATIO_TAPS = (0, 2, 4)  # behind those of the windows of a last layer: none, colour ratios, and bilateral chroma, too
PLANE_TOP = 2**22 - 1  # 16 times a full scale: differences times a factor of 7 bits stay within 32 bits
PLANES = 3  # that a refinement layer reads
WINDOWS = (3, 5, 7, 9)  # sides that can be
COMPARED = (4, 3, 3)  # in coarse chroma: steps; planes; powers of luminance


@dataclass(frozen=True)
class MosaicLayer:
    """Transforms of patches of the mosaic: output = weights · (patch − black level) / full scale + intercept."""

    rule: ClassRule = group()
    weights: NDArray[np.float32] = data(
        "float32", "class", "output", "tap", doc="taps row by row; per unit of (DN − black level) / full scale"
    )
    intercept: NDArray[np.float32] = data("float32", "class", "output", doc="added to the weighted sum")
    samples: NDArray[np.float64] = data("float64", "class", doc="training patches; 0: filled from a neighbour")
    condition: NDArray[np.float32] = data("float32", "class", doc="condition number of the class's equations; 0: none")

    def __post_init__(self) -> None:
        check(self)
        if self.weights.shape[2] != self.rule.patch**2:
            raise ValueError(f"weights has {self.weights.shape[2]} taps, the rule's patch {self.rule.patch**2}")

    def pictured(self, taken: list[int]) -> "MosaicLayer":
        """Return the layer of some outputs, by their places."""
        return replace(self, weights=self.weights[:, taken], intercept=self.intercept[:, taken])


@dataclass(frozen=True)
class CoarseChroma:
    """Noise of what a last layer compares where it takes chroma from far around (docs/method.md#coarse-chroma)."""

    variance: NDArray[np.float64] = data(
        "float64",
        "step",
        "plane",
        "power",
        doc="noise variance at luminance Y, Σ variance · Y^power, in squared output units: of the blocks each step reads",
    )

    def __post_init__(self) -> None:
        check(self)
        steps, *others = COMPARED
        if self.variance.shape == (steps + 1, *others):  # the last, of what pixels were compared by, no longer counts
            object.__setattr__(self, "variance", self.variance[:steps])
        if self.variance.shape != COMPARED:
            raise ValueError(f"variance has the shape {self.variance.shape}, not {COMPARED}")
        if not (np.isfinite(self.variance).all() and self.variance.min() >= 0 and self.variance[..., 0].min() > 0):
            raise ValueError("variance must not be negative, nor zero in darkness")

    def with_noise(self, share: float) -> "CoarseChroma":
        """Return the same for frames with this share of the noise variance."""
        return CoarseChroma(self.variance * share)


@dataclass(frozen=True)
class Clipping:
    """Outputs of plain areas where channels clip (docs/method.md#plain-clipped-areas)."""

    response: NDArray[np.float64] = data(
        "float64",
        "clipped",
        "signal",
        "output",
        doc="by the mean of each channel, a share of full scale, and by 1 behind them: of all areas, then what each channel "
        "adds that clips",
    )
    white: NDArray[np.float64] = data("float64", "channel", doc="signals of a white at Y = 1 under the training light")

    def __post_init__(self) -> None:
        check(self)
        if not self.white.min() > 0:
            raise ValueError("white must give every channel a signal")
        if self.response.shape[:2] != (1 + self.white.size,) * 2 or not np.isfinite(self.response).all():
            raise ValueError(
                f"response has the shape {self.response.shape}, and must be finite, and of one channel more twice"
            )


@dataclass(frozen=True)
class PlaneLayer:
    """Transforms of square windows of the planes X − aY, Y, Z − bY (of a white: zero, its Y, zero) of the layer before."""

    side: int = data("int64", unit="pixel", doc="side of the windows")
    weights: NDArray[np.float32] = data(
        "float32",
        "plane_class",
        "output",
        "plane_tap",
        doc="taps plane by plane, each row by row, behind them colour ratios, bilateral chroma, if any; per output unit",
    )
    intercept: NDArray[np.float32] = data("float32", "plane_class", "output", doc="added to the weighted sum")
    samples: NDArray[np.float64] = data("float64", "plane_class", doc="training patches; 0: filled from a neighbour")
    structure: StructureRule | None = group(default=None)  # its classes, if by structure
    tree: TreeRule | None = group(default=None)  # its classes, if by a tree
    coarse_chroma: CoarseChroma | None = group(default=None)  # None: chroma is that of the windows alone
    clipping: Clipping | None = group(default=None)  # beside coarse chroma; None: clipped areas are as classes leave them

    def __post_init__(self) -> None:
        check(self)
        one_rule(self.structure, self.tree)
        if self.clipping and not self.coarse_chroma:
            raise ValueError("a layer with clipping has coarse chroma, too")

    @property
    def rule(self) -> PlaneRule:
        return one_rule(self.structure, self.tree)

    @property
    def radius(self) -> int:
        return self.side // 2

    @property
    def window_taps(self) -> int:
        """Return the taps of the windows; what follows are those of colour ratios and bilateral chroma."""
        return PLANES * self.side**2

    @property
    def ratio_taps(self) -> int:
        """Return one of RATIO_TAPS."""
        return self.weights.shape[2] - self.window_taps

    def with_noise(self, share: float) -> "PlaneLayer":
        """Return the layer for frames with this share of the noise variance, as far as coarse chroma asks."""
        return replace(self, coarse_chroma=self.coarse_chroma.with_noise(share)) if self.coarse_chroma else self

    def scaled_as(self, scale: GradientScale) -> "PlaneLayer":
        """Return a copy of the layer whose rule scales gradients by `scale`."""
        return replace(self, **rule_fields(self.rule.scaled_as(scale)))


def rule_fields(rule: PlaneRule) -> dict[str, Any]:
    """Return the rule as the field that holds it."""
    return {"structure" if isinstance(rule, StructureRule) else "tree": rule}


def one_rule(structure: StructureRule | None, tree: TreeRule | None) -> PlaneRule:
    """Return the rule that is there; ValueError unless it is one of the two."""
    if structure is None and tree is not None:
        return tree
    if structure is not None and tree is None:
        return structure
    raise ValueError("a layer has either a structure rule or a tree")


@dataclass(frozen=True)
class SceneLight:
    """Light of a condition."""

    name: str = data("str", doc="the light")
    white_point: NDArray[np.float64] = data("float64", "output", doc="output of a perfect white under it, Y = 1")
    spectrum: LightSpectrum | None = group(default=None)

    def __post_init__(self) -> None:
        if not self.white_point[:3].min() > 0:
            raise ValueError(f"white_point of {self.name} is that of no light")


@dataclass(frozen=True)
class NoiseEdges:
    """Edges of classes, and noise of what coarse chroma compares, which follow the noise."""

    contrast_edges: NDArray[np.uint32] = data("uint32", "contrast_edge", "level", doc="as in first/rule/")
    constants: NDArray[np.int32] = data("int32", "constant", doc="as in first/rule/features/; none without features")
    gradients: tuple[GradientScale, ...] = group(default=())  # of each refinement layer
    coarse_chroma: CoarseChroma | None = group(default=None)  # of the last one; None: that of the table

    @classmethod
    def of(cls, first: MosaicLayer, later: Sequence[PlaneLayer]) -> "NoiseEdges":
        """Return the edges of layers."""
        constants = first.rule.features.constants if first.rule.features else np.zeros(0, np.int32)
        coarse = later[-1].coarse_chroma if later else None
        return cls(first.rule.contrast_edges, constants, tuple(layer.rule.scale for layer in later), coarse)

    def within(self, table: "TransformTable") -> "TransformTable":
        """Return a table with these edges."""
        usual = table.first.rule
        features = usual.features and replace(usual.features, constants=self.constants)
        rule = replace(usual, contrast_edges=self.contrast_edges, features=features)
        later = list(map(PlaneLayer.scaled_as, table.later, self.gradients))
        if later and self.coarse_chroma:
            later[-1] = replace(later[-1], coarse_chroma=self.coarse_chroma)
        return replace(table, first=replace(table.first, rule=rule), later=tuple(later), conditions=())


@dataclass(frozen=True)
class MosaicTransforms:
    """Transforms of the layer that reads the mosaic."""

    weights: NDArray[np.float32] = data("float32", "class", "output", "tap", doc="as in first/")
    intercept: NDArray[np.float32] = data("float32", "class", "output", doc="added to the weighted sum")
    samples: NDArray[np.float64] = data("float64", "class", doc="training patches; 0: filled from a neighbour")


@dataclass(frozen=True)
class PlaneTransforms:
    """Transforms of a refinement layer."""

    weights: NDArray[np.float32] = data("float32", "plane_class", "output", "plane_tap", doc="as in later/")
    intercept: NDArray[np.float32] = data("float32", "plane_class", "output", doc="added to the weighted sum")
    samples: NDArray[np.float64] = data("float64", "plane_class", doc="training patches; 0: filled from a neighbour")
    clipping: Clipping | None = group(default=None)  # as in later/


@dataclass(frozen=True)
class Condition:
    """Transforms of all layers, learned for frames under one light, with other noise than the camera's, or both."""

    first: MosaicTransforms = group()
    later: tuple[PlaneTransforms, ...] = group(default=())
    light: SceneLight | None = group(default=None)  # None: all lights of the training
    noise: NoiseScale | None = group(default=None)  # None: the camera's
    edges: NoiseEdges | None = group(default=None)  # None: those of the table's rules

    def __post_init__(self) -> None:
        check(self)
        if (self.noise is None) != (self.edges is None) or not (self.light or self.noise):
            raise ValueError("a condition must have a light, or a scale of the noise and its edges")

    @classmethod
    def of(
        cls, first: MosaicLayer, later: Sequence[PlaneLayer], light: SceneLight | None, noise: NoiseScale | None
    ) -> "Condition":
        """Return the transforms, and for other noise the edges, of layers that were learned for a condition."""
        return cls(
            MosaicTransforms(first.weights, first.intercept, first.samples),
            tuple(PlaneTransforms(layer.weights, layer.intercept, layer.samples, layer.clipping) for layer in later),
            light,
            noise,
            NoiseEdges.of(first, later) if noise else None,
        )

    def check_fits(self, place: str, later: Sequence[PlaneLayer], levels: int) -> None:
        """Raise ValueError, which names `place`, unless it is for a table of so many levels with these refinement layers."""
        if len(self.later) != len(later) or (self.edges and len(self.edges.gradients) != len(later)):
            raise ValueError(f"{place} holds {1 + len(self.later)} layers, the table {1 + len(later)}")
        for number, (ours, layer) in enumerate(zip(self.later, later, strict=True)):
            if ours.weights.shape != layer.weights.shape:
                raise ValueError(f"{place}/later/{number} has transforms of other shapes than later/{number}")
        if self.edges and any(len(scale.gradient_factor) != levels for scale in self.edges.gradients):
            raise ValueError(f"{place}/edges has gradients of other levels than the table")

    def pictured(self, taken: list[int]) -> "Condition":
        """Return the transforms of some outputs, by their places."""
        first = replace(self.first, weights=self.first.weights[:, taken], intercept=self.first.intercept[:, taken])
        light = self.light and replace(self.light, white_point=self.light.white_point[taken])
        return replace(self, first=first, light=light)


# Format version 4 and before.
@dataclass(frozen=True)
class _LowNoise:
    noise_left: float = data("float64")
    first: MosaicLayer = group()
    later: tuple[PlaneLayer, ...] = group(default=())


@dataclass(frozen=True)
class _OneLight:
    name: str = data("str")
    white_point: NDArray[np.float64] = data("float64", "output")
    first: MosaicTransforms = group()
    later: tuple[PlaneTransforms, ...] = group(default=())
    light: LightSpectrum | None = group(default=None)


@dataclass(frozen=True)
class _Older:
    quiet: _LowNoise | None = group(default=None)
    lights: tuple[_OneLight, ...] = group(default=())


def older_conditions(table: h5py.Group, path: Path) -> tuple[Condition, ...]:
    """Read the conditions of a table of format version 4 or before: low-noise transforms, and those of lights."""
    older: _Older = read_fields(table, _Older, path)
    low = older.quiet
    noise = () if low is None else (Condition.of(low.first, low.later, None, NoiseScale(noise_left=low.noise_left)),)
    lights = (
        Condition(each.first, each.later, SceneLight(each.name, each.white_point, each.light)) for each in older.lights
    )
    return (*noise, *lights)


@dataclass(frozen=True)
class SpectralSmoothing:
    """Mean spectrum of the pixels of like brightness about each pixel, which keeps its own brightness."""

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
class LeadingComponents:
    """Components of a spectrum, which a refinement layer reads to correct it (docs/method.md#leading-components)."""

    basis: NDArray[np.float64] = data("float64", "output", "plane", doc="rows of outputs times it are the planes")

    def __post_init__(self) -> None:
        check(self)
        if self.basis.shape[1] != PLANES:
            raise ValueError(f"basis makes {self.basis.shape[1]} planes, not {PLANES}")


@dataclass(frozen=True)
class TransformTable(Artifact):
    """Local linear transforms for every class: of the mosaic and, in refinement layers, of the layer before."""

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
    spectra: SpectralSmoothing | None = group(default=None)  # of the outputs, the last step; None: as layers leave them
    # whose windows a refinement layer reads, to correct the first layer's outputs; None: it makes outputs of X, Y, Z
    components: LeadingComponents | None = group(default=None)

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
        if any(later.coarse_chroma for later in self.later[:-1]):
            raise ValueError("a layer that another follows has coarse chroma; only the last one may")
        if self.spectra and (len(self.outputs) == 1 or self.outputs[:3] == ("X", "Y", "Z")):
            raise ValueError(f"spectra of {', '.join(self.outputs)} cannot be smoothed; they must be bands")
        if self.later and (
            len(self.later) > 1 or self.later[-1].coarse_chroma if self.components else len(self.outputs) != 3
        ):
            raise ValueError("outputs that are not three have one refinement layer at most, of components alone")
        for index, condition in enumerate(self.conditions):
            condition.check_fits(f"conditions/{index}", self.later, self.first.rule.levels)
        there = [(None, None), *((each.light and each.light.name, each.noise) for each in self.conditions)]
        lights, noises = (dict.fromkeys(part) for part in zip(*there, strict=True))
        if there != list(itertools.product(lights, noises)):
            raise ValueError("conditions are not all lights, one after the other, with the same noises each")

    def _check_refinement(self, layer: PlaneLayer) -> None:
        """Raise ValueError if a layer does not fit the first one, whose levels, saturation cases and outputs it takes."""
        layer.rule.check_fits(self.cfa.size, self.first.rule)
        taps = layer.window_taps
        if layer.side % 2 == 0 or layer.ratio_taps not in RATIO_TAPS:
            raise ValueError(f"weights has {layer.weights.shape[2]} taps, {PLANES} windows of odd side {taps}")

    @property
    def layers(self) -> tuple[MosaicLayer | PlaneLayer, ...]:
        """Return all layers in the order in which they render."""
        return (self.first, *self.later)

    def pictured(self) -> "TransformTable":
        """Return the table that pictures are made by.

        Returns
        -------
        TransformTable
            Of X, Y, Z alone if other outputs follow them, which no picture shows; of luminance three times, GREY, if it is
            the only output; else the table itself.
        """
        grey = self.outputs == LUMINANCE
        if self.later or not (grey or (self.outputs[:3] == ("X", "Y", "Z") and len(self.outputs) > 3)):
            return self
        taken = [0, 0, 0] if grey else [0, 1, 2]
        return replace(
            self,
            outputs=GREY if grey else self.outputs[:3],
            white_point=self.white_point[taken],
            first=self.first.pictured(taken),
            conditions=tuple(each.pictured(taken) for each in self.conditions),
        )

    @property
    def shows_grey(self) -> bool:
        """Return whether pictures are grey: the outputs are luminance alone, or one channel tells no colours."""
        return self.outputs == GREY or len(self.channels) == 1

    @property
    def noises(self) -> tuple[Condition, ...]:
        """Return the conditions for noise that differs from the camera's, trained on all lights together."""
        return tuple(each for each in self.conditions if each.light is None)

    @property
    def lights(self) -> tuple[SceneLight, ...]:
        """Return the lights that the table has transforms for, in the order of its conditions."""
        return tuple(each.light for each in self.conditions if each.light and each.noise is None)

    def of_light(self, light: SceneLight | None) -> "TransformTable":
        """Return the table of the transforms for a light, at every noise; None: those for all lights in common."""
        if light is None:
            return replace(self, conditions=self.noises) if self.lights else self
        usual, *noises = (each for each in self.conditions if each.light and each.light.name == light.name)
        return replace(self.under(usual), conditions=tuple(replace(each, light=None) for each in noises))

    def under(self, condition: Condition) -> "TransformTable":
        """Return the table of the transforms of one of its conditions alone."""
        light, noise = condition.light, condition.noise or NoiseScale()
        table = condition.edges.within(self) if condition.edges else self
        return replace(
            table,
            first=replace(table.first, **vars(condition.first)),
            later=tuple(replace(layer, **vars(each)) for layer, each in zip(table.later, condition.later, strict=True)),
            white_point=self.white_point if light is None else light.white_point,
            light=self.light if light is None else light.spectrum,
            output_unit=self.output_unit / noise.gain,
            exposure=self.exposure / noise.gain,
            camera=self.camera and self.camera.under(noise),
            conditions=(),
        )

    @property
    def clipped_white(self) -> NDArray[np.float64] | None:
        """XYZ (3), in output units, of the darkest white that clips every channel. No pixel is rendered brighter
        (docs/method.md#clipped-white). None if the outputs neither begin with X, Y, Z nor are GREY, or
        the light is not known."""
        if self.outputs[:3] not in (("X", "Y", "Z"), GREY) or self.light is None or self.camera is None:
            return None
        weakest = white_signal(self.light, self.camera, self.output_unit).min()
        return self.white_point[:3] / (self.white_point[1] * weakest) if weakest > 0 else None

    def gain_at(self, iso: float) -> float | None:
        """Return the analog gain at an ISO speed over that of the table's camera; None: not known."""
        return self.camera.gain_at(iso) if self.camera else None

    def dark_signal(self, exposure: float | None) -> float:
        """Return DN above black that dark current makes, on average, in `exposure` s; if that is unknown, in that of
        training. A table of before has no camera, and none."""
        return self.camera.dark_signal(self.exposure if exposure is None else exposure) if self.camera else 0.0
