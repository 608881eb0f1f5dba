"""l3 info: what an artifact holds."""

import json
from pathlib import Path
from typing import Any

import click

from l3cli.artifacts.base import describe, load
from l3cli.artifacts.table import TransformTable
from l3cli.cli import options


@click.command()
@click.argument("file", type=options.FILE)
@options.as_json
def info(file: Path, as_json: bool) -> None:
    """Show kind, version, history and every dataset (axes, type, unit, meaning) of FILE; of a transform table also
    what it has learned: classes, patches, noise gain, gain of flat areas, and its worst classes.

    Example: l3 info camera.h5
    """
    content = describe(file)
    if content["kind"] == TransformTable.kind:
        from l3cli.train.insight import insight

        content["insight"] = insight(load(TransformTable, file))
    if as_json:
        click.echo(json.dumps(content, indent=2, ensure_ascii=False))
        return
    _echo(f"{content['kind']}, format version {content['version']}")
    for stage in content["history"]:
        chosen = " ".join(f"--{key.replace('_', '-')} {value}" for key, value in sorted(stage["options"].items()))
        _echo(f"  made by l3 {stage['command']} {chosen}".rstrip() + f" (l3cli {stage['version']})")
        for role, digests in sorted(stage["inputs"].items()):
            named = ", ".join(digest[:12] for digest in digests[:4]) + (" …" if len(digests) > 4 else "")
            _echo(f"    {role}: {named}")
    frames = {item["name"].split("/")[1] for item in content["datasets"] if item["name"].startswith("frames/")}
    if frames:
        click.echo(f"{len(frames)} frames; the first:")
    for item in content["datasets"]:
        if not item["name"].startswith("frames/") or item["name"].startswith(f"frames/{min(frames)}/"):
            _echo(_line(item))
    if "insight" in content:
        for line in _learned(content["insight"]):
            _echo(line)


def _echo(line: str) -> None:
    """Print what a file says, which may be anything, without what would move a terminal's cursor."""
    click.echo("".join(letter if letter.isprintable() else "?" for letter in line))


def _line(item: dict[str, Any]) -> str:
    axes = f" ({item['axes']})" if item["axes"] else ""
    shape = "×".join(str(length) for length in item["shape"])
    value = "" if item["value"] is None else f" = {item['value']}"
    unit = "" if item["unit"] == "1" else f" {item['unit']}"
    return f"  {item['name']}{axes} {shape} {item['dtype']}{value}{unit}  {item['doc']}".replace("  ", " ", 0)


def _learned(found: dict[str, Any]) -> list[str]:
    """Lines that tell what a table has learned."""
    classes = found["classes"]
    figures = " · ".join(
        f"{output} {gain['median']:.3g}, {gain['worst']:.3g}" for output, gain in found["noise_gain"].items()
    )
    lines = [
        f"{classes['all']} classes: {classes['trained']} trained, {classes['thin']} of them on fewer patches than taps; "
        f"{classes['filled']} without patches of their own",
        "patches: " + " · ".join(f"{kind['name']} {kind['patches']:.0f}" for kind in found["kinds"]),
        f"noise gain √Σw² (median, worst class): {figures}",
        f"condition (median, worst class): {found['condition']['median']:.2g}, {found['condition']['worst']:.2g}",
        "gain of a flat signal (median of unsaturated classes):",
    ]
    for output, gains in found["dc_gain"].items():
        lines.append(f"  {output}: " + "  ".join(f"{channel} {gain:+.3f}" for channel, gain in gains.items()))
    lines.append("noisiest classes:")
    lines += [
        f"  {worst['noise_gain']:8.3g}  {worst['class']}: {worst['patches']:.0f} patches, condition {worst['condition']:.2g}"
        for worst in found["worst"]
    ]
    return lines
