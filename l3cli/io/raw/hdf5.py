"""Read raw frames from HDF5 files: a dataset with a stack, (frame, row, col), or with one frame, (row, col).

In a file that contains axis names, the axes can be in any order.
"""

import re
from math import prod
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.container import TITLE, datasets, require_within_file
from l3cli.errors import InputFileError
from l3cli.io.isolated import isolated
from l3cli.io.raw import MultiFrameFile, RawContent
from l3cli.io.raw.axes import STACK, Axes, frame_axes
from l3cli.system.files import open_regular, stamp
from l3cli.system.limits import require_picture, require_values
from l3cli.system.text import a

FILTERS = {  # numbers of compression filters, as registered with The HDF Group → names
    4: "szip", 307: "bzip2", 32000: "LZF", 32001: "blosc", 32004: "LZ4", 32008: "bitshuffle", 32013: "ZFP", 32015: "zstd",
    32017: "SZ", 32018: "FCIDECOMP", 32019: "JPEG", 32024: "SZ3", 32026: "blosc2", 32028: "SPERR",
}  # fmt: skip
# Maximum size of the chunk cache in bytes. Without a cache, a chunk with many frames would be decompressed once per frame.
CHUNK_CACHE = 128 << 20
MATLAB = "MATLAB_class"  # attribute of each variable in a MATLAB file
TRUE_COLOUR = "IMAGE_TRUECOLOR"  # value of IMAGE_SUBCLASS in the HDF5 Image specification
MOST_AXES = 8  # maximum number of axis names that are read

_opened: dict[tuple[Any, ...], Any] = {}  # identity of the last file → open file


def stack(path: Path, dataset: str | None) -> MultiFrameFile:
    """Open the frames in a dataset, or in the only dataset with frames if `dataset` is None."""
    name, count = find_stack(path, dataset)
    return MultiFrameFile(count, lambda number: RawContent(values=stack_frame(path, name, number)), numbered=False)


@isolated("h5py", "hdf5plugin")
def find_stack(path: Path, dataset: str | None) -> tuple[str, int]:
    """Return the name of the dataset with the frames, and its number of frames.

    If `dataset` is None, the file must contain only one dataset with frames, and must not be an l3 artifact. Raises
    InputFileError if the dataset does not exist, or if it contains something other than frames, such as a picture with
    several channels.
    """
    root = _open(path)
    if dataset is None and _is_artifact(path):
        kind = a(_text(root.attrs.get("kind")) or "l3 artifact")
        raise InputFileError(
            f"{path} contains {kind}, not raw frames; use a camera raw, a TIFF or PNG file with one channel"
        )
    members = dict(datasets(root))
    name = _only_stack(path, members) if dataset is None else dataset.strip("/")
    frames = members.get(name)
    if frames is None:
        raise InputFileError(f'{path} contains no dataset "{dataset}"; set ‹dataset› to a uint16 dataset (frame, row, col)')
    if not _is_stack(frames):
        raise InputFileError(
            f'{path}: the dataset "{dataset}" is {frames.dtype} of shape {frames.shape}; '
            "set ‹dataset› to a uint16 dataset (frame, row, col)"
        )
    axes = _axes(path, frames)
    _require_frames(path, frames, axes)
    return name, 1 if axes.frame is None else frames.shape[axes.frame]


@isolated("h5py", "hdf5plugin")  # the optional package hdf5plugin adds compression filters to h5py
def stack_frame(path: Path, name: str, number: int) -> NDArray:
    """Read frame `number` (counted from 0) in the dataset that `find_stack` returned, as an array (row, col).

    Raises InputFileError if the frame is damaged, or if a compression filter is not installed.
    """
    frames = _open(path, name)[name]
    axes = _axes(path, frames)
    _require_frames(path, frames, axes)
    place: list[Any] = [slice(None)] * frames.ndim
    if axes.frame is not None:
        place[axes.frame] = number
    try:
        values = np.asarray(frames[tuple(place)])
    except OSError as error:
        if filters := missing_filters(frames):
            raise InputFileError(
                f"{path}: {frames.name} is compressed with {' and '.join(filters)}, which is not installed; run: "
                "pip install hdf5plugin"
            ) from error
        raise InputFileError(f"{path}: frame {number} of {frames.name} is damaged; copy the file again") from error
    return values if axes.row < axes.col else np.ascontiguousarray(values.T)


def _axes(path: Path, frames: Any) -> Axes:
    """Determine a dataset's axes from their names, or from the convention of the program that wrote the file.

    Raises InputFileError if the dataset is a picture with several channels.
    """
    name = f"{path}: {frames.name}"
    if _text(frames.attrs.get("IMAGE_SUBCLASS")) == TRUE_COLOUR:
        raise InputFileError(f"{name} is marked as a picture with three channels (IMAGE_SUBCLASS); use the raw mosaic")
    usual = None
    if MATLAB in frames.attrs:  # MATLAB stores the axes (row, col, frame) in reverse order
        usual = Axes(0, 2, 1) if frames.ndim == 3 else Axes(None, 1, 0)
        if frames.ndim == 3 and frames.shape[0] == 3:
            raise InputFileError(
                f"{name} has shape {frames.shape}, which looks like a MATLAB picture with 3 channels; use the raw mosaic"
            )
    return frame_axes(name, frames.shape, _axis_names(frames), usual)


def _axis_names(frames: Any) -> list[str]:
    """Return a dataset's axis names, or an empty list if the file does not contain them.

    They are read from the first of these places that contains one name per axis:

    1. the labels or scales of the dimensions (HDF5),
    2. the attribute `axes` of the dataset,
    3. the attribute _ARRAY_DIMENSIONS of the dataset (xarray),
    4. the attribute `axes` of the group, if the dataset is the signal of the group (NeXus).
    """
    stated = [frames.attrs.get("axes"), frames.attrs.get("_ARRAY_DIMENSIONS")]
    group = frames.parent.attrs
    if _text(group.get("signal")) == frames.name.rpartition("/")[2]:
        stated.append(group.get("axes"))
    found = [[dimension.label or _scale_name(dimension) for dimension in frames.dims], *map(_listed, stated)]
    return next((names for names in found if len(names) == frames.ndim and any(names)), [])


def _scale_name(dimension: Any) -> str:
    return str(dimension[0].name).rpartition("/")[2] if len(dimension) else ""


def _listed(attribute: Any) -> list[str]:
    """Parse the axis names in an attribute: an array of names, or a string such as "[t:y:x]", "t,y,x" or "tyx"."""
    if isinstance(attribute, np.ndarray):
        return [_text(each) for each in attribute.ravel()[:MOST_AXES]]
    words = re.findall(r"\w+", _text(attribute))
    return list(words[0]) if len(words) == 1 and len(words[0]) <= MOST_AXES else words


def _text(attribute: Any) -> str:
    return attribute.decode(errors="replace") if isinstance(attribute, bytes) else str(attribute or "")


def missing_filters(dataset: Any) -> list[str]:
    """Return the names of the missing compression filters that a dataset requires."""
    import h5py

    created = dataset.id.get_create_plist()
    used = [created.get_filter(index) for index in range(created.get_nfilters())]
    return [
        f"{FILTERS.get(number) or name.decode(errors='replace') or 'a filter'} (HDF5 filter {number})"
        for number, _, _, name in used
        if not h5py.h5z.filter_avail(number)
    ]


def _open(path: Path, stack: str | None = None) -> Any:
    """Open an HDF5 file, which stays open for further frames until this function opens a different file.

    The size of the chunk cache is chosen for the dataset `stack`. Raises InputFileError if the file is not an HDF5 file.
    """
    import h5py

    key = (str(path), *stamp(path), stack)
    if key not in _opened:
        if not h5py.is_hdf5(path):
            raise InputFileError(f"{path} is not an HDF5 file; use an HDF5 file with a dataset (frame, row, col)")
        for other in _opened.values():
            other.close()
        _opened.clear()
        root = h5py.File(path, "r")
        if stack is not None:
            # A cache for the chunks of one frame is enough, because chunks of earlier frames are not read again.
            nbytes = min(CHUNK_CACHE, chunks_of_a_frame(root[stack], _axes(path, root[stack])))
            root.close()
            root = h5py.File(path, "r", rdcc_nbytes=nbytes)
        _opened[key] = root
    return _opened[key]


def chunks_of_a_frame(frames: Any, axes: Axes = STACK) -> int:
    """Return the number of bytes that must be decompressed to read one frame of a dataset."""
    chunks = frames.chunks or frames.shape
    across = prod(-(-frames.shape[axis] // chunks[axis]) for axis in (axes.row, axes.col))
    return across * prod(chunks) * int(frames.dtype.itemsize)


def _only_stack(path: Path, members: dict[str, Any]) -> str:
    """Return the name of the only dataset, (frame, row, col), of type uint8 or uint16.

    If there is none, datasets of any numeric type are considered. Raises InputFileError if none or several are found.
    """
    stacks = sorted(name for name, member in members.items() if _is_stack(member) and member.ndim == 3)
    counts = [name for name in stacks if members[name].dtype.kind == "u" and members[name].dtype.itemsize <= 2]
    chosen = counts or stacks
    if len(chosen) != 1:
        several = f"{len(chosen)} datasets of frames ({', '.join(chosen[:4])})"
        content = several if chosen else "no uint16 dataset (frame, row, col)"
        raise InputFileError(f"{path} contains {content}; select the dataset with ‹dataset›")
    return chosen[0]


def _is_artifact(path: Path) -> bool:
    """Return whether a file is an l3 artifact, such as a transform table."""
    with open_regular(path) as stream:
        return stream.read(len(TITLE)) == TITLE


def _is_stack(member: Any) -> bool:
    """Return whether a dataset can be a frame or a stack, according to its data type and number of axes."""
    return member.dtype.kind in "uif" and member.ndim in (2, 3) and bool(member.size)


def _require_frames(path: Path, frames: Any, axes: Axes) -> None:
    """Raise InputFileError if the dataset is stored in a different file, or if a frame or its chunks are too large."""
    require_within_file(path, frames.id)
    for shape in (frames.shape, frames.chunks or frames.shape):
        require_picture(f"{path}: {frames.name}", shape[axes.row], shape[axes.col])
    if axes.frame not in (None, 0):  # to read one frame, HDF5 must read all frames, whose values are interleaved
        require_values(f"{path}: {frames.name}", frames.chunks or frames.shape[1:], frames.dtype.itemsize)
