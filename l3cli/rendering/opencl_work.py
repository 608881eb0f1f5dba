"""What is queued on an OpenCL device: queues with their buffers, events, bands of frames."""

from dataclasses import dataclass
from typing import Any

from numpy.typing import NDArray

from l3cli.rendering.opencl_devices import pyopencl


class Track:
    """A queue and the buffers of one band; buffers grow to what is asked of them."""

    def __init__(self, context: Any) -> None:
        cl = pyopencl()
        self.queue = cl.CommandQueue(context, properties=cl.command_queue_properties.PROFILING_ENABLE)
        self.raw: Any = None
        self.labels: Any = None
        self.planes: Any = None
        self.later_labels: Any = None
        self.result: Any = None

    def download(self, buffer: Any, destination: NDArray, offset: int) -> Any:
        """Copy `buffer` from byte `offset` on to the contiguous array `destination`, without waiting."""
        copy = pyopencl().enqueue_copy(self.queue, destination, buffer, src_offset=offset, is_blocking=False)
        self.queue.flush()
        return copy


class Work:
    """What has been started for one frame: its events by stage, and the values that uploads may still be reading."""

    def __init__(self, stages: tuple[str, ...]) -> None:
        self.events: dict[str, list[Any]] = {stage: [] for stage in stages}
        self.sources: list[NDArray] = []

    def add(self, stage: str, event: Any) -> None:
        self.events[stage].append(event)

    def milliseconds(self) -> dict[str, float]:
        """What the device spent in each stage, once all is done."""
        return {
            stage: sum((event.profile.end - event.profile.start) * 1e-6 for event in events)
            for stage, events in self.events.items()
        }


@dataclass(frozen=True)
class Band:
    """Rows of a frame, with those beside them that a later layer reads, and the raw rows that the patches of all these
    touch. Each source (padded row), (padded col) names which row and column each padded one repeats: of the raw rows, or of
    the planes of the wide rows, as structures and as transforms see them."""

    rows: slice
    wide: slice
    raw_rows: slice
    columns: int
    mosaic_source: tuple[Any, Any]
    structure_source: tuple[Any, Any]
    plane_source: tuple[Any, Any]
