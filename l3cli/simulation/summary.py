"""Summaries of cameras, lab recipes and scene recipes, as JSON data and as text."""

from collections import Counter
from typing import Any

import numpy as np

from l3cli.artifacts.camera import CameraModel
from l3cli.artifacts.camera_curves import full_width
from l3cli.artifacts.camera_recipe import CameraRecipe, PhaseRecipe, columns_left_out, load_camera
from l3cli.artifacts.recipe_source import Meaning, RecipeSource
from l3cli.errors import InputFileError, listed
from l3cli.simulation.lab import LabRecipe, plan
from l3cli.simulation.light import camera_unknown, make_light, named_beyond_known, white_rates
from l3cli.system.text import array_lines, columns, counted, seconds_text, size_text

LIGHTS = ("D65", "A")
LUMINANCE = 100.0  # cd/m², luminance of white for the reported exposure times; typical indoors


def camera_summary(camera: CameraModel) -> dict[str, Any]:
    """Summarise a camera as JSON data: channels, CFA, sensor, and the exposures at which white saturates a pixel.

    Parameters
    ----------
    camera : CameraModel
        The camera.

    Returns
    -------
    dict
        JSON data. Keys of numbers end in the unit. For each channel, the entry ``channels`` describes the responsivity
        curve, and the response to a perfect white, relative to the brightest channel.

    Raises
    ------
    InputFileError
        If the camera collects no electrons from a perfect white.
    """
    lights = {name: make_light(name, {}, camera.wavelength) for name in LIGHTS}
    rates = {name: white_rates(camera, light) * camera.channel_gains for name, light in lights.items()}  # per cd/m²
    if dark := [name for name, rate in rates.items() if not rate.max() > 0]:
        raise InputFileError(f"camera {camera.name} does not respond to {' and '.join(dark)}; check its responsivities")
    _ = camera.saturation_exposure  # raises InputFileError if the camera collects no electrons from D65
    sites = np.bincount(camera.cfa.ravel(), minlength=len(camera.channels))
    curves: dict[str, Any] = {}
    for number, name in enumerate(camera.channels):
        curve = camera.responsivity[number]
        curves[name] = {
            "sites": int(sites[number]),
            "peak_nm": float(camera.wavelength[curve.argmax()]),
            "peak_e_per_photon": float(curve.max()),
            "fwhm_nm": full_width(camera.wavelength, curve),
            **{f"white_{light}": float(rate[number] / rate.max()) for light, rate in rates.items()},
        }
    filled = {light: float(camera.full_scale / rate.max()) for light, rate in rates.items()}
    return {
        "name": camera.name,
        "array": [[camera.channels[site] for site in row] for row in camera.cfa],
        "channels": curves,
        "wavelength_nm": [float(camera.wavelength[0]), float(camera.wavelength[-1])],
        "rows": camera.rows,
        "cols": camera.cols,
        "pixel_pitch_um": round(camera.pixel_pitch * 1e6, 9),
        "bits": camera.bits,
        "black_level_dn": camera.black_level,
        "white_level_dn": camera.white_level,
        "full_scale_e": camera.full_scale,
        "f_number": camera.optics.f_number,
        "saturation_exposure_cd_s_per_m2": filled,
        "luminance_cd_m2": LUMINANCE,
        "exposure_s": {light: exposure / LUMINANCE for light, exposure in filled.items()},
    }


def camera_meaning(recipe: CameraRecipe | PhaseRecipe, source: RecipeSource) -> Meaning:
    """Summarise a camera recipe, with warnings and a note about unused columns in its responsivity file."""
    camera = load_camera(source.path)
    unknown = {"warnings": camera_unknown(source.path, camera, LIGHTS)}
    return camera_summary(camera) | {"note": columns_left_out(source.path)} | unknown, []


def camera_lines(camera: dict[str, Any], width: int | None) -> list[str]:
    """Format the summary of a camera as lines, with tables of at most `width` characters."""
    lights = list(camera["exposure_s"])
    rows = []
    for name, curve in camera["channels"].items():
        wide = "–" if curve["fwhm_nm"] is None else f"{curve['fwhm_nm']:.0f}"
        whites = [f"{curve[f'white_{light}']:.3f}" for light in lights]
        peak = [f"{curve['peak_nm']:g}", f"{100 * curve['peak_e_per_photon']:.1f}", wide]
        rows.append([name, str(curve["sites"]), *peak, *whites])
    headings = ["channel\n", "sites\n", "peak\nnm", "efficiency\n%", "FWHM\nnm", *(f"white\n{light}" for light in lights)]
    filled = [f"{camera['saturation_exposure_cd_s_per_m2'][light]:.4g} cd s/m² of {light}" for light in lights]
    times = [f"{seconds_text(camera['exposure_s'][light])} of {light}" for light in lights]
    first, last = camera["wavelength_nm"]
    levels = f"{camera['bits']} bits, {camera['black_level_dn']:g}…{camera['white_level_dn']:g} DN of "
    levels += f"{camera['full_scale_e']:.5g} e-"
    return [
        f"{camera['name']}: {camera['rows']}×{camera['cols']} pixels of {camera['pixel_pitch_um']:g} µm, {levels}",
        "",
        *array_lines(camera["array"]),
        "",
        *columns(headings, rows, width),
        "",
        f"efficiency: e-/photon, {first:g}…{last:g} nm; "
        "white: response to a perfect white relative to the brightest channel",
        f"a perfect white saturates a pixel at {', '.join(filled)}; "
        f"exposure times at {camera['luminance_cd_m2']:g} cd/m² and f/{camera['f_number']:g}: {', '.join(times)}",
        *filter(None, [camera["note"]]),
    ]


def lab_meaning(recipe: LabRecipe, source: RecipeSource) -> Meaning:
    """Summarise a lab recipe for `l3 check`: captures of each type, and number and size of the frames.

    The result is empty if the camera is unknown.
    """
    camera = source.camera
    if camera is None:
        return {}, []
    captures = plan(camera, recipe, 0)
    frames = sum(capture.trials for capture in captures)
    kinds = dict(Counter(capture.kind for capture in captures))
    size = frames * camera.rows * camera.cols * 2
    warnings = named_beyond_known(recipe.lights, camera)
    return {"camera": camera.name, "captures": kinds, "frames": frames, "bytes": size, "warnings": warnings}, []


def lab_lines(lab: dict[str, Any], width: int | None) -> list[str]:
    """Format the summary of a lab recipe as lines."""
    captures = ", ".join(f"{count} {kind}" for kind, count in lab["captures"].items())
    return [f"for {lab['camera']}: captures {captures}; {lab['frames']} frames, {size_text(lab['bytes'])}"]


def scene_lines(scenes: dict[str, Any], width: int | None) -> list[str]:
    """Format the summary of a scene recipe as lines."""
    exposures = [f"{counted(len(values), 'exposure')} ({unit})" for unit, values in scenes["exposures"].items()]
    factors = [
        counted(scenes["scenes"], "scene") + (f" ({scenes['clips']} of them clips)" if scenes["clips"] else ""),
        f"{counted(len(scenes['illuminants']), 'illuminant')} ({listed(scenes['illuminants'])})",
    ]
    factors += [counted(len(scenes["luminances_cd_m2"]), "luminance"), *exposures]
    pairs = f" and {counted(scenes['pairs'], 'pair')}" if scenes["pairs"] else ""
    simulated = f"{counted(scenes['frames'], 'frame')}: {' × '.join(factors)}{pairs}"
    lines = [simulated if scenes["scenes"] else counted(scenes["pairs"], "pair")]
    if "bytes" in scenes:
        rows, cols = scenes["largest"]
        lines.append(
            f"for {scenes['camera']}: {size_text(scenes['bytes'])} without compression; the largest frame {rows}×{cols}, "
            f"{size_text(scenes['largest_bytes'])}"
        )
    return lines
