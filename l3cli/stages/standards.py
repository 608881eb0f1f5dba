"""Figures of standards of a table: edges and greys are simulated for its camera, and every pipeline renders them."""

import dataclasses
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.camera import CameraModel
from l3cli.artifacts.training_set import TrainingFrame
from l3cli.evaluation import standards
from l3cli.frames.scene import NO_ILLUMINANT, SHOWN, Scene
from l3cli.physics import spectra
from l3cli.physics.display import XYZ
from l3cli.simulation.frame import simulate
from l3cli.simulation.light import Light, automatic_exposure, make_light
from l3cli.simulation.procedural import slanted_edge, surface_patches
from l3cli.simulation.recipe import Lens
from l3cli.simulation.sensor import expose

Planes = Callable[[TrainingFrame], dict[str, NDArray[np.floating]]]  # of every pipeline
BRIGHT = 1e4  # cd/m² of a white behind edges, for exposures in which dark current does not count
LUX = 1e-9, 1e9  # within which a camera may need light
BANDS = np.array([*np.arange(SHOWN[0], SHOWN[1], 20.0), SHOWN[1]])  # nm: diffraction differs between them


def standard_figures(camera: CameraModel, outputs: tuple[str, ...], planes: Planes) -> dict[str, Any]:
    """Return the part "standards" of the document of `l3 evaluate` (docs/measurement.md), computed from frames of `camera`,
    of which the pipelines of an evaluation make `planes` (output, row, col)."""
    camera = dataclasses.replace(camera, rows=standards.SIDE, cols=standards.SIDE, flat_field=None, defects=None)
    light = make_light(standards.LIGHT, {}, camera.wavelength).at(BRIGHT)
    document: dict[str, Any] = {"edge": {}, "grey": None, "chart": None}
    eye = spectra.xyz_weights(light.wavelength)[1] * light.radiance
    for across in ("rows", "columns"):
        made = {
            name: standards.brightness(each, outputs) for name, each in planes(edge_frame(camera, light, across)).items()
        }
        document["edge"][across] = standards.edge_document(made, (camera, light.wavelength, eye), across)
    if camera.absolute:
        document["grey"] = _greys(camera, light, outputs, planes)
    if outputs == XYZ and camera.responsivity_band.any():
        document["chart"] = _chart(camera, light, planes)
    document["figures"] = standards.figures_of(document)
    return document


def edge_frame(camera: CameraModel, light: Light, across: str) -> TrainingFrame:
    """Return the frame, without noise, of an edge that is nearly vertical, to be read across "rows", or else nearly
    horizontal."""
    size = standards.SIDE, standards.SIDE
    cube = slanted_edge(size, BANDS, standards.ANGLE, standards.DARK_SIDE, standards.BRIGHT_SIDE)
    scene = Scene("edge", BANDS, cube if across == "rows" else cube.swapaxes(0, 1), NO_ILLUMINANT)
    return simulate(camera, scene, light, automatic_exposure(camera, light, standards.EXPOSED), Lens(), (0,), noises="none")


def _chart(camera: CameraModel, light: Light, planes: Planes) -> dict[str, Any]:
    """Return the mean ΔE00 between pictures of a chart, without noise, by cameras that the band of the curves allows and by
    `camera`, all through the pipelines of `camera`."""
    size = standards.SIDE, standards.SIDE
    cube = surface_patches(np.random.default_rng(0), standards.PATCHES, size, BANDS)
    scene, seconds = Scene("chart", BANDS, cube, NO_ILLUMINANT), automatic_exposure(camera, light, standards.EXPOSED)
    seen: dict[str, list[NDArray[np.floating]]] = {}
    for each in (camera, *standards.drawn_cameras(camera, np.random.default_rng(0))):
        frame = simulate(each, scene, light, seconds, Lens(), (0,), noises="none")
        for name, made in planes(frame).items():
            seen.setdefault(name, []).append(standards.patch_means(made))
    different = {
        name: [standards.colour_differences(one, first, frame.white) for one in rest]
        for name, (first, *rest) in seen.items()
    }
    return {"cameras": standards.DRAWN, "delta_e": {name: float(np.mean(each)) for name, each in different.items()}}


def _greys(camera: CameraModel, light: Light, outputs: tuple[str, ...], planes: Planes) -> dict[str, Any] | None:
    """Return signal over noise of greys; None if no channel ever reaches the ratio that is asked for,
    or dark current alone fills its pixels."""
    side, part = (standards.RAW_SIDE,) * 2, np.s_[: standards.GREY_SIDE, : standards.GREY_SIDE]
    camera, channel = dataclasses.replace(camera, rows=side[0], cols=side[1]), camera.channel_map(side)
    cube = np.full((standards.GREY_SIDE, standards.GREY_SIDE, 2), standards.GREY, np.float32)
    scene = Scene("grey", np.array(SHOWN), cube, NO_ILLUMINANT)
    frame = simulate(camera, scene, light.at(1 / np.pi), standards.EXPOSURE, Lens(diffraction=False), (0,), noises="none")
    if camera.dark_signal(frame.exposure) >= camera.white_level - camera.black_level:
        return None
    noise = standards.GreyNoise.of(camera, frame)
    known = [lux for lux in noise.lux() if lux is not None and LUX[0] < lux < LUX[1]]
    if not known:
        return None
    lux = min(known) * 2.0**standards.OCTAVES
    raw, snr = np.zeros((lux.size, len(camera.channels))), dict[str, NDArray[np.floating]]()
    one_lux, black = frame.electrons[:, 0, 0][channel], camera.black_level + camera.dark_signal(frame.exposure)
    for index, each in enumerate(lux.tolist()):
        values = expose(camera, one_lux * np.float32(each), frame.exposure, np.random.default_rng([1, index]))
        raw[index] = [standards.measured_snr(values[channel == one] - black) for one in range(len(camera.channels))]
        of_lux = dataclasses.replace(frame, raw=values[part], luminance=each / np.pi, white=frame.white * each)
        for name, made in planes(of_lux).items():
            snr.setdefault(name, np.zeros(lux.size))[index] = standards.measured_snr(standards.brightness(made, outputs))
    return standards.grey_document(camera, noise, lux, raw, snr)
