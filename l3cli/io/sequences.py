"""Find the raw frames in an input, or the rendered pictures of a sequence that is to be evaluated.

An input is a folder, a numbered pattern, a glob, a file with one or several frames, a video, or a headerless stream on
stdin. The frames are listed first. Each frame is read when it is needed.
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

STDIN_NAME = "stdin"  # name of the input in messages


@dataclass(frozen=True)
class FrameReference:
    """Reference to a frame in a sequence. `Frames.read(number)` reads the frame."""

    number: int
    stem: str  # name of the output file, without suffix
    source: Path | None = None  # input file, if it contains only this frame
    origin: str = ""  # digest of everything that determines the rendered picture; "" if not yet computed


@dataclass(frozen=True)
class FrameSequence:
    """The frames in an input, in order. A stream ends at the first frame for which `Frames.read` returns None."""

    what: str  # name of the input in messages
    frames: "Frames"  # a stream may end before the last of these frames
    count: int | None  # expected number of frames, including missing frames; None for a stream of unknown length
    stills: bool  # whether the frames are independent pictures instead of a sequence in time
    rate: Fraction | None = None  # frames per second, if the file states it
    missing: Sequence[range] = ()  # ranges of frame numbers that are missing from the sequence
    is_stream: bool = False  # whether the frames must be read in order, and their number may be unknown
    wanted: range | None = None  # frame numbers that the user selected from a stream; None for all frames
    unit: int | None = 1  # step between consecutive frame numbers; None if irregular, for example for time stamps
    times: Stated | None = None  # function that reads the frame times; None if the file does not contain them
    part: range | None = None  # positions, counted from 0, of the frames to render; None for all frames

    @property
    def lost(self) -> int:
        """Number of missing frames."""
        return sum(len(numbers) for numbers in self.missing)

    @property
    def rendered(self) -> int | None:
        """Number of frames to render, or None for a stream of unknown length."""
        return self.count if self.part is None else len(self.part)

    def renders(self, place: int) -> bool:
        """Return whether to render the frame at a position.

        Frames that are not rendered may still be read, because later frames depend on them.
        """
        return self.part is None or place in self.part

    def absent(self, numbers: range) -> InputFileError:
        """Return an error that names missing frames, for the caller to raise."""
        step = f"x{numbers.step}" if numbers.step > 1 else ""
        named = f"frame {numbers[0]} is" if len(numbers) == 1 else f"frames {numbers[0]}-{numbers[-1]}{step} are"
        return InputFileError(f"{named} not in {self.what}; select existing frames with ‹frames›, or add ‹skip_bad›")

    def rest(self, number: int) -> range:
        """Return the selected frame numbers that are missing if a stream ends before frame `number`.

        The result is empty if the user has not made a selection.
        """
        return self.wanted[self.wanted.index(number) :] if self.wanted else range(0)


@dataclass(frozen=True)
class _Series:
    """The frame numbers in an input, and functions that read and name the frame with a given number."""

    what: str  # name of the input in messages
    numbers: Collection[int] | None  # existing frame numbers in order; None for a stream
    read: Callable[[int], RawFrame | None]
    stem: Callable[[int], str]  # returns the name of the output file, without suffix
    rate: Fraction | None = None  # frames per second, if the file states it
    files: Mapping[int, Path] | None = None  # frame number → file, if each frame has its own file
    times: Stated | None = None  # function that reads the frame times; None if the file does not contain them
    expected: range | None = None  # frame numbers that should exist; None if all and only `numbers` should exist


def find_frames(
    inputs: tuple[Path, ...],
    table: TransformTable,
    known: RawOverrides,
    selection: range | None = None,
    dataset: str | None = None,
) -> FrameSequence:
    """Find the frames in one input of any type, or in several files with one frame each.

    Parameters
    ----------
    inputs : tuple of Path
        The inputs. A pattern or glob is one input, and STDIN is a headerless stream.
    table : TransformTable
        Transform table, which determines the CFA and, unless `known` contains a size, the size of headerless frames.
    known : RawOverrides
        Properties of the raw files that the user set. They take precedence over the properties in the files.
    selection : range, optional
        Numbers of the frames to select, all of which should exist. [default: all frames; in a pattern, all numbers between
        the first and the last should exist]
    dataset : str, optional
        Name of the array in an HDF5 or MATLAB file.

    Returns
    -------
    FrameSequence
        The frames in order of their numbers, and the numbers of missing frames.

    Raises
    ------
    InputFileError
        If there are no frames, or if the number of gains in `known` differs from the number of frames.
    RecipeError
        If one of several inputs is not a file with a single frame, if `dataset` does not apply to the input, or if the size
        of frames on stdin is unknown.

    Notes
    -----
    If each file contains one frame, the frame number is the last number in the file name. If a name contains no number, or
    if two names contain the same number, the files are numbered from 0 instead. The frames in a file with several frames are
    also numbered from 0.
    """
    plain = [path for path in inputs if is_one_file(path)]
    if len(plain) < len(inputs) and len(inputs) > 1:
        other = next(path for path in inputs if not is_one_file(path))
        raise RecipeError(f"{other} is a sequence; specify it as the only input, or specify only files with one frame each")
    stills = len(inputs) > 1
    series = _series_of_files("the inputs", inputs, table, known) if stills else _series(inputs[0], table, known, dataset)
    if known.gains and series.numbers is not None and len(series.expected or series.numbers) != len(known.gains):
        existing = len(series.expected or series.numbers)
        text = f"{existing} frames, but ‹gains› lists {len(known.gains)} gains; list one gain per frame"
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
    """Split the wanted frame numbers into existing numbers, in order, and ranges of missing numbers.

    Missing numbers are returned as ranges, because `wanted` may contain very many numbers.
    """
    if isinstance(numbers, range):  # the frames of a stack, which are numbered from 0
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
    """Average the dark frames in a sequence.

    Raises InputFileError if a frame is damaged, or if the frames differ in size. Raises RecipeError if the frames come from
    stdin.
    """
    if sequence.what == STDIN_NAME:
        raise RecipeError("dark frames cannot be read from stdin; save them in files")
    # The number of frames in a video is unknown until the video ends.
    return average_dark(_until_none(sequence.frames.read(frame.number) for frame in sequence.frames))


def _until_none(frames: Iterable[RawFrame | None]) -> Iterator[RawFrame]:
    for frame in frames:
        if frame is None:
            return
        yield frame


def frame_files(path: Path) -> list[Path]:
    """Return the raw files in a folder, or those that match a pattern or a glob, in order.

    For any other path, return only this path, even if the file does not exist. The list is empty if no file matches a
    pattern. Raises InputFileError if a folder contains no raw files, or if no file matches a glob.
    """
    if path.is_dir():
        return _in_folder(path)
    if not path.exists() and PATTERN.search(path.name):
        return list(numbered_files(path).values())
    return _globbed(path) if not path.exists() and is_glob(path) else [path]


def is_still(path: Path, table: TransformTable, known: RawOverrides) -> bool:
    """Return whether a path is a file with a single frame. A missing file is judged by its name."""
    return is_one_file(path) and not (path.exists() and read_stack(path, table, known))


@dataclass(frozen=True)
class Frames:
    """The frames in an input. References are created during iteration, because there may be very many frames."""

    series: _Series
    wanted: Iterable[int]

    def __iter__(self) -> Iterator[FrameReference]:
        return map(self.reference, self.wanted)

    def reference(self, number: int) -> FrameReference:
        series = self.series
        source = series.files.get(number) if series.files else None
        return FrameReference(number, series.stem(number), source)

    def read(self, number: int) -> RawFrame | None:
        """Read the frame with the given number, or return None after the end of a stream.

        Raises InputFileError if the frame is damaged, or if a stream contains fewer frames than ‹gains› lists.
        """
        return self.series.read(number)


def is_one_file(path: Path) -> bool:
    """Return whether a path is a file in a format for single frames. A missing file is judged by its name."""
    if path == STDIN or path.is_dir() or not format_of(path).holds_frame:
        return False
    return path.exists() or not (PATTERN.search(path.name) or is_glob(path))


def _series(path: Path, table: TransformTable, known: RawOverrides, dataset: str | None) -> _Series:
    if dataset is not None and not format_of(path).wants_dataset:
        raise RecipeError(f"‹dataset› applies only to HDF5 and MATLAB files, not to {path}; remove ‹dataset›")
    if path == STDIN:
        if known.size is None:
            raise RecipeError("raw frames on stdin do not state their size; set ‹size› ROWSxCOLS")
        return _series_of_stack(STDIN_NAME, "", read_stdin(table, known), table, known)
    if not path.exists() and PATTERN.search(path.name):
        return _series_of_pattern(path, table, known)
    if path.exists() and not path.is_dir() and (stack := read_stack(path, table, known, dataset)):
        return _series_of_stack(str(path), path.stem, stack, table, known)
    return _series_of_files(str(path), frame_files(path), table, known)


# ---------------------------------------------------------------------------------------------------------- files


def _in_folder(folder: Path) -> list[Path]:
    found = [path for path in folder.iterdir() if is_frame(path) and path.name[0] != "." and path.is_file()]
    # `l3 simulate` writes the ideal pictures of raw frames into the same folder.
    ideals = {path.name.removesuffix(RAW) + IDEAL for path in found if path.name.endswith(RAW)}
    files = of_one_kind(folder, (path for path in found if path.name not in ideals))
    if not files:
        raise InputFileError(
            f"{folder} contains no raw frames; use a folder with raw frames such as .tif, .png, .npy, .raw or .dng files"
        )
    return files


def _globbed(path: Path) -> list[Path]:
    files = globbed(path)
    if not files:
        raise InputFileError(f"{path} matches no file; correct the file name pattern")
    return files


def _series_of_files(what: str, paths: Iterable[Path], table: TransformTable, known: RawOverrides) -> _Series:
    """Return a series with one frame per file, numbered as described in `find_frames`."""
    paths = list(paths)
    named = [number for path in paths if (number := last_number(path)) is not None]
    numbers = named if len(set(named)) == len(paths) else range(len(paths))
    files = dict(zip(numbers, paths, strict=True))
    places = {number: place for place, number in enumerate(numbers)}
    rate = _film_rate(paths[0]) if len(paths) > 1 else None  # a frame rate is meaningless for a single frame
    return _Series(
        what, files, lambda number: read_raw(files[number], table, known.of_frame(places[number])),
        lambda number: files[number].stem, rate, files,
    )  # fmt: skip


def _film_rate(path: Path) -> Fraction | None:
    """Return the frame rate stated in a single-frame file such as a CinemaDNG file, or None."""
    return format_of(path).rate(path) if path.is_file() else None


def _series_of_pattern(pattern: Path, table: TransformTable, known: RawOverrides) -> _Series:
    files = numbered_files(pattern)
    if not files:
        raise InputFileError(f"{pattern} matches no file; use a pattern that matches raw frames, such as frame_%04d.tif")
    # The files should be numbered consecutively. A gap in the numbers counts as missing frames.
    whole, rate = range(min(files), max(files) + 1), _film_rate(next(iter(files.values())))
    return _Series(
        str(pattern), files, lambda number: read_raw(files[number], table, known.of_frame(number - whole.start)),
        lambda number: numbered_name(pattern, number).stem, rate, files, expected=whole,
    )  # fmt: skip


# ----------------------------------------------------------------------------------------------- stacks and streams


def _series_of_stack(what: str, stem: str, stack: MultiFrameFile, table: TransformTable, known: RawOverrides) -> _Series:
    """Convert a stack or stream of raw frames to a series.

    Outputs are named STEM_NUMBER, or NUMBER if `stem` is empty. The output of a single frame is named STEM, unless the stack
    sets `numbered`. Raises InputFileError if the stack is empty.
    """
    if stack.count == 0:
        raise InputFileError(f"{what} contains no frames; use an array with the axes (frame, row, column)")

    def read(number: int) -> RawFrame | None:
        content = stack.read(number)
        if content is not None:
            return frame_of(f"{what} {stack.name(number)}", content, table, known.of_frame(number))
        if number < len(known.gains):
            raise InputFileError(
                f"{what} has only {number} frames, but ‹gains› lists {len(known.gains)} gains; list one gain per frame"
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
GIVE = 'use a folder of pictures, a pattern such as "out/%04d.png", or a video'
KNOWN_MOTION = ("down", "right", "seen")  # channel names of the motion files that `l3 simulate` writes


@dataclass(frozen=True)
class PictureSequence:
    """A sequence of pictures, which are read one at a time."""

    name: str  # name of the sequence in messages
    shape: tuple[int, int]  # rows, cols
    count: int | None  # number of pictures; None for a video, because it is unknown
    pictures: Callable[[], Iterator[Linear]]  # returns a new iterator over all pictures
    files: tuple[Path, ...]  # one file per picture, or the video
    motion: tuple[Path, ...] = ()  # for each picture, the file with the motion since the previous one; empty if unknown


def find_pictures(path: Path) -> PictureSequence:
    """Find the pictures in a folder or a video, or those that match a numbered pattern or a glob.

    In a folder written by `l3 simulate`, only the ideal pictures are used. Raises InputFileError if there are no pictures,
    if they differ in size, or if a number in a pattern is missing.
    """
    if is_video(path) and not _names_several(path):
        return PictureSequence(str(path), _video_shape(path), None, functools.partial(_video_pictures, path), (path,))
    return _file_pictures(path, picture_files(path))


def picture_files(path: Path) -> list[Path]:
    """Return the picture files in a folder, or those that match a numbered pattern or a glob, in order.

    In a folder written by `l3 simulate`, only the ideal pictures are used. The pictures may differ in size. Raises
    InputFileError if there are no pictures, if a file is not a supported picture, if a number in a pattern is missing, or if
    the path is a single file.
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
            raise InputFileError(
                f"{path}: picture {lost[0]} is missing; render this picture, or select the existing pictures with a glob"
            )
        files = list(numbered.values())
    else:
        files = globbed(path)
    if not files:
        raise InputFileError(f"{path} contains no pictures; {GIVE}")
    if wrong := next((each for each in files if each.suffix.lower() not in PICTURES), None):
        raise InputFileError(f"{wrong} is not a supported picture; use {', '.join(PICTURES)}")
    return files


def require_alike(ours: PictureSequence, wanted: PictureSequence | None) -> None:
    """Raise InputFileError if a sequence has only one picture, or if it differs from `wanted` in picture size or length.

    If `wanted` is None, only the number of pictures is checked. The length of a video is unknown and therefore not compared.
    """
    if ours.count == 1:
        raise InputFileError(f"{ours.name} contains only one picture; use a sequence of at least two")
    if wanted is None:
        return
    if ours.shape != wanted.shape:
        sizes = " and ".join(f"{rows}×{cols}" for rows, cols in (ours.shape, wanted.shape))
        raise InputFileError(f"{ours.name} and {wanted.name} have {sizes} pixels; compare pictures of the same frames")
    if ours.count is not None and wanted.count is not None and ours.count != wanted.count:
        counts = f"{ours.count} and {wanted.count} pictures"
        raise InputFileError(f"{ours.name} and {wanted.name} contain {counts}; compare pictures of the same frames")


def paired(ours: PictureSequence, wanted: PictureSequence | None) -> Iterator[tuple[Linear, Linear | None, Linear | None]]:
    """Yield each frame's rendered picture, ideal picture and motion (see `read_motion`).

    The ideal picture is None if `wanted` is None, and the motion is None if it is unknown. Raises InputFileError if one
    sequence ends before the other.
    """
    ideals: Iterator[Linear | None] = wanted.pictures() if wanted else itertools.repeat(None)
    motions = iter(wanted.motion) if wanted else iter(())
    for number, picture in enumerate(ours.pictures()):
        ideal = next(ideals, None)
        if wanted is not None and ideal is None:
            raise InputFileError(
                f"{wanted.name} ends after {number} pictures, but {ours.name} continues; compare pictures of the same frames"
            )
        motion = next(motions, None)
        yield picture, ideal, None if motion is None else read_motion(motion, ours.shape)
    if wanted is not None and next(ideals, None) is not None:
        raise InputFileError(f"{ours.name} has fewer pictures than {wanted.name}; compare pictures of the same frames")


def read_motion(path: Path, shape: tuple[int, int]) -> Linear:
    """Read each pixel's motion since the previous frame, as an array (3, row, col).

    The three planes are the downward motion in pixels, the rightward motion in pixels, and a mask that is 1 where the motion
    is known and 0 elsewhere. Raises InputFileError if the file does not contain motion for frames of `shape` (rows, cols).
    """
    planes, names = read_image(path)
    if names != KNOWN_MOTION or planes.shape[:2] != shape or not np.isfinite(planes).all():
        raise InputFileError(
            f"{path} does not contain motion for frames of {shape[0]}×{shape[1]} pixels; "
            'use the file that "l3 simulate" wrote'
        )
    return np.ascontiguousarray(np.moveaxis(planes, -1, 0), np.float32)


def _names_several(path: Path) -> bool:
    """Return whether a path is a folder, a numbered pattern or a glob."""
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
                f"{each} has {size[0]}×{size[1]} pixels, but {files[0].name} has {shape[0]}×{shape[1]}; "
                "use pictures of equal size"
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
    return DecodedVideo(path, 'a video that "l3 render" wrote', _require_colours, f"{CONTAINERS},yuv4mpegpipe")


def _require_colours(path: Path, context: Any) -> None:
    if not (context.pix_fmt or "").startswith(("yuv", "gbr", "bgr", "rgb")):
        raise InputFileError(
            f"{path} is not a colour video (pixel format {context.pix_fmt or 'unknown'}); use a colour video"
        )


_open: dict[Path, InTurn] = {}


@isolated("av")
def _video_shape(path: Path) -> tuple[int, int]:
    with contextlib.closing(_video(path)) as video:
        return video.shape


@isolated("av")
def _video_picture(path: Path, number: int) -> NDArray | None:
    """Return frame `number` as encoded sRGB, (row, col, 3), uint8 or uint16, or None after the last frame.

    Frames must be read in order. Luma and chroma are converted to RGB with the BT.709 matrix, as written by `l3 render`.
    """
    frame = _open.setdefault(path, InTurn(_video)).frame(path, number)
    if frame is None:
        return None
    deep = max(component.bits for component in frame.format.components) > 8
    coded = {"src_colorspace": "ITU709"} if frame.format.name.startswith("yuv") else {}
    reformatter = pyav().video.reformatter.VideoReformatter()
    return np.asarray(reformatter.reformat(frame, format="rgb48le" if deep else "rgb24", **coded).to_ndarray())
