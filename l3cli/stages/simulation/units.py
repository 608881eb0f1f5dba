"""Work units of a simulation.

For each unit, a process reads or draws a scene, simulates its frames, and stores each frame in a file. The folder with these
files is next to the output, so that an interrupted run can be continued.
"""

import dataclasses
import hashlib
import itertools
import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from l3cli.artifacts.inspection import history_of
from l3cli.artifacts.schema import Stage
from l3cli.artifacts.training_set import (
    SceneCoverage,
    TrainingFrame,
    TrainingPair,
    TrainingSetWriter,
    part_in,
    read_part,
    write_part,
)
from l3cli.errors import InputFileError, raised_as
from l3cli.parallel import WorkerPool
from l3cli.parallel.cluster import scratch_folder
from l3cli.simulation import sources
from l3cli.simulation.frame import SimulationRun
from l3cli.simulation.recipe import Pair, Shot
from l3cli.stages.simulation.preparation import files_of, scene_over_time
from l3cli.system.checkpoint import PartsFolder
from l3cli.system.files import require_same, write_whole


def key_of(stage: Stage) -> str:
    """Return the key of a run, a digest of all options and inputs that affect its frames."""
    return hashlib.sha256(json.dumps(dataclasses.asdict(stage), sort_keys=True).encode()).hexdigest()


class StoredFrames(PartsFolder):
    """The stored frames of a run, in files that are named after the frame index."""

    def path(self, index: int) -> Path:
        """Return the path of a frame. If the file exists, the frame is finished."""
        return self.folder / f"{index:06d}.h5"

    def __iter__(self) -> Iterator[TrainingPair]:
        return map(read_part, self._files())

    def append_to(self, writer: TrainingSetWriter) -> Iterator[SceneCoverage]:
        """Append all frames to a training set, and yield the scene coverage of each frame."""
        return map(writer.append_part, self._files())

    def _files(self) -> list[Path]:
        return sorted(self.folder.glob("[0-9]*.h5"), key=lambda path: int(path.stem))


def is_of_run(output: Path, key: str) -> bool:
    """Return whether `output` exists and was written by the run with this key."""
    history = history_of(output)
    return bool(history) and key_of(history[-1]) == key


MAX_SENT_BYTES = 64 << 20  # largest result of a worker on another machine, unless a single frame is larger


@dataclass(frozen=True)
class WorkUnit:
    """The work for one process: some frames of one scene, or one real pair."""

    run: SimulationRun
    what: sources.WantedScene | Pair
    shots: list[Shot]
    digests: Mapping[Path, str] = field(default_factory=dict)  # SHA-256 of each file, verified on other machines

    @property
    def files(self) -> list[Path]:
        """Files that the unit reads."""
        if isinstance(self.what, Pair):
            return [self.run.base / self.what.raw, self.run.base / self.what.picture]
        return files_of(self.what.source, self.what.path) if self.what.path else []


def units_of(
    run: SimulationRun, work: list[tuple[sources.WantedScene, list[Shot]]], stored: StoredFrames, workers: int
) -> list[WorkUnit]:
    """Divide the missing frames into work units.

    All frames of a scene are in one unit, so that the scene is read only once, unless there are fewer scenes than workers.
    Each real pair in the recipe is a unit.

    Parameters
    ----------
    run : SimulationRun
        The run.
    work : list of (WantedScene, list of Shot)
        The scenes, each with its frames.
    stored : StoredFrames
        The frames that an earlier run has stored.
    workers : int
        Number of workers.
    """
    first = sum(len(shots) for _, shots in work)
    pairs = ((pair, [Shot(first + number, "", 0.0, 0.0)]) for number, pair in enumerate(run.recipe.pair))
    pieces = -(-2 * workers // max(1, len(work))) if workers > 1 else 1
    units = []
    everything: Iterator[tuple[Any, list[Shot]]] = itertools.chain(work, pairs)
    for what, shots in everything:
        size = -(-len(shots) // pieces)
        parts = (shots[start : start + size] for start in range(0, len(shots), size))
        needed = ([shot for shot in part if not stored.path(shot.index).exists()] for part in parts)
        units += [WorkUnit(run, what, part) for part in needed if part]
    return units


def simulate_unit(stored: StoredFrames, unit: WorkUnit) -> int:
    """Simulate and store the frames of a work unit, and return their number."""
    for index, frame, uncovered in simulated(unit):
        write_part(stored.path(index), frame, uncovered)
    return len(unit.shots)


def simulated(unit: WorkUnit) -> Iterator[tuple[int, Any, float]]:
    """Simulate the frames of a work unit.

    Yields
    ------
    (int, TrainingPair, float)
        Index of the frame, the frame, and the fraction of electrons from wavelengths without scene data.
    """
    run = unit.run
    if isinstance(unit.what, Pair):
        yield unit.shots[0].index, _pair(unit.what, run), 0.0
        return
    from l3cli.frames.scene import ChannelPicture
    from l3cli.simulation.light import uncovered_share

    at = scene_over_time(unit.what, run)
    times: dict[Shot, float] = {}
    for shot in unit.shots:
        scene = at(shot.moment)
        begins = replace(shot, index=0, moment=0)
        if shot.moment and begins not in times:  # all frames of a clip have the exposure time of its first frame
            times[begins] = run.exposure_time(at(0), begins)
        uncovered = 0.0 if isinstance(scene, ChannelPicture) else uncovered_share(run.camera, scene.wavelength)
        yield shot.index, run.frame(scene, shot, times.get(begins)), uncovered


def received(pool: WorkerPool, work: list[WorkUnit], stored: StoredFrames, digests: Mapping[Path, str]) -> Iterator[int]:
    """Let workers on other machines simulate work units, and store the frames that they return.

    The workers must have access to the same input files. Yields the number of frames in each result.

    Parameters
    ----------
    pool : WorkerPool
        The workers.
    work : list of WorkUnit
        The work units.
    stored : StoredFrames
        Receives the frames.
    digests : mapping of Path to str
        SHA-256 of each input file.
    """
    needed = []
    for unit in work:
        most = max(1, MAX_SENT_BYTES // unit.run.frame_bytes)
        hashes = {path: digests[path] for path in unit.files}
        parts = (unit.shots[start : start + most] for start in range(0, len(unit.shots), most))
        needed += [replace(unit, shots=part, digests=hashes) for part in parts]
    for sent in pool(_sent, needed, _are_frames_of):
        for index, content in sent:
            write_whole(stored.path(index), content)
        yield len(sent)


def _sent(unit: WorkUnit) -> list[tuple[int, bytes]]:
    """Simulate a work unit in a worker on another machine, and return the index and the file content of each frame."""
    for path, digest in unit.digests.items():
        require_same(path, digest)
    with scratch_folder() as folder:
        sent = []
        for index, frame, uncovered in simulated(unit):
            write_part(folder / "frame.h5", frame, uncovered)
            sent.append((index, (folder / "frame.h5").read_bytes()))
        return sent


def _are_frames_of(unit: WorkUnit, sent: list[tuple[int, bytes]]) -> bool:
    """Return whether a result of `_sent` from another machine contains exactly the frames of the unit, in order.

    Each frame must also have the expected type and the expected numbers of outputs and channels.
    """
    frames = [part_in(content) for _, content in sent]
    camera, outputs = unit.run.camera, len(unit.run.target.outputs)
    return [index for index, _ in sent] == [shot.index for shot in unit.shots] and all(
        len(frame.target) == outputs
        and isinstance(frame, TrainingFrame) != isinstance(unit.what, Pair)
        and not (isinstance(frame, TrainingFrame) and len(frame.electrons) != len(camera.channels))
        for frame in frames
    )


def _pair(pair: Pair, run: SimulationRun) -> Any:
    from l3cli.frames.frame import upright
    from l3cli.io.images import picture_flip, read_image
    from l3cli.io.raw.files import RawOverrides, read_raw
    from l3cli.io.scenes.rgb import read as read_rgb_picture
    from l3cli.physics.display import xyz_from_srgb_matrix
    from l3cli.simulation.frame import make_pair

    raw_path, path = run.base / pair.raw, run.base / pair.picture
    raw = read_raw(raw_path, run.camera, RawOverrides(phase=pair.phase))
    outputs = run.target.outputs
    pixels, names = read_image(path)
    if set(outputs) <= set(names):
        picture = np.ascontiguousarray(pixels[..., [names.index(output) for output in outputs]], np.float32)
    elif set(outputs) <= {"X", "Y", "Z"}:
        to_xyz = xyz_from_srgb_matrix()[["XYZ".index(output) for output in outputs]]
        picture = read_rgb_picture(path) @ to_xyz.T.astype(np.float32)
    else:
        raise InputFileError(f"{path} has no channels called {', '.join(outputs)}; use an EXR file with these channels")
    with raised_as(InputFileError, path):
        return make_pair(raw, upright(picture, picture_flip(path)), outputs, run.camera, pair, path.stem)
