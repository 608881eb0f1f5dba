"""Create click options from the declarations in l3cli/options, and define the options that all commands share."""

import functools
import os
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click

from l3cli.cli.results import JSON, Record, Recorded
from l3cli.cli.terminal import ErrorsOnly, Terminal, with_options
from l3cli.options.option import Choice, Declaration, File, Flag, Options, Reader, Recipe, Text, declarations
from l3cli.system import limits
from l3cli.system.console import Console, Logged

if TYPE_CHECKING:
    from click.shell_completion import CompletionItem

F = TypeVar("F", bound=Callable[..., Any])

FILE = click.Path(path_type=Path, readable=False)  # l3 checks files itself, because its messages are clearer than click's


class RecipeFile(click.Path):
    """Parameter type for a recipe: a path, or the name of a recipe in the folder configs/`kind`."""

    def __init__(self, kind: str) -> None:
        super().__init__(path_type=Path, readable=False)
        self.kind = kind

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Path:
        return Recipe(self.kind).read(value)

    def shell_complete(self, ctx: click.Context, param: click.Parameter, incomplete: str) -> list["CompletionItem"]:
        """Complete recipe names and file names. Bash adds file names itself only if a program returns no completions."""
        from click.shell_completion import CompletionItem

        from l3cli.recipes.builtin import known_recipes

        names = [name for name in known_recipes(self.kind) if name.startswith(incomplete)]
        if not names:
            return super().shell_complete(ctx, param, incomplete)
        visible = (each for each in os.scandir() if each.name.startswith(incomplete) and not each.name.startswith("."))
        files = [each.name + "/" * each.is_dir() for each in visible]
        return [CompletionItem(each) for each in (*names, *sorted(files))]


CAMERA = RecipeFile("cameras")


class Value(click.ParamType):
    """Parameter type for a value that a `Reader` parses."""

    name = "value"

    def __init__(self, reader: Reader) -> None:
        self._reader = reader

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        try:
            return self._reader.read(value)
        except ValueError as error:
            self.fail(str(error), param, ctx)


class Word(click.Choice):
    """Parameter type for one of the values of a `Choice`."""

    def __init__(self, reader: Choice) -> None:
        super().__init__(list(map(str, reader.values)))
        self._reader = reader

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        return self._reader.read(super().convert(str(value), param, ctx))


def _type(reader: Reader) -> click.ParamType | None:
    if isinstance(reader, Recipe):
        return RecipeFile(reader.kind)
    if isinstance(reader, File):
        return FILE
    if isinstance(reader, Choice):
        return Word(reader)
    return None if isinstance(reader, Flag) else click.STRING if isinstance(reader, Text) else Value(reader)


def _option(name: str, declared: Declaration) -> Callable[[F], F]:
    """Return a decorator that adds a declared option to a command."""
    default = declared.default
    return click.option(
        f"--{declared.flag or name.replace('_', '-')}",
        name,
        type=_type(declared.reader),
        is_flag=isinstance(declared.reader, Flag),
        default=default,
        multiple=declared.several,
        show_default=default is not None and default is not False and default != (),
        metavar=declared.metavar,
        help=with_options(declared.help),
    )


def of(options: type[Options], *modes: Callable[[Any], Any]) -> Callable[[F], F]:
    """Return a decorator that adds --quiet, --log, --json and the options declared in a class to a command.

    Parameters
    ----------
    options : type
        Class that declares the options. The command receives an instance of this class, with all values and the console, in
        its parameter `options`.
    *modes : callable
        Additional click decorators. The command receives their values as separate keyword arguments.
    """
    declared = declarations(options)

    def decorated(command: Callable[..., Any]) -> Any:
        @functools.wraps(command)
        def called(**given: Any) -> Any:
            chosen = {name: given.pop(name) for name in [*declared, "console"]}
            return command(**given, options=options(**chosen))

        decorators = [*(_option(name, each) for name, each in declared.items()), *modes, _LOG, _QUIET, _JSON]
        return functools.reduce(lambda made, each: each(made), reversed(decorators), called)

    return decorated


def output(what: str, required: bool = True, metavar: str = "FILE") -> Callable[[F], F]:
    """Return a decorator that adds the option -o/--output to a command. `what` is its help text without a full stop."""
    return click.option("-o", "--output", type=FILE, required=required, metavar=metavar, help=f"{what}.")


LOG = "l3cli.log"  # key of the --log path in `click.Context.meta`


def _log(context: click.Context, parameter: click.Parameter, path: Path | None) -> None:
    context.meta[LOG] = path


def _console(context: click.Context, parameter: click.Parameter, quiet: bool) -> Console:
    record = context.ensure_object(Record)
    console: Console = ErrorsOnly() if quiet else Terminal()
    if context.meta[LOG] is not None:
        console = record.log = Logged(console, context.meta[LOG], context.info_name or "l3", with_options)
    return Recorded(console, record)


_QUIET = click.option(
    "--quiet", "console", is_flag=True, callback=_console, help="Print only errors on stderr.",
)  # fmt: skip
_LOG = click.option(
    "--log", type=FILE, metavar="FILE", is_eager=True, expose_value=False, callback=_log,
    help="Also append all messages, with time, level and command, to FILE.",
)  # fmt: skip
_JSON = click.option(  # only for --help: `results.begin` has already searched the arguments for --json
    JSON, "as_json", is_flag=True, expose_value=False,
    help="Print results, warnings, times and file digests as one JSON object on stdout.",
)  # fmt: skip


def _trust(context: click.Context, parameter: click.Parameter, wanted: bool) -> None:
    if wanted:
        context.with_resource(limits.trust())


trust = click.option(
    "--trust", is_flag=True, expose_value=False, callback=_trust,
    help="Decode raw, image, MATLAB and video files in this process instead of in an isolated process with limits.",
)  # fmt: skip
