"""The programs of a table on an OpenCL device, each built when a frame first needs it."""

import functools
import os
import re
import warnings
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from l3cli.artifacts.table import TransformTable
from l3cli.errors import RecipeError
from l3cli.rendering import kernels, layout
from l3cli.rendering.display import Display
from l3cli.rendering.opencl_devices import choose_device, pyopencl, refusals
from l3cli.rendering.opencl_processor import compiled_for

BUILD_OPTIONS = ("-w", "-cl-mad-enable", "-cl-std=CL1.2")
TRANSFORM_ONLY: layout.Macros = {"TRANSFORM_ONLY": 1}  # without the kernel of the classes, which another program has
# Of the variant that joins them, programs of one kernel each: no program is kept before all its kernels have run.
CLASSES_ONLY: layout.Macros = {"CLASSES_ONLY": 1}
TOGETHER: layout.Macros = {"TOGETHER": 1}  # classes and transforms of the first layer
JOINS = ("processor",)  # variants that join them
SPARING = "PoCL 3.0"  # the version of which it was tried; others compile general forms once more before they are kept
# Compilers that read the declarations of all of OpenCL C with every program, unless these are taken for read: those of which
# it was tried. They get the declarations of what kernels call (builtins.cl).
DECLARES_ALL = re.compile(r"PoCL 3\.0.* LLVM 14\.")
FEW_DECLARED = "-D_OPENCL_H_"
Key = tuple[Any, ...]


@dataclass(frozen=True)
class Encoder:
    """What makes pictures of outputs."""

    files: tuple[str, ...]
    cut: layout.Cut  # of as many lanes as the device's compiler has registers for if 0

    def program(self, ending: layout.Macros) -> tuple[str, layout.Macros]:
        """Source and macros."""
        return layout.joined_files("lanes.cl", "vectors.cl", "encoding.cl", *self.files), {**ending, **self.cut.macros}


ENCODERS = {
    "processor": Encoder(("rows.cl", "encode.cl"), layout.Cut(256, 48, (1, 1), 0)),
    "graphics": Encoder(("encode_by_item.cl",), layout.Cut(64, 4, (64, 4), 1)),
}


class Compiler:
    """Builds programs for a device, or takes those that it or an earlier run has built."""

    def __init__(self, context: Any, device: Any) -> None:
        self.context, self._device = context, device
        self._built: dict[str, kernels.Made] = {}  # by source and options
        self.has_news = False  # a kernel that has not been kept, or has not run before

    def build(self, source: str, macros: layout.Macros) -> kernels.Made:
        """A program."""
        cl, device = pyopencl(), self._device
        options = [*BUILD_OPTIONS, *(f"-D{name}={value}" for name, value in macros.items())]
        if DECLARES_ALL.search(device.platform.version):
            source, options = f"{layout.joined_files('builtins.cl')}\n{source}", [*options, FEW_DECLARED]
        driver = (device.platform.name, device.platform.version, device.version, device.driver_version)
        identity = (*driver, device.name, compiled_for(device))

        def compiled() -> kernels.Made:
            return _made(cl.Program(self.context, source).build(options))

        def of_binary(binary: bytes) -> kernels.Made | None:
            try:
                return _made(cl.Program(self.context, [device], [binary]).build())
            except cl.Error:  # a driver that has changed and still has the same version
                return None

        known = "\0".join([*identity, *options, source])
        if known not in self._built:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # pyopencl warns of every word a compiler says
                self._built[known] = kernels.built(known, compiled, of_binary)
        return self._built[known]

    def kernel(self, made: kernels.Made, name: str) -> Any:
        """A kernel of a program."""
        self.has_news = True
        return pyopencl().Kernel(made.program, name)

    def keep(self) -> None:
        """Keep what has been compiled, once it has run: PoCL compiles kernels when they run."""
        if self.has_news:
            kernels.keep()
            self.has_news = False


@functools.cache
def compiler_of(device: Any) -> Compiler:
    """The one of a device in this process: what a renderer has built is there for the next."""
    return Compiler(pyopencl().Context([device]), device)


def _made(program: Any) -> kernels.Made:
    def binary() -> bytes:
        return bytes(program.get_info(pyopencl().program_info.BINARIES)[0])

    spares = SPARING in program.devices[0].platform.version
    return kernels.Made(program, tuple(program.kernel_names.split(";")), binary, spares)


def chosen(device: str | None, variant: str | None) -> tuple[Any, str]:
    """Device and variant of a renderer that is asked for them (OpenCLRenderer). DeviceError, RecipeError if none is."""
    found = choose_device(os.environ.get("L3_DEVICE", "") if device is None else device)
    name = variant or ("graphics" if found.type & pyopencl().device_type.GPU else "processor")
    if name not in layout.VARIANTS:
        raise RecipeError(f'variant "{name}" is unknown; use one of {", ".join(layout.VARIANTS)}')
    return found, name


def make_ready(device: str | None = None, variant: str | None = None) -> None:
    """Build what a renderer needs for any table. Errors as of `chosen`."""
    found, name = chosen(device, variant)
    with refusals(found):
        usual_encoder(compiler_of(found), ENCODERS[name])


def usual_encoder(compiler: Compiler, encoder: Encoder) -> int:
    """Build what makes usual pictures of outputs, which is soon needed: the number of lanes that its kernel's name tells. It
    runs once on a pixel, so that it can be kept."""
    cl, context = pyopencl(), compiler.context
    made = compiler.build(*encoder.program(layout.display_macros(Display(np.eye(3), 8))))
    (name,) = made.kernels
    queue, group = cl.CommandQueue(context), encoder.cut.group
    buffers = [cl.Buffer(context, cl.mem_flags.READ_WRITE, 64) for _ in range(3)]
    compiler.kernel(made, name)(queue, group, group, *buffers, np.int32(1), np.int32(1)).wait()
    return int(name.rpartition("_")[2])


class Programs:
    """The kernels of a table's layers, counted from 0, and what makes pictures of outputs.

    `ending`: what the transforms write (layout.py). `lanes`: length of the processor variant's vectors; None: what the
    device's compiler has registers for. `sets`: of transforms that pixels choose from.
    """

    def __init__(self, compiler: Compiler, table: TransformTable, variant: str, lanes: int | None, sets: int = 1) -> None:
        self._compiler, self._table, self._variant, self._sets = compiler, table, variant, sets
        self._programs: dict[Key, kernels.Made] = {}  # by layer, -1: an encoder, or "together"; and ending
        self._kernels: dict[Key, Any] = {}  # by program and name
        self._last = len(table.later)
        usual = ENCODERS[variant]
        self._encoder = replace(usual, cut=replace(usual.cut, lanes=lanes)) if lanes else usual
        self.cut = layout.VARIANTS[variant].cut(table, lanes or usual_encoder(compiler, usual))

    @property
    def encoder_cut(self) -> layout.Cut:
        """That of the encoder."""
        return self._encoder.cut

    @property
    def joins(self) -> bool:
        """Whether classes and transforms of the first layer may be one kernel."""
        return self._variant in JOINS

    def transforms(self, ending: layout.Macros, together: bool = False) -> Any:
        """The kernel of the last layer's transforms, which if it is the only one may find its classes, too."""
        return self._transforms(self._last, ending, together)

    def planes(self, layer: int, together: bool = False) -> Any:
        """The kernel that makes what layer `layer` + 1 reads, which for the first may find its classes, too."""
        return self._transforms(layer, layout.TO_PLANES, together)

    def _transforms(self, layer: int, ending: layout.Macros, together: bool) -> Any:
        if together:
            return self._kernel(self._built(layer, {**ending, **TOGETHER}), "classes_and_transform")
        return self._kernel(self._built(layer, ending | (TRANSFORM_ONLY if self.joins and not layer else {})), "transform")

    def classes(self, layer: int) -> Any:
        """The kernel that finds a layer's classes, out of whichever program of it there is."""
        usual = layout.TO_PLANES if layer < self._last else layout.OUTPUTS_AS_THEY_ARE
        if self.joins and not layer:
            return self._kernel(self._built(layer, {**usual, **CLASSES_ONLY}), "classes")
        key = next((key for key in self._programs if key[0] == layer), None) or self._built(layer, usual)
        return self._kernel(key, "structures" if layer else "classes")

    def encoder(self, ending: layout.Macros) -> Any:
        """The kernel that makes pictures of outputs."""
        key = self._built(-1, ending)
        return self._kernel(key, *self._programs[key].kernels)

    def _kernel(self, key: Key, name: str) -> Any:
        if (*key, name) not in self._kernels:
            self._kernels[*key, name] = self._compiler.kernel(self._programs[key], name)
        return self._kernels[*key, name]

    def _built(self, layer: int, ending: layout.Macros) -> Key:
        """The key of a program, which is built now if it has not been before."""
        key = (layer, *ending.items())
        if key not in self._programs:
            self._programs[key] = self._compiler.build(*self._program(layer, ending))
        return key

    def _program(self, layer: int, ending: layout.Macros) -> tuple[str, layout.Macros]:
        """Source and macros."""
        if layer < 0:
            return self._encoder.program(ending)
        if layer == 0:
            source = layout.first_source(self._variant, self._table.first.rule)
            macros = layout.table_macros(self._table, self._sets)
        else:
            later = self._table.later[layer - 1]
            source, macros = layout.later_source(self._variant, later.rule), layout.later_macros(self._table, later)
        if any(other[0] == layer for other in self._programs) and not (self.joins and layer == 0):
            macros = {**macros, **TRANSFORM_ONLY}
        return source, {**macros, **ending, **self.cut.macros}
