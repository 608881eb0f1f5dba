"""l3 schema: prints the JSON schema of recipes, for editors."""

import click

from l3cli.cli import options as declared
from l3cli.cli.results import Result
from l3cli.cli.terminal import show_json
from l3cli.options.option import Options

KINDS = ("camera", "lab", "scenes", "classes", "design", "measurements")


@click.command()
@click.argument("kind", type=click.Choice(KINDS), metavar="KIND")
@declared.of(Options)
def schema(kind: str, options: Options) -> Result:
    """Print the JSON schema of a type of recipe. KIND is camera, lab, scenes, classes, design or measurements.

    Editors with TOML support (taplo, Even Better TOML) check a recipe against the schema if the first line of the recipe
    contains the file name of the schema, for example "#:schema camera.schema.json".

    \b
    Example: l3 schema camera
    """
    from l3cli.stages.check import schema as stage

    document = stage(kind)
    return Result({"schema": document}, lambda: show_json(document))
