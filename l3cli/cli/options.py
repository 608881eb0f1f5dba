"""Options that several commands share, each declared once, and what every command says on stderr."""

import functools
import itertools
import os
import re
import sys
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import AbstractContextManager
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click

from l3cli.cli.terminal import tell
from l3cli.errors import L3Error, RecipeError
from l3cli.quantities import LARGEST_WHOLE, NoSuchNumber, Quantity

if TYPE_CHECKING:
    from click.shell_completion import CompletionItem

F = TypeVar("F", bound=Callable[..., Any])
T = TypeVar("T")

FILE = click.Path(
    path_type=Path, readable=False
)  # whoever opens it says what is wrong with it, and ends with the right code


class RecipeFile(click.Path):
    """A recipe: a file, or the name of one of the `kind` (a folder of configs/) that come with l3."""

    def __init__(self, kind: str) -> None:
        super().__init__(path_type=Path, readable=False)
        self.kind = kind

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Path:
        from l3cli.recipes import find_recipe

        return find_recipe(os.fspath(value), self.kind)

    def shell_complete(self, ctx: click.Context, param: click.Parameter, incomplete: str) -> list["CompletionItem"]:
        """Names and, beside them, files: bash does not look for files where anything else is offered."""
        from click.shell_completion import CompletionItem

        from l3cli.recipes import known_recipes

        names = [name for name in known_recipes(self.kind) if name.startswith(incomplete)]
        if not names:
            return super().shell_complete(ctx, param, incomplete)
        visible = (each for each in os.scandir() if each.name.startswith(incomplete) and not each.name.startswith("."))
        files = [each.name + "/" * each.is_dir() for each in visible]
        return [CompletionItem(each) for each in (*names, *sorted(files))]


CAMERA = RecipeFile("cameras")
MOST_JOBS = 4096


class Number(click.ParamType):
    """A number within a declared range, of a declared unit."""

    name = "number"

    def __init__(self, least: float, most: float, unit: str = "", whole: bool = False) -> None:
        self._quantity = Quantity(least, most, unit, whole)

    def convert(self, value: Any, parameter: click.Parameter | None, context: click.Context | None) -> float:
        return self.read(value, parameter, context) if isinstance(value, str) else value

    def read(self, text: str, parameter: click.Parameter | None = None, context: click.Context | None = None) -> float:
        """The number that `text` means, an int where whole ones are wanted."""
        try:
            return self._quantity.read(text)
        except NoSuchNumber as error:
            self.fail(str(error), parameter, context)


def output(what: str, required: bool = True) -> Callable[[F], F]:
    """-o/--output FILE."""
    return click.option("-o", "--output", type=FILE, required=required, metavar="FILE", help=f"{what}.")


force = click.option("--force", is_flag=True, help="Replace the output if it exists.")
quiet = click.option("--quiet", is_flag=True, help="Say nothing on stderr but errors.")
as_json = click.option("--json", "as_json", is_flag=True, help="Print the result as JSON on stdout.")
seed = click.option(
    "--seed",
    type=Number(0, LARGEST_WHOLE, whole=True),
    default=0,
    show_default=True,
    metavar="N",
    help="Number that every random draw starts from.",
)
device = click.option(
    "--device", metavar="NAME|INDEX", help='OpenCL device, by part of its name or number of "l3 bench" [default: L3_DEVICE].'
)
variant = click.option(
    "--variant",
    type=click.Choice(["processor", "graphics"]),
    help="How frames are cut into work for the device [default: by its type].",
)
backend = click.option(
    "--backend",
    type=click.Choice(["opencl", "reference"]),
    default="opencl",
    show_default=True,
    help="What renders: an OpenCL device, or numpy in float64.",
)
jobs = click.option(
    "--jobs",
    type=Number(1, MOST_JOBS, whole=True),
    default=1,
    show_default=True,
    metavar="N",
    help="Number of processes to use.",
)
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
        from l3cli.parallel.cluster import Scheduler

        spare(*filter(None, [tls_ca, tls_cert, tls_key]))
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


CLAIMED = "l3cli.claimed"  # in the context: outputs, and (folder, globs) of those in folders, that the command has claimed


def spare(*inputs: Path) -> None:
    """Say what files the command reads, as soon as they are known: until it ends, nothing takes the place of one of them,
    by whatever name and whatever --force says. RecipeError if an output that is claimed already would."""
    from l3cli.files import sparing

    context = click.get_current_context()
    context.with_resource(sparing(inputs))
    for claimed in context.meta.get(CLAIMED, ()):
        _refuse_spared(*claimed)


def _claim(folder: Path, *globs: str) -> None:
    """Refuse outputs in place of what the command reads, as far as that is known, and remember them for what will be."""
    _refuse_spared(folder, *globs)
    click.get_current_context().meta.setdefault(CLAIMED, []).append((folder, *globs))


def _refuse_spared(path: Path, *globs: str) -> None:
    from l3cli.files import refuse_spared

    for file in itertools.chain([path], *(path.glob(each) for each in globs)):
        refuse_spared(file)


def claim_file(path: Path, force: bool) -> None:
    """`hold_file`, and refuse an output that is there already."""
    from l3cli.files import refuse_existing

    hold_file(path)  # first: the run that holds it may be about to end
    refuse_existing(path, force)


def hold_file(path: Path) -> None:
    """Refuse before any work an output that is read, is no file, would pass for a recipe or cannot be written; keep
    other runs off it until the command ends."""
    from l3cli.files import refuse_existing, sole_writer_of_file

    if path.suffix == ".toml":
        raise RecipeError(f"{path}: .toml is for recipes; name an output that ends otherwise")
    _claim(path)
    refuse_existing(path, force=True)  # a folder or device
    refuse_unwritable(path)
    hold(sole_writer_of_file(path), path)


def claim_folder(path: Path, force: bool, *globs: str) -> None:
    """`hold_folder`, and refuse a folder that holds something."""
    from l3cli.files import refuse_filled_folder

    hold_folder(path, *globs)
    refuse_filled_folder(path, force)


def hold_folder(path: Path, *globs: str) -> None:
    """Refuse, before any work, a folder that is a file or cannot be written into, or where what is read is among the files
    that will be written, which the globs match; keep other runs off it until the command ends."""
    from l3cli.files import refuse_filled_folder, sole_writer_of_folder

    refuse_filled_folder(path, force=True)  # a file
    refuse_unwritable(path)
    _claim(path, *globs)
    hold(sole_writer_of_folder(path), path)


def hold(claim: AbstractContextManager[bool], output: Path) -> None:
    """Keep a claim on an output until the command ends."""
    if not click.get_current_context().with_resource(claim):
        tell(f"warning: {output} lies on storage without file locks: see that no other run writes it")


def refuse_unwritable(path: Path) -> None:
    """L3Error if `path` lies where nothing can be written."""
    whole = path.absolute()
    folder = whole if whole.is_dir() else next(parent for parent in whole.parents if parent.exists())
    if not folder.is_dir():
        raise L3Error(f"{folder} is a file, not a folder; name another output than {path}")
    if not os.access(folder, os.W_OK | os.X_OK):
        raise L3Error(f"{folder} cannot be written to; name an output in a folder of your own")


def say(message: str, quiet: bool) -> None:
    """One line of talk on stderr."""
    if not quiet:
        tell(message)


SIZES = ("COLUMNS", "LINES")  # environment variables that tell a terminal's size
DIGITS = re.compile(r"[0-9]{1,6}")  # of a size


def width() -> int | None:
    """Characters in a line of stdout, as its terminal or the environment variable COLUMNS tells; None: any number."""
    import shutil

    columns = os.environ.get("COLUMNS", "")
    if not sys.stdout.isatty() and not DIGITS.fullmatch(columns):
        return None
    return max(shutil.get_terminal_size().columns, 40)


def folded(line: str, deeper: int) -> list[str]:
    """A line of stdout as several, `deeper` characters further in from the second on, where the terminal is not as wide."""
    import textwrap

    wide = width()
    return textwrap.wrap(line, wide, subsequent_indent=" " * deeper, break_on_hyphens=False) if wide else [line]


# ------------------------------------------------------------------------------------------------------ progress

SELDOM, OFTEN = 600.0, 10.0  # seconds after which a log hears of the progress at the latest, and before which it does not


def progress(items: Iterable[T], total: int | None, what: str, quiet: bool) -> Iterator[T]:
    """Pass `items` on and tell rate and time left: as a bar on a terminal, elsewhere as plain lines, one every tenth."""
    if quiet:
        return iter(items)
    drawn = sys.stderr.isatty() and os.environ.get("TERM", "dumb") != "dumb"
    return (_with_bar if drawn else _with_lines)(items, total, what)


def _with_bar(items: Iterable[T], total: int | None, what: str) -> Iterator[T]:
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

    told = TextColumn("{task.fields[told]}")
    columns = (TextColumn(what), BarColumn(bar_width=16), MofNCompleteColumn(), told, TimeElapsedColumn())
    tells = {name: os.environ[name] for name in os.environ if name not in SIZES or DIGITS.fullmatch(os.environ[name])}
    with Progress(*columns, console=Console(stderr=True, _environ=tells), transient=True) as bar:
        task, start = bar.add_task(what, total=total, told=""), time.monotonic()
        for done, item in enumerate(items, 1):
            yield item
            bar.update(task, advance=1, told=_pace(done, total, time.monotonic() - start))


def _with_lines(items: Iterable[T], total: int | None, what: str) -> Iterator[T]:
    start = last = time.monotonic()
    tenth = 0
    for done, item in enumerate(items, 1):
        yield item
        now = time.monotonic()
        reached = 10 * done // total if total else 0
        if done != total and ((reached > tenth and now - last >= OFTEN) or now - last >= SELDOM):
            of = f" of {total}" if total else ""
            tell(f"{what}: {done}{of}, {_pace(done, total, now - start)}")
            last, tenth = now, reached


def _pace(done: int, total: int | None, seconds: float) -> str:
    """How fast it goes, and how long it will go on."""
    each = max(seconds, 1e-9) / done
    rate = f"{1 / each:.3g} a second" if each < 2 else f"{_span(each)} each"
    return rate if total is None else f"{rate}, {_span(max(total - done, 0) * each)} left"


def _span(seconds: float) -> str:
    """A length of time in its two largest units."""
    seconds = round(seconds)
    for unit, name, part, smaller in ((86400, "d", 3600, "h"), (3600, "h", 60, "min"), (60, "min", 1, "s")):
        if seconds >= unit:
            return f"{seconds // unit} {name} {seconds % unit // part} {smaller}"
    return f"{seconds} s"
