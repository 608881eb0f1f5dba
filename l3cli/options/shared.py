"""Options that several commands share."""

from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from l3cli.errors import RecipeError, shortened
from l3cli.options.option import Given, Name, Number, Options, Reader, option, options
from l3cli.system.text import LARGEST_WHOLE

if TYPE_CHECKING:
    from l3cli.parallel.cluster import Scheduler

MOST_JOBS = 4096
PAIR = tuple[int, int]
OnePath = Given[Name | None, Path | None]


class Pair(Reader):
    """Two whole numbers with a separator between them, such as ROW,COL."""

    def __init__(self, shape: str, separator: str, number: Number) -> None:
        self._shape, self._separator, self._number = shape, separator, number

    def read(self, given: Any) -> tuple[int, int]:
        text = given if isinstance(given, str) else self._separator.join(map(str, given))
        first, has_separator, second = text.partition(self._separator)
        try:
            if has_separator:
                return self._number.read(first), self._number.read(second)
        except ValueError as error:
            raise ValueError(f'"{shortened(text)}" is not {self._shape}: {error}') from None
        raise ValueError(f'"{shortened(text)}" is not {self._shape}')


LEVEL = Number(0, 65535, "DN")
SITE = Pair("ROW,COL", ",", Number(0, 65535, "rows or columns", whole=True))


class Shard(Pair):
    """I/N, a part of a work divided into several."""

    def __init__(self) -> None:
        super().__init__("I/N, such as 1/4", "/", Number(0, 1_000_000, "shards", whole=True))

    def read(self, given: Any) -> tuple[int, int]:
        index, count = super().read(given)
        if not 1 <= index <= count:
            most = max(count, 1)
            raise ValueError(f"{index}/{count}: shards count from 1/{most} to {most}/{most}")
        return index, count


@options
class BackendOptions(Options):
    """Choice of what renders."""

    backend: Literal["opencl", "reference"] = option(
        "opencl", "Render on an OpenCL device, or by numpy in float64.", shared=True
    )


@options
class DeviceOptions(Options):
    """Choice of an OpenCL device and of kernels for it."""

    device: str | None = option(
        None,
        'OpenCL device, by part of its name or number of "l3 bench" [default: L3_DEVICE].',
        metavar="NAME|INDEX",
        shared=True,
    )
    variant: Literal["processor", "graphics"] | None = option(
        None, "Kernels for a processor or a graphics card [default: by the device's type].", shared=True
    )


@options
class SeedOptions(Options):
    """Choice of random numbers."""

    seed: int = option(0, "Seed of the random numbers.", Number(0, LARGEST_WHOLE, whole=True), metavar="N", shared=True)


@options
class SchedulerOptions(Options):
    """Choice of workers on other machines."""

    scheduler: str | None = option(
        None, "Run on the workers of this dask scheduler, tcp://HOST:PORT.", metavar="ADDRESS", bytes=False, shared=True
    )
    tls_ca: OnePath = option(
        None, "Authority that signed the scheduler's certificate (tls://…).", metavar="PEM", bytes=False, shared=True
    )
    tls_cert: OnePath = option(None, "Certificate to show to the scheduler.", metavar="PEM", bytes=False, shared=True)
    tls_key: OnePath = option(None, "Key of ‹tls_cert›.", metavar="PEM", bytes=False, shared=True)

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.scheduler is None and (self.tls_ca or self.tls_cert or self.tls_key):
            raise RecipeError("‹tls_ca›, ‹tls_cert› and ‹tls_key› go with ‹scheduler›")

    def cluster(self) -> "Scheduler | None":
        """Return the scheduler, None without one; errors as of Scheduler."""
        if self.scheduler is None:
            return None
        from l3cli.parallel.cluster import Scheduler

        return Scheduler(self.scheduler, self.tls_ca, self.tls_cert, self.tls_key, self.console.warn)


@options
class JobsOptions(Options):
    """Choice of how many processes work."""

    jobs: int = option(
        1, "Number of processes to use.", Number(1, MOST_JOBS, whole=True), metavar="N", bytes=False, shared=True
    )


@options
class WorkerOptions(JobsOptions, SchedulerOptions):
    """Choice of processes, on this machine or on others."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.scheduler is not None and self.jobs > 1:
            raise RecipeError("‹jobs› is the number of processes here; leave it out with ‹scheduler›")


@options
class ForceOptions(Options):
    """Choice of what may be replaced."""

    force: bool = option(False, "Replace the output if it exists.", bytes=False, shared=True)
