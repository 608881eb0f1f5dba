"""The transform table: the class rule and the transforms of every layer (docs/method.md#classes).

A table may also hold transforms for conditions: for single lights (docs/method.md#several-lights), and for frames with more
or less noise than the camera's (docs/method.md#noise-sets). All conditions share the class rules, except that class edges
follow the noise.
"""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.camera import CameraModel, NoiseScale, check_cfa, check_sensor
from l3cli.artifacts.class_rule import ClassRule
from l3cli.artifacts.plane_rules import GradientScale, StructureRule, TreeRule
from l3cli.artifacts.schema import Artifact, check, data, group
from l3cli.artifacts.training_set import LightSpectrum, white_signal

PlaneRule = StructureRule | TreeRule
LUMINANCE = ("Y",)  # outputs of a table that renders luminance only
GREY = ("Y", "Y", "Y")  # outputs of such a table when it renders pictures
PLANE_STEP = 2.0**-18  # quantum of the planes' integers in output units, far below the noise of any sensor
RATIO_TAPS = (0, 2, 4)  # extra taps of the last layer: none, colour ratios, or colour ratios and bilateral chroma
PLANE_TOP = 2**22 - 1  # 16 times full scale; a difference of planes times a 7-bit factor stays within 32 bits
PLANES = 3  # that a refinement layer reads: X − aY, Y, Z − bY
WINDOWS = (3, 5, 7, 9)  # possible sides of the window that spectra are smoothed over, in pixels
COMPARED = (4, 3, 3)  # shape of the noise in coarse chroma: steps, planes, powers of luminance


@dataclass(frozen=True)
class MosaicLayer:
    """The first layer: transforms of patches of the mosaic.

    Output = weights · (patch − black level) / full scale + intercept, with the weights and the intercept of the pixel's
    class.
    """

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
        """Return the layer with some of its outputs, given by their indices."""
        return replace(self, weights=self.weights[:, taken], intercept=self.intercept[:, taken])


@dataclass(frozen=True)
class CoarseChroma:
    """Noise of the coarse chroma that the last layer compares (docs/method.md#coarse-chroma)."""

    variance: NDArray[np.float64] = data(
        "float64",
        "step",
        "plane",
        "power",
        doc="noise variance at luminance Y, Σ variance · Y^power, in squared output units: of the blocks each step reads",
    )

    def __post_init__(self) -> None:
        check(self)
        if self.variance.shape != COMPARED:
            raise ValueError(f"variance has the shape {self.variance.shape}, not {COMPARED}")
        if not (np.isfinite(self.variance).all() and self.variance.min() >= 0 and self.variance[..., 0].min() > 0):
            raise ValueError("variance must not be negative, nor zero in darkness")

    def with_noise(self, share: float) -> "CoarseChroma":
        """Return a copy for frames with this fraction of the noise variance."""
        return CoarseChroma(self.variance * share)


@dataclass(frozen=True)
class Clipping:
    """Response of uniform areas where channels clip (docs/method.md#plain-clipped-areas)."""

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
            raise ValueError("white must be above zero in every channel")
        if self.response.shape[:2] != (1 + self.white.size,) * 2 or not np.isfinite(self.response).all():
            raise ValueError(
                f"response has the shape {self.response.shape}; it must be finite, and its first two axes channels + 1 long"
            )


@dataclass(frozen=True)
class PlaneLayer:
    """A refinement layer: transforms of square windows of three planes that the previous layer has rendered.

    The planes are X − aY, Y and Z − bY. The factors a and b are chosen such that a white is (0, Y, 0).
    """

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
    structure: StructureRule | None = group(default=None)  # the class rule, if classes are structures
    tree: TreeRule | None = group(default=None)  # the class rule, if classes are the leaves of a tree
    coarse_chroma: CoarseChroma | None = group(default=None)  # None: chroma comes from the windows only
    clipping: Clipping | None = group(default=None)  # requires coarse chroma; None: clipped areas are not smoothed

    def __post_init__(self) -> None:
        check(self)
        one_rule(self.structure, self.tree)
        if self.clipping and not self.coarse_chroma:
            raise ValueError("a layer with clipping must have coarse chroma")

    @property
    def rule(self) -> PlaneRule:
        """Class rule of the layer."""
        return one_rule(self.structure, self.tree)

    @property
    def radius(self) -> int:
        return self.side // 2

    @property
    def window_taps(self) -> int:
        """Number of taps in the windows. Taps for colour ratios and bilateral chroma follow them."""
        return PLANES * self.side**2

    @property
    def ratio_taps(self) -> int:
        """Number of taps after those of the windows, one of RATIO_TAPS."""
        return self.weights.shape[2] - self.window_taps

    def with_noise(self, share: float) -> "PlaneLayer":
        """Return the layer for frames with this fraction of the noise variance; only coarse chroma depends on it."""
        return replace(self, coarse_chroma=self.coarse_chroma.with_noise(share)) if self.coarse_chroma else self

    def scaled_as(self, scale: GradientScale) -> "PlaneLayer":
        """Return a copy of the layer whose rule scales gradients by `scale`."""
        return replace(self, **rule_fields(self.rule.scaled_as(scale)))


def rule_fields(rule: PlaneRule) -> dict[str, Any]:
    """Return a refinement layer's rule under the name of the field that holds it."""
    return {"structure" if isinstance(rule, StructureRule) else "tree": rule}


def one_rule(structure: StructureRule | None, tree: TreeRule | None) -> PlaneRule:
    """Return the one of two rules that is not None; ValueError unless exactly one is given."""
    if structure is None and tree is not None:
        return tree
    if structure is not None and tree is None:
        return structure
    raise ValueError("a layer has either a structure rule or a tree")


@dataclass(frozen=True)
class SceneLight:
    """A light that a table has transforms for."""

    name: str = data("str", doc="the light")
    white_point: NDArray[np.float64] = data("float64", "output", doc="output of a perfect white under it, Y = 1")
    spectrum: LightSpectrum | None = group(default=None)

    def __post_init__(self) -> None:
        if not self.white_point[:3].min() > 0:
            raise ValueError(f"white_point of {self.name} must be above zero")


@dataclass(frozen=True)
class NoiseEdges:
    """The parts of the class rules that depend on the noise: edges of classes, and the noise in coarse chroma."""

    contrast_edges: NDArray[np.uint32] = data("uint32", "contrast_edge", "level", doc="as in first/rule/")
    constants: NDArray[np.int32] = data("int32", "constant", doc="as in first/rule/features/; none without features")
    gradients: tuple[GradientScale, ...] = group(default=())  # one per refinement layer
    coarse_chroma: CoarseChroma | None = group(default=None)  # of the last layer; None: as in the table

    @classmethod
    def of(cls, first: MosaicLayer, later: Sequence[PlaneLayer]) -> "NoiseEdges":
        """Return the noise-dependent parts of the rules of a table's layers."""
        constants = first.rule.features.constants if first.rule.features else np.zeros(0, np.int32)
        coarse = later[-1].coarse_chroma if later else None
        return cls(first.rule.contrast_edges, constants, tuple(layer.rule.scale for layer in later), coarse)

    def within(self, table: "TransformTable") -> "TransformTable":
        """Return a copy of a table with these edges and without conditions."""
        usual = table.first.rule
        features = usual.features and replace(usual.features, constants=self.constants)
        rule = replace(usual, contrast_edges=self.contrast_edges, features=features)
        later = list(map(PlaneLayer.scaled_as, table.later, self.gradients))
        if later and self.coarse_chroma:
            later[-1] = replace(later[-1], coarse_chroma=self.coarse_chroma)
        return replace(table, first=replace(table.first, rule=rule), later=tuple(later), conditions=())


@dataclass(frozen=True)
class MosaicTransforms:
    """Transforms of the first layer under a condition."""

    weights: NDArray[np.float32] = data("float32", "class", "output", "tap", doc="as in first/")
    intercept: NDArray[np.float32] = data("float32", "class", "output", doc="added to the weighted sum")
    samples: NDArray[np.float64] = data("float64", "class", doc="training patches; 0: filled from a neighbour")


@dataclass(frozen=True)
class PlaneTransforms:
    """Transforms of a refinement layer under a condition."""

    weights: NDArray[np.float32] = data("float32", "plane_class", "output", "plane_tap", doc="as in later/")
    intercept: NDArray[np.float32] = data("float32", "plane_class", "output", doc="added to the weighted sum")
    samples: NDArray[np.float64] = data("float64", "plane_class", doc="training patches; 0: filled from a neighbour")
    clipping: Clipping | None = group(default=None)  # as in later/


@dataclass(frozen=True)
class Condition:
    """Transforms of all layers, learned for one light, for another noise than the camera's, or for both."""

    first: MosaicTransforms = group()
    later: tuple[PlaneTransforms, ...] = group(default=())
    light: SceneLight | None = group(default=None)  # None: all lights of the training set
    noise: NoiseScale | None = group(default=None)  # None: the camera's noise
    edges: NoiseEdges | None = group(default=None)  # None: the edges of the table's rules

    def __post_init__(self) -> None:
        check(self)
        if (self.noise is None) != (self.edges is None) or not (self.light or self.noise):
            raise ValueError("a condition must have a light, or a scale of the noise and its edges")

    @classmethod
    def of(
        cls, first: MosaicLayer, later: Sequence[PlaneLayer], light: SceneLight | None, noise: NoiseScale | None
    ) -> "Condition":
        """Return a condition from layers that were trained for it.

        Parameters
        ----------
        first : MosaicLayer
        later : sequence of PlaneLayer
        light : SceneLight or None
            None for all lights of the training set.
        noise : NoiseScale or None
            None for the camera's noise. Otherwise the condition also holds the edges of the layers' rules.
        """
        return cls(
            MosaicTransforms(first.weights, first.intercept, first.samples),
            tuple(PlaneTransforms(layer.weights, layer.intercept, layer.samples, layer.clipping) for layer in later),
            light,
            noise,
            NoiseEdges.of(first, later) if noise else None,
        )

    def check_fits(self, place: str, later: Sequence[PlaneLayer], levels: int) -> None:
        """Raise ValueError, naming `place`, unless the condition fits a table's refinement layers and number of levels."""
        if len(self.later) != len(later) or (self.edges and len(self.edges.gradients) != len(later)):
            raise ValueError(f"{place} holds {1 + len(self.later)} layers, the table {1 + len(later)}")
        for number, (ours, layer) in enumerate(zip(self.later, later, strict=True)):
            if ours.weights.shape != layer.weights.shape:
                raise ValueError(f"{place}/later/{number} has transforms of other shapes than later/{number}")
        if self.edges and any(len(scale.gradient_factor) != levels for scale in self.edges.gradients):
            raise ValueError(f"{place}/edges has gradients of other levels than the table")

    def pictured(self, taken: list[int]) -> "Condition":
        """Return the condition with some of its outputs, given by their indices. Refinement layers are kept as they are."""
        first = replace(self.first, weights=self.first.weights[:, taken], intercept=self.first.intercept[:, taken])
        light = self.light and replace(self.light, white_point=self.light.white_point[taken])
        return replace(self, first=first, light=light)


@dataclass(frozen=True)
class SpectralSmoothing:
    """Smoothing of spectra: each pixel gets the mean spectrum of its neighbours of similar brightness, but keeps its
    brightness.
    """

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
    """The components of a spectrum that a refinement layer reads and corrects (docs/method.md#leading-components)."""

    basis: NDArray[np.float64] = data("float64", "output", "plane", doc="rows of outputs times it are the planes")

    def __post_init__(self) -> None:
        check(self)
        if self.basis.shape[1] != PLANES:
            raise ValueError(f"basis makes {self.basis.shape[1]} planes, not {PLANES}")


@dataclass(frozen=True, repr=False)
class TransformTable(Artifact):
    """Local linear transforms for every class of every layer, and the rules that decide the class of a pixel.

    The first layer transforms patches of the mosaic. Each refinement layer transforms windows of what the previous layer
    rendered. A table is all that rendering needs (docs/method.md#classes).

    Attributes
    ----------
    camera_name : str
    rows, cols : int
        Size of the camera's frames, in pixels.
    channels : tuple of str
    cfa : ndarray, (cfa_row, cfa_col)
        Index of the channel at each site of the super-pixel.
    bits : int
        Bit depth of raw values.
    black_level, white_level : float
        Levels of the raw values that the table expects, in DN.
    outputs : tuple of str
        Names of the outputs: ("X", "Y", "Z"), ("Y",) or names of spectral bands.
    output_unit : float
        Scene luminance times exposure time that an output of 1 stands for, in cd s/m².
    white_point : ndarray, (output,)
        Output of a perfect white under the training light, scaled to Y = 1.
    first : MosaicLayer
    later : tuple of PlaneLayer
        Refinement layers in order.
    exposure : float
        Mean exposure time of the simulated training frames, in s.
    light : LightSpectrum or None
        Mean light on the training scenes.
    camera : CameraModel or None
        The camera that the table was trained for, without its fit. `l3 train` always stores it.
    conditions : tuple of Condition
        Transforms for other noise, then for each light.
    spectra : SpectralSmoothing or None
        Smoothing of spectra after all layers.
    components : LeadingComponents or None
        The components of a spectrum that a refinement layer corrects. None if that layer makes X, Y, Z itself.
    """

    kind: ClassVar[str] = "transform table"
    made_by: ClassVar[str] = '"l3 train"'

    camera_name: str = data("str", doc="the camera it was learned for")
    rows: int = data("int64", unit="pixel", doc="height of the camera's frames")
    cols: int = data("int64", unit="pixel", doc="width of the camera's frames")
    channels: tuple[str, ...] = data("str", "channel", doc="names of the spectral channels")
    cfa: NDArray[np.uint8] = data("uint8", "cfa_row", "cfa_col", doc="channel of each site of the super-pixel")
    bits: int = data("int64", unit="bit", doc="depth of the raw values")
    black_level: float = data("float64", unit="DN", doc="black level of the raw values the table expects")
    white_level: float = data("float64", unit="DN", doc="white level of the raw values the table expects")
    outputs: tuple[str, ...] = data("str", "output", doc="names of the outputs")
    target_description: str = data("str", doc="what the outputs are")
    output_unit: float = data(
        "float64", unit="cd s/m^2", doc="scene luminance × exposure time that an output of 1 stands for"
    )
    white_point: NDArray[np.float64] = data(
        "float64", "output", doc="output of a perfect white under the training light, Y = 1"
    )
    first: MosaicLayer = group()
    later: tuple[PlaneLayer, ...] = group(default=())
    exposure: float = data("float64", unit="s", doc="mean exposure time of the simulated training frames", default=0.0)
    light: LightSpectrum | None = group(default=None)
    camera: CameraModel | None = group(default=None)
    conditions: tuple[Condition, ...] = group(default=())
    spectra: SpectralSmoothing | None = group(default=None)
    components: LeadingComponents | None = group(default=None)

    def __post_init__(self) -> None:
        super().__post_init__()
        check_sensor(self.rows, self.cols, self.bits, self.black_level, self.white_level)
        check_cfa(self.cfa, self.channels)
        if self.camera and not (self.camera.channels == self.channels and np.array_equal(self.camera.cfa, self.cfa)):
            raise ValueError("the camera's CFA differs from the table's")
        if not self.outputs or not self.output_unit > 0:
            raise ValueError("a table needs at least one output, and output_unit above zero")
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
            raise ValueError("only the last layer may have colour ratios")
        if any(later.coarse_chroma for later in self.later[:-1]):
            raise ValueError("only the last layer may have coarse chroma")
        if self.spectra and (len(self.outputs) == 1 or self.outputs[:3] == ("X", "Y", "Z")):
            raise ValueError(f"spectra of {', '.join(self.outputs)} cannot be smoothed; they must be bands")
        if self.later and (
            len(self.later) > 1 or self.later[-1].coarse_chroma if self.components else len(self.outputs) != 3
        ):
            raise ValueError("a table without exactly three outputs may have one refinement layer, which reads components")
        for index, condition in enumerate(self.conditions):
            condition.check_fits(f"conditions/{index}", self.later, self.first.rule.levels)
        there = [(None, None), *((each.light and each.light.name, each.noise) for each in self.conditions)]
        lights, noises = (dict.fromkeys(part) for part in zip(*there, strict=True))
        if there != list(itertools.product(lights, noises)):
            raise ValueError("conditions must list every light in turn, each with the same noises")

    def _check_refinement(self, layer: PlaneLayer) -> None:
        """Raise ValueError if a layer does not fit the levels, saturation cases and sites of the first layer."""
        layer.rule.check_fits(self.cfa.size, self.first.rule)
        taps = layer.window_taps
        if layer.side % 2 == 0 or layer.ratio_taps not in RATIO_TAPS:
            raise ValueError(f"weights has {layer.weights.shape[2]} taps, but {PLANES} windows of odd side have {taps}")

    @property
    def summary(self) -> str:
        classes = " + ".join(f"{len(layer.weights)}" for layer in self.layers)
        array = f"{self.cfa.shape[0]}×{self.cfa.shape[1]} CFA of {', '.join(self.channels)}"
        conditions = f", {len(self.conditions)} conditions" if self.conditions else ""
        return f'"{self.camera_name}", {array} → {", ".join(self.outputs)}; {classes} classes{conditions}'

    @property
    def layers(self) -> tuple[MosaicLayer | PlaneLayer, ...]:
        """All layers, in the order in which they render."""
        return (self.first, *self.later)

    def pictured(self) -> "TransformTable":
        """Return the table that pictures are rendered with.

        Returns
        -------
        TransformTable
            If further outputs follow X, Y, Z, a table of X, Y, Z only. If luminance is the only output, a table that
            renders it three times, GREY. Otherwise the table itself.
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
        """Whether pictures are grey: the table renders luminance only, or the camera has a single channel."""
        return self.outputs == GREY or len(self.channels) == 1

    @property
    def noises(self) -> tuple[Condition, ...]:
        """The conditions for noise that differs from the camera's, trained on all lights together."""
        return tuple(each for each in self.conditions if each.light is None)

    @property
    def lights(self) -> tuple[SceneLight, ...]:
        """The lights that the table has transforms for, in the order of its conditions."""
        return tuple(each.light for each in self.conditions if each.light and each.noise is None)

    def of_light(self, light: SceneLight | None) -> "TransformTable":
        """Return a table with the transforms for one light, or for None the transforms trained on all lights.

        The table keeps its conditions for other noise.
        """
        if light is None:
            return replace(self, conditions=self.noises) if self.lights else self
        usual, *noises = (each for each in self.conditions if each.light and each.light.name == light.name)
        return replace(self.under(usual), conditions=tuple(replace(each, light=None) for each in noises))

    def under(self, condition: Condition) -> "TransformTable":
        """Return a table with the transforms of one of its conditions only."""
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
        """XYZ (3), in output units, of the darkest white that clips every channel; no pixel is rendered brighter
        (docs/method.md#clipped-white).

        None if the light is unknown, or if the outputs are neither GREY nor begin with X, Y, Z.
        """
        if self.outputs[:3] not in (("X", "Y", "Z"), GREY) or self.light is None or self.camera is None:
            return None
        weakest = white_signal(self.light, self.camera, self.output_unit).min()
        return self.white_point[:3] / (self.white_point[1] * weakest) if weakest > 0 else None

    def gain_at(self, iso: float) -> float | None:
        """Return the analog gain at an ISO speed, relative to the gain of the table's camera, or None if it is unknown."""
        return self.camera.gain_at(iso) if self.camera else None

    def dark_signal(self, exposure: float | None) -> float:
        """Return the mean dark signal above black, in DN, after `exposure` seconds.

        If the exposure time is None, that of the training frames is used. Tables without a camera return 0.
        """
        return self.camera.dark_signal(self.exposure if exposure is None else exposure) if self.camera else 0.0
