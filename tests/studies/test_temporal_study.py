"""Benefit of the temporal filter in static areas, and its cost in moving areas.

python -m pytest -m slow -s tests/studies/test_temporal_study.py      all metrics (15 minutes of processor time)

Scenes are larger than a frame and move over the simulated sensor at a mean signal of 0.02 of full scale: a static scene,
pans of 0.5, 1, 4 and 7 pixels per frame, a zoom, slow and fast objects in front of a static background, and a cut. The PSNR
compares the displayed picture with the ideal picture. Noise is the standard deviation over time in a static scene. One table
renders all frames twice: only with the usual set of transforms, and with both sets.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates, zoom

from l3cli.artifacts.camera import CameraModel
from l3cli.artifacts.camera_recipe import load_camera
from l3cli.artifacts.store import load
from l3cli.artifacts.table import TransformTable
from l3cli.cli import run
from l3cli.frames.frame import RawFrame
from l3cli.frames.scene import NO_ILLUMINANT, Scene
from l3cli.physics.display import displayed, srgb_curve, white_luminance
from l3cli.rendering.renderer import NoiseRenderer
from l3cli.rendering.temporal.chunks import filters
from l3cli.simulation import procedural, sensor
from l3cli.simulation.frame import simulate
from l3cli.simulation.light import make_light
from l3cli.simulation.recipe import Lens
from l3cli.simulation.sensor import averaging_exposure
from tests.helpers.paths import CONFIGS

SIDE, DRAWN, BORDER = 256, 640, 16  # pixels: of a frame, of what is drawn, left out at its edge
COUNT, SETTLED = 18, 9  # frames, and those before the noise has fallen
LEVEL = 0.02  # mean signal, share of full scale
Planes = NDArray[np.float32]
KINDS = ("static", "pan 0.5", "pan 1", "pan 4", "pan 7", "zoom", "object", "slow object", "cut")


@dataclass(frozen=True)
class Drawn:
    """A scene: what its channels collect, e-, and its XYZ in the unit of outputs, both (plane, row, col)."""

    planes: Planes
    channels: int
    seconds: float


@pytest.fixture(scope="module", params=["bayer", "fiveband"])
def made(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> tuple[CameraModel, TransformTable]:
    """A camera and its default table of two sets."""
    folder, name = tmp_path_factory.mktemp("temporal"), request.param
    recipe = (CONFIGS / "classes/default.toml").read_text().replace("[learning]\n", "[learning]\nnoise_left = 0.125\n")
    (folder / "two.toml").write_text(recipe)
    for command in (
        ("simulate", "default", "--camera", name, "-o", folder / "training.h5", "--jobs", 2),
        ("train", folder / "training.h5", "--classes", folder / "two.toml", "-o", folder / "table.h5", "--jobs", 2),
    ):
        assert run([*map(str, command), "--quiet"]) == 0
    return load_camera(CONFIGS / f"cameras/{name}.toml"), load(TransformTable, folder / "table.h5")


def drawn(camera: CameraModel, seed: int, larger: int = 1) -> Drawn:
    """A scene of dead leaves; `larger`: so many times, and smoother, as through a longer lens."""
    wavelength = procedural.grid(camera.wavelength)
    cube = procedural.dead_leaves(np.random.default_rng(seed), (DRAWN, DRAWN), wavelength)
    light = make_light("D65", {}, camera.wavelength).at(100.0)
    scene = Scene("leaves", wavelength, cube, NO_ILLUMINANT)
    frame = simulate(camera, scene, light, partial(averaging_exposure, share=LEVEL), Lens(), (seed,))
    planes = np.concatenate([frame.electrons, frame.target * np.float32(frame.exposure)])
    part = planes[:, : DRAWN // larger, : DRAWN // larger]
    planes = part if larger == 1 else np.stack([zoom(plane, larger, order=1) for plane in part])
    return Drawn(planes, len(frame.electrons), frame.exposure)


def window(planes: Planes, row: float, col: float, zoom: float = 1.0) -> Planes:
    """A frame's part of planes, from (row, col) on, about whose middle it is shrunk."""
    down, across = np.indices((SIDE, SIDE)) - SIDE / 2
    place = [down * zoom + SIDE / 2 + row, across * zoom + SIDE / 2 + col]
    return np.stack([map_coordinates(plane, place, order=1, mode="mirror") for plane in planes]).astype(np.float32)


def moving(kind: str, scene: Planes, other: Planes) -> Iterator[Planes]:
    """The planes of every frame."""
    down, across = np.indices((SIDE, SIDE))
    pans = {"static": (0, 0), "pan 0.5": (0.3, 0.4), "pan 1": (0, 1), "pan 4": (0, 4), "pan 7": (2, 7)}
    discs = {"object": (60, 40, 2.7, 5.3), "slow object": (100, 60, 0.3, 0.7)}
    for i in range(COUNT):
        if kind in pans:
            yield window(scene, 100 + pans[kind][0] * i, 100 + pans[kind][1] * i)
        elif kind == "zoom":
            yield window(scene, 190, 190, 1.01**i)
        elif kind == "cut":
            yield window(scene if i < SETTLED + 4 else other, 100, 100)
        else:
            row, col, fall, drift = discs[kind]
            cover = np.clip(45.5 - np.hypot(down - row - fall * i, across - col - drift * i), 0, 1).astype(np.float32)
            yield window(scene, 100, 100) * (1 - cover) + window(other, 200 - fall * i, 200 - drift * i) * cover


def shown(xyz: NDArray[Any], table: TransformTable, scale: float) -> NDArray[Any]:
    return srgb_curve(displayed(xyz, table.white_point, scale))[BORDER:-BORDER, BORDER:-BORDER]


def psnr(one: NDArray[Any], other: NDArray[Any]) -> float:
    return float(-10 * np.log10(np.mean((one - other) ** 2)))


def part_of_pattern(camera: CameraModel) -> sensor.FixedPattern:
    """What the pixels of a frame differ by."""
    whole = sensor.fixed_pattern(camera)
    return sensor.FixedPattern(whole.prnu[:SIDE, :SIDE], whole.dsnu[:SIDE, :SIDE])


@pytest.mark.slow
@pytest.mark.parametrize("larger", [1, 2])
def test_gains_and_losses(made: tuple[CameraModel, TransformTable], larger: int) -> None:
    camera, table = made
    usual, both = (NoiseRenderer("opencl", each) for each in (replace(table, conditions=()), table))
    make = filters("opencl", table)
    pattern = part_of_pattern(camera)
    scenes = [drawn(camera, seed, larger) for seed in (1, 2, 3, 4, 5, 6)]
    columns = f"{'gain':>9} {'worst frame':>12} {'noise':>9}"
    print(f"\n{camera.name}, scenes {larger} times as large")
    print(f"{'':20} {'alone':>7} one set: {columns}   two sets: {columns}")
    for kind in KINDS:
        gains, alone, spreads = [], [], []
        for one, other in zip(scenes[::2], scenes[1::2], strict=True):
            filtering, pictures = make(), []
            for number, planes in enumerate(moving(kind, one.planes, other.planes)):
                mosaic = sensor.mosaic(planes[: one.channels], camera.cfa)
                rng = np.random.default_rng([7, number])
                values = sensor.read_out(camera, pattern, mosaic, one.seconds, rng)
                dark = camera.dark_signal(one.seconds)
                frame = RawFrame(str(number), values, camera.black_level, camera.white_level, dark=dark)
                target = planes[one.channels :]
                scale = white_luminance(target[1])
                filtered = filtering.filtered(frame)
                rendered = (usual.outputs(frame), usual.outputs(filtered), both.outputs(filtered))
                three = [shown(each * table.output_unit, table, scale) for each in rendered]
                ideal = shown(target, table, scale)
                alone.append(psnr(three[0], ideal))
                gains.append([psnr(each, ideal) - alone[-1] for each in three[1:]])
                pictures.append(three)
            settled = np.array(pictures[SETTLED:])
            spreads.append(settled.std(axis=0).mean(axis=(1, 2, 3)))
        noise = 20 * np.log10(spreads[0][1:] / spreads[0][0])
        later, worst = np.array(gains).reshape(-1, COUNT, 2)[:, SETTLED:].mean(axis=(0, 1)), np.min(gains, axis=0)
        figures = zip(later, worst, noise, strict=True)
        columns = " ".join(f"{gain:+18.2f} {least:+12.2f} {fall:+6.1f} dB" for gain, least, fall in figures)
        print(f"{kind:20} {np.mean(alone):7.2f} {columns}", flush=True)
        assert (worst > -0.1).all()
        assert kind != "static" or (noise < -6).all()
