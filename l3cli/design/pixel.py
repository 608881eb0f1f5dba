"""The pixel of a design recipe: sensor, noise and lens of a camera, whatever its array."""

import dataclasses
from pathlib import Path

from l3cli.artifacts.camera import CameraModel, Optics
from l3cli.artifacts.camera_recipe import camera_files, load_camera
from l3cli.design.recipe import DesignRecipe, PixelRecipe
from l3cli.errors import RecipeError
from l3cli.recipes.builtin import find_recipe
from l3cli.recipes.toml import KIND_KEYS, load_recipe, parse_toml, read_text


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
