"""Find the files in a folder, or those that match a glob or a numbered pattern such as frame_%04d.tif or frame_####.tif.

The module also sorts numbered file names, finds the clips in a folder, and derives output names.
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

RAW, IDEAL, MOTION = "_raw.tif", "_ideal.png", "_motion.exr"  # endings of the file names in a simulated sequence
MOST_WILD = 4  # maximum number of path components with wildcards, each of which multiplies the number of folders to search
MOST_DIGITS = 18  # maximum number of digits in a frame number, which may be a time in µs and must fit into 64 bits
PATTERN = re.compile(r"%(0[0-9]{1,2})?d|#{1,99}")  # placeholder for the number in a file name
DIGITS = re.compile(r"[0-9]+")  # ASCII digits only


def natural_order(path: Path) -> tuple[Any, ...]:
    """Return a sort key that compares numbers in file names by value, so that frame_9 sorts before frame_10."""
    return tuple((int(part), part) if DIGITS.fullmatch(part) else (0, part) for part in re.split(r"([0-9]+)", str(path)))


def last_number(path: Path) -> int | None:
    """Return the last number in a file name without its suffix.

    Returns None if the name contains no number, or if the number has more than MOST_DIGITS digits.
    """
    numbers = DIGITS.findall(path.stem)
    return int(numbers[-1]) if numbers and len(numbers[-1]) <= MOST_DIGITS else None


def numbered_name(pattern: Path, number: int) -> Path:
    """Insert a number into a pattern, in place of the first placeholder (%d, %04d or ####) in its file name."""

    def digits(field: re.Match[str]) -> str:
        width = len(field[0]) if field[0][0] == "#" else int(field[1] or 0)
        return f"{number:0{width}d}"

    return pattern.with_name(PATTERN.sub(digits, pattern.name, count=1))


def numbered_files(pattern: Path) -> dict[int, Path]:
    """Return the existing files that match a numbered pattern, by their numbers in increasing order."""
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
    """Return whether a path contains a wildcard: *, ? or [."""
    return any(letter in str(path) for letter in "*?[")


def globbed(path: Path) -> list[Path]:
    """Return the files that match a glob in natural order, without hidden files."""
    matches = Path(path.anchor or ".").glob(str(path.relative_to(path.anchor)))
    return sorted((each for each in matches if each.name[0] != "." and each.is_file()), key=natural_order)


def of_one_kind(folder: Path, files: Iterable[Path]) -> list[Path]:
    """Sort files in natural order. Raises InputFileError if their suffixes differ."""
    files = sorted(files, key=natural_order)
    kinds = sorted({path.suffix.lower() for path in files})
    if len(kinds) > 1:
        raise InputFileError(
            f'{folder} contains {" and ".join(kinds)} files; select one file type, for example with "{folder}/*{kinds[0]}"'
        )
    return files


def find_scenes(pattern: str, folder: Path, folders: bool | None = False) -> list[Path]:
    """Find the scenes to which a name or a glob in a recipe refers.

    Parameters
    ----------
    pattern : str
        Name or glob, relative to `folder`.
    folder : Path
        The recipe's folder.
    folders : bool or None
        Whether the scenes are folders instead of files. None if both are allowed.

    Returns
    -------
    list of Path
        At least one file or folder, sorted by name.

    Raises
    ------
    InputFileError
        If nothing matches, if the glob is invalid, or if too many parts of the path contain wildcards.
    """
    wanted = {True: Path.is_dir, False: Path.is_file, None: Path.exists}[folders]
    single = folder / pattern
    if wanted(single):
        return [single]
    if single.is_dir():
        raise InputFileError(f"{single} is a folder; specify the scene files in the folder")
    if sum(is_glob(Path(part)) for part in single.parts) > MOST_WILD:
        raise InputFileError(
            f"{single} has wildcards in more than {MOST_WILD} parts of the path; write the first folders without wildcards"
        )
    root = Path(single.anchor)  # "" for a relative folder
    try:
        paths = sorted(path for path in root.glob(str(single.relative_to(root))) if wanted(path))
    except ValueError as error:
        raise InputFileError(f'{single} is not a valid glob; use "**" only as a whole folder name') from error
    if not paths:
        raise InputFileError(f"{single} does not exist; specify a scene file or a glob relative to the recipe's folder")
    return paths


WILD = re.compile(r"\[[^]]*\]|[*?]")


def name_of(source: Path) -> str:
    """Derive the output name of a clip from its input.

    For an existing file or folder, the output name is the input's name without its suffix. For a pattern or glob, it is the
    name without placeholders and wildcards or, if nothing remains, the name of the folder.
    """
    if source.exists():
        name = source.resolve().name if source.is_dir() else source.stem
        return PATTERN.sub("_", name) or "clip"  # with a placeholder, the output name would itself be a pattern
    plain = WILD.sub("", PATTERN.sub("", source.stem)).strip("_-. ")
    return plain or WILD.sub("", source.parent.resolve().name) or "clip"


def refuse_one_name(sources: Sequence[Path]) -> None:
    """Raise RecipeError if two clips have the same output name, or if one of them is stdin."""
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
    """Find the clips in a folder. A clip is a video, a file with several frames, a folder of frames, or a single frame.

    Parameters
    ----------
    folder : Path
        The folder.
    sensor : callable
        Function that returns the table or camera. It is needed for the frame size of headerless files.
    known : RawOverrides
        Properties of the raw files that the user set.
    warn : callable
        Function that is called with a warning if files are skipped.

    Returns
    -------
    list of Path
        The clips in natural order. Empty if the folder itself is one clip, because its first readable file contains a single
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
    # HDF5 files are not reported, because they are probably l3 artifacts.
    left_out = sorted(path.name for path in longer if not format_of(path).wants_dataset)
    if left_out:
        more = f" and {len(left_out) - 1} more" if len(left_out) > 1 else ""
        warn(
            f"{folder} is rendered as one sequence of frames, without {left_out[0]}{more}; "
            "specify such files as inputs to render them"
        )
    return []


def _is_clip(path: Path) -> bool:
    """Return whether a path is a file with a raw format's suffix, or a folder that contains such a file."""
    try:
        if not path.is_dir():
            return path.suffix.lower() in BY_SUFFIX and path.is_file()
        return any(each.name[0] != "." and each.suffix.lower() in BY_SUFFIX for each in path.iterdir())
    except OSError:
        return True  # treat an unreadable path as a clip, so that rendering reports the error
