"""The training set: raw frames with their ideal outputs and, for simulated frames, noise-free electrons."""

import contextlib
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import h5py
import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts import container, store
from l3cli.artifacts.camera import CameraModel
from l3cli.artifacts.notebook import html
from l3cli.artifacts.scales import coordinates_of, name_axes
from l3cli.artifacts.schema import Artifact, check, data, group
from l3cli.errors import InputFileError
from l3cli.physics import spectra

LARGEST = 1e12  # largest allowed value in electrons, cd/m² or seconds; its square fits into a 32-bit float


@dataclass(frozen=True)
class LightSpectrum:
    """Spectrum of an illuminant, as the radiance of a perfect white of 1 cd/m²."""

    wavelength: NDArray[np.float64] = data("float64", "wavelength", unit="nm", doc="wavelengths of the spectrum")
    radiance: NDArray[np.float32] = data(
        "float32", "wavelength", unit="photons/s/sr/m^2/nm", doc="radiance of a perfect white of 1 cd/m^2"
    )
    spread: float = data(
        "float64",
        doc="if the spectrum is the mean of several illuminants: largest relative difference between an illuminant and this "
        "mean",
        default=0.0,
    )

    def __post_init__(self) -> None:
        check(self)
        if not (self.wavelength.size > 1 and self.wavelength[0] > 0 and (np.diff(self.wavelength) > 0).all()):
            raise ValueError("wavelength of an illuminant must contain at least two positive, increasing values")
        if not self.radiance.min() >= 0 < self.radiance.max():
            raise ValueError(
                "the radiance of an illuminant must not be negative, and must be positive at one wavelength or more"
            )


def white_signal(light: LightSpectrum, camera: CameraModel, output_unit: float | None = None) -> NDArray[np.float64]:
    """Return the signal of each camera channel for a white surface with Y = 1 under an illuminant.

    Parameters
    ----------
    light : LightSpectrum
        The illuminant.
    camera : CameraModel
        The camera.
    output_unit : float, optional
        Luminance × exposure time, in cd s/m², that corresponds to Y = 1. If it is set, colour-science need not be imported.
        [default: the output unit of the camera]

    Returns
    -------
    ndarray, (channel,)
        Signal above black as a fraction of full scale. It can exceed 1.
    """
    radiance = spectra.resample(light.radiance.astype(np.float64), light.wavelength, camera.wavelength)
    unit = camera.output_unit if output_unit is None else output_unit
    return np.asarray(camera.signal_weights @ radiance * (unit / camera.full_scale))


def stokes_signals(light: LightSpectrum, camera: CameraModel) -> NDArray[np.float64]:
    """Return the change of `white_signal`, (2, channel), if the light is polarised so that S1 or S2 equals S0."""
    radiance = spectra.resample(light.radiance.astype(np.float64), light.wavelength, camera.wavelength)
    weights = camera.stokes_weights[1:] * camera.channel_gains[:, None]
    return np.asarray(weights @ radiance * (camera.output_unit / camera.full_scale))


@dataclass(frozen=True)
class TrainingPair:
    """A raw frame and the ideal outputs of each pixel.

    This class represents real pairs, in which the raw frame comes from a camera. Simulated frames are instances of the
    subclass `TrainingFrame`.
    """

    raw: NDArray[np.uint16] = data(
        "uint16", "row", "col", unit="DN", doc="noisy mosaic, which begins at site (0, 0) of the colour filter array"
    )
    target: NDArray[np.float32] = data(
        "float32", "output", "row", "col", unit="cd/m^2 (XYZ)", doc="ideal outputs at each pixel of the sensor"
    )
    white: NDArray[np.float64] = data(
        "float64", "output", unit="cd/m^2 (XYZ)", doc="target of a perfect white under this illuminant"
    )
    scene: str = data("str", doc="name of the scene")
    illuminant: str = data("str", doc="name of the illuminant")
    luminance: float = data("float64", unit="cd/m^2", doc="luminance of a perfect white")
    exposure: float = data("float64", unit="s", doc="exposure time")
    light: LightSpectrum | None = group(default=None, kw_only=True)  # None for real pairs

    def __post_init__(self) -> None:
        check(self)
        _require_moderate("target", self.target)
        if not (self.white.size and self.white.min() >= 0 < self.white.max() <= LARGEST):
            raise ValueError(
                f"white must contain no negative value and at least one positive value, and no value may exceed {LARGEST:g}"
            )
        if min(self.luminance, self.exposure) < 1 / LARGEST or max(self.luminance, self.exposure) > LARGEST:
            bounds = f"between {1 / LARGEST:g} and {LARGEST:g}"
            raise ValueError(f"luminance is {self.luminance:g} and exposure is {self.exposure:g}, but both must be {bounds}")

    @property
    def dark_time(self) -> float:
        """Time in s during which the dark signal in `raw` accumulated.

        It is 0 for real pairs, because their dark signal has already been subtracted.
        """
        return 0.0

    @property
    def shown(self) -> "Shown | None":
        """Fingerprints of the scene and the illuminant. None if they are unknown, as in all real pairs."""
        return None


@dataclass(frozen=True)
class Shown:
    """Fingerprints of a frame's scene and illuminant, which identify them in the training sets of different cameras."""

    scene: NDArray[np.float64] = data(
        "float64", "projection", doc="fingerprint that identifies the visible part of the scene"
    )
    light: str = data("str", doc="SHA-256 of the measured spectra from which the illuminant was made")

    def __post_init__(self) -> None:
        check(self)


@dataclass(frozen=True)
class IgnoredPixels:
    """Pixels without data in the scene file.

    They are filled from neighbouring pixels, and training ignores them.
    """

    mask: NDArray[np.uint8] = data(
        "uint8", "row", "col", doc="1: the pixel has no data and is ignored; 0: the pixel is used"
    )

    def __post_init__(self) -> None:
        check(self)


@dataclass(frozen=True)
class TrainingFrame(TrainingPair):
    """A simulated pair, which also contains the noise-free electrons of every channel at every pixel.

    From these electrons, training can compute mosaics with any CFA offset and in all eight orientations
    (docs/method.md#patches). `raw` is the mosaic that the camera itself would record.
    """

    electrons: NDArray[np.float32] = data(
        "float32",
        "channel",
        "row",
        "col",
        unit="e-",
        doc="mean number of photo-electrons of every channel at every pixel, without noise and clipping",
    )
    seed: tuple[int, ...] = data("int64", "seed_word", doc="seed of the noise in this frame")
    shown: Shown | None = group(default=None)  # None: the scene and the illuminant have no fingerprints
    ignored: IgnoredPixels | None = group(default=None)  # None: no pixel is ignored

    def __post_init__(self) -> None:
        super().__post_init__()
        _require_moderate("electrons", self.electrons)

    @property
    def dark_time(self) -> float:
        return self.exposure


def _require_moderate(name: str, values: NDArray[np.float32]) -> None:
    """Raise ValueError if there are no values, or if the product of two values could overflow a 32-bit float."""
    if values.size == 0 or max(float(values.max()), -float(values.min())) > LARGEST:
        raise ValueError(f"{name} must not be empty, and its absolute values must not exceed {LARGEST:g}")


@dataclass(frozen=True, repr=False)
class TrainingSet(Artifact):
    """Header of a training set: the camera, the outputs and the description of the target.

    The groups frames/00000, frames/00001… contain simulated frames, and pairs/00000… real pairs. Use `open_training_set` to
    read them one by one.

    Attributes
    ----------
    camera : CameraModel
        The camera that was simulated.
    outputs : tuple of str
        Names of the outputs.
    target_description : str
        Description of the target.
    target_light : LightSpectrum or None
        The illuminant under which all targets are computed. None if each target is computed under the frame's own
        illuminant.
    """

    kind: ClassVar[str] = "training set"
    made_by: ClassVar[str] = '"l3 simulate"'

    camera: CameraModel = group()
    outputs: tuple[str, ...] = data("str", "output", doc="names of the outputs")
    target_description: str = data("str", doc="description of the target")
    target_light: LightSpectrum | None = group(default=None)

    @property
    def summary(self) -> str:
        return f"{self.camera.summary} → {', '.join(self.outputs)}"


def frame_name(index: int, scene: str) -> str:
    """Build the stem of a frame's file names from its number and scene, such as "00003_street-lamp".

    Characters of the scene name other than ASCII letters and digits are replaced by hyphens.
    """
    return f"{index:05d}_{re.sub(r'[^A-Za-z0-9]+', '-', scene)}"


@dataclass(frozen=True)
class FrameLight:
    """The illuminant of a frame: the fields of `TrainingPair` that describe it, without the pixels."""

    illuminant: str = data("str", doc="name of the illuminant")
    white: NDArray[np.float64] = data("float64", "output", unit="cd/m^2 (XYZ)", doc="target of a perfect white")
    luminance: float = data("float64", unit="cd/m^2", doc="luminance of a perfect white under the illuminant")


GROUPS: dict[str, type[TrainingPair]] = {"frames": TrainingFrame, "pairs": TrainingPair}


class TrainingSetReader:
    """An open training set, which can contain more frames than fit into memory.

    `len()` returns the number of frames and real pairs. Iteration yields the simulated frames first, then the real pairs,
    and reads them one at a time.

    Attributes
    ----------
    head : TrainingSet
        Camera, outputs and history.
    """

    def __init__(self, root: h5py.File, path: Path) -> None:
        self._path = path
        self.head: TrainingSet = store.read_fields(root, TrainingSet, path, history=store.read_history(root, path))
        held = store.members(root, path)
        self._groups = {name: store.hard_group(root, name, path) for name in GROUPS if name in held}
        self._names = [(name, each) for name, group in self._groups.items() for each in store.members(group, path)]
        if not self._names:
            raise InputFileError(f'{path} contains no frames; create the file again with "l3 simulate"')

    def __len__(self) -> int:
        return len(self._names)

    @property
    def simulated(self) -> int:
        """Number of simulated frames, which come before the real pairs."""
        return sum(group == "frames" for group, _ in self._names)

    def __repr__(self) -> str:
        real = len(self) - self.simulated
        pairs = f" and {real} real pairs" if real else ""
        return f"<{type(self).__name__}: {self.simulated} frames{pairs} of {self.head.summary}>"

    def _repr_html_(self) -> str:
        return html(repr(self), self.head)

    @property
    def has_pairs(self) -> bool:
        return "pairs" in self._groups

    def frame(self, index: int) -> TrainingPair:
        """Read a frame: a TrainingFrame if it was simulated, otherwise a TrainingPair."""
        return self._read(index, GROUPS[self._names[index][0]])

    def pair(self, index: int) -> TrainingPair:
        """Read a frame as a TrainingPair. This skips the electrons, which are most of the data of a simulated frame."""
        return self._read(index, TrainingPair)

    def _read(self, index: int, kind: type[TrainingPair]) -> TrainingPair:
        group, name = self._names[index]
        frame: TrainingPair = store.read_fields(store.hard_group(self._groups[group], name, self._path), kind, self._path)
        channels = len(frame.electrons) if isinstance(frame, TrainingFrame) else len(self.head.camera.channels)
        if (channels, len(frame.target)) != (len(self.head.camera.channels), len(self.head.outputs)):
            raise InputFileError(
                f"{self._path}: the channels or outputs of {group}/{name} differ from the header; create the file again"
            )
        return frame

    def light(self, index: int) -> FrameLight:
        """Read only the illuminant of a frame."""
        group, name = self._names[index]
        light: FrameLight = store.read_fields(
            store.hard_group(self._groups[group], name, self._path), FrameLight, self._path
        )
        return light

    def __iter__(self) -> Iterator[TrainingPair]:
        for index in range(len(self)):
            yield self.frame(index)


@contextlib.contextmanager
def open_training_set(path: Path, unchanged: bool = False) -> Iterator[TrainingSetReader]:
    """Open a training set for reading in a `with` block.

    Parameters
    ----------
    path : Path
        File of the training set.
    unchanged : bool
        Skip the verification of the digest, for a file that the current run has already verified.

    Raises
    ------
    InputFileError
        If the file is damaged, is not a training set, or contains no frames.
    """
    with store.open_artifact(path, TrainingSet, unchanged=unchanged) as root:
        yield TrainingSetReader(root, path)


class TrainingSetWriter:
    """Appends simulated frames and real pairs to a new training set."""

    def __init__(self, root: h5py.File, head: TrainingSet) -> None:
        self._root = root
        self._coordinates = {**coordinates_of(head.camera), **coordinates_of(head)}

    def _place(self, simulated: bool) -> tuple[h5py.Group, str]:
        group = self._root.require_group("frames" if simulated else "pairs")
        return group, f"{len(group):05d}"

    def append(self, frame: TrainingPair) -> None:
        group, name = self._place(isinstance(frame, TrainingFrame))
        store.write_fields(group.create_group(name), frame, compressed=False)
        name_axes(group[name], type(frame), self._coordinates)

    def append_part(self, path: Path) -> "SceneCoverage":
        """Append a copy of the frame that `write_part` wrote to `path`, and return the coverage of its scene."""
        with container.open_file(path) as part:
            simulated = bool(part.attrs["simulated"])
            group, name = self._place(simulated)
            part.copy("frame", group, name)
            name_axes(group[name], TrainingFrame if simulated else TrainingPair, self._coordinates)
            return SceneCoverage(str(part.attrs["scene"]), float(part.attrs["uncovered"]))


@contextlib.contextmanager
def write_training_set(path: Path, head: TrainingSet) -> Iterator[TrainingSetWriter]:
    """Write a new training set in a `with` block.

    If the block ends without an error, the file is renamed to `path`. Otherwise no file remains.
    """
    with store.new_artifact(path, head.kind, head.history) as root:
        store.write_fields(root, head)
        name_axes(root, type(head), {}, head)
        yield TrainingSetWriter(root, head)


@dataclass(frozen=True)
class SceneCoverage:
    """The name of a frame's scene, and how completely the scene data cover the camera's wavelengths."""

    scene: str  # name of the scene
    uncovered: float  # for a perfect white: fraction of its electrons from wavelengths without scene data


def write_part(path: Path, frame: TrainingPair, uncovered: float) -> None:
    """Write one frame to a separate file, so that an interrupted run can be continued.

    `uncovered` is stored with the frame (see `SceneCoverage`).
    """
    with container.new_file(path) as root:
        root.attrs["simulated"] = isinstance(frame, TrainingFrame)
        root.attrs["scene"] = frame.scene.encode("utf-8", "replace").decode()  # file names may contain invalid characters
        root.attrs["uncovered"] = uncovered
        store.write_fields(root.create_group("frame"), frame, compressed=False)


def read_part(path: Path) -> TrainingPair:
    """Read a frame that `write_part` wrote, without verifying the digest."""
    with container.open_file(path) as part:
        return _frame_of(part, path)


def part_in(content: bytes) -> TrainingPair:
    """Read a frame from the bytes of a file that `write_part` wrote.

    Raises ValueError if the bytes do not match their digest.
    """
    with container.open_content(content) as part:
        return _frame_of(part, Path("frame.h5"))


def _frame_of(part: h5py.File, path: Path) -> TrainingPair:
    kind = TrainingFrame if part.attrs["simulated"] else TrainingPair
    frame: TrainingPair = store.read_fields(part["frame"], kind, path)
    return frame


def whole_part(path: Path) -> bool:
    """Return whether a file that `write_part` wrote exists and matches its digest."""
    try:
        container.check(path, "l3 simulate")
    except InputFileError:
        return False
    return True
