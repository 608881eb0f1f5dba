"""The transform table: class rule and weights, all that rendering needs (METHOD 3, 4)."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.camera import CameraModel, check_cfa, check_sensor
from l3cli.artifacts.schema import Artifact, check, data, group

CLASS_BITS = 12  # class decisions are taken on the upper 12 bits of a value, so that 32-bit sums are exact
LEVEL_FRACTION = 8  # fractional bits of a channel mean in the level sum
CONTRAST_FRACTION = 9  # fractional bits of a channel variance in the contrast sum
CHROMA_SCALE = 1 << 10  # of the chroma weights: sums over 16 channels stay within 32 bits
MAX_CHROMAS = 64
MAX_PATCH = 15
CHROMA_FRACTION = 4  # fractional bits of a channel mean above black in the chroma scores


@dataclass(frozen=True)
class ClassRule:
    """The integer class rule of METHOD 3, written out in classify.py.

    class = ((site · levels + level) · contrasts + contrast) · kinds + kind, with site = row · cfa columns + column.
    The kind is the chroma of an unsaturated pixel, and chromas − 1 + case of one near saturation.
    """

    patch: int = data("int64", unit="pixel", doc="side of the square neighbourhood, odd")
    shift: int = data("int64", unit="bit", doc="values are shifted right by this before sums are formed")
    level_edges: NDArray[np.uint32] = data(
        "uint32",
        "level_edge",
        unit="DN >> shift, times 256 times channels",
        doc="sum over channels of the channel means at which the next level begins",
    )
    contrast_edges: NDArray[np.uint32] = data(
        "uint32",
        "contrast_edge",
        "level",
        unit="(DN >> shift)^2, times 512",
        doc="sum over channels of the channel variances above which the next contrast begins",
    )
    saturation: int = data("int64", unit="DN", doc="value from which a pixel counts as saturated")
    saturation_radius: int = data("int64", unit="pixel", doc="pixels this near the centre decide the saturation case")
    case_of_code: NDArray[np.uint16] = data(
        "uint16", "code", doc="saturation case of each pattern of saturated channels (bit c: channel c)"
    )

    chroma_black: int = data(
        "int64", unit="(DN >> shift) times 16", doc="black level, taken off channel means for the chroma"
    )
    chroma_weights: NDArray[np.int32] = data(
        "int32", "chroma", "channel", doc="weights of the channel means; the chroma of the lowest score wins"
    )

    def __post_init__(self) -> None:
        check(self)
        if not 1 <= len(self.chroma_weights) <= MAX_CHROMAS or np.abs(self.chroma_weights).max() > 2 * CHROMA_SCALE:
            raise ValueError(f"chroma_weights must be 1…{MAX_CHROMAS} rows within ±{2 * CHROMA_SCALE}")
        if self.patch % 2 == 0 or not 1 <= self.patch <= MAX_PATCH:
            raise ValueError(f"patch is {self.patch}, not an odd number up to {MAX_PATCH}")
        if (np.diff(self.level_edges.astype(np.int64)) <= 0).any():
            raise ValueError("level_edges do not increase: more levels than values")
        if not 0 <= self.saturation_radius <= self.patch // 2 or self.saturation < 0:
            raise ValueError("saturation must not be negative, its radius not larger than the patch's")
        if self.contrast_edges.shape[1] != self.levels:
            raise ValueError(f"contrast_edges has {self.contrast_edges.shape[1]} levels, level_edges make {self.levels}")

    @property
    def radius(self) -> int:
        return self.patch // 2

    @property
    def levels(self) -> int:
        return len(self.level_edges) + 1

    @property
    def contrasts(self) -> int:
        return len(self.contrast_edges) + 1

    @property
    def cases(self) -> int:
        return int(self.case_of_code.max()) + 1

    @property
    def chromas(self) -> int:
        return len(self.chroma_weights)

    @property
    def kinds(self) -> int:
        return self.chromas + self.cases - 1

    @property
    def classes_per_site(self) -> int:
        return self.levels * self.contrasts * self.kinds


def check_rule(rule: ClassRule, channels: int, bits: int) -> None:
    """ValueError if a rule is not for a camera of so many channels and bits."""
    if not 0 <= rule.shift <= bits <= rule.shift + CLASS_BITS:
        raise ValueError(f"{bits} bits shifted by {rule.shift} leave more than {CLASS_BITS}")
    if rule.chroma_weights.shape[1] != channels:
        raise ValueError(f"chroma_weights is for {rule.chroma_weights.shape[1]} channels")
    if len(rule.case_of_code) != 2**channels:
        raise ValueError(f"case_of_code has {len(rule.case_of_code)} codes for {channels} channels")


@dataclass(frozen=True)
class TransformTable(Artifact):
    """Local linear transforms for every class: output = weights · (patch − black) / (white − black) + intercept."""

    kind: ClassVar[str] = "transform table"
    version: ClassVar[int] = 2
    made_by: ClassVar[str] = '"l3 train"'

    camera_name: str = data("str", doc="the camera it was learned for")
    rows: int = data("int64", unit="pixel", doc="height of the camera's frames")
    cols: int = data("int64", unit="pixel", doc="width of the camera's frames")
    channels: tuple[str, ...] = data("str", "channel", doc="names of the spectral channels")
    cfa: NDArray[np.uint8] = data("uint8", "cfa_row", "cfa_col", doc="channel of each site of the super-pixel")
    bits: int = data("int64", unit="bit", doc="depth of the raw values")
    black: float = data("float64", unit="DN", doc="black level of the raw values the table expects")
    white: float = data("float64", unit="DN", doc="saturation level of the raw values the table expects")
    outputs: tuple[str, ...] = data("str", "output", doc="names of the outputs")
    target_description: str = data("str", doc="what the outputs are")
    output_unit: float = data(
        "float64", unit="cd s/m^2", doc="scene luminance × exposure time that an output of 1 stands for"
    )
    white_point: NDArray[np.float64] = data(
        "float64", "output", doc="output of a perfect white under the training light, Y = 1"
    )
    rule: ClassRule = group()
    weights: NDArray[np.float32] = data(
        "float32", "class", "output", "tap", doc="taps row by row; per unit of (DN − black) / (white − black)"
    )
    intercept: NDArray[np.float32] = data("float32", "class", "output", doc="added to the weighted sum")
    samples: NDArray[np.float64] = data("float64", "class", doc="training patches; 0: filled from a neighbour")
    condition: NDArray[np.float32] = data("float32", "class", doc="condition number of the class's equations; 0: none")
    exposure: float = data("float64", unit="s", doc="mean exposure time of the simulated training frames", default=0.0)
    camera: CameraModel | None = group(default=None)  # it was learned for, without its fit; None: an older file

    def __post_init__(self) -> None:
        super().__post_init__()
        check_sensor(self.rows, self.cols, self.bits, self.black, self.white)
        check_cfa(self.cfa, self.channels)
        if self.camera and not (self.camera.channels == self.channels and np.array_equal(self.camera.cfa, self.cfa)):
            raise ValueError("camera has another CFA than the table")
        if not self.outputs or not self.output_unit > 0:
            raise ValueError("there must be an output, and its unit above zero")
        if not self.exposure >= 0:
            raise ValueError("exposure must not be negative")
        sites = self.cfa.size
        if len(self.weights) != sites * self.rule.classes_per_site:
            raise ValueError(
                f"weights holds {len(self.weights)} classes, the rule makes {sites} × {self.rule.classes_per_site}"
            )
        if self.weights.shape[2] != self.rule.patch**2:
            raise ValueError(f"weights has {self.weights.shape[2]} taps, the rule's patch {self.rule.patch**2}")
        check_rule(self.rule, len(self.channels), self.bits)

    def dark_signal(self, exposure: float | None) -> float:
        """DN above black that dark current makes, on average, in `exposure` s; if that is unknown, in that of training. A
        table of before has no camera, and none."""
        return self.camera.dark_signal(self.exposure if exposure is None else exposure) if self.camera else 0.0
