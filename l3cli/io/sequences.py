"""Find frames that belong together, in order and with numbers: folders, patterns, globs, stacks, headerless streams, videos.

Also sequences of finished pictures that are evaluated. Frames are listed here but not read, so that memory does not grow
with their number and they can be read ahead.
"""

import contextlib
import functools
import itertools
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.table import TransformTable
from l3cli.errors import InputFileError, RecipeError
from l3cli.frames.correction import DarkFrame, average_dark
from l3cli.frames.frame import RawFrame
from l3cli.io.file_names import (
    IDEAL,
    MOTION,
    PATTERN,
    RAW,
    globbed,
    is_glob,
    last_number,
    natural_order,
    numbered_files,
    numbered_name,
    of_one_kind,
)
from l3cli.io.images import picture_size, read_image
from l3cli.io.isolated import isolated
from l3cli.io.pictures.registry import suffixes
from l3cli.io.raw import MultiFrameFile
from l3cli.io.raw.files import RawOverrides, format_of, frame_of, is_frame, read_raw, read_stack, read_stdin
from l3cli.io.scenes import rgb
from l3cli.io.video import CONTAINERS, DecodedVideo, InTurn, Stated, is_video, pyav, unit_of
from l3cli.physics.display import srgb_decoded
from l3cli.system.files import STDIN

STDIN_NAME = "stdin"  # name in messages


@dataclass(frozen=True)
class FrameReference:
    """Names a frame of a sequence, which `Frames.read` reads."""

    number: int
    stem: str  # stem of the output file
    source: Path | None = None  # the file, if it contains this frame only
    origin: str = ""  # digest of what its picture is made from, once computed


@dataclass(frozen=True)
class FrameSequence:
    """Frames in order. The frames of a stream go on until one of them reads as None."""

    what: str  # name in messages
    frames: "Frames"  # the existing frames, or the possible frames of a stream
    count: int | None  # expected number of frames; None for a stream of unknown length
    stills: bool  # whether the frames are single files and not a sequence in time
    rate: Fraction | None = None  # frames per second, if the file states it
    missing: Sequence[range] = ()  # numbers of frames that are missing from the sequence
    is_stream: bool = False
    wanted: range | None = None  # numbers selected from a stream
    unit: int | None = 1  # step of the numbers from frame to frame; None if they do not count frames
    times: Stated | None = None  # times of the frames, if the file states them
    part: range | None = None  # positions, from 0, of the frames to render; None for all

    @property
    def lost(self) -> int:
        """Number of missing frames."""
        return sum(len(numbers) for numbers in self.missing)

    @property
    def rendered(self) -> int | None:
        """Number of frames to render; None for a stream of unknown length."""
        return self.count if self.part is None else len(self.part)

    def renders(self, place: int) -> bool:
        """Whether the frame at a position is rendered. Other frames are only read because later frames depend on them."""
        return self.part is None or place in self.part

    def absent(self, numbers: range) -> InputFileError:
        """Return the error for frames that do not exist."""
        step = f"x{numbers.step}" if numbers.step > 1 else ""
        named = f"frame {numbers[0]} is" if len(numbers) == 1 else f"frames {numbers[0]}-{numbers[-1]}{step} are"
        return InputFileError(f"{named} not in {self.what}; choose with ‹frames›, or add ‹skip_bad›")

    def rest(self, number: int) -> range:
        """Return the numbers selected from a stream, beginning at the number where it ended."""
        return self.wanted[self.wanted.index(number) :] if self.wanted else range(0)


@dataclass(frozen=True)
class _Series:
    """An input: its frame numbers, and a function that reads a frame by number."""

    what: str  # name in messages
    numbers: Collection[int] | None  # in order; None for a stream
    read: Callable[[int], RawFrame | None]
    stem: Callable[[int], str]
    rate: Fraction | None = None
    files: Mapping[int, Path] | None = None  # number → file, if each frame has a file of its own
    times: Stated | None = None  # times of the frames of a stream
    expected: range | None = None  # expected numbers; None if only the existing numbers are expected


def find_frames(
    inputs: tuple[Path, ...],
    table: TransformTable,
    known: RawOverrides,
    selection: range | None = None,
    dataset: str | None = None,
) -> FrameSequence:
    """Find the frames of one input of any kind, or of several files with one frame each.

    Parameters
    ----------
    inputs : tuple of Path
        The inputs.
    table : TransformTable
        States the size of headerless frames, and the array.
    known : RawOverrides
        Facts about the raw files.
    selection : range, optional
        Frame numbers to select, all of which are expected to exist. The number of a file is the last number in its name.
        Frames of a stack count from 0. For a pattern, every number between the first and the last is expected.
    dataset : str, optional
        Name of the array in an HDF5 or MATLAB file.

    Raises
    ------
    InputFileError
        If there are no frames.
    RecipeError
        If one of several inputs is not a single file.
    """
    plain = [path for path in inputs if is_one_file(path)]
    if len(plain) < len(inputs) and len(inputs) > 1:
        other = next(path for path in inputs if not is_one_file(path))
        raise RecipeError(f"{other} is a sequence; give it alone, or several files of one frame each")
    stills = len(inputs) > 1
    series = _series_of_files("the inputs", inputs, table, known) if stills else _series(inputs[0], table, known, dataset)
    if known.gains and series.numbers is not None and len(series.expected or series.numbers) != len(known.gains):
        text = f"{len(series.expected or series.numbers)} frames, and ‹gains› lists {len(known.gains)}; list one for each"
        raise InputFileError(f"{series.what}: {text}")
    if series.numbers is None:
        count = None if selection is None else len(selection)
        frames = Frames(series, itertools.count() if selection is None else selection)
        step = 1 if selection is None else selection.step
        about = (series.what, frames, count, count == 1, series.rate)
        return FrameSequence(*about, is_stream=True, wanted=selection, unit=step, times=series.times)
    chosen = selection if selection is not None else series.expected
    there, missing = (series.numbers, []) if chosen is None else _divided(chosen, series.numbers)
    count = len(series.numbers if chosen is None else chosen)
    unit = None if stills else unit_of(list(there)) if chosen is None else chosen.step
    return FrameSequence(series.what, Frames(series, there), count, stills or count == 1, series.rate, missing, unit=unit)


def _divided(wanted: range, numbers: Collection[int]) -> tuple[Sequence[int], list[range]]:
    """Split the wanted numbers into existing numbers, in order, and ranges of missing ones. Both may be too many to list."""
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


def read_dark(sequence: FrameSequence) -> DarkFrame:
    """Return the mean of frames exposed without light. Raises InputFileError if one is missing, damaged or different."""
    if sequence.what == STDIN_NAME:
        raise RecipeError("dark frames are files, not a stream; save them first")
    # The number of frames in a video is known only at its end.
    return average_dark(_until_none(sequence.frames.read(frame.number) for frame in sequence.frames))


def _until_none(frames: Iterable[RawFrame | None]) -> Iterator[RawFrame]:
    for frame in frames:
        if frame is None:
            return
        yield frame


def frame_files(path: Path) -> list[Path]:
    """Return the files of an input of any kind. Raises InputFileError if there are none."""
    if path.is_dir():
        return _in_folder(path)
    if not path.exists() and PATTERN.search(path.name):
        return list(numbered_files(path).values())
    return _globbed(path) if not path.exists() and is_glob(path) else [path]


def is_still(path: Path, table: TransformTable, known: RawOverrides) -> bool:
    """Whether a path is a file with a single frame."""
    return is_one_file(path) and not (path.exists() and read_stack(path, table, known))


@dataclass(frozen=True)
class Frames:
    """The frames of a series. References are created one by one in each iteration, since there may be many."""

    series: _Series
    wanted: Iterable[int]

    def __iter__(self) -> Iterator[FrameReference]:
        return map(self.reference, self.wanted)

    def reference(self, number: int) -> FrameReference:
        """Return the frame with a number."""
        series = self.series
        source = series.files.get(number) if series.files else None
        return FrameReference(number, series.stem(number), source)

    def read(self, number: int) -> RawFrame | None:
        """Read the frame with a number. None after the end of a stream; InputFileError if it is damaged."""
        return self.series.read(number)


def is_one_file(path: Path) -> bool:
    """Whether a path, existing or not, names a file that can contain a single frame."""
    if path == STDIN or path.is_dir() or not format_of(path).holds_frame:
        return False
    return path.exists() or not (PATTERN.search(path.name) or is_glob(path))


def _series(path: Path, table: TransformTable, known: RawOverrides, dataset: str | None) -> _Series:
    if dataset is not None and not format_of(path).wants_dataset:
        raise RecipeError(f"‹dataset› names an array of an HDF5 file; {path} is not one")
    if path == STDIN:
        if known.size is None:
            raise RecipeError("raw frames on stdin have no header with their size; give it with ‹size› ROWSxCOLS")
        return _series_of_stack(STDIN_NAME, "", read_stdin(table, known), table, known)
    if not path.exists() and PATTERN.search(path.name):
        return _series_of_pattern(path, table, known)
    if path.exists() and not path.is_dir() and (stack := read_stack(path, table, known, dataset)):
        return _series_of_stack(str(path), path.stem, stack, table, known)
    return _series_of_files(str(path), frame_files(path), table, known)


# ---------------------------------------------------------------------------------------------------------- files


def _in_folder(folder: Path) -> list[Path]:
    found = [path for path in folder.iterdir() if is_frame(path) and path.name[0] != "." and path.is_file()]
    ideals = {path.name.removesuffix(RAW) + IDEAL for path in found if path.name.endswith(RAW)}  # added by a simulation
    files = of_one_kind(folder, (path for path in found if path.name not in ideals))
    if not files:
        raise InputFileError(f"{folder} holds no raw frames; give a folder of .tif .tiff .png .npy .raw .dng …")
    return files


def _globbed(path: Path) -> list[Path]:
    files = globbed(path)
    if not files:
        raise InputFileError(f"{path} matches no file; give the raw frames' names")
    return files


def _series_of_files(what: str, paths: Iterable[Path], table: TransformTable, known: RawOverrides) -> _Series:
    """Return a series with one frame per file.

    Frames are numbered by file name, or from 0 if a name has no number or two have the same number.
    """
    paths = list(paths)
    named = [number for path in paths if (number := last_number(path)) is not None]
    numbers = named if len(set(named)) == len(paths) else range(len(paths))
    files = dict(zip(numbers, paths, strict=True))
    places = {number: place for place, number in enumerate(numbers)}
    rate = _film_rate(paths[0]) if len(paths) > 1 else None  # a single frame has no rate
    return _Series(
        what, files, lambda number: read_raw(files[number], table, known.of_frame(places[number])),
        lambda number: files[number].stem, rate, files,
    )  # fmt: skip


def _film_rate(path: Path) -> Fraction | None:
    """Return the frame rate that a file with one frame states, as in CinemaDNG."""
    return format_of(path).rate(path) if path.is_file() else None


def _series_of_pattern(pattern: Path, table: TransformTable, known: RawOverrides) -> _Series:
    files = numbered_files(pattern)
    if not files:
        raise InputFileError(f"{pattern} matches no file; give the raw frames' pattern, such as frame_%04d.tif")
    # A pattern implies consecutive numbers, so a missing number is a lost frame.
    whole, rate = range(min(files), max(files) + 1), _film_rate(next(iter(files.values())))
    return _Series(
        str(pattern), files, lambda number: read_raw(files[number], table, known.of_frame(number - whole.start)),
        lambda number: numbered_name(pattern, number).stem, rate, files, expected=whole,
    )  # fmt: skip


# ----------------------------------------------------------------------------------------------- stacks and streams


def _series_of_stack(what: str, stem: str, stack: MultiFrameFile, table: TransformTable, known: RawOverrides) -> _Series:
    """Return the frames of a file or of stdin. Output names are the `stem`, if there is one, and the number."""
    if stack.count == 0:
        raise InputFileError(f"{what} holds no frames; give a file of frames × rows × columns")

    def read(number: int) -> RawFrame | None:
        content = stack.read(number)
        if content is not None:
            return frame_of(f"{what} {stack.name(number)}", content, table, known.of_frame(number))
        if number < len(known.gains):
            raise InputFileError(
                f"{what} has no frame {number}, and ‹gains› lists {len(known.gains)}; list one for each frame"
            )
        return None

    def named(number: int) -> str:
        if stack.count == 1 and not stack.numbered:
            return stem
        return f"{stem}_{number:06d}" if stem else f"{number:06d}"

    numbers = None if stack.count is None else range(stack.count)
    return _Series(what, numbers, read, named, stack.rate, times=stack.times)


PICTURES = suffixes("codes")
Linear = NDArray[np.float32]  # (row, col, 3) linear sRGB
GIVE = 'give a folder of pictures, a pattern such as "out/%04d.png", or a video'
KNOWN_MOTION = ("down", "right", "seen")


@dataclass(frozen=True)
class PictureSequence:
    """Pictures in order, read one by one."""

    name: str
    shape: tuple[int, int]  # rows, cols
    count: int | None  # None for a video, whose length is unknown
    pictures: Callable[[], Iterator[Linear]]
    files: tuple[Path, ...]
    motion: tuple[Path, ...] = ()  # files with the motion of each picture since the previous one


def find_pictures(path: Path) -> PictureSequence:
    """Find a sequence of pictures: a folder, a numbered pattern, a glob, or a video.

    For a folder from a simulation, these are the ideal pictures. Raises InputFileError if there are none, if sizes differ,
    or if a number is missing.
    """
    if is_video(path) and not _names_several(path):
        return PictureSequence(str(path), _video_shape(path), None, functools.partial(_video_pictures, path), (path,))
    return _file_pictures(path, picture_files(path))


def picture_files(path: Path) -> list[Path]:
    """Return the pictures of a folder, a numbered pattern or a glob, in order, of any size.

    For a folder from a simulation, these are the ideal pictures. Raises InputFileError if there are none, or if a number is
    missing.
    """
    if not _names_several(path):
        what = "is a single file" if path.exists() else "does not exist"
        raise InputFileError(f"{path} {what}; {GIVE}")
    if path.is_dir():
        files = _pictures_in(path)
    elif PATTERN.search(path.name):
        numbered = numbered_files(path)
        if lost := [
            number for number in range(min(numbered, default=0), max(numbered, default=0)) if number not in numbered
        ]:
            raise InputFileError(f"{path}: number {lost[0]} is missing; name what is there with a glob, or render it again")
        files = list(numbered.values())
    else:
        files = globbed(path)
    if not files:
        raise InputFileError(f"{path} holds no pictures; {GIVE}")
    if wrong := next((each for each in files if each.suffix.lower() not in PICTURES), None):
        raise InputFileError(f"{wrong} is not a picture; pictures are {', '.join(PICTURES)}")
    return files


def require_alike(ours: PictureSequence, wanted: PictureSequence | None) -> None:
    """Raise InputFileError if a sequence has a single picture, or differs from the ideal one in size or length."""
    if ours.count == 1:
        raise InputFileError(f"{ours.name} holds one picture; a sequence has two or more")
    if wanted is None:
        return
    if ours.shape != wanted.shape:
        sizes = " and ".join(f"{rows}×{cols}" for rows, cols in (ours.shape, wanted.shape))
        raise InputFileError(f"{ours.name} and {wanted.name} are of {sizes} pixels; give pictures of the same frames")
    if ours.count is not None and wanted.count is not None and ours.count != wanted.count:
        counts = f"{ours.count} and {wanted.count} pictures"
        raise InputFileError(f"{ours.name} and {wanted.name} hold {counts}; give pictures of the same frames")


def paired(ours: PictureSequence, wanted: PictureSequence | None) -> Iterator[tuple[Linear, Linear | None, Linear | None]]:
    """Yield the rendered picture, the ideal picture and the known motion of each frame.

    Raises InputFileError if one sequence ends before the other.
    """
    ideals: Iterator[Linear | None] = wanted.pictures() if wanted else itertools.repeat(None)
    motions = iter(wanted.motion) if wanted else iter(())
    for number, picture in enumerate(ours.pictures()):
        ideal = next(ideals, None)
        if wanted is not None and ideal is None:
            raise InputFileError(f"{wanted.name} ends after {number} pictures, {ours.name} goes on; give the same frames")
        motion = next(motions, None)
        yield picture, ideal, None if motion is None else read_motion(motion, ours.shape)
    if wanted is not None and next(ideals, None) is not None:
        raise InputFileError(f"{ours.name} ends before {wanted.name}; give pictures of the same frames")


def read_motion(path: Path, shape: tuple[int, int]) -> Linear:
    """Read the motion of a frame since the previous one (3, row, col): pixels down, pixels right, and 1 where it is
    known.
    """
    planes, names = read_image(path)
    if names != KNOWN_MOTION or planes.shape[:2] != shape or not np.isfinite(planes).all():
        raise InputFileError(f"{path} is not a motion of frames of {shape[0]}×{shape[1]}; give what l3 simulate wrote")
    return np.ascontiguousarray(np.moveaxis(planes, -1, 0), np.float32)


def _names_several(path: Path) -> bool:
    """Whether a path is a folder, a numbered pattern or a glob."""
    return path.is_dir() or (not path.exists() and (bool(PATTERN.search(path.name)) or is_glob(path)))


def _pictures_in(folder: Path) -> list[Path]:
    simulated = sorted(folder.glob(f"*{IDEAL}"), key=natural_order)
    if simulated:
        return simulated
    return of_one_kind(
        folder, (path for path in folder.iterdir() if path.suffix.lower() in PICTURES and path.name[0] != ".")
    )


def _file_pictures(path: Path, files: list[Path]) -> PictureSequence:
    shape = picture_size(files[0])
    for each in files[1:]:
        if (size := picture_size(each)) != shape:
            raise InputFileError(
                f"{each} is {size[0]}×{size[1]}, {files[0].name} {shape[0]}×{shape[1]}; give pictures of one size"
            )
    motion = tuple(each.with_name(each.name.removesuffix(IDEAL) + MOTION) for each in files if each.name.endswith(IDEAL))
    known = motion if len(motion) == len(files) and all(each.is_file() for each in motion) else ()
    return PictureSequence(str(path), shape, len(files), lambda: map(rgb.read, files), tuple(files), known)


# ------------------------------------------------------------------------------------------------------------ videos


def _video_pictures(path: Path) -> Iterator[Linear]:
    number = 0
    while (picture := _video_picture(path, number)) is not None:
        levels = np.arange(np.iinfo(picture.dtype).max + 1) / np.iinfo(picture.dtype).max
        yield srgb_decoded(levels).astype(np.float32)[picture]
        number += 1


def _video(path: Path) -> DecodedVideo:
    return DecodedVideo(path, "what l3 render made", _require_colours, f"{CONTAINERS},yuv4mpegpipe")


def _require_colours(path: Path, context: Any) -> None:
    if not (context.pix_fmt or "").startswith(("yuv", "gbr", "bgr", "rgb")):
        raise InputFileError(f"{path} holds {context.pix_fmt or 'unknown'} pixels; give a video of colours")


_open: dict[Path, InTurn] = {}


@isolated("av")
def _video_shape(path: Path) -> tuple[int, int]:
    with contextlib.closing(_video(path)) as video:
        return video.shape


@isolated("av")
def _video_picture(path: Path, number: int) -> NDArray | None:
    """Return frame `number` as encoded sRGB (row, col, 3) of 8 or 16 bits, or None after the last.

    Luma and chroma are those of BT.709, as `l3 render` writes them.
    """
    frame = _open.setdefault(path, InTurn(_video)).frame(path, number)
    if frame is None:
        return None
    deep = max(component.bits for component in frame.format.components) > 8
    coded = {"src_colorspace": "ITU709"} if frame.format.name.startswith("yuv") else {}
    reformatter = pyav().video.reformatter.VideoReformatter()
    return np.asarray(reformatter.reformat(frame, format="rgb48le" if deep else "rgb24", **coded).to_ndarray())
