"""l3 info: what an artifact holds, and what this l3 is made of."""

import json
from pathlib import Path
from typing import Any

import click

from l3cli.cli import options


@click.command()
@click.argument("file", type=options.FILE, required=False, metavar="FILE")
@click.option(
    "--version", "versions", is_flag=True, help="Versions of l3, Python and libraries, and OpenCL devices; no FILE."
)
@options.as_json
def info(file: Path | None, versions: bool, as_json: bool) -> None:
    """Show kind, version, history and every dataset (axes, type, unit, meaning) of FILE; of a transform table also
    what it has learned: classes, patches, noise gain, gain of flat areas, and its worst classes.

    \b
    Example: l3 info camera.h5
    """
    if versions == (file is not None):
        raise click.UsageError("give either a FILE or --version")
    content = _versions() if file is None else _content(file)
    if as_json:
        click.echo(json.dumps(content, indent=2, ensure_ascii=False))
        return
    for line in _version_lines(content) if versions else _lines(content):
        _echo(line)


def _echo(line: str) -> None:
    """Print what a file says, which may be anything, without what would move a terminal's cursor."""
    line = "".join(letter if letter.isprintable() else "?" for letter in line)
    click.echo(options.folded(line, len(line) - len(line.lstrip()) + 4))


# ------------------------------------------------------------------------------------------------------ artifacts


def _content(file: Path) -> dict[str, Any]:
    """What is in a file, ready for JSON."""
    from l3cli.artifacts.base import describe, load
    from l3cli.artifacts.table import TransformTable

    content = describe(file)
    if content["kind"] == TransformTable.kind:
        from l3cli.train.insight import insight

        content["insight"] = insight(load(TransformTable, file))
    return content


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
    return lines + (_learned(content["insight"]) if "insight" in content else [])


def _line(item: dict[str, Any]) -> str:
    shape = "×".join(str(length) for length in item["shape"])
    parts = [item["name"], f"({item['axes']})" if item["axes"] else "", shape, item["dtype"]]
    parts += ["" if item["value"] is None else f"= {_short(item['value'])}", "" if item["unit"] == "1" else item["unit"]]
    return f"  {' '.join(filter(None, parts))}  {item['doc']}"


def _short(value: Any) -> str:
    """A number to six digits, text as it is; JSON tells all digits."""
    if isinstance(value, list):
        return f"[{', '.join(map(_short, value))}]"
    return f"{value:.6g}" if isinstance(value, float) else str(value)


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


# ------------------------------------------------------------------------------------------------------- versions


def _versions() -> dict[str, Any]:
    """What a report of a fault should tell: l3, Python, libraries (None: an extra not installed), OpenCL devices."""
    import platform
    import re
    from importlib import metadata

    from l3cli import __version__
    from l3cli.errors import DeviceError
    from l3cli.render.opencl_devices import survey

    try:
        required = metadata.requires("l3cli") or []
    except metadata.PackageNotFoundError:  # sources on a path, not installed
        required = []
    names = sorted(
        {re.split(r"[^\w.-]", each)[0] for each in required if "'dev'" not in each.replace('"', "'")}, key=str.lower
    )
    try:
        devices = survey()
    except DeviceError as error:
        devices = [str(error)]
    return {
        "l3": __version__,
        "python": platform.python_version(),
        "system": f"{platform.system()} {platform.machine()}",
        "libraries": {name: _version(name) for name in names},
        "devices": devices,
    }


def _version(name: str) -> str | None:
    from importlib import metadata

    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return None


def _version_lines(found: dict[str, Any]) -> list[str]:
    libraries = [f"  {name} {version or 'is not installed'}" for name, version in found["libraries"].items()]
    devices = [f"  {device}" for device in found["devices"]]
    return [f"l3 {found['l3']}", f"Python {found['python']} on {found['system']}", *libraries, "OpenCL devices:", *devices]
