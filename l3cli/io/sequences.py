"""Frames that belong together, in order and with numbers: folders, patterns, globs, stacks, headerless streams, raw videos.

What is found here is not read yet, so that memory does not grow with the number of frames and reading can run ahead.
"""

import functools
import itertools
import re
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.table import TransformTable
from l3cli.dark import DarkFrame, average_dark
from l3cli.errors import InputFileError, RecipeError
from l3cli.frame import RawFrame
from l3cli.io import raw_files
from l3cli.io.camera_raws import film_rate
from l3cli.io.fits_files import fits_shape
from l3cli.io.pages import count_pages, read_page
from l3cli.io.raw_files import KnownBetter
from l3cli.io.stacks import find_stack, stack_frame

STDIN = Path("-")
STACKS = (".h5", ".hdf5", ".hdf")
VIDEOS = (".mkv", ".mov", ".mp4", ".avi")
CAMERA_RAWS = tuple(
    "." + name for name in ("3fr", "ari", "arw", "cr2", "cr3", "dcr", "dng", "erf", "fff", "iiq", "kdc", "mos", "mrw")
    + ("nef", "nrw", "orf", "pef", "raf", "rw2", "rwl", "srw", "x3f")
)  # fmt: skip
ONE_FRAME = (
    raw_files.HEADERLESS + raw_files.IMAGES + raw_files.FITS + CAMERA_RAWS + (".npy", ".pgm")
)  # what is taken from a folder
MOST_DIGITS = 18  # of a number: enough for the time to a microsecond, within 64 bits
PATTERN = re.compile(r"%(0[0-9]{1,2})?d|#{1,99}")  # no wider than names are
DIGITS = re.compile(r"[0-9]+")  # of a number: not those of every script, some of which are no digits to Python


@dataclass(frozen=True)
class Pending:
    """A frame that is still to be read."""

    number: int
    stem: str  # of the file that is made of it
    read: Callable[[], RawFrame | None]  # None: there is no such frame, the stream ended before; InputFileError: broken
    source: Path | None = None  # the file that holds it alone
    origin: str | None = None  # what tells it from another frame of its number, once somebody has asked


@dataclass(frozen=True)
class Footage:
    """Frames in their order. Those of a stream go on until one of them reads as None."""

    what: str  # its name in messages
    frames: "Frames"  # that there are; of a stream, that there may be
    count: int | None  # that there ought to be; None: as many as a stream has
    stills: bool  # files named one by one: no sequence in time
    rate: Fraction | None = None  # frames a second, where the file tells
    missing: Sequence[range] = ()  # numbers of those that ought to be and are not, known before reading
    is_stream: bool = False
    wanted: range | None = None  # numbers chosen of a stream

    @property
    def lost(self) -> int:
        """How many are missing."""
        return sum(len(numbers) for numbers in self.missing)

    def absent(self, numbers: range) -> InputFileError:
        """Says that frames are not there."""
        step = f"x{numbers.step}" if numbers.step > 1 else ""
        named = f"frame {numbers[0]} is" if len(numbers) == 1 else f"frames {numbers[0]}-{numbers[-1]}{step} are"
        return InputFileError(f"{named} not in {self.what}; choose with --frames, or add --skip-bad")

    def rest(self, number: int) -> range:
        """The numbers wanted of a stream from one on, at which it has ended."""
        return self.wanted[self.wanted.index(number) :] if self.wanted else range(0)


@dataclass(frozen=True)
class _Series:
    """What one input holds: which numbers, and how the frame of a number is read."""

    what: str  # its name in messages
    numbers: Collection[int] | None  # in order; None: a stream
    read: Callable[[int], RawFrame | None]
    stem: Callable[[int], str]
    rate: Fraction | None = None
    files: Mapping[int, Path] | None = None  # of those frames that have one each
    expected: range | None = None  # numbers that there ought to be; None: those that there are


def find_frames(
    inputs: tuple[Path, ...],
    table: TransformTable,
    known: KnownBetter,
    selection: range | None = None,
    dataset: str | None = None,
) -> Footage:
    """The frames of `inputs`: many files of one frame each, or one input of any kind. A file's number is the last number in
    its name, a stack's frames count from 0; of a pattern every number between its ends is expected, of `selection` all.

    InputFileError if there are none; RecipeError if several inputs are not all files.
    """
    plain = [path for path in inputs if _is_one_file(path)]
    if len(plain) < len(inputs) and len(inputs) > 1:
        other = next(path for path in inputs if not _is_one_file(path))
        raise RecipeError(f"{other} is a sequence; give it alone, or several files of one frame each")
    stills = len(inputs) > 1
    series = _of_files("the inputs", inputs, table, known) if stills else _series(inputs[0], table, known, dataset)
    if series.numbers is None:
        count = None if selection is None else len(selection)
        frames = Frames(series, itertools.count() if selection is None else selection)
        return Footage(series.what, frames, count, count == 1, series.rate, is_stream=True, wanted=selection)
    chosen = selection if selection is not None else series.expected
    there, missing = (series.numbers, []) if chosen is None else _divided(chosen, series.numbers)
    count = len(series.numbers if chosen is None else chosen)
    return Footage(series.what, Frames(series, there), count, stills or count == 1, series.rate, missing)


def _divided(wanted: range, numbers: Collection[int]) -> tuple[Sequence[int], list[range]]:
    """Those of the numbers wanted that there are, in order, and the others: either may be too many to be looked at."""
    if isinstance(numbers, range):  # of a stack: from 0 on
        there: Sequence[int] = range(wanted.start, min(wanted.stop, len(numbers)), wanted.step)
        return there, [wanted[len(there) :]] if len(there) < len(wanted) else []
    there, missing, following = sorted(number for number in numbers if number in wanted), [], 0
    for number in there:
        at = wanted.index(number)
        if at > following:
            missing.append(wanted[following:at])
        following = at + 1
    return there, [*missing, wanted[following:]] if following < len(wanted) else missing


def read_dark(footage: Footage) -> DarkFrame:
    """The mean of frames that were exposed without light; InputFileError if one is missing, broken or of another kind."""
    if footage.count is None:
        raise RecipeError("dark frames are files, not a stream; save them first")
    return average_dark(frame for pending in footage.frames if (frame := pending.read()) is not None)


@dataclass(frozen=True)
class Frames:
    """The frames of a series, made one by one each time they are gone through: there may be many."""

    series: _Series
    wanted: Iterable[int]

    def __iter__(self) -> Iterator[Pending]:
        return map(self.pending, self.wanted)

    def pending(self, number: int) -> Pending:
        """The frame of a number."""
        series = self.series
        source = series.files.get(number) if series.files else None
        return Pending(number, series.stem(number), functools.partial(series.read, number), source)


def _is_one_file(path: Path) -> bool:
    """Whether this is the name of a file, existing or not, that can hold just one frame."""
    if path == STDIN or path.is_dir() or path.suffix.lower() in STACKS + VIDEOS:
        return False
    return path.exists() or not (PATTERN.search(path.name) or _is_glob(path))


def _is_glob(path: Path) -> bool:
    return any(letter in str(path) for letter in "*?[")


def _series(path: Path, table: TransformTable, known: KnownBetter, dataset: str | None) -> _Series:
    suffix = path.suffix.lower()
    if dataset is not None and suffix not in STACKS:
        raise RecipeError(f"--dataset names an array of an HDF5 file; {path} is none")
    if path == STDIN:
        return _stdin(table, known)
    if path.is_dir():
        return _of_files(str(path), _in_folder(path), table, known)
    if not path.exists() and PATTERN.search(path.name):
        return _of_pattern(path, table, known)
    if not path.exists() and _is_glob(path):
        return _of_files(str(path), _globbed(path), table, known)
    if path.exists() and suffix in STACKS:
        return _hdf5_stack(path, table, known, dataset)
    if path.exists() and suffix in VIDEOS:
        return _video(path, table, known)
    if path.exists() and suffix == ".npy" and raw_files.npy_axes(path) == 3:
        return _npy_stack(path, table, known)
    if path.exists() and suffix in raw_files.FITS and len(fits_shape(path)) == 3:
        return _fits_stack(path, table, known)
    if path.exists() and suffix in raw_files.TIFF and (count := count_pages(path)) > 1:
        return _page_stack(path, count, table, known)
    if path.exists() and suffix in raw_files.HEADERLESS:
        return _headerless_stack(path, table, known)
    return _of_files(str(path), (path,), table, known)


# ---------------------------------------------------------------------------------------------------------- files


def _in_folder(folder: Path) -> list[Path]:
    found = [
        path for path in folder.iterdir() if path.suffix.lower() in ONE_FRAME and path.name[0] != "." and path.is_file()
    ]
    kinds = sorted({path.suffix.lower() for path in found})
    if len(kinds) > 1:
        raise InputFileError(f'{folder} holds {" and ".join(kinds)} files; name one kind, such as "{folder}/*{kinds[0]}"')
    if not found:
        raise InputFileError(f"{folder} holds no raw frames; give a folder of {' '.join(raw_files.IMAGES)} .npy .raw .dng …")
    return sorted(found, key=_natural)


def _globbed(path: Path) -> list[Path]:
    matches = Path(path.anchor or ".").glob(str(path.relative_to(path.anchor)))
    found = [each for each in matches if each.name[0] != "." and each.is_file()]
    if not found:
        raise InputFileError(f"{path} matches no file; give the raw frames' names")
    return sorted(found, key=_natural)


def _natural(path: Path) -> tuple[Any, ...]:
    """Sorts 9 before 10."""
    return tuple((int(part), part) if DIGITS.fullmatch(part) else (0, part) for part in re.split(r"([0-9]+)", str(path)))


def last_number(path: Path) -> int | None:
    """The last number in a file's name."""
    found = DIGITS.findall(path.stem)
    return int(found[-1]) if found and len(found[-1]) <= MOST_DIGITS else None


def _of_files(what: str, paths: Iterable[Path], table: TransformTable, known: KnownBetter) -> _Series:
    """One frame a file. Numbered by the files' names; from 0 if a name has no number or two have the same."""
    paths = list(paths)
    named = [number for path in paths if (number := last_number(path)) is not None]
    numbers = named if len(set(named)) == len(paths) else range(len(paths))
    of_number = dict(zip(numbers, paths, strict=True))

    def stem(number: int) -> str:
        return of_number[number].stem if number in of_number else f"{number:06d}"

    def read(number: int) -> RawFrame:
        return raw_files.read_raw(of_number[number], table, known)

    rate = _film_rate(paths[0]) if len(paths) > 1 else None  # a frame alone has no rate
    return _Series(what, of_number, read, stem, rate, of_number)


def _film_rate(path: Path) -> Fraction | None:
    """Frames a second that a CinemaDNG file tells."""
    return film_rate(path) if path.suffix.lower() == ".dng" and path.is_file() else None


def numbered_name(pattern: Path, number: int) -> Path:
    """The pattern's file of a number: %d, %04d or a run of # in its name stands for it."""

    def digits(found: re.Match[str]) -> str:
        width = len(found[0]) if found[0][0] == "#" else int(found[1] or 0)
        return f"{number:0{width}d}"

    return pattern.with_name(PATTERN.sub(digits, pattern.name, count=1))


def numbered_files(pattern: Path) -> dict[int, Path]:
    """The files that exist of a pattern, by number, in order."""
    where = PATTERN.search(pattern.name)
    if where is None or not pattern.parent.is_dir():
        return {}
    spelled = re.compile(
        f"{re.escape(pattern.name[: where.start()])}([0-9]{{1,{MOST_DIGITS}}}){re.escape(pattern.name[where.end() :])}"
    )
    found = {}
    for path in pattern.parent.iterdir():
        match = spelled.fullmatch(path.name)
        if match and numbered_name(pattern, int(match[1])).name == path.name:
            found[int(match[1])] = path
    return dict(sorted(found.items()))


def _of_pattern(pattern: Path, table: TransformTable, known: KnownBetter) -> _Series:
    found = numbered_files(pattern)
    if not found:
        raise InputFileError(f"{pattern} matches no file; give the raw frames' pattern, such as frame_%04d.tif")
    # A pattern says that the frames are numbered throughout: a number left out is a frame lost.
    whole = range(min(found), max(found) + 1)

    def read(number: int) -> RawFrame:
        return raw_files.read_raw(found[number], table, known)

    rate = _film_rate(next(iter(found.values())))
    return _Series(str(pattern), found, read, lambda number: numbered_name(pattern, number).stem, rate, found, whole)


# --------------------------------------------------------------------------------------------------------- stacks


def _stack(path: Path, count: int, pixels: Callable[[int], NDArray], table: TransformTable, known: KnownBetter) -> _Series:
    def read(number: int) -> RawFrame:
        return raw_files.frame_of(f"{path} frame {number}", pixels(number), table, known)

    stem = path.stem
    return _Series(str(path), range(count), read, lambda number: stem if count == 1 else f"{stem}_{number:06d}")


def _page_stack(path: Path, count: int, table: TransformTable, known: KnownBetter) -> _Series:
    def read(number: int) -> RawFrame:
        values, exposure = read_page(path, number)
        return raw_files.frame_of(f"{path} page {number + 1}", values, table, known, exposure)

    return _Series(str(path), range(count), read, lambda number: f"{path.stem}_{number:06d}")


def _headerless_stack(path: Path, table: TransformTable, known: KnownBetter) -> _Series:
    """As many frames as the file has room for; one that is cut is found when it is read."""
    layout, found = raw_files.layout_of(path, table, known), path.stat().st_size
    if found < 2 * layout.frame_bytes:
        return _of_files(str(path), (path,), table, known)

    def pixels(number: int) -> NDArray:
        content = np.fromfile(path, np.uint8, layout.frame_bytes, offset=number * layout.frame_bytes)
        if content.size < layout.frame_bytes:
            raise InputFileError(f"{path} ends within frame {number} of {layout}; give its size with --size ROWSxCOLS")
        return layout.unpack(content)

    return _stack(path, -(-found // layout.frame_bytes), pixels, table, known)


def _fits_stack(path: Path, table: TransformTable, known: KnownBetter) -> _Series:
    def read(number: int) -> RawFrame:
        return raw_files.fits_frame(path, number, table, known)

    return _Series(str(path), range(fits_shape(path)[0]), read, lambda number: f"{path.stem}_{number:06d}")


def _npy_stack(path: Path, table: TransformTable, known: KnownBetter) -> _Series:
    def pixels(number: int) -> NDArray:
        return raw_files.map_npy(path, 3)[number]  # mapped anew: pages of a mapping that is kept count as memory

    return _stack(path, len(raw_files.map_npy(path, 3)), pixels, table, known)


def _hdf5_stack(path: Path, table: TransformTable, known: KnownBetter, dataset: str | None) -> _Series:
    name, count = find_stack(path, dataset)
    return _stack(path, count, lambda number: stack_frame(path, name, number), table, known)


# -------------------------------------------------------------------------------------------------------- streams


class _Stream:
    """Reads frame by frame, each number after the one before it; frames between are passed over."""

    def __init__(self, following: Callable[[], NDArray | None], frame_of: Callable[[NDArray, int], RawFrame]) -> None:
        self._following = following  # the next frame's pixels; None at the end
        self._frame_of = frame_of
        self._next = 0

    def read(self, number: int) -> RawFrame | None:
        pixels: NDArray | None = None
        while self._next <= number:
            self._next += 1  # before reading: a frame that fails has been passed
            try:
                pixels = self._following()
            except InputFileError as error:
                if self._next <= number:
                    continue  # nobody wants it
                raise InputFileError(f"frame {number}: {error}") from error
            if pixels is None:
                return None
        if pixels is None:
            return None
        return self._frame_of(pixels, number)


def _stdin(table: TransformTable, known: KnownBetter) -> _Series:
    if known.size is None:
        raise RecipeError("raw frames on stdin do not tell their size; give it with --size ROWSxCOLS")
    layout = raw_files.layout_of(STDIN, table, known)
    # Unbuffered: a thread that waits in a buffered stream would keep the interpreter from ending.
    pipe = open(0, "rb", buffering=0, closefd=False)  # noqa: SIM115

    def following() -> NDArray | None:
        content = bytearray(layout.frame_bytes)
        filled = 0
        while filled < len(content) and (got := pipe.readinto(memoryview(content)[filled:])):
            filled += got
        if 0 < filled < len(content):
            raise InputFileError(f"stdin ends within the frame, of {layout}; check --size ROWSxCOLS")
        return layout.unpack(content) if filled else None

    stream = _Stream(following, lambda pixels, number: raw_files.frame_of(f"stdin frame {number}", pixels, table, known))
    return _Series("stdin", None, stream.read, lambda number: f"{number:06d}")


def _video(path: Path, table: TransformTable, known: KnownBetter) -> _Series:
    from l3cli.io.video import raw_video_frame, raw_video_rate

    rate, numbers = raw_video_rate(path), itertools.count()

    def following() -> NDArray | None:
        return raw_video_frame(path, next(numbers))

    stream = _Stream(following, lambda pixels, number: raw_files.frame_of(f"{path} frame {number}", pixels, table, known))
    return _Series(str(path), None, stream.read, lambda number: f"{path.stem}_{number:06d}", rate)
