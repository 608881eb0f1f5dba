"""l3 info: prints the contents of an artifact or a raw file, or the software versions of this installation."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from l3cli.cli import options as declared
from l3cli.cli.results import Result
from l3cli.cli.terminal import folded, show
from l3cli.errors import InputFileError
from l3cli.options.commands import InfoOptions
from l3cli.system.files import files_to_read
from l3cli.system.text import figure, printable

if TYPE_CHECKING:
    from l3cli.stages.information import Verification

NOT_STATED = "not stated"
OPTIONAL = (  # label, key and unit of properties that are printed only if the raw file states them
    ("baseline exposure", "baseline_exposure", " EV"),
    ("camera", "camera", ""),
    ("lens", "lens", ""),
    ("date", "date", ""),
    ("ISO speed", "iso", ""),
    ("f-number", "f_number", ""),
    ("focal length", "focal_length", " mm"),
)
ORIENTATIONS = {3: "turned by 180°", 5: "turned by 90° to the left", 6: "turned by 90° to the right"}  # LibRaw flip codes


@click.command()
@click.argument("file", type=declared.FILE, required=False, metavar="FILE")
@click.argument("inputs", type=declared.FILE, nargs=-1, metavar="[INPUT…]")
@declared.of(InfoOptions)
def info(file: Path | None, inputs: tuple[Path, ...], options: InfoOptions) -> Result:
    """Print the type, the version, the history and the datasets (axes, type, unit, meaning) of the artifact FILE. For a
    transform table, also print its classes, patches, noise gain, gain of flat areas and noisiest classes.

    If FILE is a raw file with one frame, print what l3 reads from it: size, levels, filter array, white balance, exposure.

    With --verify, verify the digest of FILE, read all its data, and compare the INPUTs with the input files in its history
    (artifacts, recipes, frames, spectra). If an INPUT is not in the history, it is the wrong file or has changed (exit code
    3).

    \b
    Example: l3 info camera.h5
             l3 info photo.dng
             l3 info --verify table.h5 training.h5 camera.h5 scenes.toml
    """
    if options.version == (file is not None):
        raise click.UsageError("specify either a FILE or --version")
    if options.verify and file is not None:
        return _verify(file, inputs)
    if options.verify or inputs:
        raise click.UsageError('specify only one file; to compare FILE with its input files, use "l3 info --verify"')
    from l3cli.stages.information import content, versions

    files = files_to_read({"artifact": [file]} if file else {})
    document = versions() if file is None else content(file)
    lines = _version_lines(document) if file is None else _raw_lines(document) if "size" in document else _lines(document)
    return Result(document, lambda: _show(lines), files=files)


def _show(lines: list[str]) -> None:
    for line in lines:
        show(*folded(printable(line), len(line) - len(line.lstrip()) + 4))


def _verify(file: Path, inputs: tuple[Path, ...]) -> Result:
    """Verify an artifact, and check that its history contains the files `inputs`.

    If a file is missing from the history, the result contains an InputFileError.
    """
    from l3cli.stages.information import verification

    files = files_to_read({"artifact": [file], "inputs": inputs})
    result = verification(file, inputs)
    fault = None
    if result.strangers:
        named = ", ".join(str(path) for path in result.strangers)
        fault = InputFileError(
            f"the history of {file} does not contain {named}; specify the original input files, or create {file} again"
        )
    return Result(result.document(), lambda: show(*_verified(file, result)), fault, files=files)


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


def _raw_lines(frame: dict[str, Any]) -> list[str]:
    """Format the properties of a raw frame as lines. Missing properties are omitted if they are in OPTIONAL."""
    values, gains = frame["values"], frame["neutral"]
    facts = {
        "size": "{}×{} pixels (rows × columns)".format(*frame["size"]),
        "values": f"{values['lowest']} to {values['highest']} DN, mean {values['mean']:.6g} DN",
        "black level": _stated(frame["black_level"], " DN"),
        "white level": _stated(frame["white_level"], " DN"),
        "filter array": frame["filter_array"] or NOT_STATED,
        "grey surface": " : ".join(f"{colour} {figure(signal, '.4g')}" for colour, signal in gains.items())
        if gains
        else NOT_STATED,
        "exposure time": _stated(frame["exposure_time"], " s"),
    }
    if frame["saturated"]:
        facts["white level"] += f", reached by {100 * frame['saturated']:.2g} % of the pixels"
    for label, key, unit in OPTIONAL:
        if frame[key] is not None:
            facts[label] = _stated(frame[key], unit)
    if frame["orientation"]:
        facts["orientation"] = ORIENTATIONS.get(frame["orientation"], "mirrored")
    if frame["masked_pixels"]:
        facts["masked pixels"] = "{} beside the rows, {} above and below the columns".format(*frame["masked_pixels"])
    if frame["gain_map"]:
        facts["gain map"] = "yes"
    if frame["lens_corrections"]:
        facts["lens corrections"] = str(frame["lens_corrections"])
    facts |= {f"note {number}": note for number, note in enumerate(frame["notes"], 1)}
    return [frame["kind"], *(f"  {name:<17} {text}" for name, text in facts.items())]


def _stated(value: Any, unit: str) -> str:
    return NOT_STATED if value is None else f"{_short(value)}{unit}"


def _verified(file: Path, verification: "Verification") -> list[str]:
    """Return one line about the artifact's data, and one line per role of its input files."""
    intact = verification.intact
    whole = f"the contents match the digest; {intact.datasets} datasets can be read"
    lines = [f"{file}: {intact.kind}, format version {intact.version}: {whole}"]
    for link in verification.links:
        names = ", ".join(link.given[:4]) + (" …" if len(link.given) > 4 else "")
        rest = f"{link.named - len(link.given)} not listed" if link.named > len(link.given) else ""
        right = f"{len(link.given)} verified ({names})" if link.given else ""
        lines.append(f"  {link.stage} {link.role}: {', '.join(filter(None, (right, rest)))}")
    return lines


def _line(item: dict[str, Any]) -> str:
    shape = "×".join(str(length) for length in item["shape"])
    parts = [item["name"], f"({item['axes']})" if item["axes"] else "", shape, item["dtype"]]
    parts += ["" if item["value"] is None else f"= {_short(item['value'])}", "" if item["unit"] == "1" else item["unit"]]
    return f"  {' '.join(filter(None, parts))}  {item['doc']}"


def _short(value: Any) -> str:
    """Format a value with six significant digits. The JSON contains all digits."""
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
        f"Decoder of raw, image and video files: {versions['decoding']}",
    ]
