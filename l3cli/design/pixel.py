"""The pixel of a design recipe: sensor, noise and lens of a camera, whatever its array."""

import dataclasses
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.camera import CameraModel, Optics
from l3cli.artifacts.camera_recipe import camera_files, load_camera
from l3cli.design.error import Cfa
from l3cli.design.recipe import DesignRecipe, PixelRecipe, shown
from l3cli.errors import RecipeError
from l3cli.recipes.builtin import CURVES, find_recipe
from l3cli.recipes.toml import KIND_KEYS, load_recipe, parse_toml, read_text, toml_value
from l3cli.system.text import printable

Array = NDArray[np.float64]


def pixel_camera(path: Path) -> CameraModel:
    """Return the camera of a file, or one with the pixel of a design recipe."""
    if is_design(path):
        recipe = load_recipe(path, DesignRecipe)
        return pixel_of(recipe.pixel, path.parent)
    return dataclasses.replace(load_camera(path), readout=None)


def is_design(path: Path) -> bool:
    """Return whether a file is a design recipe."""
    if path.suffix != ".toml":
        return False
    content = parse_toml(read_text(path), str(path))
    return any(key in content for key in KIND_KEYS[DesignRecipe.title])


def pixel_files(path: Path) -> list[Path]:
    """Return the files that `pixel_camera` reads."""
    if is_design(path):
        return [path, *camera_files(base_camera(load_recipe(path, DesignRecipe).pixel, path.parent))]
    return camera_files(path)


def base_camera(pixel: PixelRecipe, folder: Path) -> Path:
    """Return the file of the camera that a pixel is of: beside the recipe, or one that comes with l3."""
    own = folder / pixel.camera
    return own if own.is_file() else find_recipe(pixel.camera, "cameras")


def pixel_of(pixel: PixelRecipe, folder: Path) -> CameraModel:
    """Return the camera of a pixel; its array and filters do not count."""
    base = load_camera(base_camera(pixel, folder))
    if not base.absolute:
        raise RecipeError(
            f"pixel.camera: {base.name} has only a relative responsivity; give one of known quantum efficiency"
        )
    noise, optics = base.noise, base.optics
    if pixel.read_noise_e is not None:
        noise = dataclasses.replace(noise, read_noise=pixel.read_noise_e)
    gain = base.gain
    if pixel.well_e is not None:
        noise, gain = dataclasses.replace(noise, well_capacity=pixel.well_e), gain * base.full_scale / pixel.well_e
    if pixel.f_number is not None:
        optics = Optics(optics.focal_length, pixel.f_number, optics.object_distance)
    pitch = base.pixel_pitch if pixel.pitch_um is None else pixel.pitch_um * 1e-6
    return dataclasses.replace(base, noise=noise, gain=gain, optics=optics, pixel_pitch=pitch, readout=None, fit=None)


def camera_with(pixel: CameraModel, cfa: Cfa, names: Sequence[str], wavelength: Array, curves: Array) -> CameraModel:
    """Return the camera of a pixel with an array of some filters of a library, whose `curves` are (filter, wavelength)."""
    used = np.unique(cfa)
    return dataclasses.replace(
        pixel,
        name=shown(cfa, names),
        channels=tuple(names[each] for each in used),
        cfa=np.searchsorted(used, cfa).astype(np.uint8),
        wavelength=wavelength,
        responsivity=curves[used],
        responsivity_band=np.zeros_like(curves[used]),
    )


def camera_texts(camera: CameraModel, origin: str) -> dict[str, str]:
    """Return the recipe of a camera without a readout, and the curves that it names, by file."""
    noise, optics = camera.noise, camera.optics
    rows = "\n".join(f'  "{" ".join(camera.channels[site] for site in row)}",' for row in camera.cfa)
    recipe = f"""\
# {printable(origin)}
name = {toml_value(camera.name)}

[sensor]
rows = {camera.rows}
cols = {camera.cols}
pixel_pitch_um = {camera.pixel_pitch * 1e6:.6g}
bits = {camera.bits}
gain_dn_per_e = {camera.gain:.6g}
black_level_dn = {camera.black_level:.6g}
white_level_dn = {camera.white_level:.6g}
fixed_pattern_seed = {camera.fixed_pattern_seed}

[cfa]
channels = {toml_value(camera.channels)}
pattern = [
{rows}
]

[responsivity]
file = "{CURVES}"

[noise]
read_noise_e = {noise.read_noise:.6g}
dark_current_e_per_s = {noise.dark_current:.6g}
dsnu_e = {noise.dsnu:.6g}
prnu = {noise.prnu:.6g}
column_noise_e = {noise.column_noise:.6g}
well_capacity_e = {noise.well_capacity:.6g}

[optics]
focal_length_mm = {optics.focal_length * 1e3:.6g}
f_number = {optics.f_number:.6g}
object_distance_m = {optics.object_distance:.6g}
"""
    heading = ",".join(["wavelength_nm", *(f"{name} (e-/photon)" for name in camera.channels)])
    grid = zip(camera.wavelength, camera.responsivity.T, strict=True)
    lines = [f"{at:g}," + ",".join(f"{value:.6f}" for value in row) for at, row in grid]
    return {"camera.toml": recipe, CURVES: "\n".join([heading, *lines]) + "\n"}
