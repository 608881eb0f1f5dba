"""Compile the OpenCL programs for a table. Each program is compiled for the first frame that uses it."""

import functools
import os
import warnings
from dataclasses import replace
from typing import Any

import numpy as np

from l3cli.artifacts.table import TransformTable
from l3cli.errors import RecipeError
from l3cli.rendering.display import Display
from l3cli.rendering.opencl import layout
from l3cli.rendering.opencl.devices import choose_device, pyopencl, refusals
from l3cli.rendering.opencl.processor import PLATFORM, compiled_for

BUILD_OPTIONS = ("-w", "-cl-mad-enable", "-cl-std=CL1.2")
# Macros that limit a program to one kernel, so that unused kernels are not compiled.
TRANSFORM_ONLY: layout.Macros = {"TRANSFORM_ONLY": 1}  # transforms
CLASSES_ONLY: layout.Macros = {"CLASSES_ONLY": 1}  # classes of the first layer
JOINED: layout.Macros = {"JOINED": 1}  # classes and transforms of the first layer together
WITHOUT_HEADER = "-D_OPENCL_H_"  # skips PoCL's header with the declarations of all OpenCL functions
Key = tuple[Any, ...]


class Compiler:
    """Compiles programs for a device, and caches them within this process."""

    def __init__(self, context: Any, device: Any) -> None:
        self.context, self._device = context, device
        self._built: dict[tuple[str, ...], Any] = {}  # source and options → program

    def build(self, source: str, macros: layout.Macros) -> Any:
        """Compile a program from its source and macros."""
        options = [*BUILD_OPTIONS, *(f"-D{name}={value}" for name, value in macros.items())]
        if name := compiled_for(self._device):  # so that PoCL does not use cached kernels for other processors
            options.append(f"-DCOMPILED_FOR={name}")
        if PLATFORM in self._device.platform.version:  # its header is slow to read
            source = f"{layout.joined_files('common/builtins.cl')}\n{source}"
            options.append(WITHOUT_HEADER)
        key = (source, *options)
        if key not in self._built:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # pyopencl warns about any compiler output
                self._built[key] = pyopencl().Program(self.context, source).build(options)
        return self._built[key]


@functools.cache
def compiler_of(device: Any) -> Compiler:
    """Return the compiler for a device. All renderers in a process share it."""
    return Compiler(pyopencl().Context([device]), device)


def chosen(device: str | None, variant: str | None) -> tuple[Any, str]:
    """Return the device and the variant for the arguments `device` and `variant` of `OpenCLRenderer`.

    Raises DeviceError if no device matches, and RecipeError if the variant is unknown.
    """
    found = choose_device(os.environ.get("L3_DEVICE", "") if device is None else device)
    name = variant or ("graphics" if found.type & pyopencl().device_type.GPU else "processor")
    if name not in layout.VARIANTS:
        raise RecipeError(f'variant "{name}" is unknown; use one of {", ".join(layout.VARIANTS)}')
    return found, name


def make_ready(device: str | None = None, variant: str | None = None) -> None:
    """Compile the default encoder, which does not depend on the table. Parameters and errors are as in `chosen`."""
    found, name = chosen(device, variant)
    with refusals(found):
        usual_encoder(compiler_of(found), name)


def usual_encoder(compiler: Compiler, variant: str) -> int:
    """Compile the encoder for 8-bit sRGB pictures, and return the device's vector length.

    The vector length is part of the kernel's name. PoCL compiles a kernel when it is first run, so this function runs the
    kernel on one pixel.
    """
    cl, context = pyopencl(), compiler.context
    cut = layout.VARIANTS[variant].encoder_cut
    macros = layout.display_macros(Display(np.eye(3), 8)) | cut.macros
    program = compiler.build(layout.encoder_source(variant), macros)
    (name,) = program.kernel_names.split(";")
    queue = cl.CommandQueue(context)
    buffers = [cl.Buffer(context, cl.mem_flags.READ_WRITE, 64) for _ in range(3)]
    cl.Kernel(program, name)(queue, cut.group, cut.group, *buffers, np.int32(1), np.int32(1)).wait()
    return int(name.rpartition("_")[2])


class Programs:
    """The kernels for a table's layers, counted from 0, and for the encoder.

    In all methods, `ending` contains the macros from layout.py that select what a kernel writes: planes, outputs or encoded
    pixels.

    Parameters
    ----------
    compiler : Compiler
        Compiler for the device.
    table : TransformTable
        Table with which the kernels render.
    variant : str
        A key of layout.VARIANTS.
    lanes : int or None
        Vector length of the variant "processor" (the CPU kernels), or None for the width of the device's registers.
    sets : int
        Number of sets of transforms.
    """

    def __init__(self, compiler: Compiler, table: TransformTable, variant: str, lanes: int | None, sets: int = 1) -> None:
        self._compiler, self._table, self._variant, self._sets = compiler, table, variant, sets
        self._programs: dict[Key, Any] = {}  # layer (−1 for the encoder) and `ending` macros → program
        self._kernels: dict[Key, Any] = {}  # key of the program and kernel name → kernel
        self._last = len(table.later)
        made_for = layout.VARIANTS[variant]
        self.joins = made_for.joins
        self.encoder_cut = replace(made_for.encoder_cut, lanes=lanes) if lanes else made_for.encoder_cut
        self.cut = made_for.cut(table, lanes or usual_encoder(compiler, variant))

    def transforms(self, ending: layout.Macros, joined: bool = False) -> Any:
        """Return the kernel that applies the last layer's transforms.

        If `joined` is true, the kernel also classifies the pixels. This requires a table with a single layer.
        """
        return self._transforms(self._last, ending, joined)

    def first_outputs(self) -> Any:
        """Return the kernel that computes the first layer's outputs, for tables in which the last layer corrects them."""
        return self._transforms(0, layout.OUTPUTS_AS_THEY_ARE, joined=False)

    def planes(self, layer: int, joined: bool = False) -> Any:
        """Return the kernel that computes the planes from `layer` for the next layer.

        If `joined` is true, the kernel also classifies the pixels. This is possible only in the first layer.
        """
        return self._transforms(layer, layout.TO_PLANES, joined)

    def _transforms(self, layer: int, ending: layout.Macros, joined: bool) -> Any:
        if joined:
            return self._kernel(self._built(layer, {**ending, **JOINED}), "classes_and_transform")
        return self._kernel(self._built(layer, ending | (TRANSFORM_ONLY if self.joins and not layer else {})), "transform")

    def classes(self, layer: int) -> Any:
        """Return the kernel that classifies the pixels for a layer. A program that is already compiled is reused."""
        usual = layout.TO_PLANES if layer < self._last else layout.OUTPUTS_AS_THEY_ARE
        if self.joins and not layer:
            return self._kernel(self._built(layer, {**usual, **CLASSES_ONLY}), "classes")
        key = next((key for key in self._programs if key[0] == layer), None) or self._built(layer, usual)
        return self._kernel(key, "structures" if layer else "classes")

    def encoder(self, ending: layout.Macros) -> Any:
        """Return the kernel that encodes outputs as pictures."""
        key = self._built(-1, ending)
        return self._kernel(key, self._programs[key].kernel_names)

    def _kernel(self, key: Key, name: str) -> Any:
        if (*key, name) not in self._kernels:
            self._kernels[*key, name] = pyopencl().Kernel(self._programs[key], name)
        return self._kernels[*key, name]

    def _built(self, layer: int, ending: layout.Macros) -> Key:
        """Compile a program if necessary, and return its key in `_programs`."""
        key = (layer, *ending.items())
        if key not in self._programs:
            self._programs[key] = self._compiler.build(*self._program(layer, ending))
        return key

    def _program(self, layer: int, ending: layout.Macros) -> tuple[str, layout.Macros]:
        """Return the source and the macros of a program."""
        if layer < 0:
            return layout.encoder_source(self._variant), {**ending, **self.encoder_cut.macros}
        if layer == 0:
            source = layout.first_source(self._variant, self._table.first.rule)
            macros = layout.table_macros(self._table, self._sets)
        else:
            later = self._table.later[layer - 1]
            source = layout.refinement_source(self._variant, later)
            macros = layout.refinement_macros(self._table, later)
        if any(other[0] == layer for other in self._programs) and not (self.joins and layer == 0):
            macros = {**macros, **TRANSFORM_ONLY}
        return source, {**macros, **ending, **self.cut.macros}
