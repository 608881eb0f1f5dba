"""A measurement file of dark and white frames alone: all else is taken from a camera model or recipe.

    base = "camera.h5"                                    # or a camera recipe
    [[dark]]                                              # lens cap: one exposure or several
    frames = ["dark1.dng", "dark2.dng"]
    exposure_s = 0.02
    [[white]]                                             # an even white, neither clipped nor dark
    frames = ["white1.dng", "white2.dng"]
    exposure_s = 0.02

Frames are raw files of any format; names are relative to the folder of the measurement file.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.camera import CameraModel
from l3cli.artifacts.camera_recipe import camera_files, load_camera
from l3cli.errors import InputFileError, RecipeError
from l3cli.frames.measurement import Body, Capture, Measurements
from l3cli.io.frames import require_bits
from l3cli.io.measurement_recipe import CaptureRecipe, MeasurementRecipe
from l3cli.io.raw.files import read_raw
from l3cli.recipes.toml import Recipe, load_recipe, parse_toml, read_text


class CorrectionRecipe(Recipe):
    """MEASUREMENTS.toml of a camera that is known but for its defects and flat field."""

    title: ClassVar[str] = MeasurementRecipe.title

    base: str  # camera model or recipe, relative to this file
    dark: list[CaptureRecipe]
    white: list[CaptureRecipe]


@dataclass(frozen=True)
class RawFrames:
    """Raw files read one by one each time they are gone through."""

    paths: tuple[Path, ...]
    camera: CameraModel

    def __iter__(self) -> Iterator[NDArray[np.uint16]]:
        shape = (self.camera.rows, self.camera.cols)
        for path in self.paths:
            frame = read_raw(path, self.camera)
            if frame.values.shape != shape or frame.phase != (0, 0):
                raise InputFileError(
                    f"{path} of {frame.values.shape[0]}×{frame.values.shape[1]} pixels, first site {frame.phase}, is no "
                    f"whole frame of camera {self.camera.name} of {shape[0]}×{shape[1]}; give whole raw frames"
                )
            require_bits(path, frame.values, self.camera.bits)
            yield frame.values


def has_base(path: Path) -> bool:
    """Return whether a measurement file takes its camera from another file."""
    return "base" in parse_toml(read_text(path, CorrectionRecipe.title), str(path))


def read_correction_recipe(path: Path) -> CorrectionRecipe:
    """Raise RecipeError if it names no dark or no white frames, or one without an exposure time."""
    recipe = load_recipe(path, CorrectionRecipe)
    for table in ("dark", "white"):
        captures: list[CaptureRecipe] = getattr(recipe, table)
        if not captures:
            raise RecipeError(f"{path}: there is no [[{table}]] capture; add some")
        for capture in captures:
            if not capture.frames or capture.seconds is None or not 0 < capture.seconds < 1e5:
                raise RecipeError(f"{path}: a [[{table}]] capture needs frames and an exposure_s above 0")
    return recipe


def correction_files(path: Path) -> dict[str, list[Path]]:
    """Return such a file and all that it names, by their role."""
    recipe = read_correction_recipe(path)
    names = [name for capture in [*recipe.dark, *recipe.white] for name in capture.frames]
    return {
        "measurements": [path],
        "frames": [path.parent / name for name in names],
        "camera": camera_files(path.parent / recipe.base),
    }


def correction_measurements(path: Path) -> Measurements:
    """Return the captures of such a file; frames are read later, one by one. RecipeError or InputFileError as of other
    ones."""
    recipe = read_correction_recipe(path)
    camera = load_camera(path.parent / recipe.base)
    body = Body(
        camera.name, camera.rows, camera.cols, camera.pixel_pitch, camera.bits, camera.channels, camera.cfa, camera.optics
    )

    def captures(listed: list[CaptureRecipe]) -> tuple[Capture, ...]:
        return tuple(
            Capture(
                each.frames[0], each.seconds or 0.0, RawFrames(tuple(path.parent / name for name in each.frames), camera)
            )
            for each in listed
        )

    return Measurements(body=body, darks=captures(recipe.dark), whites=captures(recipe.white), base=camera)
