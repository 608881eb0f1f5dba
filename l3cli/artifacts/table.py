"""The transform table: class rule and weights, all that rendering needs (docs/method.md#classes)."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.camera import CameraModel, check_cfa, check_sensor
from l3cli.artifacts.class_rule import ClassRule, check_rule
from l3cli.artifacts.schema import Artifact, data, group


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
