"""Partial sums: the least-squares normal equations, summed over the training frames of one shard.

A file contains the sums of one layer, separately for each canonical site and class. A canonical site represents all CFA
sites that are symmetric to it. The layer is the first layer (docs/method.md#exact-sums) or a refinement layer
(docs/method.md#layers).
"""

import contextlib
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import h5py
import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts import store
from l3cli.artifacts.camera import CameraModel
from l3cli.artifacts.class_rule import ClassRule
from l3cli.artifacts.layers import PLANES, RATIO_TAPS, PlaneRule, one_rule
from l3cli.artifacts.plane_rules import GradientScale, StructureRule, TreeRule
from l3cli.artifacts.scales import name_axes
from l3cli.artifacts.schema import Artifact, check, data, group
from l3cli.artifacts.table import TransformTable
from l3cli.artifacts.training_set import LightSpectrum, TrainingSet
from l3cli.errors import InputFileError

USUAL, OTHERS = "sums", "condition_sums"  # HDF5 groups with the sums for the camera's noise and for the noise sets


@dataclass(frozen=True)
class ClassSums:
    """First-layer sums over the weighted training patches of one canonical site.

    A canonical site represents all CFA sites that are symmetric to it.
    The columns of the normal equations are the taps, the intercept and the outputs.
    """

    moments: NDArray[np.float64] = data(
        "float64", "class", "pair", doc="products of the columns: upper triangle of the moment matrix, row by row"
    )
    noise: NDArray[np.float64] = data(
        "float64",
        "class",
        "tap",
        doc="noise variance of the taps; if rows or columns share noise, also the covariances of taps in the same line",
    )
    count: NDArray[np.float64] = data("float64", "class", doc="number of training patches")

    def __post_init__(self) -> None:
        check(self)


def noise_columns(rule: ClassRule, camera: CameraModel) -> int:
    """Return the number of noise terms that first-layer sums store per class.

    There is one variance per tap. If the camera has row or column noise, there is also one covariance for each pair of taps
    in the same row, and one for each pair of taps in the same column.
    """
    pairs_per_line = rule.patch * (rule.patch - 1) // 2
    return rule.patch**2 + (2 * rule.patch * pairs_per_line if camera.has_line_noise else 0)


@dataclass(frozen=True, repr=False)
class PartialSums(Artifact):
    """Header of a file with partial sums of the first layer.

    The groups sums/00000, sums/00001… contain the sums for the camera's noise, in the order of `sites`. The groups
    condition_sums/0/00000… contain the sums for the first noise set (docs/method.md#noise-sets), and so on.

    The last stage in the history describes the training. All shards of a training have equal histories.
    """

    kind: ClassVar[str] = "partial sums"
    made_by: ClassVar[str] = '"l3 train --shard I/N"'

    shard: int = data("int64", doc="number of this shard, from 1")
    shards: int = data("int64", doc="number of shards")
    pass_number: int = data(
        "int64", doc="1: first pass, whose errors determine the weights in the second pass; 2: last pass"
    )
    patches: NDArray[np.int64] = data(
        "int64", "frame", doc="number of patches per site of each training frame, in all shards together"
    )
    training: TrainingSet = group()
    rule: ClassRule = group()
    white_point: NDArray[np.float64] = data(
        "float64", "output", doc="outputs of a perfect white under the training illuminant, scaled to Y = 1"
    )
    sites: NDArray[np.int64] = data(
        "int64", "canonical_site", doc="CFA sites that are trained, as row · CFA columns + column", coordinate=True
    )
    exposure: float = data("float64", unit="s", doc="mean exposure time of the simulated training frames", default=0.0)
    light: LightSpectrum | None = group(default=None)  # mean illuminant of the training scenes

    def __post_init__(self) -> None:
        super().__post_init__()
        if not 1 <= self.shard <= self.shards or self.pass_number not in (1, 2):
            raise ValueError(
                f"shard is {self.shard}, shards is {self.shards} and pass_number is {self.pass_number}; shard must be "
                "between 1 and the value of shards, and pass_number must be 1 or 2"
            )
        self.rule.check_fits(len(self.training.camera.channels), self.training.camera.bits)
        if len(self.white_point) != len(self.training.outputs):
            raise ValueError(
                f"white_point has {len(self.white_point)} values, but there are {len(self.training.outputs)} outputs"
            )

    @property
    def shapes(self) -> tuple[tuple[int, int], tuple[int, int], tuple[int]]:
        """Shapes that `moments`, `noise` and `count` must have in each site's sums."""
        classes, taps = self.rule.classes_per_site, self.rule.patch**2
        width = taps + 1 + len(self.training.outputs)
        noise = noise_columns(self.rule, self.training.camera)
        return (classes, width * (width + 1) // 2), (classes, noise), (classes,)


@dataclass(frozen=True)
class LayerSums:
    """Refinement-layer sums over the training samples of one canonical site.

    A canonical site represents all CFA sites that are symmetric to it.
    The columns of the normal equations are the taps, the intercept, and the outputs converted to opponent planes.
    """

    moments: NDArray[np.float64] = data(
        "float64",
        "plane_class",
        "plane_pair",
        doc="products of the columns, without noise: upper triangle of the moment matrix, row by row",
    )
    noise: NDArray[np.float64] = data(
        "float64",
        "plane_class",
        "plane_tap_pair",
        doc="covariance of the noise of the taps and of the corrected outputs: upper triangle, row by row",
    )
    count: NDArray[np.float64] = data("float64", "plane_class", doc="number of training samples")

    def __post_init__(self) -> None:
        check(self)


@dataclass(frozen=True, repr=False)
class PartialLayerSums(Artifact):
    """Header of a file with partial sums of a refinement layer.

    Groups and history are as in `PartialSums`.
    """

    kind: ClassVar[str] = "partial sums of a layer"
    made_by: ClassVar[str] = '"l3 train --shard I/N"'

    shard: int = data("int64", doc="number of this shard, from 1")
    shards: int = data("int64", doc="number of shards")
    mosaics: NDArray[np.int64] = data(
        "int64", "frame", doc="number of mosaics of each training frame, in all shards together"
    )
    side: int = data("int64", unit="pixel", doc="side of the windows")
    table: TransformTable = group()  # table with all previous layers
    sites: NDArray[np.int64] = data(
        "int64", "canonical_site", doc="CFA sites that are trained, as row · CFA columns + column", coordinate=True
    )
    structure: StructureRule | None = group(default=None)  # None if the class rule is a decision tree
    tree: TreeRule | None = group(default=None)  # None if the class rule distinguishes structures
    ratio_taps: int = data(
        "int64", doc="number of taps for colour ratios and bilateral chroma, which follow the taps of the windows", default=0
    )
    gradients: tuple[GradientScale, ...] = group(default=())  # one scale per noise set

    @property
    def rule(self) -> PlaneRule:
        return one_rule(self.structure, self.tree)

    def __post_init__(self) -> None:
        super().__post_init__()
        if not 1 <= self.shard <= self.shards:
            raise ValueError(f"shard is {self.shard}, but must be between 1 and {self.shards}")
        if self.table.camera is None:
            raise ValueError("table must contain a camera model")
        if self.ratio_taps not in RATIO_TAPS:
            raise ValueError(f"ratio_taps is {self.ratio_taps}, but must be one of {', '.join(map(str, RATIO_TAPS))}")
        if self.side < 1 or self.side % 2 == 0:
            raise ValueError(f"side is {self.side}, but must be a positive, odd number")
        self.rule.check_fits(self.table.cfa.size, self.table.first.rule)
        levels = self.table.first.rule.levels
        if [len(scale.gradient_factor) for scale in self.gradients] != [levels for _ in self.table.noises]:
            raise ValueError(
                f"gradients must contain a GradientScale for each of the table's {len(self.table.noises)} noise conditions, "
                f"with one factor for each of the {levels} levels"
            )

    @property
    def shapes(self) -> tuple[tuple[int, int], tuple[int, int], tuple[int]]:
        """Shapes that `moments`, `noise` and `count` must have in each site's sums."""
        classes, outputs = self.rule.classes_per_site, len(self.table.outputs)
        taps = PLANES * self.side**2 + self.ratio_taps
        width, noisy = taps + 1 + outputs, taps + (outputs if self.table.components else 0)
        return (classes, width * (width + 1) // 2), (classes, noisy * (noisy + 1) // 2), (classes,)


Head = PartialSums | PartialLayerSums
SUMS: dict[type[Head], type] = {PartialSums: ClassSums, PartialLayerSums: LayerSums}  # type of a site's sums


class PartialSumsReader:
    """An open file with partial sums, which are read site by site to save memory.

    Attributes
    ----------
    head : PartialSums or PartialLayerSums
        Header of the file.
    conditions : int
        Number of noise sets with sums in the file, not counting the camera's noise.

    Raises
    ------
    InputFileError
        If the sums of a site are missing.
    """

    def __init__(self, root: h5py.File, path: Path) -> None:
        self._path = path
        kind = next(kind for kind in SUMS if kind.kind == root.attrs["kind"])
        self.head: Any = store.read_fields(root, kind, path, history=store.read_history(root, path))
        held = store.members(root, path)
        self._sums = [store.hard_group(root, USUAL, path)]
        if OTHERS in held:
            others = store.hard_group(root, OTHERS, path)
            self._sums += [store.hard_group(others, str(number), path) for number in range(len(store.members(others, path)))]
        if any(len(store.members(sums, path)) != len(self.head.sites) for sums in self._sums):
            raise InputFileError(
                f"{path}: the sums of one or more sites are missing; create the file again with {kind.made_by}"
            )
        self.conditions = len(self._sums) - 1

    def site(self, index: int, condition: int = 0) -> Any:
        """Read the sums of one site: ClassSums for the first layer, LayerSums for a refinement layer.

        Parameters
        ----------
        index : int
            Index of the site in `head.sites`.
        condition : int, default 0
            0 for the camera's noise, or the number of a noise set, from 1 to `conditions`.

        Raises
        ------
        InputFileError
            If the shapes of the sums do not match the class rule.
        """
        where = store.hard_group(self._sums[condition], f"{index:05d}", self._path)
        sums: Any = store.read_fields(where, SUMS[type(self.head)], self._path)
        if (sums.moments.shape, sums.noise.shape, sums.count.shape) != self.head.shapes:
            raise InputFileError(
                f"{self._path}: the sums in {where.name} do not match the class rule; create the file again"
            )
        return sums


@contextlib.contextmanager
def open_partial_sums(path: Path) -> Iterator[PartialSumsReader]:
    """Open a file with partial sums in a `with` block.

    Raises
    ------
    InputFileError
        If the file is damaged or does not contain partial sums.
    """
    with store.open_artifact(path, *SUMS) as root:
        yield PartialSumsReader(root, path)


def write_partial_sums(path: Path, head: Head, *sets: Iterable[ClassSums] | Iterable[LayerSums]) -> None:
    """Write a file with partial sums. After an error, no incomplete file remains.

    Parameters
    ----------
    path : Path
        The new file.
    head : PartialSums or PartialLayerSums
        Header of the file.
    *sets : iterable of ClassSums or LayerSums
        One iterable for the camera's noise, followed by one per noise set. Each iterable yields the sums of the sites in
        `head.sites`, one at a time, so that only one site's sums need to be in memory.
    """
    with store.new_artifact(path, head.kind, head.history) as root:
        store.write_fields(root, head)
        name_axes(root, type(head), {}, head)
        for number, sums in enumerate(sets):
            below = root.create_group(f"{OTHERS}/{number - 1}" if number else USUAL)
            for index, site in enumerate(sums):
                group = below.create_group(f"{index:05d}")
                store.write_fields(group, site)
                name_axes(group, type(site), {})
