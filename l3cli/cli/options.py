"""Options that several commands share, each declared once, and what every command says on stderr."""

import functools
import re
import sys
import time
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any, TypeVar

import click

F = TypeVar("F", bound=Callable[..., Any])
T = TypeVar("T")

FILE = click.Path(path_type=Path)


def output(what: str, required: bool = True) -> Callable[[F], F]:
    """-o/--output FILE."""
    return click.option("-o", "--output", type=FILE, required=required, metavar="FILE", help=f"{what}.")


force = click.option("--force", is_flag=True, help="Replace the output if it exists.")
quiet = click.option("--quiet", is_flag=True, help="Say nothing on stderr but errors.")
as_json = click.option("--json", "as_json", is_flag=True, help="Print the result as JSON on stdout.")
seed = click.option("--seed", type=click.IntRange(0), default=0, show_default=True, help="Seed of every random draw.")
device = click.option(
    "--device", metavar="NAME|INDEX", help='OpenCL device, by part of its name or number of "l3 bench" [default: L3_DEVICE].'
)
variant = click.option(
    "--variant",
    type=click.Choice(["processor", "graphics"]),
    help="How frames are cut into work for the device [default: by its type].",
)
jobs = click.option("--jobs", type=click.IntRange(1), default=1, show_default=True, help="Processes to use.")
_ADDRESS = click.option(
    "--scheduler", metavar="ADDRESS", help="Work on the machines of this dask scheduler, tcp://HOST:PORT."
)
_CA = click.option("--tls-ca", type=FILE, metavar="PEM", help="Authority that signed the scheduler's certificate (tls://…).")
_CERTIFICATE = click.option("--tls-cert", type=FILE, metavar="PEM", help="Certificate to show to the scheduler.")
_KEY = click.option("--tls-key", type=FILE, metavar="PEM", help="Key of --tls-cert.")


def scheduler(command: Callable[..., Any]) -> Callable[..., Any]:
    """--scheduler ADDRESS and its TLS files, all as one parameter `scheduler`; to stand above --jobs and --quiet."""

    @functools.wraps(command)
    def called(
        scheduler: str | None, tls_ca: Path | None, tls_cert: Path | None, tls_key: Path | None, **others: Any
    ) -> Any:
        from l3cli.parallel import Scheduler

        if scheduler is None:
            if tls_ca or tls_cert or tls_key:
                raise click.UsageError("--tls-ca, --tls-cert and --tls-key go with --scheduler")
            return command(scheduler=None, **others)
        if others.get("jobs", 1) > 1:
            raise click.UsageError("--jobs is the number of processes here; leave it out with --scheduler")

        def warn(message: str) -> None:
            say(f"warning: {message}", others["quiet"])

        return command(scheduler=Scheduler(scheduler, tls_ca, tls_cert, tls_key, warn), **others)

    return _ADDRESS(_CA(_CERTIFICATE(_KEY(called))))


def frame_name(index: int, scene: str) -> str:
    """Stem of the files of one frame of a training set: its number and its scene, without odd characters."""
    return f"{index:05d}_{re.sub(r'[^A-Za-z0-9]+', '-', scene)}"


def say(message: str, quiet: bool) -> None:
    """One line of talk on stderr."""
    if not quiet:
        click.echo(message, err=True)


def progress(items: Iterable[T], total: int | None, what: str, quiet: bool) -> Iterator[T]:
    """Pass `items` on with a bar on a terminal (rate and time left), nothing elsewhere."""
    if quiet or not sys.stderr.isatty():
        yield from items
        return
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    rate = TextColumn("{task.fields[rate]}")
    columns = (TextColumn(what), BarColumn(), MofNCompleteColumn(), rate, TextColumn("left"), TimeRemainingColumn())
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task, start = bar.add_task(what, total=total, rate=""), time.monotonic()
        for done, item in enumerate(items, 1):
            yield item
            bar.update(task, advance=1, rate=f"{done / max(time.monotonic() - start, 1e-9):.3g} a second")
