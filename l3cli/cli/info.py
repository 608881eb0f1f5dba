"""l3 info: what an artifact holds."""

import json
from pathlib import Path
from typing import Any

import click

from l3cli.artifacts.base import describe
from l3cli.cli import options


@click.command()
@click.argument("file", type=options.FILE)
@options.as_json
def info(file: Path, as_json: bool) -> None:
    """Show kind, version, history and every dataset (axes, type, unit, meaning) of FILE.

    Example: l3 info camera.h5
    """
    content = describe(file)
    if as_json:
        click.echo(json.dumps(content, indent=2, ensure_ascii=False))
        return
    click.echo(f"{content['kind']}, format version {content['version']}")
    for stage in content["history"]:
        chosen = " ".join(f"--{key.replace('_', '-')} {value}" for key, value in sorted(stage["options"].items()))
        click.echo(f"  made by l3 {stage['command']} {chosen}".rstrip() + f" (l3cli {stage['version']})")
        for role, digests in sorted(stage["inputs"].items()):
            named = ", ".join(digest[:12] for digest in digests[:4]) + (" …" if len(digests) > 4 else "")
            click.echo(f"    {role}: {named}")
    frames = {item["name"].split("/")[1] for item in content["datasets"] if item["name"].startswith("frames/")}
    if frames:
        click.echo(f"{len(frames)} frames; the first:")
    for item in content["datasets"]:
        if not item["name"].startswith("frames/") or item["name"].startswith(f"frames/{min(frames)}/"):
            click.echo(_line(item))


def _line(item: dict[str, Any]) -> str:
    axes = f" ({item['axes']})" if item["axes"] else ""
    shape = "×".join(str(length) for length in item["shape"])
    value = "" if item["value"] is None else f" = {item['value']}"
    unit = "" if item["unit"] == "1" else f" {item['unit']}"
    return f"  {item['name']}{axes} {shape} {item['dtype']}{value}{unit}  {item['doc']}".replace("  ", " ", 0)
