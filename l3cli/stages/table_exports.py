"""Transform table → files that run, or are read, elsewhere: C source or plain arrays."""

from dataclasses import replace
from pathlib import Path

from l3cli.artifacts.store import load
from l3cli.artifacts.table import TransformTable
from l3cli.errors import RecipeError
from l3cli.export.folder import folder_files
from l3cli.export.source import PREFIX, c_files
from l3cli.options.tools import ExportOptions
from l3cli.physics.display import XYZ
from l3cli.rendering.white.lights import mix_for, mixed
from l3cli.rendering.white.source import given_white
from l3cli.stages.claims import OutputGuard
from l3cli.stages.input_warnings import warn_of_white
from l3cli.stages.plan import Made, before_work
from l3cli.stages.rendering.lights import mix_of_given
from l3cli.system.files import write_whole

QUIET_README = """
## The quiet set

These are the quiet transforms of a table of two sets, for pixels of which a filter in time has left at most {limit:.3g} of
the variance of noise that varies from frame to frame; they were learned for {noise_left:.3g} of it. Other pixels are
rendered by the usual set, which is exported alone, with test files of its own.
"""


def export_table(table: Path, output: Path, options: ExportOptions) -> list[str]:
    """Write a transform table into a folder, as C source unless the options say otherwise; return the names of the files.
    InputFileError if it is no table or beyond the form, RecipeError if words, a set or a prefix are given for another form
    or there is no such white, set or prefix, L3Error if a file cannot be written."""
    form, words, prefix, which = options.form or "c", options.words, options.prefix, options.which
    white, console = options.white, options.console
    if form != "c" and (words or prefix is not None):
        raise RecipeError(f"‹{'words' if words else 'prefix'}› is for C source; leave it out")
    if which and form == "folder":
        raise RecipeError("a folder of arrays holds both sets; leave ‹set› out")
    with OutputGuard(console) as claims:
        claims.protect(table)
        claims.hold_folder(output)
        transforms = load(TransformTable, table)
        if white is not None and not transforms.lights and (form != "c" or transforms.outputs != XYZ):
            raise RecipeError(f"{table} has transforms of no single lights to be mixed for a ‹white›; leave it out")
        transforms = mixed(transforms, mix_of_given(white, transforms, mix_for, console))
        shown = given_white(white, transforms)
        quiet = transforms.quiet
        if which == "quiet" and quiet is None:
            raise RecipeError(f"{table} has one set of transforms; leave ‹set› out, or train with noise_left")
        if quiet and form != "folder" and which is None:
            console.report(
                f"{table}: the usual set of transforms is written, ‹set› quiet writes that for frames filtered in time"
            )
        if quiet and which == "quiet":
            transforms = replace(transforms, first=quiet.first, later=quiet.later, quiet=None)
        balance = shown.balance if shown else None
        if white and shown and form == "c":
            warn_of_white(white, shown, transforms, console)
        files = (
            c_files(transforms, words or "float32", balance, PREFIX if prefix is None else prefix)
            if form == "c"
            else folder_files(transforms)
        )
        if quiet and which == "quiet":
            files["README.md"] += QUIET_README.format(limit=quiet.limit, noise_left=quiet.noise_left).encode()
        for name in files:
            claims.claim_file(output / name, options.force)
        before_work({"table": [table]}, *(Made(output / name, "export", len(content)) for name, content in files.items()))
        for name, content in files.items():
            write_whole(output / name, content)
        console.info(f"{output}: {', '.join(files)} written")
        return list(files)
