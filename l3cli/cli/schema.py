"""l3 schema: the JSON schema of recipes, for editors."""

import click

from l3cli.cli.terminal import Terminal, show_json

KINDS = ("camera", "lab", "scenes", "classes", "measurements")


@click.command()
@click.argument("kind", type=click.Choice(KINDS), metavar="KIND")
def schema(kind: str) -> None:
    """Print the JSON schema of a KIND of recipe: camera, lab, scenes, classes or measurements. With it editors (taplo, Even
    Better TOML) check a recipe whose first line is "#:schema camera.schema.json", the file that holds it.

    \b
    Example: l3 schema camera
    """
    from l3cli.stages.checking.schema import schema as stage

    show_json(stage(kind), Terminal())
