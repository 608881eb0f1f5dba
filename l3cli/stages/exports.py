"""Camera model → files that other software reads: curves, colour matrices, tuning files, a data sheet."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.camera import CameraModel
from l3cli.artifacts.camera_recipe import camera_files, load_camera
from l3cli.artifacts.store import open_artifact
from l3cli.artifacts.table import TransformTable
from l3cli.errors import InputFileError
from l3cli.export import camera_profile, profiles
from l3cli.export.camera_profile import datasheet
from l3cli.export.profiles import export_curves, export_paths
from l3cli.options.tools import ExportOptions
from l3cli.stages.claims import OutputGuard
from l3cli.stages.plan import Made, before_work
from l3cli.system.console import Console
from l3cli.system.files import write_whole
from l3cli.system.text import printable

DATASHEET, DCP = "datasheet.csv", "dcp.json"
RASPBERRY_PI, SIMPLE = "libcamera_rpi.json", "libcamera_simple.yaml"


def is_table(path: Path) -> bool:
    """Return whether a file holds a transform table and no camera; InputFileError if it holds neither."""
    if path.suffix == ".toml":
        return False
    with open_artifact(path) as root:
        kind = str(root.attrs["kind"])
    if kind not in (CameraModel.kind, TransformTable.kind):
        raise InputFileError(f"{path} holds a {kind}; give a camera model or recipe, or a transform table")
    return kind == TransformTable.kind


def always(folder: Path) -> list[Path]:
    """The files that every camera is exported to."""
    return [*export_paths(folder), folder / DATASHEET]


def by_array(folder: Path, channels: Sequence[str], cfa: NDArray[np.integer]) -> list[Path]:
    """The further files that cameras of an array may be exported to."""
    names = [DCP] if len(channels) >= camera_profile.LEAST_CHANNELS else []
    names += [RASPBERRY_PI, SIMPLE] if camera_profile.bayer_order(channels, cfa) else []
    return [folder / name for name in names]


def export(camera: Path, output: Path, options: ExportOptions) -> dict[str, dict[str, dict[str, Any]]]:
    """Write a camera (model or recipe) into a folder, as `l3 calibrate --export` does; the errors of its matrices, for each
    light. RecipeError or InputFileError if it is no camera, L3Error if a file cannot be written."""
    console, force = options.console, options.force
    with OutputGuard(console) as claims:
        claims.protect(camera, *camera_files(camera))
        for path in always(output):
            claims.claim_file(path, force)
        model = load_camera(camera)
        further = by_array(output, model.channels, model.cfa)
        for path in further:
            claims.claim_file(path, force)
        made = (Made(path, "export") for path in (*always(output), *further))
        before_work({"camera": camera_files(camera)}, *made)
        matrices = write(model, output, console)
        written = [*always(output), *(further if matrices else [])]
        console.info(f"{output}: {', '.join(path.name for path in written)} written")
        return matrices


def write(camera: CameraModel, folder: Path, console: Console) -> dict[str, dict[str, dict[str, Any]]]:
    """Write all files; what is left out is told. The errors of the matrices, for each light."""
    camera = replace(camera, name=printable(camera.name))  # that of a file may hold bytes that are no text
    lights = {name: camera_profile.light_matrices(camera, name) for name in camera_profile.TEMPERATURES}
    known = {name: matrices for name, matrices in lights.items() if matrices is not None}
    export_curves(camera, folder)
    write_whole(folder / DATASHEET, profiles.datasheet_csv(datasheet(camera)))
    if missing := [name for name in lights if name not in known]:
        few = len(camera.channels) < camera_profile.LEAST_CHANNELS
        reason = "it has fewer than three channels" if few else f"a channel sees next to nothing of {missing[0]}"
        console.report(f"{camera.name}: no colour matrices and no tuning files: {reason}")
        return {}
    planes = list(
        camera_profile.rgb_order(camera.channels) or range(len(camera.channels))
    )  # raw files have r, g, b in this order
    parts = {
        name: profiles.ProfileMatrices(each.neutral[planes], each.colour.values[planes], each.forward.values[:, planes])
        for name, each in known.items()
    }
    names = [camera.channels[plane] for plane in planes]
    write_whole(folder / DCP, profiles.dcp_json(camera.name, names, parts))
    order = camera_profile.bayer_order(camera.channels, camera.cfa)
    if order is None:
        console.report(f"{camera.name}: no tuning files for libcamera, which knows 2×2 arrays of r, g and b alone")
    else:
        tuning = _tuning(camera, known, order)
        write_whole(folder / RASPBERRY_PI, profiles.raspberry_pi_json(camera.name, tuning))
        write_whole(folder / SIMPLE, profiles.simple_yaml(camera.name, tuning))
    kinds = ("CCM", "ForwardMatrix", "ColorMatrix")
    return {
        name: {kind: camera_profile.errors(each)[kind] for kind in kinds if kind == "CCM" or name in profiles.ILLUMINANTS}
        for name, each in known.items()
    }


def _tuning(
    camera: CameraModel, known: dict[str, camera_profile.LightMatrices], order: tuple[int, int, int]
) -> profiles.Tuning:
    corrections = {camera_profile.TEMPERATURES[name]: each.correction.values[:, order] for name, each in known.items()}
    curve, noise = camera_profile.temperature_curve(camera, order), camera_profile.noise_profile(camera)
    return profiles.Tuning(camera_profile.black_level_16(camera), corrections, curve, noise)
