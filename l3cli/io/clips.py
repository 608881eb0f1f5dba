"""Clips of one call: which files of a folder are clips, and what the output of each is called."""

import contextlib
import re
from collections.abc import Callable, Sequence
from pathlib import Path

from l3cli.errors import L3Error, RecipeError
from l3cli.io.file_names import PATTERN, natural_order
from l3cli.io.raw.cfa_codes import Sensor
from l3cli.io.raw.files import BY_SUFFIX, RawOverrides, format_of, holds_several, is_frame
from l3cli.system.files import STDIN

WILD = re.compile(r"\[[^]]*\]|[*?]")


def name_of(source: Path) -> str:
    """Return the name of a clip's output: that of its file or folder; of a pattern or glob what is left without its
    placeholders or, if nothing is, the name of its folder."""
    if source.exists():
        name = source.resolve().name if source.is_dir() else source.stem
        return PATTERN.sub("_", name) or "clip"  # which an output must not be taken for
    plain = WILD.sub("", PATTERN.sub("", source.stem)).strip("_-. ")
    return plain or WILD.sub("", source.parent.resolve().name) or "clip"


def refuse_one_name(sources: Sequence[Path]) -> None:
    """Raise RecipeError if two clips have one name."""
    named: dict[str, Path] = {}
    for source in sources:
        if source == STDIN:
            raise RecipeError("stdin is one clip; render it alone")
        other = named.setdefault(name_of(source), source)
        if other != source:
            raise RecipeError(f'{other} and {source} would both become "{name_of(source)}"; render them apart')


def clips_in(folder: Path, sensor: Callable[[], Sensor], known: RawOverrides, warn: Callable[[str], None]) -> list[Path]:
    """Return the videos, files of several frames, folders of frames and single frames of a folder of clips. None of a
    folder of frames, which is one clip: one whose first file that can be read as frames holds just one."""
    paths = [path for path in folder.iterdir() if path.name[0] != "."]  # a million, it may be
    frames = {path.name for path in paths if is_frame(path)}
    longer = [path for path in paths if path.name not in frames and _is_clip(path)]
    several = None
    for path in map(folder.joinpath, sorted(frames)):
        with contextlib.suppress(L3Error):  # broken, so it does not tell
            if path.is_file():
                several = holds_several(path, sensor, known)
                break
    if several or (several is None and longer):
        return sorted(filter(_is_clip, paths), key=natural_order)
    left_out = sorted(path.name for path in longer if not format_of(path).wants_dataset)  # HDF5: artifacts, most likely
    if left_out:
        more = f" and {len(left_out) - 1} more" if len(left_out) > 1 else ""
        warn(f"{folder} is taken for its frames, without {left_out[0]}{more}; name these, too, if they are meant")
    return []


def _is_clip(path: Path) -> bool:
    """Return whether this is a raw file or a folder that holds some."""
    try:
        if not path.is_dir():
            return path.suffix.lower() in BY_SUFFIX and path.is_file()
        return any(each.name[0] != "." and each.suffix.lower() in BY_SUFFIX for each in path.iterdir())
    except OSError:
        return True  # rendering it says what is wrong
