"""Headerless files: the values of frames and nothing else, laid out as the caller or the table says."""

from pathlib import Path

import numpy as np

from l3cli.errors import InputFileError
from l3cli.io.raw.content import InOrder, MultiFrameFile, RawContent, Request
from l3cli.io.raw.packed import PACKED, WORDS, Layout, make_layout
from l3cli.system.limits import require_picture, require_values


def layout_of(path: Path, size: tuple[int, int], packing: str | None, stride: int | None) -> Layout:
    """Return the layout of a headerless file of frames of `size` (rows, columns); its suffix may name the packing."""
    suffix = path.suffix.lower().removeprefix(".")
    layout = make_layout(size, packing or (suffix if suffix in PACKED else WORDS), stride)
    require_picture(str(path), layout.rows, layout.cols)
    require_values(str(path), (layout.rows, layout.stride), value_bytes=1)
    return layout


def read(path: Path, request: Request) -> RawContent:
    """Return one frame's values and nothing else."""
    layout = _layout(request)
    size = path.stat().st_size
    if size != layout.frame_bytes:
        raise InputFileError(
            f"{path} has {size} bytes, {layout} have {layout.frame_bytes}; "
            "give its size with ‹size› ROWSxCOLS, ‹packing› and ‹stride›"
        )
    return RawContent(values=layout.unpack(np.fromfile(path, np.uint8)), exchangeable=layout.exchangeable)


def stack(path: Path, request: Request) -> MultiFrameFile | None:
    """As many frames as the file has room for; one that is cut is noticed when it is read. None where there is no second."""
    layout, size = _layout(request), path.stat().st_size
    if size < 2 * layout.frame_bytes:
        return None

    def frame(number: int) -> RawContent:
        content = np.fromfile(path, np.uint8, layout.frame_bytes, offset=number * layout.frame_bytes)
        if content.size < layout.frame_bytes:
            raise InputFileError(f"{path} ends within frame {number} of {layout}; give its size with ‹size› ROWSxCOLS")
        return RawContent(values=layout.unpack(content), exchangeable=layout.exchangeable)

    return MultiFrameFile(-(-size // layout.frame_bytes), frame)


def stdin(layout: Layout) -> MultiFrameFile:
    """Return the frames that come on stdin."""
    # Unbuffered: a thread that waits in a buffered stream would keep the interpreter from ending.
    pipe = open(0, "rb", buffering=0, closefd=False)  # noqa: SIM115

    def following() -> np.ndarray | None:
        content = bytearray(layout.frame_bytes)
        filled = 0
        while filled < len(content) and (got := pipe.readinto(memoryview(content)[filled:])):
            filled += got
        if 0 < filled < len(content):
            raise InputFileError(f"stdin ends within the frame, of {layout}; check ‹size› ROWSxCOLS")
        return layout.unpack(content) if filled else None

    return MultiFrameFile(None, InOrder(following, layout.exchangeable).read)


def _layout(request: Request) -> Layout:
    assert request.layout is not None  # the registry says that it is wanted
    return request.layout
