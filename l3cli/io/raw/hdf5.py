"""Stacks of raw frames in HDF5 files: a dataset of 8- or 16-bit integers (frame, row, col), or of one frame (row, col)."""

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.container import datasets, require_within_file
from l3cli.errors import InputFileError
from l3cli.io.isolated import isolated
from l3cli.io.raw import MultiFrameFile, RawContent
from l3cli.system.files import stamp
from l3cli.system.limits import require_picture

FILTERS = {  # by the numbers that The HDF Group registered
    4: "szip", 307: "bzip2", 32000: "LZF", 32001: "blosc", 32004: "LZ4", 32008: "bitshuffle", 32013: "ZFP", 32015: "zstd",
    32017: "SZ", 32018: "FCIDECOMP", 32019: "JPEG", 32024: "SZ3", 32026: "blosc2", 32028: "SPERR",
}  # fmt: skip
CHUNK_CACHE = 128 << 20  # bytes at most: chunks of many frames are unpacked once, not once a frame

_opened: dict[tuple[Any, ...], Any] = {}  # the last file, by what would change if it were another one


def stack(path: Path, dataset: str | None) -> MultiFrameFile:
    """Return the frames of a dataset."""
    name, count = find_stack(path, dataset)
    return MultiFrameFile(count, lambda number: RawContent(values=stack_frame(path, name, number)), numbered=False)


@isolated("h5py", "hdf5plugin")
def find_stack(path: Path, dataset: str | None) -> tuple[str, int]:
    """Return name and number of frames of the stack `dataset`, or of the only one; InputFileError without one."""
    root = _open(path)
    held = dict(datasets(root))
    name = _only_stack(path, held) if dataset is None else dataset.strip("/")
    frames = held.get(name)
    if frames is None or not _is_stack(frames, (2, 3)):
        content = "no dataset" if frames is None else f"{frames.dtype} {frames.shape}"
        raise InputFileError(f"{path}: {dataset} is {content}; name with ‹dataset› one of uint16 (frame, row, col)")
    _require_frames(path, frames)
    return name, len(frames) if frames.ndim == 3 else 1


@isolated("h5py", "hdf5plugin")  # the second, where it is installed, adds filters to the first
def stack_frame(path: Path, name: str, number: int) -> NDArray:
    """Return one frame (row, col) of a stack whose name `find_stack` returned."""
    frames = _open(path, name)[name]
    _require_frames(path, frames)
    try:
        return frames[number] if frames.ndim == 3 else frames[()]
    except OSError as error:
        if filters := missing_filters(frames):
            raise InputFileError(
                f"{path}: {frames.name} is compressed by {' and '.join(filters)}, which HDF5 has not; install it with: "
                "pip install hdf5plugin"
            ) from error
        raise InputFileError(f"{path}: frame {number} of {frames.name} is damaged; copy the file again") from error


def missing_filters(dataset: Any) -> list[str]:
    """Return the names of the filters that a dataset's chunks have passed through and that are not installed."""
    import h5py

    created = dataset.id.get_create_plist()
    used = [created.get_filter(index) for index in range(created.get_nfilters())]
    return [
        f"{FILTERS.get(number) or name.decode(errors='replace') or 'a filter'} (HDF5 filter {number})"
        for number, _, _, name in used
        if not h5py.h5z.filter_avail(number)
    ]


def _open(path: Path, stack: str | None = None) -> Any:
    """Return the file, kept open from frame to frame of a stack."""
    import h5py

    key = (str(path), *stamp(path), stack)
    if key not in _opened:
        if not h5py.is_hdf5(path):
            raise InputFileError(f"{path} is not an HDF5 file; give one with a dataset (frame, row, col)")
        for other in _opened.values():
            other.close()
        _opened.clear()
        root = h5py.File(path, "r")
        if stack is not None:
            # A cache that held more than what is read next would fill as the frames go by.
            nbytes = min(CHUNK_CACHE, chunks_of_a_frame(root[stack]))
            root.close()
            root = h5py.File(path, "r", rdcc_nbytes=nbytes)
        _opened[key] = root
    return _opened[key]


def chunks_of_a_frame(frames: Any) -> int:
    """Return the bytes that are unpacked for one frame of a dataset (…, row, col)."""
    chunks = frames.chunks or frames.shape
    across = -(-frames.shape[-2] // chunks[-2]) * -(-frames.shape[-1] // chunks[-1])
    return int(across * np.prod(chunks, dtype=np.int64) * frames.dtype.itemsize)


def _only_stack(path: Path, held: dict[str, Any]) -> str:
    stacks = sorted(name for name, member in held.items() if _is_stack(member, (3,)))
    if len(stacks) != 1:
        several = f"{len(stacks)} datasets of frames ({', '.join(stacks[:4])})"
        content = several if stacks else "no dataset uint16 (frame, row, col)"
        raise InputFileError(f"{path} holds {content}; name one with ‹dataset›")
    return stacks[0]


def _is_stack(member: Any, axes: tuple[int, ...]) -> bool:
    return member.dtype.kind == "u" and member.dtype.itemsize <= 2 and member.ndim in axes and bool(member.size)


def _require_frames(path: Path, frames: Any) -> None:
    """Raise InputFileError if the frames lie in another file, or one of them, or what is unpacked with it, is too large."""
    require_within_file(path, frames.id)
    for shape in (frames.shape, frames.chunks or frames.shape):
        require_picture(f"{path}: {frames.name}", *shape[-2:])
