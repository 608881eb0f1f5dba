"""Sequences of finished pictures, to be judged: folders, patterns, globs, videos."""

import contextlib
import functools
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from l3cli.errors import InputFileError
from l3cli.io.file_names import IDEAL, MOTION, PATTERN, globbed, is_glob, natural_order, numbered_files, of_one_kind
from l3cli.io.images import picture_size, read_image
from l3cli.io.isolated import isolated
from l3cli.io.pictures.registry import suffixes
from l3cli.io.scenes import rgb
from l3cli.io.video import CONTAINERS, DecodedVideo, InTurn, is_video, pyav
from l3cli.physics.display import srgb_decoded

PICTURES = suffixes("codes")
Linear = NDArray[np.float32]  # (row, col, 3) linear sRGB
GIVE = 'give a folder of pictures, a pattern such as "out/%04d.png", or a video'
KNOWN_MOTION = ("down", "right", "seen")


@dataclass(frozen=True)
class PictureSequence:
    """Pictures in their order, read one by one."""

    name: str
    shape: tuple[int, int]  # rows, cols
    count: int | None  # None: of a video, until it ends
    pictures: Callable[[], Iterator[Linear]]
    files: tuple[Path, ...]
    motion: tuple[Path, ...] = ()  # files of how each has moved since the one before


def find_pictures(path: Path) -> PictureSequence:
    """Return the sequence of a name: a folder (of a simulation its ideal pictures), a numbered pattern, a glob, or a video.
    InputFileError if there is none, its pictures differ in size, or a number is missing."""
    if is_video(path) and not _names_several(path):
        return PictureSequence(str(path), _video_shape(path), None, functools.partial(_video_pictures, path), (path,))
    return _file_pictures(path, picture_files(path))


def picture_files(path: Path) -> list[Path]:
    """Return the pictures of a folder (of a simulation its ideal ones), a numbered pattern or a glob, in their order, of any
    sizes. InputFileError if there is none, or a number is missing."""
    if not _names_several(path):
        what = "is a single file" if path.exists() else "does not exist"
        raise InputFileError(f"{path} {what}; {GIVE}")
    if path.is_dir():
        files = _in_folder(path)
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
        raise InputFileError(f"{wrong} is no picture; pictures are {', '.join(PICTURES)}")
    return files


def read_motion(path: Path, shape: tuple[int, int]) -> Linear:
    """Return the motion of a frame since the one before (3, row, col): pixels down, right, and 1 where the same was seen."""
    planes, names = read_image(path)
    if names != KNOWN_MOTION or planes.shape[:2] != shape or not np.isfinite(planes).all():
        raise InputFileError(f"{path} is no motion of frames of {shape[0]}×{shape[1]}; give what l3 simulate wrote")
    return np.ascontiguousarray(np.moveaxis(planes, -1, 0), np.float32)


def _names_several(path: Path) -> bool:
    """Return whether a name is that of a folder, a numbered pattern or a glob."""
    return path.is_dir() or (not path.exists() and (bool(PATTERN.search(path.name)) or is_glob(path)))


def _in_folder(folder: Path) -> list[Path]:
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
    """Return encoded sRGB (row, col, 3) of frame `number`, of 8 or 16 bits; None after the last. Luma and chroma are
    those of BT.709, as `l3 render` writes them."""
    frame = _open.setdefault(path, InTurn(_video)).frame(path, number)
    if frame is None:
        return None
    deep = max(component.bits for component in frame.format.components) > 8
    coded = {"src_colorspace": "ITU709"} if frame.format.name.startswith("yuv") else {}
    reformatter = pyav().video.reformatter.VideoReformatter()
    return np.asarray(reformatter.reformat(frame, format="rgb48le" if deep else "rgb24", **coded).to_ndarray())
