"""l3 info: what an artifact holds."""

import dataclasses
import json
from pathlib import Path
from typing import Any

import click

from l3cli.artifacts.base import describe, load
from l3cli.artifacts.table import TransformTable
from l3cli.cli import options


@click.command()
@click.argument("file", type=options.FILE)
@click.argument("inputs", type=options.FILE, nargs=-1, metavar="[INPUT…]")
@click.option("--verify", "verifies", is_flag=True, help="Check every byte of FILE, and that it was made of the INPUTs.")
@options.as_json
def info(file: Path, inputs: tuple[Path, ...], verifies: bool, as_json: bool) -> None:
    """Show kind, version, history and every dataset (axes, type, unit, meaning) of FILE; of a transform table also
    what it has learned: classes, patches, noise gain, gain of flat areas, and its worst classes.

    With --verify tell whether FILE is as it was written, to the last byte, and which of the files that its history names
    are given as INPUT: artifacts, recipes, frames, spectra. One that it does not name is another file, or has changed: exit
    code 3.

    \b
    Example: l3 info camera.h5
             l3 info --verify table.h5 training.h5 camera.h5 scenes.toml
    """
    if verifies:
        _verify(file, inputs, as_json)
        return
    if inputs:
        raise click.UsageError("one file at a time, unless --verify compares it with what it was made of")
    content = describe(file)
    if content["kind"] == TransformTable.kind:
        from l3cli.train.insight import insight

        content["insight"] = insight(load(TransformTable, file))
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
    if "insight" in content:
        click.echo("\n".join(_learned(content["insight"])))


def _verify(file: Path, inputs: tuple[Path, ...], as_json: bool) -> None:
    """What is right and what is not given; InputFileError if something is not right."""
    from l3cli.artifacts.verify import chain, verify
    from l3cli.errors import InputFileError
    from l3cli.files import sha256

    intact = verify(file)
    links, strangers = chain(intact.history, {path: sha256(path) for path in inputs})
    if as_json:
        document = {
            "kind": intact.kind,
            "version": intact.version,
            "digest": intact.digest,
            "datasets": intact.datasets,
            "history": [dataclasses.asdict(link) for link in links],
            "different": [str(path) for path in strangers],
        }
        click.echo(json.dumps(document, indent=2, ensure_ascii=False))
    else:
        digest = "every byte is as written" if intact.digest else "without a digest of its bytes, which version 2 has"
        click.echo(f"{file}: {intact.kind}, format version {intact.version}: {digest}; {intact.datasets} datasets are right")
        for link in links:
            told = ", ".join(link.given[:4]) + (" …" if len(link.given) > 4 else "")
            rest = f"{link.named - len(link.given)} not given" if link.named > len(link.given) else ""
            right = f"{len(link.given)} verified ({told})" if link.given else ""
            click.echo(f"  {link.stage} {link.role}: {', '.join(filter(None, (right, rest)))}")
    if strangers:
        named = ", ".join(str(path) for path in strangers)
        raise InputFileError(f"{named}: not what {file} was made of; another file, or changed since")


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
