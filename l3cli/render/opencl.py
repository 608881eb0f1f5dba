"""Rendering on an OpenCL device: one upload, four kernels (opencl/*.cl), one download (DESIGN 4)."""

import atexit
import contextlib
import os
import shutil
import tempfile
import warnings
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from l3cli import classify
from l3cli.artifacts.table import CHROMA_FRACTION, LEVEL_FRACTION, TransformTable
from l3cli.errors import DeviceError
from l3cli.frame import RawFrame, mirrored_indices
from l3cli.render.display import Display, require_xyz

SOURCES = ("vectors.cl", "ingest.cl", "classes.cl", "transform.cl", "encode.cl")  # joined in this order
VECTOR = 16  # pixels that the kernels take side by side
INSTALL = 'install one, on any processor with: pip install "pyopencl[pocl]"'


@dataclass(frozen=True)
class Schedule:
    """How a frame is cut into work-items; says nothing about what is computed."""

    tile: int  # columns of a work-item that labels classes, a multiple of VECTOR
    band: int  # rows of such a work-item
    strip: int  # pixels of a row that a work-item of the other kernels takes; 0: all of them
    group: tuple[int, int] | None  # work-group size; None: the driver chooses


# A processor vectorises within a work-item and wants few and long ones, a graphics card wants many.
PROCESSOR = Schedule(tile=256, band=48, strip=0, group=(1, 1))
GRAPHICS = Schedule(tile=VECTOR, band=16, strip=1, group=None)


class OpenCLRenderer:
    """Renderer on the first suitable OpenCL device, or the one that the environment variable L3_DEVICE names.

    Device, program, kernels and the table's buffers are made once; a frame's buffers once for each frame size.
    DeviceError if there is no device or it refuses.
    """

    def __init__(self, table: TransformTable) -> None:
        self.table = table
        self.device = choose_device(os.environ.get("L3_DEVICE", ""))
        cl = _pyopencl()
        self.schedule = GRAPHICS if self.device.type & cl.device_type.GPU else PROCESSOR
        with self._refusals():
            self._context = cl.Context([self.device])
            self._queue = cl.CommandQueue(self._context, properties=cl.command_queue_properties.PROFILING_ENABLE)
            program = _build(self._context, _macros(table, self.schedule.tile))
            names = ("ingest", "classes", "transform", "encode8", "encode16")
            self._kernels = {name: cl.Kernel(program, name) for name in names}
            self._class_buffers = [self._constant(array) for array in _class_arrays(table)]
            self._weights = self._constant(_packed_weights(table))
        self._buffers: _FrameBuffers | None = None

    def labels(self, frame: RawFrame) -> NDArray[np.uint32]:
        """Class (row, col) of every pixel."""
        with self._refusals():
            buffers, _ = self._classify(frame)
            return self._download(buffers.labels, buffers.shape, np.uint32)[0]

    def outputs(self, frame: RawFrame) -> NDArray[np.float32]:
        """Outputs of the table, (output, row, col)."""
        with self._refusals():
            buffers, _ = self._transform(frame)
            return self._download(buffers.planes, (len(self.table.outputs), *buffers.shape), np.float32)[0]

    def picture(self, frame: RawFrame, display: Display) -> NDArray:
        """The frame as sRGB (row, col, 3), encoded on the device; RecipeError unless the table's outputs are X, Y, Z."""
        return self._picture(frame, display)[0]

    def stage_times(self, frame: RawFrame, display: Display) -> dict[str, float]:
        """Milliseconds that the device spent in each stage of one picture; call it twice, the first run warms up."""
        events = self._picture(frame, display)[1]
        return {stage: (event.profile.end - event.profile.start) * 1e-6 for stage, event in events.items()}

    def _picture(self, frame: RawFrame, display: Display) -> tuple[NDArray, dict[str, Any]]:
        require_xyz(self.table.outputs)
        with self._refusals():
            buffers, events = self._transform(frame)
            rows, cols = buffers.shape
            strip = VECTOR if self.schedule.strip else -(-cols // VECTOR) * VECTOR
            matrix = self._constant(display.matrix.astype(np.float32))
            arguments = (buffers.planes, matrix, buffers.picture, np.uint64(rows * cols), np.int32(strip))
            events["encode"] = self._run(f"encode{display.bits}", (-(-rows * cols // strip), 1), *arguments)
            picture, events["download"] = self._download(buffers.picture, (rows, cols, 3), display.dtype)
        return picture, events

    def _transform(self, frame: RawFrame) -> tuple["_FrameBuffers", dict[str, Any]]:
        buffers, events = self._classify(frame)
        rows, cols = buffers.shape
        strip = self.schedule.strip or cols
        sizes = (np.int32(cols), np.int32(buffers.stride), np.uint64(rows * cols), np.int32(strip))
        arguments = (buffers.mosaic, buffers.labels, self._weights, buffers.planes, *sizes)
        events["transform"] = self._run("transform", (-(-cols // strip), rows), *arguments)
        return buffers, events

    def _classify(self, frame: RawFrame) -> tuple["_FrameBuffers", dict[str, Any]]:
        """Upload, ingest and classes; the events of each stage."""
        table, schedule = self.table, self.schedule
        values = np.ascontiguousarray(frame.at_levels(table.black, table.white, table.bits).values)
        buffers = self._frame_buffers(values.shape)
        rows, cols = values.shape
        stride, strip = buffers.stride, schedule.strip or buffers.stride
        events = {"upload": _pyopencl().enqueue_copy(self._queue, buffers.raw, values, is_blocking=False)}
        sizes = (np.int32(cols), np.int32(stride), np.float32(table.black), np.int32(strip))
        arguments = (buffers.raw, buffers.row_source, buffers.column_source, buffers.padded, buffers.mosaic, *sizes)
        events["ingest"] = self._run("ingest", (-(-stride // strip), rows + 2 * table.rule.radius), *arguments)
        layout = tuple(np.int32(number) for number in (rows, cols, stride, *frame.phase, schedule.band))
        grid = (-(-cols // schedule.tile), -(-rows // schedule.band))
        events["classes"] = self._run("classes", grid, buffers.padded, *self._class_buffers, buffers.labels, *layout)
        return buffers, events

    def _run(self, kernel: str, grid: tuple[int, int], *arguments: Any) -> Any:
        return self._kernels[kernel](self._queue, grid, self.schedule.group, *arguments)

    def _download(self, buffer: Any, shape: tuple[int, ...], dtype: Any) -> tuple[NDArray, Any]:
        array = np.empty(shape, dtype)
        return array, _pyopencl().enqueue_copy(self._queue, array, buffer, is_blocking=True)

    def _constant(self, array: NDArray) -> Any:
        cl = _pyopencl()
        array = np.ascontiguousarray(array if array.size else np.zeros(1, array.dtype))  # no buffer may be empty
        return cl.Buffer(self._context, cl.mem_flags.READ_ONLY | cl.mem_flags.COPY_HOST_PTR, hostbuf=array)

    def _frame_buffers(self, shape: tuple[int, ...]) -> "_FrameBuffers":
        """Buffers for frames of `shape`, kept until a frame of another shape comes."""
        if self._buffers is None or self._buffers.shape != shape:
            self._buffers = None  # let go of the old ones first
            self._buffers = self._new_buffers(shape[0], shape[1])
        return self._buffers

    def _new_buffers(self, rows: int, cols: int) -> "_FrameBuffers":
        cl, radius, cfa = _pyopencl(), self.table.rule.radius, self.table.cfa
        # Behind whole tiles one more vector: room for both margins, since a patch has at most 15 columns.
        stride = -(-cols // self.schedule.tile) * self.schedule.tile + VECTOR
        padded_rows = rows + 2 * radius
        column_source = np.zeros(stride, np.int32)
        column_source[: cols + 2 * radius] = mirrored_indices(cols, radius, cfa.shape[1])

        def scratch(items: int, size: int) -> Any:
            return cl.Buffer(self._context, cl.mem_flags.READ_WRITE, items * size)

        return _FrameBuffers(
            shape=(rows, cols),
            stride=stride,
            row_source=self._constant(mirrored_indices(rows, radius, cfa.shape[0])),
            column_source=self._constant(column_source),
            raw=scratch(rows * cols, 2),
            padded=scratch(padded_rows * stride, 2),
            mosaic=scratch(padded_rows * stride, 4),
            labels=scratch(rows * cols, 4),
            planes=scratch(len(self.table.outputs) * rows * cols + VECTOR, 4),
            picture=scratch((rows * cols + VECTOR) * 3, 2),
        )

    @contextlib.contextmanager
    def _refusals(self) -> Iterator[None]:
        """What OpenCL refuses, as a DeviceError of one line."""
        cl = _pyopencl()
        try:
            yield
        except cl.MemoryError as error:
            raise DeviceError(f"{self.device.name.strip()} has too little memory for this table and frame") from error
        except cl.Error as error:
            reason = " ".join(str(error).split())[:300]
            raise DeviceError(f"{self.device.name.strip()} failed: {reason}; choose another with L3_DEVICE") from error


@dataclass(frozen=True)
class _FrameBuffers:
    """Device buffers of one frame size; `stride` is the length of a padded row."""

    shape: tuple[int, int]
    stride: int
    row_source: Any
    column_source: Any
    raw: Any
    padded: Any
    mosaic: Any
    labels: Any
    planes: Any
    picture: Any


# ------------------------------------------------------------------------------------------- devices and programs


def devices() -> list[Any]:
    """Every OpenCL device there is, in the order that L3_DEVICE counts."""
    cl = _pyopencl()
    try:
        return [device for platform in cl.get_platforms() for device in platform.get_devices()]
    except cl.Error:  # no driver at all
        return []


def choose_device(wanted: str) -> Any:
    """The device that `wanted` names by index or part of its name; else the first GPU, else the first of any kind.

    DeviceError if there is none.
    """
    found = devices()
    if not found:
        raise DeviceError(f"no OpenCL device was found; {INSTALL}")
    if not wanted:
        gpu = _pyopencl().device_type.GPU
        return next((device for device in found if device.type & gpu), found[0])
    if wanted.isdecimal() and int(wanted) < len(found):
        return found[int(wanted)]
    named = [device for device in found if wanted.lower() in device.name.lower()]
    if not named or wanted.isdecimal():
        names = ", ".join(f"{index}: {device.name.strip()}" for index, device in enumerate(found))
        raise DeviceError(f'L3_DEVICE is "{wanted}", but the OpenCL devices are {names}')
    return named[0]


def source_folder() -> Path:
    """Where the .cl files lie: inside the installed package, or beside it in a checkout."""
    package = Path(__file__).parents[1]
    inside = package / "opencl"
    return inside if inside.is_dir() else package.parent / "opencl"


def program_source() -> str:
    """The .cl files in their order; #line keeps file and line in the compiler's messages."""
    folder = source_folder()
    return "\n".join(f'#line 1 "{name}"\n{(folder / name).read_text(encoding="utf-8")}' for name in SOURCES)


def _pyopencl() -> Any:
    """pyopencl, imported when first needed; DeviceError if there is no OpenCL at all."""
    _ensure_pocl_cache()
    try:
        import pyopencl
    except ImportError as error:
        raise DeviceError(f"OpenCL cannot be loaded ({error}); {INSTALL}") from error
    return pyopencl


def _ensure_pocl_cache() -> None:
    """Give PoCL a folder that it can write to: without one it finds no device, and says nothing."""
    if "POCL_CACHE_DIR" in os.environ:
        return
    try:
        caches = os.environ.get("XDG_CACHE_HOME") or Path("~/.cache").expanduser()
        folder = Path(caches, "l3cli", "pocl")
        folder.mkdir(parents=True, exist_ok=True)
        tempfile.TemporaryFile(dir=folder).close()
    except (OSError, RuntimeError):  # RuntimeError: there is no home at all
        folder = Path(tempfile.mkdtemp(prefix="l3-pocl-"))
        atexit.register(shutil.rmtree, folder, ignore_errors=True)
    os.environ["POCL_CACHE_DIR"] = str(folder)


def _build(context: Any, macros: dict[str, int]) -> Any:
    options = ["-w", "-cl-mad-enable", "-cl-std=CL1.2", *(f"-D{name}={value}" for name, value in macros.items())]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # pyopencl warns of every word a compiler says
        return _pyopencl().Program(context, program_source()).build(options)


# ------------------------------------------------------------------------------------------------ what kernels read


def _macros(table: TransformTable, tile: int) -> dict[str, int]:
    """Everything about a table that a kernel's loops and formulas depend on."""
    rule = table.rule
    return {
        "PATCH": rule.patch,
        "RADIUS": rule.radius,
        "LANES": _lanes(rule.patch),
        "CHANNELS": len(table.channels),
        "OUTPUTS": len(table.outputs),
        "CFA_ROWS": table.cfa.shape[0],
        "CFA_COLUMNS": table.cfa.shape[1],
        "LEVELS": rule.levels,
        "CONTRASTS": rule.contrasts,
        "CHROMAS": rule.chromas,
        "KINDS": rule.kinds,
        "SHIFT": rule.shift,
        "LEVEL_FRACTION": LEVEL_FRACTION,
        "CHROMA_FRACTION": CHROMA_FRACTION,
        "CHROMA_BLACK": rule.chroma_black,
        "SATURATION": rule.saturation,
        "SATURATION_RADIUS": rule.saturation_radius,
        "TILE": tile,
    }


def _lanes(patch: int) -> int:
    """Length of the vectors that hold the taps of a patch row: 4, 8 or 16."""
    return next(lanes for lanes in (4, 8, 16) if lanes >= patch)


def _class_arrays(table: TransformTable) -> tuple[NDArray, ...]:
    """The constants of the kernel `classes`, in the order of its arguments; what they are stands there."""
    rule, channels = table.rule, len(table.channels)
    near = classify.neighbourhoods(table.cfa, rule.patch, channels)
    period = np.arange(table.cfa.shape[1] + VECTOR - 1) % table.cfa.shape[1]
    cfa = table.cfa[:, period].astype(np.uint32)
    member = np.where(cfa == np.arange(channels, dtype=np.uint32)[:, None, None], np.uint32(0xFFFFFFFF), np.uint32(0))

    def by_channel(site_values: classify.Integers) -> NDArray[np.uint32]:
        return site_values.reshape(*table.cfa.shape, channels).transpose(2, 0, 1)[:, :, period].astype(np.uint32)

    return (
        member,
        np.uint32(1) << cfa,
        by_channel(near.count),
        by_channel(near.mean_reciprocal),
        by_channel(near.variance_reciprocal),
        period.astype(np.uint32),
        rule.level_edges,
        rule.contrast_edges,
        rule.case_of_code,
        rule.chroma_weights,
    )


def _packed_weights(table: TransformTable) -> NDArray[np.float32]:
    """(class, 1 + patch row, output, lane): the intercept in lane 0 of the first row, then weights per DN above black."""
    classes, outputs, _ = table.weights.shape
    patch = table.rule.patch
    packed = np.zeros((classes, 1 + patch, outputs, _lanes(patch)), np.float32)
    packed[:, 0, :, 0] = table.intercept
    per_dn = table.weights.astype(np.float64) / (table.white - table.black)
    packed[:, 1:, :, :patch] = per_dn.reshape(classes, outputs, patch, patch).transpose(0, 2, 1, 3)
    return packed
