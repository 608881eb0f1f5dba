"""Transform table → files that run, or are read, elsewhere: C source, plain arrays, or an ONNX graph."""

from dataclasses import replace
from pathlib import Path
from typing import Literal

from l3cli.artifacts.store import load
from l3cli.artifacts.table import TransformTable
from l3cli.errors import RecipeError
from l3cli.files import write_whole
from l3cli.rendering.lights import mix_for, mixed
from l3cli.rendering.portable.folder import folder_files
from l3cli.rendering.portable.onnx_model import onnx_files
from l3cli.rendering.portable.source import Words, c_files
from l3cli.stages.claims import Claims
from l3cli.stages.console import Console
from l3cli.stages.plan import Made, before_work
from l3cli.stages.rendering.lights import mix_of_given

Form = Literal["c", "folder", "onnx"]
SetName = Literal["usual", "quiet"]
QUIET_README = """
## The quiet set

These are the quiet transforms of a table of two sets, for pixels of which a filter in time has left at most {limit:.3g} of
the variance of noise that varies from frame to frame; they were learned for {noise_left:.3g} of it. Other pixels are
rendered by the usual set, which is exported alone, with test files of its own.
"""


def export_table(
    table: Path,
    output: Path,
    form: Form,
    console: Console,
    *,
    words: Words | None = None,
    white: str | None = None,
    which: SetName | None = None,
    force: bool = False,
) -> list[str]:
    """Write a transform table into a folder in one of the forms, C source with outputs in `words` (without: float32); the
    names of the files. `white`: name or "x,y" of that which transforms of several lights are mixed for; `which` of two sets
    C source or a graph holds (without: the usual one). InputFileError if it is no table or beyond the form, RecipeError if
    words or a set are given for another form, there is no such white or set or onnx is not installed, L3Error if a file
    cannot be written."""
    if words and form != "c":
        raise RecipeError("‹words› is for C source; leave it out")
    if which and form == "folder":
        raise RecipeError("a folder of arrays holds both sets; leave ‹set› out")
    with Claims(console) as claims:
        claims.spare(table)
        claims.hold_folder(output)
        transforms = load(TransformTable, table)
        if white is not None and not transforms.lights:
            raise RecipeError(f"{table} has transforms of no single lights to be mixed for a ‹white›; leave it out")
        transforms = mixed(transforms, mix_of_given(white, transforms, mix_for, console))
        quiet = transforms.quiet
        if which == "quiet" and quiet is None:
            raise RecipeError(f"{table} has one set of transforms; leave ‹set› out, or train with noise_left")
        if quiet and form != "folder" and which is None:
            console.alert(
                f"{table}: the usual set of transforms is written, ‹set› quiet writes that for frames filtered in time"
            )
        if quiet and which == "quiet":
            transforms = replace(transforms, first=quiet.first, later=quiet.later, quiet=None)
        files = _files(transforms, form, words or "float32")
        if quiet and which == "quiet":
            files["README.md"] += QUIET_README.format(limit=quiet.limit, noise_left=quiet.noise_left).encode()
        for name in files:
            claims.claim_file(output / name, force)
        before_work({"table": [table]}, *(Made(output / name, "export", len(content)) for name, content in files.items()))
        for name, content in files.items():
            write_whole(output / name, content)
        console.say(f"{output}: {', '.join(files)} written")
        return list(files)


def _files(table: TransformTable, form: Form, words: Words) -> dict[str, bytes]:
    if form == "c":
        return c_files(table, words)
    return folder_files(table) if form == "folder" else onnx_files(table)
