"""A real raw frame and the picture it should become, as training takes them."""

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.camera import CameraModel
from l3cli.artifacts.training_set import TrainingPair
from l3cli.frames.frame import RawFrame, as_taken
from l3cli.physics import spectra
from l3cli.simulation.light import make_light, white_rates
from l3cli.simulation.recipe import Pair

LIGHT = "picture"  # the light of a pair: whatever it was, its picture shows it as D65
BRIGHT = 0.9  # of full scale and of picture white: brighter pixels do not tell the scale


def make_pair(
    raw: RawFrame, picture: NDArray[np.float32], outputs: tuple[str, ...], camera: CameraModel, pair: Pair, name: str
) -> TrainingPair:
    """Return the pair of `raw` and a linear `picture` (row, col, output) that is upright as the camera was held.

    Both are cut so that they begin with CFA site (0, 0). The picture's values times `pair.scale` are shares of full scale of
    a white as bright; without it the scale is that of a grey world. ValueError if the picture reaches beyond the raw frame,
    or this beyond the camera's bits.
    """
    picture = as_taken(picture, raw.orientation)
    own_levels = (raw.black_level, raw.white_level) == (camera.black_level, camera.white_level)
    if own_levels and raw.values.max() >= 2**camera.bits:
        raise ValueError(f"the raw frame holds {raw.values.max()} DN, more than {camera.bits} bits; check sensor.bits")
    levelled = raw.at_levels(camera.black_level, camera.white_level, camera.bits).values
    rows, cols = picture.shape[:2]
    top, left = pair.offset
    if top + rows > levelled.shape[0] or left + cols > levelled.shape[1]:
        raise ValueError(
            f"the picture of {rows}×{cols} at offset {top}, {left} reaches beyond the raw frame of "
            f"{levelled.shape[0]}×{levelled.shape[1]}; cut it to what the raw shows"
        )
    down, across = (
        -(phase + start) % period for phase, start, period in zip(raw.phase, pair.offset, camera.cfa.shape, strict=True)
    )
    if down >= rows or across >= cols:
        raise ValueError("the picture is smaller than the CFA's super-pixel")
    values = levelled[top + down : top + rows, left + across : left + cols]
    wanted = np.moveaxis(picture[down:, across:], 2, 0)
    scale = pair.scale / raw.light_share if pair.scale else _grey_world_scale(values, wanted, camera)
    white = spectra.white_point("D65") if outputs == ("X", "Y", "Z") else np.ones(len(outputs))
    unit = scale * camera.saturation_exposure  # one second's exposure
    return TrainingPair(
        raw=np.ascontiguousarray(values),
        target=np.ascontiguousarray(wanted * np.float32(unit)),
        white=white * unit,
        scene=name,
        illuminant=LIGHT,
        luminance=unit,
        exposure=1.0,
    )


def _grey_world_scale(values: NDArray[np.uint16], picture: NDArray[np.float32], camera: CameraModel) -> float:
    """Return the share of full scale per picture value, from the means of both, were the scene grey under D65."""
    share = (values - camera.black_level) / (camera.white_level - camera.black_level)
    bright = picture[1] if len(picture) == 3 else picture.mean(axis=0)
    usable = (share < BRIGHT) & (bright < BRIGHT)
    if not usable.any() or bright[usable].mean() <= 0:
        raise ValueError("the picture is black or white everywhere; give another, or scale")
    rates = white_rates(camera, make_light("D65", {}, camera.wavelength))
    response = (rates / rates.max())[camera.cfa].mean()
    return float(max(share[usable].mean(), 1e-6) / response / bright[usable].mean())
