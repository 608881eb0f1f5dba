"""Transform table → files that run, or are read, elsewhere: C source, plain arrays, or an ONNX graph."""

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
FORMS = {"c": "C source renders", "onnx": "an ONNX graph renders"}


def export_table(
    table: Path,
    output: Path,
    form: Form,
    console: Console,
    *,
    words: Words | None = None,
    white: str | None = None,
    force: bool = False,
) -> list[str]:
    """Write a transform table into a folder in one of the forms, C source with outputs in `words` (without: float32); the
    names of the files. `white`: name or "x,y" of that which transforms of several lights are mixed for. InputFileError if it
    is no table or beyond the form, RecipeError if words are given for another form, there is no such white or onnx is not
    installed, L3Error if a file cannot be written."""
    if words and form != "c":
        raise RecipeError("‹words› is for C source; leave it out")
    with Claims(console) as claims:
        claims.spare(table)
        claims.hold_folder(output)
        transforms = load(TransformTable, table)
        if white is not None and not transforms.lights:
            raise RecipeError(f"{table} has transforms of no single lights to be mixed for a ‹white›; leave it out")
        transforms = mixed(transforms, mix_of_given(white, transforms, mix_for, console))
        if transforms.quiet and form != "folder":
            console.alert(
                f"{table}: {FORMS[form]} frames one by one, so the table's second set, for frames filtered in time, "
                "is left out; ‹to› folder has it"
            )
        files = _files(transforms, form, words or "float32")
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
