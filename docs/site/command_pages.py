"""Generate the command reference from the click declarations of the commands."""

import inspect

import click
from markup import code, page, plain, table

from l3cli.cli import COMMANDS, l3
from l3cli.errors import DeviceError, InputFileError, L3Error, RecipeError

CODES = {
    "0": "The command succeeded.",
    **{str(error.exit_code): inspect.getdoc(error) or "" for error in (L3Error, RecipeError, InputFileError, DeviceError)},
    "130": "You interrupted the command (Ctrl-C).",
    "143": "The command was terminated (SIGTERM).",
}


def command_pages() -> dict[str, str]:
    codes = table(["code", "meaning"], ([number, plain(meaning)] for number, meaning in CODES.items()))
    intro = (
        "This page is for looking up options. It contains the `--help` text of every command. "
        "[Commands and recipes](../commands.md) says which files each command reads and writes."
    )
    return {"commands.md": page("# Command reference", intro, *map(section, COMMANDS), "## Exit codes", codes, EXIT)}


EXIT = "[Exit codes and guarantees](../guarantees.md) explains the exit codes."


def section(name: str) -> str:
    command = l3.get_command(click.Context(l3, info_name="l3"), name)
    assert command is not None
    context = click.Context(command, info_name=f"l3 {name}")
    usage = f"```none\n{context.command_path} {' '.join(command.collect_usage_pieces(context))}\n```"
    options = [option for option in command.params if isinstance(option, click.Option) and not option.hidden]
    rows = [row(option, context) for option in options]
    return page(f"## l3 {name}", usage, *paragraphs(command.help or ""), table(["option", "meaning"], rows)).rstrip()


def paragraphs(text: str) -> list[str]:
    """Return the paragraphs of a help text. A paragraph marked with \\b, in which click keeps the lines, becomes code."""
    parts = inspect.cleandoc(text).split("\n\n")
    return ["```none\n" + part[2:] + "\n```" if part.startswith("\b\n") else plain(part) for part in parts]


def row(option: click.Option, context: click.Context) -> tuple[str, str]:
    names = ", ".join(option.opts) + "".join(f" / {name}" for name in option.secondary_opts)
    value = "" if option.is_flag or option.count else f" {option.make_metavar(context)}"
    meaning = plain(option.help or "")
    if isinstance(option.default, str | int | float) and option.default is not False and "default" not in meaning:
        meaning += f" [default: {option.default}]"
    return code(names + value), meaning + (" Required." if option.required else "")
