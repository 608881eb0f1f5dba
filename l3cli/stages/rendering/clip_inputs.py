"""Clips that a call names, what their outputs are called, and the state of these by the checkpoint that lies beside them.

An item is an output, listed as its clip is begun and again as it has ended. So an output whose clip was begun and has not
ended is half of a run's making. Outputs are known by names, sizes and times, clips by names and fingerprints: another clip
of the same size and time is another clip.
"""

import contextlib
import hashlib
import json
import os
import re
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

from l3cli.artifacts.store import load
from l3cli.artifacts.table import TransformTable
from l3cli.errors import InputFileError, L3Error, RecipeError
from l3cli.io.file_names import PATTERN, natural_order
from l3cli.io.raw.cfa_codes import Sensor
from l3cli.io.raw.files import holds_several
from l3cli.io.raw.registry import BY_SUFFIX, format_of, is_frame
from l3cli.io.sequences import frame_files, is_one_file
from l3cli.io.video import is_video
from l3cli.options.render import RenderOptions
from l3cli.stages.rendering.checkpoint import listed_pictures
from l3cli.stages.rendering.destination import Destination, overrides
from l3cli.system.files import STDIN, is_ours, refuse_protected
from l3cli.system.ledger import dated, fingerprint

WILD = re.compile(r"\[[^]]*\]|[*?]")


def clips_of(inputs: Sequence[Path], table: Path, options: RenderOptions, output: Path) -> tuple[Path, ...]:
    """Each input, in the place of a folder of clips what lies in it. RecipeError if the output would arrive there."""
    clips: list[Path] = []
    for each in inputs:
        inside = _clips_in(each, lambda: load(TransformTable, table), options) if each.is_dir() else []
        ours, theirs = (Path(os.path.realpath(path)) for path in (each, output))  # of a loop of links, too
        if inside and (ours in (theirs, *theirs.parents) or theirs in ours.parents):
            raise RecipeError(f"{output} and {each} lie in one another; name an output elsewhere")
        clips += [path for path in inside if os.path.realpath(path) != os.path.realpath(table)] or [each]
    return tuple(clips)


def are_clips(inputs: Sequence[Path], output: Path, suffix: str) -> bool:
    """Return whether each input is a clip of its own: there are several, of which one is a sequence, or videos are wanted
    in a folder. Several files of one frame each are one job."""
    wants_videos = is_video(Path(f"clip.{suffix}")) and not is_video(output)
    return wants_videos or (len(inputs) > 1 and not all(map(is_one_file, inputs)))


def name_of(source: Path) -> str:
    """Return the name of a clip's output: that of its file or folder; of a pattern or glob what is left without its
    placeholders or, if nothing is, the name of its folder."""
    if source.exists():
        name = source.resolve().name if source.is_dir() else source.stem
        return PATTERN.sub("_", name) or "clip"  # which an output must not be taken for
    plain = WILD.sub("", PATTERN.sub("", source.stem)).strip("_-. ")
    return plain or WILD.sub("", source.parent.resolve().name) or "clip"


def _clips_in(folder: Path, sensor: Callable[[], Sensor], options: RenderOptions) -> list[Path]:
    """Return the videos, files of several frames, folders of frames and single frames of a folder of clips. None of a
    folder of frames, which is one clip: one whose first file that can be read as frames holds just one."""
    paths = [path for path in folder.iterdir() if path.name[0] != "."]  # a million, it may be
    frames = {path.name for path in paths if is_frame(path)}
    longer = [path for path in paths if path.name not in frames and _is_clip(path)]
    several = None
    for path in map(folder.joinpath, sorted(frames)):
        with contextlib.suppress(L3Error):  # broken, so it does not tell
            if path.is_file():
                several = holds_several(path, sensor, overrides(options))
                break
    if several or (several is None and longer):
        return sorted(filter(_is_clip, paths), key=natural_order)
    left_out = sorted(path.name for path in longer if not format_of(path).wants_dataset)  # HDF5: artifacts, most likely
    if left_out:
        more = f" and {len(left_out) - 1} more" if len(left_out) > 1 else ""
        options.console.warn(
            f"{folder} is taken for its frames, without {left_out[0]}{more}; name these, too, if they are meant"
        )
    return []


def _is_clip(path: Path) -> bool:
    """Return whether this is a raw file or a folder that holds some."""
    try:
        if not path.is_dir():
            return path.suffix.lower() in BY_SUFFIX and path.is_file()
        return any(each.name[0] != "." and each.suffix.lower() in BY_SUFFIX for each in path.iterdir())
    except OSError:
        return True  # rendering it says what is wrong


def refuse_one_name(sources: Sequence[Path]) -> None:
    """RecipeError if two clips have one name."""
    named: dict[str, Path] = {}
    for source in sources:
        if source == STDIN:
            raise RecipeError("stdin is one clip; render it alone")
        other = named.setdefault(name_of(source), source)
        if other != source:
            raise RecipeError(f'{other} and {source} would both become "{name_of(source)}"; render them apart')


@dataclass(frozen=True)
class Entry:
    """State of a clip."""

    clip: str  # file or folder, pattern or glob that it is made of, absolute
    of: str  # identity of the clip's files
    made: str | None = None  # identity of what is in the output; None: not ended, or failed
    frames: int = 0
    left_out: int = 0
    seconds: float = 0.0
    frame_times: str | None = None


def _identity(known: Iterable[object]) -> str:
    return hashlib.sha256(json.dumps(list(known)).encode()).hexdigest()[:32]


def identity_of_clip(source: Path) -> str:
    """Return the identity of a clip's files, by names and fingerprints; InputFileError if a folder or glob holds none."""
    return _identity([path.name, *(fingerprint(path) if path.exists() else ())] for path in frame_files(source))


def identity_of_output(output: Path) -> str:
    """Return the identity of a file, or of all files of a folder, by names, sizes and times."""
    return _identity([path.name, *(dated(path) or ())] for path in files_of_output(output))


def files_of_output(output: Path) -> list[Path]:
    """Return the file, or all files of the folder but locks and the like."""
    return sorted(path for path in output.iterdir() if not is_ours(path.name)) if output.is_dir() else [output]


@dataclass(frozen=True)
class Standing:
    """State of a clip and its output."""

    source: Path
    output: Path
    is_file: bool
    of: str  # identity of the clip
    entry: Entry | None  # what a run before has made there; None: nothing, or it does not matter

    @property
    def same(self) -> bool:
        """Return whether the output is of this content."""
        return self.entry is not None and self.entry.of == self.of

    @property
    def checkpoint(self) -> Path:
        """File among the pictures of a run that was stopped."""
        return Destination(self.output, "folder", "").checkpoint

    @property
    def of_other(self) -> Path | None:
        """The clip in another place that the output was made of, as long as it is there."""
        if self.entry is None or self.same or self.entry.clip == os.path.realpath(self.source):
            return None
        clip = Path(self.entry.clip)
        try:
            return clip if any(path.exists() for path in frame_files(clip)) else None
        except (InputFileError, OSError):
            return None

    @property
    def ours(self) -> bool:
        """Return whether the output may be replaced or continued: it is unchanged since a run made it of this clip or one
        that is gone, or it is where that run was stopped."""
        if self.entry is None or self.of_other:
            return False
        if self.entry.made is not None:
            return self.entry.made == identity_of_output(self.output)
        return self.same or self.is_file or self.checkpoint.is_file()  # else nothing says which pictures are of that run

    @property
    def is_finished(self) -> bool:
        """Return whether the output is whole and of this content."""
        return self.ours and self.same and self.entry is not None and self.entry.made is not None

    def clear(self) -> None:
        """Remove the pictures that a run before has made of another content of the clip: it may have had more frames."""
        if self.entry is None or self.is_file or not self.output.is_dir():
            return
        for path in files_of_output(self.output) if self.entry.made else listed_pictures(self.checkpoint):
            refuse_protected(path)
            path.unlink()
