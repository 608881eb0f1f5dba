"""One frame: a scene under a light, through lens and sensor, beside its target (docs/method.md#simulation)."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.camera import CameraModel
from l3cli.artifacts.training_set import Shown, TrainingFrame
from l3cli.frames.scene import ChannelPicture, Scene
from l3cli.physics.lens import relative_illumination
from l3cli.simulation import optics, sensor
from l3cli.simulation.light import Light, electron_weights, white_rates
from l3cli.simulation.recipe import Lens
from l3cli.simulation.targets import XYZ, Target, output_weights


@dataclass(frozen=True)
class Saturating:
    """An exposure that makes this share of all pixels reach full scale."""

    share: float


@dataclass(frozen=True)
class Averaging:
    """An exposure that makes the mosaic's mean reach this share of full scale, were nothing clipped."""

    share: float


def simulate(
    camera: CameraModel,
    scene: Scene | ChannelPicture,
    light: Light,
    exposure: float | Saturating | Averaging,
    lens: Lens,
    seed: tuple[int, ...],
    target: Target = XYZ,
    noises: str = "all",
) -> TrainingFrame:
    """Return the signals that the camera collects of `scene` under `light` in `exposure` seconds, and the picture without
    lens or noise.

    One scene sample is one pixel: its average over the pixel's area, so that frame and target are registered. The chain is
    linear up to the noise, so the bands are first projected on outputs and channels in one product: a wavelength-dependent
    blur needs the channels a few times (LOW_RANK_ERROR), nothing needs the bands again. Of a picture of channel signals only
    the sensor is simulated. ValueError if an automatic exposure finds no light.
    """
    ideal, rates, white = _seen(camera, scene, light, lens, target)
    seconds = _seconds(camera, rates, exposure)
    electrons = rates * np.float32(seconds)
    rng = np.random.default_rng(seed)
    return TrainingFrame(
        electrons=electrons,
        raw=sensor.expose(camera, sensor.mosaic(electrons, camera.cfa), seconds, rng, noises),
        target=ideal,
        white=white,
        scene=scene.name,
        illuminant=light.name,
        luminance=light.luminance,
        exposure=seconds,
        light=light.spectrum,
        seed=seed,
        shown=Shown(scene.fingerprint, light.measured),
    )


def exposure_time(
    camera: CameraModel, scene: Scene | ChannelPicture, light: Light, exposure: Saturating | Averaging, lens: Lens
) -> float:
    """Return the seconds of an automatic exposure, as `simulate` takes them of this scene; ValueError as there."""
    return _seconds(camera, _seen(camera, scene, light, lens, XYZ)[1], exposure)


def _seen(
    camera: CameraModel, scene: Scene | ChannelPicture, light: Light, lens: Lens, target: Target
) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float64]]:
    """Return as `_collected` does, and the target (output) of a perfect white."""
    if isinstance(scene, ChannelPicture):
        return _signalled(camera, scene, light)
    ideal, rates = _collected(camera, scene, light, lens, target)
    return ideal, rates, output_weights(target, camera, light, light.wavelength).sum(axis=1)


def _collected(
    camera: CameraModel, scene: Scene, light: Light, lens: Lens, target: Target
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return the picture without lens or noise (output, row, col), and what the channels collect (channel, row, col)
    e-/s."""
    bands, pitch = scene.wavelength, camera.pixel_pitch
    wanted = output_weights(target, camera, light, bands)
    collected = electron_weights(camera, light, bands)
    transfer = optics.lens_transfer(camera.optics, pitch, bands, lens.diffraction, lens.defocus_um * 1e-6)
    terms = np.ones((1, bands.size)) if transfer is None else transfer.spectral
    unit = (
        collected.max() or 1.0
    )  # taken out of what is rounded to float32, so that rounding is the same for every luminance
    through = (collected[:, None] / unit * terms).reshape(-1, bands.size)
    planes = optics.project(scene.reflectance, np.concatenate([wanted, through]))
    ideal, rates = planes[: len(wanted)], planes[len(wanted) :]
    if transfer is not None:
        shape = (len(collected), len(terms), *rates.shape[1:])
        rates = optics.blurred_channels(rates.reshape(shape), transfer, pitch)
        np.maximum(rates, 0.0, out=rates)  # diffraction of a point may ring below zero
    rates *= np.float32(unit)
    if lens.off_axis:
        distance, shape = camera.optics.image_distance, (rates.shape[1], rates.shape[2])
        rates *= relative_illumination(distance, pitch, shape).astype(np.float32)
    return ideal, rates


def _signalled(
    camera: CameraModel, picture: ChannelPicture, light: Light
) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float64]]:
    """Return, of a picture of channel signals, the target (channel, row, col) in the unit of the camera's bands, the
    signals that the channels collect (channel, row, col) e-/s, and the target's white (channel)."""
    full = (white_rates(camera, light) * camera.channel_gains).max()
    white = full * camera.saturation_exposure / camera.full_scale
    signal = np.moveaxis(picture.signal, -1, 0)
    rates, ideal = (np.ascontiguousarray(signal * np.float32(unit)) for unit in (full, white))
    if camera.readout is not None:
        rates *= (camera.sensitivity / camera.channel_gains).astype(np.float32)[:, None, None]
    return ideal, rates, np.full(len(signal), white)


def _seconds(camera: CameraModel, rates: NDArray[np.float32], exposure: float | Saturating | Averaging) -> float:
    """Return the exposure in seconds."""
    if isinstance(exposure, Saturating):
        return sensor.saturating_exposure(camera, sensor.mosaic(rates, camera.cfa), exposure.share)
    if isinstance(exposure, Averaging):
        return sensor.averaging_exposure(camera, sensor.mosaic(rates, camera.cfa), exposure.share)
    return exposure
