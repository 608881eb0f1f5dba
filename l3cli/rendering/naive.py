"""The transforms of one layer by a plain kernel, a work-item a pixel (opencl/naive.cl): a yardstick for the benchmark."""

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.table import TransformTable
from l3cli.frame import RawFrame, mirrored_indices
from l3cli.rendering import layout
from l3cli.rendering.opencl_devices import choose_device, pyopencl, refusals
from l3cli.rendering.opencl_programs import Compiler


class NaiveTransforms:
    """The first layer of a table on an OpenCL device, as `OpenCLRenderer` takes it; for frames of one size at the table's
    levels. DeviceError if there is no device or it refuses."""

    def __init__(self, table: TransformTable, device: str, frame: RawFrame, labels: NDArray[np.uint32]) -> None:
        """`labels`: class (row, col) of every pixel of the frame."""
        cl = pyopencl()
        self._device, self._shape = choose_device(device), frame.values.shape
        (rows, cols), rule, period = frame.values.shape, table.first.rule, table.cfa.shape
        weights = table.first.weights / np.float32(table.white_level - table.black_level)
        arrays = (
            frame.values,
            mirrored_indices(rows, rule.radius, period[0]).astype(np.int32),
            mirrored_indices(cols, rule.radius, period[1]).astype(np.int32),
            labels.astype(np.uint32),
            weights,
            table.first.intercept,
        )
        with refusals(self._device):
            context = cl.Context([self._device])
            self._queue = cl.CommandQueue(context, properties=cl.command_queue_properties.PROFILING_ENABLE)
            self._compiler = Compiler(context, self._device)
            macros: layout.Macros = {"PATCH": rule.patch, "OUTPUTS": len(table.outputs)}
            self._kernel = self._compiler.kernel(self._compiler.build(layout.joined_files("naive.cl"), macros), "naive")
            flags = cl.mem_flags.READ_ONLY | cl.mem_flags.COPY_HOST_PTR
            buffers = [cl.Buffer(context, flags, hostbuf=np.ascontiguousarray(array)) for array in arrays]
            self._outputs = np.empty((len(table.outputs), rows, cols), np.float32)
            self._result = cl.Buffer(context, cl.mem_flags.WRITE_ONLY, self._outputs.nbytes)
            self._arguments = (*buffers, self._result, np.float32(frame.black_level), np.int32(rows), np.int32(cols))

    def milliseconds(self) -> float:
        """What the device spends in the kernel, once."""
        with refusals(self._device):
            event = self._kernel(self._queue, self._shape[::-1], None, *self._arguments)
            event.wait()
            self._compiler.keep()
            return float((event.profile.end - event.profile.start) * 1e-6)

    def outputs(self) -> NDArray[np.float32]:
        """What the kernel has made: (output, row, col)."""
        with refusals(self._device):
            pyopencl().enqueue_copy(self._queue, self._outputs, self._result)
        return self._outputs
