"""Command-line interface of l3. Each command is imported only when it is run, and all errors are reported here."""

import errno
import importlib
import sys
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import click

from l3cli import __version__
from l3cli.cli.results import Record, Result, begin
from l3cli.cli.terminal import drop, prepare, to_stderr
from l3cli.errors import L3Error, suggestion
from l3cli.parallel import one_blas_thread
from l3cli.system import signals
from l3cli.system.limits import require_address_space, require_settings, without_plots
from l3cli.system.signals import Terminated, heed, leave_to_python

if TYPE_CHECKING:
    from click.shell_completion import CompletionItem

COMMANDS = {
    "calibrate": "estimate a camera model from lab measurements or photos",
    "simulate": "simulate a training set for a camera",
    "train": "train a transform table on training sets",
    "render": "render raw frames to pictures with a table",
    "evaluate": "evaluate a table on unseen frames",
    "report": "show artifacts on one page with plots and pictures",
    "compare": "compare evaluations of several cameras at each luminance",
    "design": "rank colour filter arrays by their predicted error",
    "info": "show the contents and the history of an artifact",
    "export": "convert a camera or table to C source or files for other software",
    "bench": "measure the time per frame on this machine",
    "check": "check recipes and explain what they mean",
    "schema": "print the JSON schema of recipes, for editors",
    "lab": "simulate lab measurements of a camera",
    "init": "create a folder with recipes and a Makefile for a camera",
}

ADVICE = {
    errno.ENOSPC: "; free some space and run the command again",
    errno.EACCES: "; change the permissions, or specify a different file",
    errno.EROFS: "; specify an output on a different file system",
    errno.ENOTDIR: "; a part of the path is a file; correct the path",
}
NO_THREAD = "can't start new thread"  # message of Python's RuntimeError if no thread can be started


class Pipeline(click.Group):
    """The group of all commands, in pipeline order. The module of a command is imported on demand."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        return list(COMMANDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        if cmd_name not in COMMANDS:
            return None
        return getattr(importlib.import_module(f"l3cli.cli.{cmd_name}"), cmd_name)

    def resolve_command(self, ctx: click.Context, args: list[str]) -> tuple[str | None, click.Command | None, list[str]]:
        if args[0] not in COMMANDS and not args[0].startswith("-") and not ctx.resilient_parsing:
            raise click.UsageError(f'no command "{args[0]}"; {suggestion(args[0], COMMANDS)}', ctx)
        return super().resolve_command(ctx, args)

    def invoke(self, ctx: click.Context) -> Any:
        try:
            return super().invoke(ctx)
        except Terminated as stop:
            raise click.Abort from stop  # click prints a line break after KeyboardInterrupt (^C), but not after Abort

    def shell_complete(self, ctx: click.Context, incomplete: str) -> list["CompletionItem"]:
        """Complete the name of a command without importing any command."""
        from click.shell_completion import CompletionItem

        commands = [CompletionItem(name, help=what) for name, what in COMMANDS.items() if name.startswith(incomplete)]
        return commands + click.Command.shell_complete(self, ctx, incomplete)

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        with formatter.section("Commands"):
            formatter.write_dl(list(COMMANDS.items()))


@click.group(
    cls=Pipeline,
    invoke_without_command=True,
    subcommand_metavar="COMMAND [ARGS]...",
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100},
)
@click.version_option(__version__, prog_name="l3")
@click.pass_context
def l3(context: click.Context) -> None:
    """Build the image-processing pipeline of a camera with any colour filter array.

    Calibrate a camera from measurements (calibrate), simulate it on scenes (simulate), train a table of local linear
    transforms (train) and render raw frames with the table (render). Each stage writes one HDF5 file for the next.
    """
    require_address_space()
    # `l3` without a command is an error, because in a script, an empty variable is the usual cause.
    if context.invoked_subcommand is None:
        for line in context.get_help().splitlines():
            to_stderr(line)
        context.exit(2)
    require_settings()


def main() -> None:
    """Run the command line. An error prints one line on stderr and sets the exit code (docs/guarantees.md#exit-codes)."""
    prepare()
    heed()
    one_blas_thread()
    without_plots()
    code = run(sys.argv[1:])
    leave_to_python()
    sys.exit(code)


def run(arguments: list[str]) -> int:
    """Run l3 with these command-line arguments, and return the exit code."""
    record, results = begin(arguments), list[Result]()
    code = _guarded(lambda: _called(arguments, record, results), record)
    if not record.as_json or not (results or record.error):  # without result or error, the command only printed its help
        return code
    shown = _guarded(lambda: record.show(next(iter(results), None), code), record)
    return code or shown


def _called(arguments: list[str], record: Record, results: list[Result]) -> int:
    """Run the command, and return its exit code.

    The command's result is appended to `results`. Unless --json is set, it is also printed as text.
    """
    try:
        result: Any = l3.main(arguments, prog_name="l3", standalone_mode=False, obj=record)
    except Exception as error:
        if (stop := signals.behind(error)) is not None:
            raise stop from None
        raise
    if not isinstance(result, Result):
        return result if isinstance(result, int) else 0
    results.append(result)
    if result.text and not record.as_json:
        result.text()
    sys.stdout.flush()
    if result.fault:
        raise result.fault
    return result.code


def _guarded(work: Callable[[], int | None], record: Record) -> int:
    """Run `work`, and return its exit code. Errors are printed to stderr and recorded."""

    def fail(message: str, code: int) -> int:
        line = " ".join(message.split())
        to_stderr(f"l3: {line}")
        record.fail(line, code)
        return code

    try:
        code = work()
        sys.stdout.flush()
        return code or 0
    except click.exceptions.Exit as stop:
        return stop.exit_code
    except click.ClickException as error:
        return fail(_usage(error), 2)
    except L3Error as error:
        return fail(str(error), error.exit_code)
    except BrokenPipeError:
        drop(sys.stdout)  # the program at the other end of the pipe has ended
        return 1
    except Terminated:
        signals.ignore()
        return fail("terminated", 143)
    except (KeyboardInterrupt, click.Abort):
        signals.ignore()
        return fail("interrupted", 130)
    except MemoryError:
        return fail("out of memory; use smaller frames, or fewer --jobs if the command has this option", 1)
    except ImportError as error:
        return fail(f"l3 cannot load a library: {error}; free some memory, or reinstall l3cli", 1)
    except RuntimeError as error:
        if str(error) != NO_THREAD:
            raise
        return fail(
            "out of memory or threads; increase the limits (ulimit -v, ulimit -u), or use fewer --jobs if the command "
            "has this option",
            1,
        )
    except OSError as error:
        if error.filename is None:
            drop(sys.stdout)
        advice = ADVICE.get(error.errno or 0, "")
        return fail(f"{error.filename or 'input/output'}: {error.strerror or error}{advice}", 1)


def _usage(error: click.ClickException) -> str:
    """Return the message of a usage error, with a pointer to the command's --help."""
    message = error.format_message().rstrip(".")
    if isinstance(error, click.NoSuchOption):
        similar = [name for name in error.possibilities or () if name.startswith("--")]
        message = f"no option {error.option_name}" + (f"; {suggestion(error.option_name, similar)}" if similar else "")
    if isinstance(error, click.BadParameter) and error.param is not None and isinstance(error.param.type, click.Choice):
        # click's message is "Invalid value for '--codec': 'h256' is not 'h264'" or "… is not one of …".
        message = message.partition(" is not ")[0]
        known = map(str, error.param.type.choices)
        message += f"; {suggestion(message.rpartition(': ')[2][1:-1], known)}"
    if not isinstance(error, click.UsageError) or error.ctx is None:
        return message
    return f'{message}{"" if message.endswith("?") else ";"} see "{error.ctx.command_path} --help"'
