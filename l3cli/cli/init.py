"""l3 init: creates a folder with recipes and a Makefile, for a camera or for a benchmark."""

from pathlib import Path

import click

from l3cli.cli import options as declared
from l3cli.cli import terminal
from l3cli.cli.results import Result
from l3cli.cli.terminal import show
from l3cli.errors import suggestion
from l3cli.options.commands import InitOptions


def _completed(context: click.Context, parameter: click.Parameter, incomplete: str) -> list[str]:
    """Complete the name of a recipe or camera in the shell."""
    from l3cli.recipes.builtin import cameras_by_name, starters

    return [name for name in (*starters(), *cameras_by_name()) if name.startswith(incomplete)]


@click.command()
@click.argument("recipe", required=False, metavar="[RECIPE]", shell_complete=_completed)
@click.argument("folder", type=declared.FILE, required=False, metavar="[DIR]")
@click.argument("more", nargs=-1, metavar="")
@declared.of(InitOptions)
def init(recipe: str | None, folder: Path | None, more: tuple[str, ...], options: InitOptions) -> Result:
    """Create the folder DIR with recipes for a camera, and with a Makefile that runs the pipeline and renders a picture and
    a report. DIR also contains this pipeline for Snakemake and for Slurm job arrays.

    RECIPE is the name of a camera type or a benchmark, the name of a camera whose measured curves come with l3 (--list), or
    your own camera recipe (.toml), which is copied together with its curves. The Makefile of a benchmark trains on one
    folder of your pictures, and evaluates on a second folder.

    With --from, l3 derives the camera recipe from raw files. If the files come from several cameras, l3 creates a folder in
    DIR for each camera. If --from specifies a design ("l3 design"), the recipe describes the best array of the design.

    Without arguments, list the recipes.

    \b
    Example: l3 init bayer demo && make -C demo
             l3 init nikon_d810 mine && make -C mine PHOTO=$PWD/photo.nef
             l3 init my_camera.toml mine && make -C mine
             l3 init --from photo.dng mine && make -C mine picture.png
    """
    from l3cli.recipes.builtin import cameras_by_name, starters, summary
    from l3cli.stages.starting import start, start_designed, start_from, start_named, start_recipe

    for_photos = "light", "phase", "pattern", "black_level", "white_level", "opcodes"
    of_photos = [name for name in for_photos if getattr(options, name) is not None]
    if options.photos:  # if the shell expands a glob to several files, all but the first become arguments
        named = [Path(each) for each in (recipe, folder, *more) if each is not None]
        if not named:
            raise click.UsageError('specify a new folder, for example "l3 init --from photo.dng mine"')
        if single := next((each for each in options.photos if each.suffix in (".h5", ".toml")), None):
            what, make = ("design", start_designed) if single.suffix == ".h5" else ("recipe", start_recipe)
            if len(options.photos) + len(named) != 2:
                raise click.UsageError(f"--from needs exactly one {what} and one folder; remove the other arguments")
            if of_photos:
                option = f"--{of_photos[0].replace('_', '-')}"
                raise click.UsageError(f"{option} works only with raw files, not with a {what}; remove {option}")
            return Result({"folders": [str(named[0])]}, files=make(single, named[0], options))
        made, files = start_from([*options.photos, *named[:-1]], named[-1], options)
        return Result({"folders": [str(each) for each in made]}, files=files)
    if of_photos:
        raise click.UsageError(
            f"--{of_photos[0].replace('_', '-')} works only with raw files; specify the raw files with --from"
        )
    if more:
        raise click.UsageError(f'the argument "{more[0]}" is not expected; if it is a raw file, specify it with --from')
    if options.named:
        words = " ".join(str(each) for each in (recipe, folder) if each is not None)
        cameras = {name: ", ".join(names) for name, names in cameras_by_name(words).items()}
        if not cameras:
            raise click.UsageError(f'no camera has the name "{words}"; "l3 init --list" lists all cameras')
        return Result({"cameras": cameras}, lambda: _list(cameras))
    known, by_name = starters(), cameras_by_name()
    if recipe is None:
        recipes = {name: summary(path) for name, path in known.items()}
        options.console.info(f'"l3 init --list" lists {len(by_name)} more cameras by name')
        options.console.info('next: choose a recipe and a new folder, for example "l3 init bayer demo"')
        return Result({"recipes": recipes}, lambda: _list(recipes))
    if recipe.endswith(".toml"):
        if folder is None:
            raise click.UsageError(f'specify a new folder, for example "l3 init {recipe} mine"')
        return Result({"folders": [str(folder)]}, files=start_recipe(Path(recipe), folder, options))
    if recipe not in known and recipe not in by_name:
        raise click.UsageError(f'no recipe "{recipe}"; {suggestion(recipe, (*known, *by_name))}')
    if folder is None:
        raise click.UsageError(f'specify a new folder, for example "l3 init {recipe} {recipe}"')
    files = start(known[recipe], folder, options) if recipe in known else start_named(recipe, folder, options)
    return Result({"folders": [str(folder)]}, files=files)


def _list(recipes: dict[str, str]) -> None:
    wide = max(map(len, recipes))
    for name, what in recipes.items():
        show(*terminal.folded(f"{name:{wide}}  {what}", wide + 2))
