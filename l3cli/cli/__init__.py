"""The command line: a group that imports a command only when it is asked for, and the one door for errors."""

import importlib
import os
import signal
import sys
from typing import Any

import click

from l3cli import __version__
from l3cli.errors import L3Error

COMMANDS = {
    "calibrate": "lab measurements → camera model",
    "simulate": "camera × scenes × lights → training set",
    "train": "training set → transform table",
    "render": "raw frames through a table → pictures",
    "evaluate": "quality of a table on frames it was not trained on",
    "report": "artifacts → one page with plots and pictures",
    "compare": "evaluations of several cameras over the light on the scene",
    "info": "kind, version, axes, units, history of an artifact",
    "bench": "frames per second here, stage by stage",
    "lab": "a virtual lab: the measurements a camera would give",
    "init": "a folder of recipes and pipelines for one kind of camera",
}


class Pipeline(click.Group):
    """Commands in the order of the pipeline, each in its own module."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        return list(COMMANDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        if cmd_name not in COMMANDS:
            return None
        return getattr(importlib.import_module(f"l3cli.cli.{cmd_name}"), cmd_name)

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        with formatter.section("Commands"):
            formatter.write_dl(list(COMMANDS.items()))


@click.group(cls=Pipeline, context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100})
@click.version_option(__version__, prog_name="l3")
def l3() -> None:
    """Give a camera with any colour filter array its image pipeline.

    Measure the camera (calibrate), simulate it on scenes (simulate), learn a table of local linear transforms (train),
    render raw frames through it (render). Every stage leaves one HDF5 file for the next.
    """


class Terminated(BaseException):
    """SIGTERM has come: a scheduler or a user ends the program, which cleans up as after Ctrl-C."""


def main() -> None:
    """Run the command line; every failure ends as one line on stderr and the exit code of README, "Exit codes"."""
    signal.signal(signal.SIGTERM, _terminate)
    sys.exit(run(sys.argv[1:]))


def run(arguments: list[str]) -> int:
    """Exit code of `l3 ARGUMENTS`, after printing what there is to print."""
    try:
        result: Any = l3.main(arguments, prog_name="l3", standalone_mode=False)
        return result if isinstance(result, int) else 0
    except click.exceptions.Exit as stop:
        return stop.exit_code
    except click.ClickException as error:
        hint = ""
        if isinstance(error, click.UsageError) and error.ctx is not None:
            hint = f'; see "{error.ctx.command_path} --help"'
        return _fail(f"{error.format_message().rstrip('.')}{hint}", 2)
    except L3Error as error:
        return _fail(str(error), error.exit_code)
    except BrokenPipeError:
        # Whoever read our output has gone: nothing is left to say, and Python must not try to flush it at exit.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 1
    except (KeyboardInterrupt, click.Abort):
        return _fail("interrupted", 130)
    except Terminated:
        return _fail("terminated", 143)
    except MemoryError:
        return _fail("out of memory; use fewer --jobs or smaller frames", 1)
    except OSError as error:
        return _fail(f"{error.filename or 'input/output'}: {error.strerror or error}", 1)


def _terminate(number: int, frame: object) -> None:
    signal.signal(number, signal.SIG_IGN)  # once is enough: nothing must disturb the cleaning up
    raise Terminated


def _fail(message: str, code: int) -> int:
    line = "".join(letter if letter.isprintable() else "?" for letter in " ".join(message.split()))
    click.echo(f"l3: {line}", err=True)
    return code
