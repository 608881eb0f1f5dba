"""Options that several commands share, each declared once, and what every command says on stderr."""

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


def _trust(context: click.Context, parameter: click.Parameter, value: bool) -> None:
    if value:
        from l3cli.limits import trust

        context.with_resource(trust())


trust = click.option(
    "--trust",
    is_flag=True,
    expose_value=False,
    callback=_trust,
    help="Decode raw, image, MATLAB and video files here, not in a process of limited time and memory.",
)


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
