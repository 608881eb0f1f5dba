"""Options of the command line, made of their declarations (l3cli/options); those of how a command speaks and runs."""

import functools
import importlib
import os
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click

from l3cli.cli.results import JSON, recorded
from l3cli.cli.terminal import ErrorsOnly, Terminal, with_options
from l3cli.options.option import Choice, Declaration, File, Flag, Options, Reader, Recipe, Text, declarations

if TYPE_CHECKING:
    from click.shell_completion import CompletionItem

    from l3cli.system.console import Console

F = TypeVar("F", bound=Callable[..., Any])

FILE = click.Path(path_type=Path, readable=False)  # the reader checks it, with a message and an exit code that fit


class RecipeFile(click.Path):
    """A recipe: a file, or the name of one of the `kind` (a folder of configs/) that come with l3."""

    def __init__(self, kind: str) -> None:
        super().__init__(path_type=Path, readable=False)
        self.kind = kind

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Path:
        return Recipe(self.kind).read(value)

    def shell_complete(self, ctx: click.Context, param: click.Parameter, incomplete: str) -> list["CompletionItem"]:
        """Return names and, beside them, files: bash completes no files where anything else is offered."""
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
    """A value that the reader of an option takes."""

    name = "value"

    def __init__(self, reader: Reader) -> None:
        self._reader = reader

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        try:
            return self._reader.read(value)
        except ValueError as error:
            self.fail(str(error), param, ctx)


class Word(click.Choice):
    """One of the words of a choice."""

    def __init__(self, reader: Choice) -> None:
        super().__init__(list(map(str, reader.values)))
        self._reader = reader

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        word = str(value)
        return self._reader.read(word if word in self._reader.gone else super().convert(word, param, ctx))


def _type(reader: Reader) -> click.ParamType | None:
    if isinstance(reader, Recipe):
        return RecipeFile(reader.kind)
    if isinstance(reader, File):
        return FILE
    if isinstance(reader, Choice):
        return Word(reader)
    return None if isinstance(reader, Flag) else click.STRING if isinstance(reader, Text) else Value(reader)


def _option(name: str, declared: Declaration) -> Callable[[F], F]:
    """Return click's option for a declared one."""
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
    """Add all options of a command as its parameter `options`: the declared ones, `modes`, and how the command speaks
    (--quiet, --log FILE, --json)."""
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
    """Add -o/--output FILE."""
    return click.option("-o", "--output", type=FILE, required=required, metavar=metavar, help=f"{what}.")


LOG = "l3cli.log"  # in a context's meta: the path of --log


def _log(context: click.Context, parameter: click.Parameter, path: Path | None) -> None:
    context.meta[LOG] = path


def _console(context: click.Context, parameter: click.Parameter, quiet: bool) -> "Console":
    console: Console = ErrorsOnly() if quiet else Terminal()
    if context.meta[LOG] is not None:
        from l3cli.system.console import Logged

        console = Logged(console, context.meta[LOG], context.info_name or "l3", with_options)
    return recorded(console)


_QUIET = click.option(
    "--quiet", "console", is_flag=True, callback=_console, help="Print no messages on stderr but errors.",
)  # fmt: skip
_LOG = click.option(
    "--log", type=FILE, metavar="FILE", is_eager=True, expose_value=False, callback=_log,
    help="Also append all messages to FILE, with time, level and command.",
)  # fmt: skip
_JSON = click.option(  # results.begin has seen it already
    JSON, "as_json", is_flag=True, expose_value=False,
    help="Print results, warnings, times and digests as one JSON object on stdout.",
)  # fmt: skip


def _mode(name: str, module: str, what: str) -> Callable[[F], F]:
    """Add a flag under which the whole command runs within the block that `module` has of its name."""

    def enter(context: click.Context, parameter: click.Parameter, wanted: bool) -> None:
        if wanted:
            context.with_resource(getattr(importlib.import_module(module), name)())

    return click.option(f"--{name.replace('_', '-')}", is_flag=True, expose_value=False, callback=enter, help=what)


trust = _mode(
    "trust", "l3cli.system.limits",
    "Decode raw, image, MATLAB and video files in this process, not in an isolated one with limits.",
)  # fmt: skip
dry_run = _mode(
    "dry_run", "l3cli.system.outputs",
    "Check everything that is checked before work, say what would be read and made, and write nothing.",
)  # fmt: skip
