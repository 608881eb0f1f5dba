"""One frame: a scene under a light, through lens and sensor, beside the picture it should become (METHOD 1.2, 1.3, 2)."""

import numpy as np

from l3cli.artifacts.camera import CameraModel
from l3cli.artifacts.training_set import TrainingFrame
from l3cli.scene import Scene
from l3cli.simulate import sensor
from l3cli.simulate.light import Light, electron_weights, xyz_weights
from l3cli.simulate.optics import blurred_channels, project, relative_illumination
from l3cli.simulate.recipe import Lens


def simulate(
    camera: CameraModel, scene: Scene, light: Light, exposure: float, lens: Lens, seed: tuple[int, ...]
) -> TrainingFrame:
    """What the camera collects of `scene` under `light` in `exposure` seconds, and the XYZ picture without lens or noise.

    One scene sample is one pixel: its average over the pixel's area, so that frame and target are registered.
    """
    white = xyz_weights(light, light.wavelength).sum(axis=1)
    target = project(scene.reflectance, xyz_weights(light, scene.wavelength))
    weights = electron_weights(camera, light, scene.wavelength) * exposure
    if lens.diffraction:
        pitch, f_number = camera.pixel_pitch, camera.optics.f_number
        electrons = blurred_channels(scene.reflectance, weights, scene.wavelength, f_number, pitch)
    else:
        electrons = project(scene.reflectance, weights)
    if lens.off_axis:
        electrons = electrons * relative_illumination(camera.optics, camera.pixel_pitch, electrons.shape[1:])
    electrons = np.maximum(electrons, np.float32(0.0))  # diffraction of a point may ring below zero
    raw = sensor.expose(camera, sensor.mosaic(electrons, camera.cfa), exposure, np.random.default_rng(seed))
    return TrainingFrame(
        electrons=electrons,
        raw=raw,
        target=target,
        white=white,
        scene=scene.name,
        illuminant=light.name,
        luminance=light.luminance,
        exposure=exposure,
        seed=seed,
    )
