"""The pixel of a design recipe: sensor, noise and lens of a camera, whatever its array."""

import dataclasses
from pathlib import Path

import msgspec

from l3cli.artifacts.camera import CameraModel, Optics
from l3cli.artifacts.camera_recipe import CfaRecipe, NoiseRecipe, OpticsRecipe, SensorRecipe, camera_files, load_camera
from l3cli.design.recipe import DesignRecipe, PixelRecipe
from l3cli.errors import RecipeError
from l3cli.recipes.builtin import CURVES, find_recipe
from l3cli.recipes.toml import KIND_KEYS, load_recipe, parse_toml, read_text, toml_value
from l3cli.system.text import printable


def is_design(path: Path) -> bool:
    """Return whether a file is a design recipe."""
    keys = KIND_KEYS[DesignRecipe.title]
    return path.suffix == ".toml" and any(key in parse_toml(read_text(path), str(path)) for key in keys)


def pixel_camera(path: Path) -> tuple[CameraModel, list[Path]]:
    """Return the camera of a file, or one with the pixel of a design recipe, and the files that it is read from."""
    if not is_design(path):
        return dataclasses.replace(load_camera(path), readout=None), camera_files(path)
    pixel = load_recipe(path, DesignRecipe).pixel
    return pixel_of(pixel, path.parent), [path, *camera_files(base_camera(pixel, path.parent))]


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
    noise, optics, gain = base.noise, base.optics, base.gain
    if pixel.read_noise_e is not None:
        noise = dataclasses.replace(noise, read_noise=pixel.read_noise_e)
    if pixel.well_e is not None:
        noise, gain = dataclasses.replace(noise, well_capacity=pixel.well_e), gain * base.full_scale / pixel.well_e
    if pixel.f_number is not None:
        optics = Optics(optics.focal_length, pixel.f_number, optics.object_distance)
    pitch = base.pixel_pitch if pixel.pitch_um is None else pixel.pitch_um * 1e-6
    return dataclasses.replace(base, noise=noise, gain=gain, optics=optics, pixel_pitch=pitch, readout=None, fit=None)


def camera_texts(camera: CameraModel, origin: str) -> dict[str, str]:
    """Return the recipe of a camera without a readout, and the curves that it names, by file."""
    noise, optics = camera.noise, camera.optics
    pitch, rows = round(camera.pixel_pitch * 1e6, 6), [[camera.channels[site] for site in row] for row in camera.cfa]
    levels = (camera.bits, camera.gain, camera.black_level, camera.white_level, camera.fixed_pattern_seed)
    dark = (noise.read_noise, noise.dark_current, noise.dsnu, noise.prnu, noise.column_noise)
    tables = {
        "sensor": SensorRecipe(camera.rows, camera.cols, pitch, *levels),
        "cfa": CfaRecipe(list(camera.channels), [" ".join(row) for row in rows]),
        "noise": NoiseRecipe(noise.well_capacity, *dark),
        "optics": OpticsRecipe(round(optics.focal_length * 1e3, 9), optics.f_number, optics.object_distance),
    }
    recipe = [f"# {printable(origin)}", f"name = {toml_value(camera.name)}", f'responsivity = {{ file = "{CURVES}" }}']
    for name, table in tables.items():
        recipe += ["", f"[{name}]", *(f"{key} = {toml_value(each)}" for key, each in msgspec.structs.asdict(table).items())]
    curves = [",".join(["wavelength_nm", *(f"{name} (e-/photon)" for name in camera.channels)])]
    for at, row in zip(camera.wavelength, camera.responsivity.T, strict=True):
        curves.append(f"{at:g}," + ",".join(f"{value:.6f}" for value in row))
    return {"camera.toml": "\n".join(recipe) + "\n", CURVES: "\n".join(curves) + "\n"}
