"""Meaning of recipes, as lines and tables of plain text."""

import re
from collections.abc import Iterable
from typing import Any

from l3cli.errors import listed
from l3cli.stages.checking.check import Finding, Judgement
from l3cli.stages.checking.kinds import KINDS
from l3cli.system.text import columns, counted, figure

INDENT = "  "
ENTRY = re.compile(r"\[\d+\]|^.*(?= does not exist)")  # of a message: what differs between equal faults
FEW, NAMED = 3, 8  # equal faults that each have a line; lines that are named of more


def as_text(judgement: Judgement, width: int | None = None) -> list[str]:
    """Return a line a fault, as editors know it; or what the recipe means, tables no wider than `width` characters."""
    if judgement.findings:
        lines = [f"{judgement.path}:{line}: {message}" for line, message in folded(judgement.findings)]
        more = f"{f'{judgement.more} ' * (judgement.more > 1)}more"
        return [*lines, f"{judgement.path}: and {more}"] if judgement.more else lines
    assert judgement.kind is not None
    inside = None if width is None else width - len(INDENT)
    lines = WRITERS[judgement.kind](judgement.meaning, inside) if judgement.meaning else []
    return [f"{judgement.path}: {KINDS[judgement.kind].title}", *(f"{INDENT}{line}".rstrip() for line in lines)]


def folded(findings: Iterable[Finding]) -> list[tuple[int, str]]:
    """Return line and message of each finding; of more than FEW that differ only in the entry of a list, or in the file
    that is missing, the first with the lines of the others."""
    alike: dict[str, list[Finding]] = {}
    for finding in findings:
        alike.setdefault(ENTRY.sub("", finding.message), []).append(finding)
    lines: list[tuple[int, str]] = []
    for first, *others in alike.values():
        if len(others) < FEW:
            lines += [(finding.line, finding.message) for finding in (first, *others)]
        else:
            where = ", ".join(str(finding.line) for finding in others[:NAMED]) + " …" * (len(others) > NAMED)
            lines.append((first.line, f"{first.message} (and {len(others)} times more, in lines {where})"))
    return sorted(lines, key=lambda each: each[0])


def _camera(camera: dict[str, Any], width: int | None) -> list[str]:
    lights = list(camera["exposure_s"])
    rows = []
    for name, curve in camera["channels"].items():
        wide = "–" if curve["fwhm_nm"] is None else f"{curve['fwhm_nm']:.0f}"
        whites = [f"{curve[f'white_{light}']:.3f}" for light in lights]
        peak = [f"{curve['peak_nm']:g}", f"{100 * curve['peak_e_per_photon']:.1f}", wide]
        rows.append([name, str(curve["sites"]), *peak, *whites])
    headings = ["channel\n", "sites\n", "peak\nnm", "efficiency\n%", "FWHM\nnm", *(f"white\n{light}" for light in lights)]
    filled = [f"{camera['saturation_exposure_cd_s_per_m2'][light]:.4g} cd s/m² of {light}" for light in lights]
    times = [f"{_seconds(camera['exposure_s'][light])} of {light}" for light in lights]
    first, last = camera["wavelength_nm"]
    levels = f"{camera['bits']} bits, {camera['black_level_dn']:g}…{camera['white_level_dn']:g} DN of "
    levels += f"{camera['full_scale_e']:.5g} e-"
    return [
        f"{camera['name']}: {camera['rows']}×{camera['cols']} pixels of {camera['pixel_pitch_um']:g} µm, {levels}",
        "",
        *_array(camera["array"]),
        "",
        *columns(headings, rows, width),
        "",
        f"efficiency: e-/photon, {first:g}…{last:g} nm; white: what a channel collects of it, over the brightest channel",
        f"a white fills a pixel at {', '.join(filled)}: "
        f"at {camera['luminance_cd_m2']:g} cd/m² and f/{camera['f_number']:g} in {', '.join(times)}",
        *filter(None, [camera["note"]]),
    ]


def _array(rows: list[list[str]]) -> list[str]:
    wide = max(len(name) for row in rows for name in row)
    return [" ".join(name.ljust(wide) for name in row).rstrip() for row in rows]


def _lab(lab: dict[str, Any], width: int | None) -> list[str]:
    captures = ", ".join(f"{count} {kind}" for kind, count in lab["captures"].items())
    return [f"for {lab['camera']}: captures {captures}; {lab['frames']} frames, {_size(lab['bytes'])}"]


def _scenes(scenes: dict[str, Any], width: int | None) -> list[str]:
    exposures = [f"{len(values)} exposures ({unit})" for unit, values in scenes["exposures"].items()]
    factors = [
        f"{scenes['scenes']} scenes" + (f" ({scenes['clips']} of them clips)" if scenes["clips"] else ""),
        f"{len(scenes['illuminants'])} illuminants ({listed(scenes['illuminants'])})",
    ]
    factors += [f"{len(scenes['luminances_cd_m2'])} luminances", *exposures]
    pairs = f" and {scenes['pairs']} pairs" if scenes["pairs"] else ""
    lines = [f"{scenes['frames']} frames: {' × '.join(factors)}{pairs}" if scenes["scenes"] else f"{scenes['pairs']} pairs"]
    if "bytes" in scenes:
        rows, cols = scenes["largest"]
        lines.append(
            f"for {scenes['camera']}: {_size(scenes['bytes'])} without compression; the largest frame {rows}×{cols}, "
            f"{_size(scenes['largest_bytes'])}"
        )
    return lines


def _classes(classes: dict[str, Any], width: int | None) -> list[str]:
    further = "".join(f" × {size} values of {name}" for name, size in classes["further"].items())
    kinds = f"({classes['chromas']} chromas + {classes['saturation_cases'] - 1} saturation cases at most)"
    lines = []
    for number, layer in enumerate(classes["layers"], 1):
        how = (
            f": {classes['levels']} levels × {counted(classes['contrasts'], 'contrast')}{further} × {kinds}"
            if number == 1
            else ""
        )
        lines.append(f"layer {number}: {layer['classes_per_site']} classes a site of {layer['taps']} taps{how}")
    if "table_bytes" in classes:
        size = _size(classes["table_bytes"])
        lines.append(f"for {classes['camera']}: {classes['sites']} sites; a table of three outputs has up to {size}")
        if classes["per_light"]:
            lines.append("and as much again for each light of the training")
    return lines


def _measurements(measured: dict[str, Any], width: int | None) -> list[str]:
    lines = [f"{measured['name']}: channels {', '.join(measured['channels'])}", "", *_array(measured["array"]), ""]
    for name, section in measured["sections"].items():
        told = (
            [counted(section["captures"], "capture"), counted(section["frames"], "frame")] if "captures" in section else []
        )
        if "exposure_s" in section:
            told.append(" … ".join(dict.fromkeys(map(_seconds, section["exposure_s"]))))
        if "wavelength_nm" in section:
            told.append("{:g}…{:g} nm".format(*section["wavelength_nm"]))
        told += [", ".join(section["illuminants"])] if "illuminants" in section else []
        told += [section["file"]] if "file" in section else []
        told += [f"well of {section['well_capacity_e']:g} e-"] if "well_capacity_e" in section else []
        lines.append(f"[{name}] {', '.join(told)}")
    return lines


def _seconds(value: float) -> str:
    return f"{figure(value, '.4g')} s" if value >= 1 else f"{value * 1e3:.3g} ms"


def _size(count: int) -> str:
    return f"{count / 1e9:.3g} GB" if count >= 1e9 else f"{count / 1e6:.3g} MB"


WRITERS = {"camera": _camera, "lab": _lab, "scenes": _scenes, "classes": _classes, "measurements": _measurements}
