"""l3 init: a folder with the recipes of one kind of camera and the pipelines that make pictures of them."""

import itertools
import re
import textwrap
import tomllib
from pathlib import Path
from typing import TYPE_CHECKING

import click

from l3cli.cli import options, terminal
from l3cli.cli.terminal import show
from l3cli.errors import suggestion
from l3cli.recipes import known_recipes, recipe_folder

if TYPE_CHECKING:
    from l3cli.stages.console import Console

# What a folder of recipes holds beside its camera.toml: name there ← name in configs/.
COMMON = {
    "lab.toml": "lab/default.toml",
    "scenes.toml": "scenes/default.toml",
    "bands_scenes.toml": "scenes/bands.toml",
    "unseen.toml": "scenes/demo_unseen.toml",
    "classes.toml": "classes/default.toml",
    "Makefile": "pipelines/Makefile",
    "Snakefile": "pipelines/Snakefile",
    "slurm.sh": "pipelines/slurm.sh",
}


def _completed(context: click.Context, parameter: click.Parameter, incomplete: str) -> list[str]:
    """Names of recipes for the shell."""
    return [name for name in known_recipes("cameras") if name.startswith(incomplete)]


@click.command()
@click.argument("recipe", required=False, metavar="[RECIPE]", shell_complete=_completed)
@click.argument("folder", type=options.FILE, required=False, metavar="[DIR]")
@options.force
@options.quiet
def init(recipe: str | None, folder: Path | None, force: bool, console: "Console") -> None:
    """Make DIR with the recipes of one kind of camera and a Makefile that leads from them to a picture and a report. Beside
    it lie the same pipeline for Snakemake and for job arrays of Slurm.

    Without arguments, list the recipes.

    \b
    Example: l3 init bayer demo && make -C demo
    """
    known = known_recipes("cameras")
    if recipe is None:
        wide = max(map(len, known))
        for name, path in known.items():
            show(*terminal.folded(f"{name:{wide}}  {summary(path)}", wide + 2))
        console.say('next: one of them and a new folder, such as "l3 init bayer demo"')
        return
    if recipe not in known:
        raise click.UsageError(f'no recipe "{recipe}"; {suggestion(recipe, known)}')
    if folder is None:
        raise click.UsageError(f'name the folder to make, such as "l3 init {recipe} {recipe}"')
    origins = folder_files(known[recipe])
    claims = options.claims(console)
    claims.spare(*origins.values())
    claims.claim_folder(folder, force, *origins)
    write_folder(origins, folder)
    console.say(f"{folder}: {summary(known[recipe])}; next: make -C {folder}")


def summary(path: Path) -> str:
    """One line on a camera recipe: the period of its array, its channels, the first sentence of the file's first comment."""
    text = path.read_text(encoding="utf-8")
    cfa = tomllib.loads((_base(path) or path).read_text(encoding="utf-8"))["cfa"]
    comment = " ".join(
        line.lstrip("# ") for line in itertools.takewhile(lambda line: line.startswith("#"), text.splitlines())
    )
    sentence = textwrap.shorten(re.split(r"[:;] |[.] (?=[A-Z])", comment)[0].rstrip("."), 84, placeholder=" …")
    period = f"{len(cfa['pattern'])}×{len(cfa['pattern'][0].split())}"
    return f"{period}, {len(cfa['channels']):2} channels  {sentence}"


def folder_files(camera: Path) -> dict[str, Path]:
    """What the recipe folder of a camera recipe holds, by name: the files it is copied from."""
    base = _base(camera)
    files = {name: recipe_folder() / source for name, source in COMMON.items()} | {"camera.toml": camera}
    return files | ({} if base is None else {base.name: base})


def _base(camera: Path) -> Path | None:
    """The camera recipe that this one builds on, beside it."""
    named = tomllib.loads(camera.read_text(encoding="utf-8")).get("base")
    return None if named is None else camera.parent / named


def write_folder(origins: dict[str, Path], folder: Path) -> None:
    """A recipe folder, each file whole or not at all."""
    from l3cli.files import atomic_output

    for name, origin in origins.items():
        with atomic_output(folder / name) as temporary:
            temporary.write_bytes(origin.read_bytes())
            temporary.chmod(0o755 if origin.suffix == ".sh" else 0o644)
