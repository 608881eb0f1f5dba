"""The programs of a table on an OpenCL device, each built when a frame first needs it."""

import warnings
from dataclasses import replace
from typing import Any

import numpy as np

from l3cli.artifacts.table import TransformTable
from l3cli.rendering import kernels, layout
from l3cli.rendering.display import Display
from l3cli.rendering.opencl_devices import pyopencl

BUILD_OPTIONS = ("-w", "-cl-mad-enable", "-cl-std=CL1.2")
Key = tuple[Any, ...]
# What makes pictures of outputs: its files and its cut, of as many lanes as the device's compiler has registers for if 0.
ENCODERS = {
    "processor": (("rows.cl", "encode.cl"), layout.Cut(256, 48, (1, 1), 0)),
    "graphics": (("encode_by_item.cl",), layout.Cut(64, 4, (64, 4), 1)),
}


class Compiler:
    """Builds programs for a device, or takes those that an earlier run has built."""

    def __init__(self, context: Any, device: Any) -> None:
        self._context, self._device = context, device
        self.has_compiled = False  # something that has not been kept

    def build(self, source: str, macros: layout.Macros) -> Any:
        """A program."""
        cl, device = pyopencl(), self._device
        options = [*BUILD_OPTIONS, *(f"-D{name}={value}" for name, value in macros.items())]
        identity = (device.platform.name, device.platform.version, device.name, device.version, device.driver_version)

        def compiled() -> Any:
            self.has_compiled = True
            return cl.Program(self._context, source).build(options)

        def of_binary(binary: bytes) -> Any | None:
            try:
                return cl.Program(self._context, [device], [binary]).build()
            except cl.Error:  # a driver that has changed and still has the same version
                return None

        def binary_of(program: Any) -> bytes:
            return bytes(program.get_info(cl.program_info.BINARIES)[0])

        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # pyopencl warns of every word a compiler says
            return kernels.built("\0".join([*identity, *options, source]), compiled, of_binary, binary_of)


class Programs:
    """The kernels of a table's layers, counted from 0, and what makes pictures of outputs.

    `ending`: what the transforms write (layout.py). `lanes`: length of the processor variant's vectors; None: what the
    device's compiler has registers for.
    """

    def __init__(self, compiler: Compiler, table: TransformTable, variant: str, lanes: int | None) -> None:
        self._compiler, self._table, self._variant = compiler, table, variant
        self._programs: dict[Key, Any] = {}  # by layer, -1: an encoder; and ending
        self._kernels: dict[Key, Any] = {}  # by program and name
        self._last = len(table.later)
        self._encoder_files, known = ENCODERS[variant]
        self.encoder_cut = replace(known, lanes=lanes or known.lanes)
        self.cut = layout.VARIANTS[variant].cut(table, self._lanes())

    def transforms(self, ending: layout.Macros) -> Any:
        """The kernel of the last layer's transforms."""
        return self._kernel(self._built(self._last, ending), "transform")

    def planes(self, layer: int) -> Any:
        """The kernel that makes what layer `layer` + 1 reads."""
        return self._kernel(self._built(layer, layout.TO_PLANES), "transform")

    def classes(self, layer: int) -> Any:
        """The kernel that finds a layer's classes, out of whichever program of it there is."""
        usual = layout.TO_PLANES if layer < self._last else layout.OUTPUTS_AS_THEY_ARE
        key = next((key for key in self._programs if key[0] == layer), None) or self._built(layer, usual)
        return self._kernel(key, "structures" if layer else "classes")

    def encoder(self, ending: layout.Macros) -> Any:
        """The kernel that makes pictures of outputs."""
        key = self._built(-1, ending)
        return self._kernel(key, self._programs[key].kernel_names)

    def _kernel(self, key: Key, name: str) -> Any:
        if (*key, name) not in self._kernels:
            self._kernels[*key, name] = pyopencl().Kernel(self._programs[key], name)
        return self._kernels[*key, name]

    def _built(self, layer: int, ending: layout.Macros) -> Key:
        """The key of a program, which is built now if it has not been before."""
        key = (layer, *ending.items())
        if key not in self._programs:
            source, macros, cut = self._parts(layer)
            self._programs[key] = self._compiler.build(source, {**macros, **ending, **cut.macros})
        return key

    def _parts(self, layer: int) -> tuple[str, layout.Macros, layout.Cut]:
        """Source, shapes and cut of a program."""
        if layer < 0:
            files = ("lanes.cl", "vectors.cl", "encoding.cl", *self._encoder_files)
            return layout.joined_files(*files), {}, self.encoder_cut
        if layer == 0:
            return layout.first_source(self._variant, self._table.first.rule), layout.table_macros(self._table), self.cut
        later = self._table.later[layer - 1]
        return layout.later_source(self._variant, later.rule), layout.later_macros(self._table, later), self.cut

    def _lanes(self) -> int:
        """Pixels side by side, by the name of an encoder: that of usual pictures, which is soon needed."""
        return int(self.encoder(layout.display_macros(Display(np.eye(3), 8))).function_name.rpartition("_")[2])
