"""l3 info: contents of an artifact, or versions of this installation."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from l3cli.cli import options as declared
from l3cli.cli.results import Result
from l3cli.cli.terminal import folded, show
from l3cli.errors import InputFileError
from l3cli.options.commands import InfoOptions
from l3cli.system.text import figure, printable

if TYPE_CHECKING:
    from l3cli.stages.information import Verification


@click.command()
@click.argument("file", type=declared.FILE, required=False, metavar="FILE")
@click.argument("inputs", type=declared.FILE, nargs=-1, metavar="[INPUT…]")
@declared.of(InfoOptions)
def info(file: Path | None, inputs: tuple[Path, ...], options: InfoOptions) -> Result:
    """Show kind, version, history and every dataset (axes, type, unit, meaning) of FILE; of a transform table also
    classes, patches, noise gain, gain of flat areas, and its noisiest classes.

    With --verify check every byte of FILE against its digest, read all of it, and say which of the files that its history
    names are given as INPUT: artifacts, recipes, frames, spectra. An INPUT that the history does not name is another file,
    or has changed: exit code 3.

    \b
    Example: l3 info camera.h5
             l3 info --verify table.h5 training.h5 camera.h5 scenes.toml
    """
    if options.version == (file is not None):
        raise click.UsageError("give either a FILE or --version")
    if options.verify and file is not None:
        return _verify(file, inputs)
    if options.verify or inputs:
        raise click.UsageError("one file at a time, unless --verify compares it with what it was made of")
    from l3cli.stages.information import content, versions

    document = versions() if file is None else content(file)
    lines = _version_lines(document) if file is None else _lines(document)
    return Result(document, lambda: _show(lines))


def _show(lines: list[str]) -> None:
    for line in lines:
        show(*folded(printable(line), len(line) - len(line.lstrip()) + 4))


def _verify(file: Path, inputs: tuple[Path, ...]) -> Result:
    """Return what is verified and what is not given; InputFileError with it if something differs."""
    from l3cli.stages.information import verification

    result = verification(file, inputs)
    fault = None
    if result.strangers:
        named = ", ".join(str(path) for path in result.strangers)
        fault = InputFileError(f"{named}: not what {file} was made of; another file, or changed since")
    return Result(result.document(), lambda: show(*_verified(file, result)), fault)


def _lines(content: dict[str, Any]) -> list[str]:
    lines = [f"{content['kind']}, format version {content['version']}"]
    for stage in content["history"]:
        chosen = " ".join(f"--{key.replace('_', '-')} {value}" for key, value in sorted(stage["options"].items()))
        lines.append(f"  made by l3 {stage['command']} {chosen}".rstrip() + f" (l3cli {stage['version']})")
        for role, digests in sorted(stage["inputs"].items()):
            named = ", ".join(digest[:12] for digest in digests[:4]) + (" …" if len(digests) > 4 else "")
            lines.append(f"    {role}: {named}")
    frames = {item["name"].split("/")[1] for item in content["datasets"] if item["name"].startswith("frames/")}
    if frames:
        lines.append(f"{len(frames)} frame{'s; the first' if len(frames) > 1 else ''}:")
    for item in content["datasets"]:
        if not item["name"].startswith("frames/") or item["name"].startswith(f"frames/{min(frames)}/"):
            lines.append(_line(item))
    if "insight" in content:
        from l3cli.training.summary import learned

        lines += learned(content["insight"])
    return lines


def _verified(file: Path, verification: "Verification") -> list[str]:
    """Return lines on what is verified, and what the history names that is not given."""
    intact = verification.intact
    digest = "every byte is as written" if intact.digest else "without a digest of its bytes, which version 2 has"
    lines = [f"{file}: {intact.kind}, format version {intact.version}: {digest}; {intact.datasets} datasets can be read"]
    for link in verification.links:
        names = ", ".join(link.given[:4]) + (" …" if len(link.given) > 4 else "")
        rest = f"{link.named - len(link.given)} not given" if link.named > len(link.given) else ""
        right = f"{len(link.given)} verified ({names})" if link.given else ""
        lines.append(f"  {link.stage} {link.role}: {', '.join(filter(None, (right, rest)))}")
    return lines


def _line(item: dict[str, Any]) -> str:
    shape = "×".join(str(length) for length in item["shape"])
    parts = [item["name"], f"({item['axes']})" if item["axes"] else "", shape, item["dtype"]]
    parts += ["" if item["value"] is None else f"= {_short(item['value'])}", "" if item["unit"] == "1" else item["unit"]]
    return f"  {' '.join(filter(None, parts))}  {item['doc']}"


def _short(value: Any) -> str:
    """Return a number to six digits, text as it is; JSON has all digits."""
    if isinstance(value, list):
        return f"[{', '.join(map(_short, value))}]"
    return figure(value, ".6g") if isinstance(value, float) else str(value)


def _version_lines(versions: dict[str, Any]) -> list[str]:
    libraries = [f"  {name} {version or 'is not installed'}" for name, version in versions["libraries"].items()]
    devices = [f"  {device}" for device in versions["devices"]]
    return [
        f"l3 {versions['l3']}",
        f"Python {versions['python']} on {versions['system']}",
        *libraries,
        "OpenCL devices:",
        *devices,
        f"Decoder of foreign files: {versions['decoding']}",
    ]
