"""Which clips a call names: its inputs, what lies in a folder of clips, and what their outputs are called."""

import contextlib
import os
import re
from collections.abc import Callable, Sequence
from pathlib import Path

from l3cli.artifacts.store import load
from l3cli.artifacts.table import TransformTable
from l3cli.errors import L3Error, RecipeError
from l3cli.io.file_names import PATTERN, natural_order
from l3cli.io.raw.cfa_codes import Sensor
from l3cli.io.raw.files import holds_several
from l3cli.io.raw.registry import BY_SUFFIX, format_of, is_frame
from l3cli.io.sequences import is_one_file
from l3cli.io.video import is_video
from l3cli.options.render import RenderOptions
from l3cli.stages.rendering.destination import overrides
from l3cli.system.files import STDIN

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
