"""Find the files that a folder, a glob or a numbered pattern such as frame_%04d.tif or frame_####.tif refers to.

The module also sorts numbered names, finds the clips in a folder, and derives the names of output files.
"""

import contextlib
import re
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

from l3cli.errors import InputFileError, L3Error, RecipeError
from l3cli.io.raw.cfa_codes import Sensor
from l3cli.io.raw.files import BY_SUFFIX, RawOverrides, format_of, holds_several, is_frame
from l3cli.system.files import STDIN

RAW, IDEAL, MOTION = "_raw.tif", "_ideal.png", "_motion.exr"  # endings of the files of a simulated sequence
MOST_WILD = 4  # maximum number of path components with wildcards; each multiplies the number of folders to search
MOST_DIGITS = 18  # maximum number of digits of a frame number, which may be a time in microseconds and must fit in 64 bits
PATTERN = re.compile(r"%(0[0-9]{1,2})?d|#{1,99}")  # placeholder of a number
DIGITS = re.compile(r"[0-9]+")  # ASCII digits only, because Python cannot convert every digit that \d matches


def natural_order(path: Path) -> tuple[Any, ...]:
    """Return a sort key that sorts file names by their numbers, so that frame_9 comes before frame_10."""
    return tuple((int(part), part) if DIGITS.fullmatch(part) else (0, part) for part in re.split(r"([0-9]+)", str(path)))


def last_number(path: Path) -> int | None:
    """Return the last number in the name of a file, or None if the name contains no number."""
    numbers = DIGITS.findall(path.stem)
    return int(numbers[-1]) if numbers and len(numbers[-1]) <= MOST_DIGITS else None


def numbered_name(pattern: Path, number: int) -> Path:
    """Return the file name that a pattern has for a number, which replaces %d, %04d or a sequence of #."""

    def digits(field: re.Match[str]) -> str:
        width = len(field[0]) if field[0][0] == "#" else int(field[1] or 0)
        return f"{number:0{width}d}"

    return pattern.with_name(PATTERN.sub(digits, pattern.name, count=1))


def numbered_files(pattern: Path) -> dict[int, Path]:
    """Return the existing files that match a numbered pattern, as a mapping from number to file in ascending order."""
    where = PATTERN.search(pattern.name)
    if where is None or not pattern.parent.is_dir():
        return {}
    spelled = re.compile(
        f"{re.escape(pattern.name[: where.start()])}([0-9]{{1,{MOST_DIGITS}}}){re.escape(pattern.name[where.end() :])}"
    )
    files = {}
    for path in pattern.parent.iterdir():
        match = spelled.fullmatch(path.name)
        if match and numbered_name(pattern, int(match[1])).name == path.name:
            files[int(match[1])] = path
    return dict(sorted(files.items()))


def is_glob(path: Path) -> bool:
    """Whether a path contains wildcards."""
    return any(letter in str(path) for letter in "*?[")


def globbed(path: Path) -> list[Path]:
    """Return the files that match a glob, in natural order, without hidden files."""
    matches = Path(path.anchor or ".").glob(str(path.relative_to(path.anchor)))
    return sorted((each for each in matches if each.name[0] != "." and each.is_file()), key=natural_order)


def of_one_kind(folder: Path, files: Iterable[Path]) -> list[Path]:
    """Sort the files of a folder in natural order. Raises InputFileError if their suffixes differ."""
    files = sorted(files, key=natural_order)
    kinds = sorted({path.suffix.lower() for path in files})
    if len(kinds) > 1:
        raise InputFileError(
            f'{folder} contains {" and ".join(kinds)} files; select one file type, for example with "{folder}/*{kinds[0]}"'
        )
    return files


def find_scenes(pattern: str, folder: Path, folders: bool | None = False) -> list[Path]:
    """Find the scene files that a name or glob in a recipe refers to.

    Parameters
    ----------
    pattern : str
        Name or glob relative to `folder`.
    folder : Path
        Folder of the recipe.
    folders : bool or None
        Whether scenes are folders instead of files. None if they can be both.

    Returns
    -------
    list of Path
        The files, sorted by name.

    Raises
    ------
    InputFileError
        If no file matches.
    """
    wanted = {True: Path.is_dir, False: Path.is_file, None: Path.exists}[folders]
    single = folder / pattern
    if wanted(single):
        return [single]
    if single.is_dir():
        raise InputFileError(f"{single} is a folder; specify the scene files in the folder")
    if sum(is_glob(Path(part)) for part in single.parts) > MOST_WILD:
        raise InputFileError(
            f"{single} has wildcards in more than {MOST_WILD} parts of the path; write the upper folders without wildcards"
        )
    root = Path(single.anchor)  # "" for a relative folder
    try:
        paths = sorted(path for path in root.glob(str(single.relative_to(root))) if wanted(path))
    except ValueError as error:
        raise InputFileError(f'{single} is not a valid glob; use "**" only as a whole folder name') from error
    if not paths:
        raise InputFileError(f"{single} does not exist; specify a scene file or a glob relative to the folder of the recipe")
    return paths


WILD = re.compile(r"\[[^]]*\]|[*?]")


def name_of(source: Path) -> str:
    """Return the output name of a clip.

    If the clip is an existing file or folder, the result is its name. If the clip is a pattern or glob, the result is the
    pattern without placeholders or, if nothing remains, the name of its folder.
    """
    if source.exists():
        name = source.resolve().name if source.is_dir() else source.stem
        return PATTERN.sub("_", name) or "clip"  # otherwise the output name could be mistaken for a pattern
    plain = WILD.sub("", PATTERN.sub("", source.stem)).strip("_-. ")
    return plain or WILD.sub("", source.parent.resolve().name) or "clip"


def refuse_one_name(sources: Sequence[Path]) -> None:
    """Raise RecipeError if two clips would have the same output name, or if stdin is one of several inputs."""
    named: dict[str, Path] = {}
    for source in sources:
        if source == STDIN:
            raise RecipeError("stdin cannot be combined with other inputs; render stdin with a separate command")
        other = named.setdefault(name_of(source), source)
        if other != source:
            raise RecipeError(
                f'{other} and {source} have the same output name "{name_of(source)}"; render them with separate commands'
            )


def clips_in(folder: Path, sensor: Callable[[], Sensor], known: RawOverrides, warn: Callable[[str], None]) -> list[Path]:
    """Return the clips in a folder. A clip is a video, a file with several frames, a folder of frames, or a single frame.

    Parameters
    ----------
    folder : Path
        The folder.
    sensor : callable
        Returns the table or camera, which states the frame size of headerless files.
    known : RawOverrides
        Facts about the raw files that the user states.
    warn : callable
        Called with a warning if files are left out.

    Returns
    -------
    list of Path
        The clips. The list is empty if the folder itself is one clip, that is, if its first readable file contains a single
        frame.
    """
    paths = [path for path in folder.iterdir() if path.name[0] != "."]
    frames = {path.name for path in paths if is_frame(path)}
    longer = [path for path in paths if path.name not in frames and _is_clip(path)]
    several = None
    for path in map(folder.joinpath, sorted(frames)):
        with contextlib.suppress(L3Error):  # a damaged file is skipped, and the next file is tried
            if path.is_file():
                several = holds_several(path, sensor, known)
                break
    if several or (several is None and longer):
        return sorted(filter(_is_clip, paths), key=natural_order)
    # HDF5 files are most likely artifacts, so they are not reported.
    left_out = sorted(path.name for path in longer if not format_of(path).wants_dataset)
    if left_out:
        more = f" and {len(left_out) - 1} more" if len(left_out) > 1 else ""
        warn(
            f"{folder} is rendered as one sequence of frames, without {left_out[0]}{more}; "
            "to render these files, specify them as inputs"
        )
    return []


def _is_clip(path: Path) -> bool:
    """Whether a path is a raw file, or a folder that contains raw files."""
    try:
        if not path.is_dir():
            return path.suffix.lower() in BY_SUFFIX and path.is_file()
        return any(each.name[0] != "." and each.suffix.lower() in BY_SUFFIX for each in path.iterdir())
    except OSError:
        return True  # the error is reported when the clip is rendered
