"""The transform table: class rules and linear transforms of all layers (docs/method.md#classes)."""

import itertools
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.camera import CameraModel, NoiseScale, check_cfa, check_sensor
from l3cli.artifacts.conditions import Condition, NoiseEdges, SceneLight
from l3cli.artifacts.layers import PLANES, RATIO_TAPS, MosaicLayer, PlaneLayer
from l3cli.artifacts.schema import Artifact, check, data, group
from l3cli.artifacts.training_set import LightSpectrum, white_signal
from l3cli.physics.stokes import STOKES

LUMINANCE = ("Y",)  # outputs of a table that renders only luminance
GREY = ("Y", "Y", "Y")  # outputs of a luminance table after its conversion by `TransformTable.pictured`
WINDOWS = (3, 5, 7, 9)  # allowed window sides for averaging spectra, in pixels


@dataclass(frozen=True)
class SpectralSmoothing:
    """Settings of spectral smoothing.

    Each pixel's spectrum is replaced by the mean spectrum of neighbours with similar brightness. The pixel's own brightness
    is preserved.
    """

    window: int = data("int64", unit="pixel", doc="side of the square neighbourhood over which spectra are averaged")
    reach: float = data("float64", doc="relative difference in brightness at which pixels are excluded from the mean")

    def __post_init__(self) -> None:
        check(self)
        if self.window not in WINDOWS:
            raise ValueError(f"window is {self.window}, but must be one of {', '.join(map(str, WINDOWS))}")
        if not 0 < self.reach < 1:
            raise ValueError(f"reach is {self.reach:g}, but must be greater than 0 and less than 1")

    @property
    def radius(self) -> int:
        return self.window // 2


@dataclass(frozen=True)
class ChromaSmoothing:
    """Settings of chroma smoothing, for tables with the outputs X, Y, Z (docs/method.md#smoothed-chroma).

    Each pixel's chromaticity is averaged with the chromaticities of similar neighbours: of its 16 neighbours, those with
    similar luminance and chroma. The pixel's luminance is preserved.
    """

    reach: float = data("float64", doc="relative difference in luminance at which the weight of a neighbour reaches zero")
    likeness: float = data(
        "float64",
        doc="difference in X/Y or Z/Y, as a fraction of the value for white, at which the weight of a near neighbour "
        "reaches zero; half of it for far neighbours",
    )

    def __post_init__(self) -> None:
        check(self)
        if not 0 < self.reach < 1:
            raise ValueError(f"reach is {self.reach:g}, but must be greater than 0 and less than 1")
        if not self.likeness > 0:
            raise ValueError(f"likeness is {self.likeness:g}, but must be positive")


@dataclass(frozen=True)
class LeadingComponents:
    """Conversion of the outputs to the three planes that a refinement layer corrects (docs/method.md#leading-components).

    For spectra, the planes are the leading components. For colours with Stokes parameters, they are S1, Y and S2.
    """

    basis: NDArray[np.float64] = data(
        "float64", "output", "plane", doc="matrix that converts outputs to planes: planes = outputs · basis"
    )

    def __post_init__(self) -> None:
        check(self)
        if self.basis.shape[1] != PLANES:
            raise ValueError(f"basis has {self.basis.shape[1]} planes, but must have {PLANES}")

    @property
    def chroma_outputs(self) -> tuple[int, ...]:
        """Indices of the two outputs that equal the chroma planes. Empty if a chroma plane combines several outputs."""
        chroma = self.basis[:, :: PLANES - 1]
        single = (np.count_nonzero(chroma, axis=0) == 1).all() and (chroma.max(axis=0) == 1).all()
        return tuple(chroma.argmax(axis=0).tolist()) if single else ()


@dataclass(frozen=True, repr=False)
class TransformTable(Artifact):
    """Everything that rendering needs: class rules, and the linear transform of each class, for all layers.

    The class rules classify the pixels. The first layer transforms patches of the mosaic, and each refinement layer
    transforms windows of the previous layer's output (docs/method.md#classes).

    Attributes
    ----------
    camera_name : str
        Name of the camera.
    rows, cols : int
        Size of the camera's frames in pixels.
    channels : tuple of str
        Names of the channels.
    cfa : ndarray, (cfa_row, cfa_col)
        Index of the channel at each site of the super-pixel.
    bits : int
        Bit depth of raw values.
    black_level, white_level : float
        Levels in DN that raw values must have before they are rendered.
    outputs : tuple of str
        Names of the outputs, such as ("X", "Y", "Z"), ("Y",) or names of spectral bands.
    target_description : str
        Description of the outputs.
    output_unit : float
        Scene luminance × exposure time that corresponds to an output of 1, in cd s/m².
    white_point : ndarray, (output,)
        Outputs of a perfect white under the training illuminant, scaled to Y = 1.
    first : MosaicLayer
        First layer.
    later : tuple of PlaneLayer
        Refinement layers, in order.
    exposure : float
        Mean exposure time of the simulated training frames in s.
    light : LightSpectrum or None
        Mean illuminant of the training scenes.
    camera : CameraModel or None
        The camera model for which the table was trained, without its `fit`. `l3 train` always stores it.
    conditions : tuple of Condition
        Transforms for noise sets, then transforms for each illuminant.
    spectra : SpectralSmoothing or None
        Spectral smoothing after all layers. None: no smoothing.
    chroma_smoothing : ChromaSmoothing or None
        Chroma smoothing after all layers. None: no smoothing.
    components : LeadingComponents or None
        Planes that the refinement layer corrects, if the outputs are spectra or include Stokes parameters. Otherwise None.
    """

    kind: ClassVar[str] = "transform table"
    made_by: ClassVar[str] = '"l3 train"'

    camera_name: str = data("str", doc="name of the camera for which the table was trained")
    rows: int = data("int64", unit="pixel", doc="rows of the camera's frames")
    cols: int = data("int64", unit="pixel", doc="columns of the camera's frames")
    channels: tuple[str, ...] = data("str", "channel", doc="names of the spectral channels")
    cfa: NDArray[np.uint8] = data(
        "uint8", "cfa_row", "cfa_col", doc="index of the channel at each site, for one period of the colour filter array"
    )
    bits: int = data("int64", unit="bit", doc="bit depth of the raw values")
    black_level: float = data("float64", unit="DN", doc="black level of the raw values that the table expects")
    white_level: float = data("float64", unit="DN", doc="white level of the raw values that the table expects")
    outputs: tuple[str, ...] = data("str", "output", doc="names of the outputs")
    target_description: str = data("str", doc="description of the outputs")
    output_unit: float = data(
        "float64", unit="cd s/m^2", doc="scene luminance × exposure time that corresponds to an output of 1"
    )
    white_point: NDArray[np.float64] = data(
        "float64", "output", doc="outputs of a perfect white under the training illuminant, scaled to Y = 1"
    )
    first: MosaicLayer = group()
    later: tuple[PlaneLayer, ...] = group(default=())
    exposure: float = data("float64", unit="s", doc="mean exposure time of the simulated training frames", default=0.0)
    light: LightSpectrum | None = group(default=None)
    camera: CameraModel | None = group(default=None)
    conditions: tuple[Condition, ...] = group(default=())
    spectra: SpectralSmoothing | None = group(default=None)
    chroma_smoothing: ChromaSmoothing | None = group(default=None)
    components: LeadingComponents | None = group(default=None)

    def __post_init__(self) -> None:
        super().__post_init__()
        check_sensor(self.rows, self.cols, self.bits, self.black_level, self.white_level)
        check_cfa(self.cfa, self.channels)
        if self.camera and not (self.camera.channels == self.channels and np.array_equal(self.camera.cfa, self.cfa)):
            raise ValueError("the table and its camera model have different channels or CFAs")
        if not self.outputs or not self.output_unit > 0:
            raise ValueError("outputs must not be empty, and output_unit must be positive")
        if not self.exposure >= 0:
            raise ValueError(f"exposure is {self.exposure:g}, but must not be negative")
        for layer in self.layers:
            sites, classes = self.cfa.size, layer.rule.classes_per_site
            if len(layer.weights) != sites * classes:
                raise ValueError(
                    f"weights has {len(layer.weights)} classes, but the class rule defines {classes} classes at each of the "
                    f"{sites} sites"
                )
        self.first.rule.check_fits(len(self.channels), self.bits)
        for later in self.later:
            self._check_refinement(later)
        if any(later.ratio_taps for later in self.later[:-1]):
            raise ValueError("only the last layer may have taps for colour ratios")
        if any(later.coarse_chroma for later in self.later[:-1]):
            raise ValueError("only the last layer may have coarse_chroma")
        if self.spectra and (len(self.outputs) == 1 or self.outputs[:3] == ("X", "Y", "Z")):
            raise ValueError(
                f"the outputs {', '.join(self.outputs)} are not spectral bands, so they cannot be smoothed as spectra"
            )
        if self.chroma_smoothing and (self.outputs != ("X", "Y", "Z") or not (self.white_point > 0).all()):
            raise ValueError("chroma_smoothing requires the outputs X, Y, Z and a white_point with positive values")
        if self.later and (len(self.later) > 1 if self.components else len(self.outputs) != 3):
            raise ValueError(
                f"refinement layers require three outputs, but there are {len(self.outputs)}; a table with a different "
                "number of outputs can have only one refinement layer, and must have components, which this layer corrects"
            )
        if self.later and self.later[-1].coarse_chroma and not self.chroma_outputs:
            raise ValueError("coarse_chroma requires a table in which each chroma plane equals an output")
        for index, condition in enumerate(self.conditions):
            condition.check_fits(f"conditions/{index}", self.later, self.first.rule.levels)
        there = [(None, None), *((each.light and each.light.name, each.noise) for each in self.conditions)]
        lights, noises = (dict.fromkeys(part) for part in zip(*there, strict=True))
        if there != list(itertools.product(lights, noises)):
            raise ValueError("conditions must be grouped by illuminant, with the same noise conditions for every illuminant")

    def _check_refinement(self, layer: PlaneLayer) -> None:
        """Raise ValueError unless a refinement layer fits the CFA and the first layer and has a valid number of taps."""
        layer.rule.check_fits(self.cfa.size, self.first.rule)
        taps = layer.window_taps
        if layer.side % 2 == 0 or layer.ratio_taps not in RATIO_TAPS:
            raise ValueError(
                f"side is {layer.side} and weights has {layer.weights.shape[2]} taps; side must be odd, and weights must "
                f"have the {taps} taps of {PLANES} windows, plus {' or '.join(map(str, RATIO_TAPS))} extra taps"
            )

    @property
    def summary(self) -> str:
        classes = " + ".join(f"{len(layer.weights)}" for layer in self.layers)
        array = f"{self.cfa.shape[0]}×{self.cfa.shape[1]} CFA of {', '.join(self.channels)}"
        conditions = f", {len(self.conditions)} conditions" if self.conditions else ""
        return f'"{self.camera_name}", {array} → {", ".join(self.outputs)}; {classes} classes{conditions}'

    @property
    def layers(self) -> tuple[MosaicLayer | PlaneLayer, ...]:
        """All layers, in the order in which they are applied."""
        return (self.first, *self.later)

    def pictured(self) -> "TransformTable":
        """Return a table with only the outputs that are needed to render pictures.

        Outputs in addition to X, Y, Z are removed. A single output Y is repeated three times (GREY). Other tables stay
        unchanged. Tables with refinement layers never change, because these layers need all outputs of the first layer.
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
        """Whether the table renders grey pictures: from luminance, Stokes parameters or a single channel."""
        return self.outputs in (GREY, STOKES) or len(self.channels) == 1

    @property
    def chroma_outputs(self) -> tuple[int, ...]:
        """Indices of the outputs that coarse chroma smoothing changes: those in the chroma planes of refinement layers."""
        return (0, PLANES - 1) if self.components is None else self.components.chroma_outputs

    @property
    def noises(self) -> tuple[Condition, ...]:
        """The conditions for noise sets that were trained on all illuminants together."""
        return tuple(each for each in self.conditions if each.light is None)

    @property
    def lights(self) -> tuple[SceneLight, ...]:
        """The illuminants with their own transforms, in the order of the conditions."""
        return tuple(each.light for each in self.conditions if each.light and each.noise is None)

    def of_light(self, light: SceneLight | None) -> "TransformTable":
        """Return a table with only the transforms for one illuminant, including its noise sets.

        If `light` is None, these are the transforms that were trained on all illuminants together.
        """
        if light is None:
            return replace(self, conditions=self.noises) if self.lights else self
        usual, *noises = (each for each in self.conditions if each.light and each.light.name == light.name)
        return replace(self.under(usual), conditions=tuple(replace(each, light=None) for each in noises))

    def under(self, condition: Condition) -> "TransformTable":
        """Return a table with only the transforms of one condition.

        White point, illuminant, camera, output unit and exposure time also change to match the condition.
        """
        light, noise = condition.light, condition.noise or NoiseScale()
        table = self._with_edges(condition.edges) if condition.edges else self
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

    def _with_edges(self, edges: NoiseEdges) -> "TransformTable":
        """Return the table with class rules for a different noise, and without transforms for other conditions."""
        usual = self.first.rule
        features = usual.features and replace(usual.features, constants=edges.constants)
        rule = replace(usual, contrast_edges=edges.contrast_edges, features=features)
        later = list(map(PlaneLayer.scaled_as, self.later, edges.gradients))
        if later and edges.coarse_chroma:
            later[-1] = replace(later[-1], coarse_chroma=edges.coarse_chroma)
        return replace(self, first=replace(self.first, rule=rule), later=tuple(later), conditions=())

    @property
    def clipped_white(self) -> NDArray[np.float64] | None:
        """XYZ of the darkest white that clips every channel, in output units (docs/method.md#clipped-white).

        No pixel is rendered brighter than this white. None if the illuminant or the camera is unknown, or if the first three
        outputs are neither X, Y, Z nor GREY.
        """
        if self.outputs[:3] not in (("X", "Y", "Z"), GREY) or (white := self.white_signals) is None:
            return None
        return self.white_point[:3] / (self.white_point[1] * white.min())

    @property
    def white_signals(self) -> NDArray[np.float64] | None:
        """Signal of each channel for a white surface with the output Y = 1, as a fraction of full scale.

        Rendering uses these signals to raise the luminance of pixels where it is much too low
        (docs/method.md#raised-pixels). None if the illuminant or the camera is unknown, or if a channel has no signal.
        """
        if self.light is None or self.camera is None:
            return None
        signals = white_signal(self.light, self.camera, self.output_unit)
        return signals if signals.min() > 0 else None

    def gain_at(self, iso: float) -> float | None:
        """Convert an ISO speed to an analog gain, relative to the table's camera (see `CameraModel.gain_at`).

        Returns None if the gain is unknown or the table contains no camera.
        """
        return self.camera.gain_at(iso) if self.camera else None

    def dark_signal(self, exposure: float | None) -> float:
        """Return the mean dark signal after `exposure` seconds, in DN.

        If `exposure` is None, the training frames' mean exposure time applies. If the table contains no camera, the result
        is 0.
        """
        return self.camera.dark_signal(self.exposure if exposure is None else exposure) if self.camera else 0.0
