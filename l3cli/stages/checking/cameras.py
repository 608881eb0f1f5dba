"""Camera recipes: what they refuse, and what the camera is."""

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.camera import CameraModel
from l3cli.artifacts.camera_curves import full_width, responsivity
from l3cli.artifacts.camera_recipe import CameraRecipe, PhaseRecipe, camera_faults, columns_left_out, load_camera
from l3cli.errors import InputFileError
from l3cli.recipes.faults import Fault, fault
from l3cli.simulation.light import make_light, white_rates
from l3cli.stages.checking.source import Source

LIGHTS = ("D65", "A")
LUMINANCE = 100.0  # cd/m² of the white whose exposure is told: a room
FILE = ("responsivity", "file")
Array = NDArray[np.float64]


def faults(recipe: CameraRecipe | PhaseRecipe, source: Source) -> Iterator[Fault]:
    """Yield all that is wrong with the numbers of a recipe, or with its file of curves."""
    if source.path.suffix != ".toml":
        yield fault("commands know a camera recipe by its suffix; call the file NAME.toml", "name")
    if isinstance(recipe, PhaseRecipe):
        return
    wrong = list(camera_faults(recipe))
    yield from wrong
    declared = recipe.responsivity
    if declared.file is not None:
        work = (responsivity, declared, recipe.cfa.channels, source.path.parent)
        if not any(each.keys[0][0] in ("responsivity", "cfa") for each in wrong):
            yield from source.attempt(FILE, *work)


def meaning(recipe: CameraRecipe | PhaseRecipe, source: Source) -> tuple[dict[str, Any], list[Fault]]:
    """Return the camera in figures, and a note on columns of its file of curves."""
    return describe(load_camera(source.path)) | {"note": columns_left_out(source.path)}, []


def describe(camera: CameraModel) -> dict[str, Any]:
    """Return the curves of each channel, its share of what the brightest collects of a white, and the exposures that fill a
    pixel. InputFileError if it collects nothing."""
    lights = {name: make_light(name, {}, camera.wavelength) for name in LIGHTS}
    rates = {name: white_rates(camera, light) * camera.channel_gains for name, light in lights.items()}  # of 1 cd/m²
    if dark := [name for name, rate in rates.items() if not rate.max() > 0]:
        raise InputFileError(f"camera {camera.name} collects nothing of {' and '.join(dark)}; check responsivity")
    _ = camera.saturation_exposure  # the same of the light of its own wavelengths alone
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
