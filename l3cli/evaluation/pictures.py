"""Pictures of an evaluated frame: every pipeline beside the ideal, and where ours errs."""

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.training_set import TrainingPair
from l3cli.physics.display import displayed, displayed_delta_e, scene_xyz, srgb_codes, white_luminance

Array = NDArray[np.floating]
Picture = NDArray[np.uint8]
ERROR_WHITE = 10.0  # ΔE00 shown white in an error map; 0 is black
RAMP = np.array([[0, 0, 0], [70, 10, 110], [190, 40, 90], [245, 140, 30], [255, 255, 255]])  # sRGB, each 2.5 ΔE00 further


def frame_pictures(frame: TrainingPair, planes: dict[str, Array]) -> dict[str, Picture]:
    """Return sRGB pictures (row, col, 3) by name: "ideal", each pipeline of `planes` (XYZ (3, row, col) in the target's
    unit), and "error", the ΔE00 of the first of them, ours, by `error_map`. All are shown on the target's scale."""
    scale = white_luminance(frame.target[1])
    ideal = displayed(frame.target, frame.white, scale)
    shown = {name: displayed(of, frame.white, scale) for name, of in planes.items()}
    ours = next(iter(shown.values()))
    pictures = {name: srgb_codes(linear) for name, linear in shown.items()}
    return {**pictures, "ideal": srgb_codes(ideal), "error": error_map(displayed_delta_e(ours, ideal))}


def planes_of(picture: Array, frame: TrainingPair) -> Array:
    """Return XYZ planes (3, row, col) in the target's unit of a picture (row, col, 3) of a frame by another pipeline.

    The picture is linear sRGB of any brightness: one factor brings it to that of the target, by least squares of luminance
    where it does not clip."""
    planes = scene_xyz(picture, frame.white, 1.0)
    shown, wanted = (of[1][picture.max(axis=2) < 1.0] for of in (planes, frame.target))
    square = float((shown**2).sum())
    return planes * (float((shown * wanted).sum()) / square if square > 0 else frame.white[1])


def error_map(difference: Array) -> Picture:
    """Return ΔE00 (row, col) as colours (row, col, 3): black 0, purple 2.5, red 5, orange 7.5, white 10 and more."""
    place = np.clip(difference / ERROR_WHITE, 0.0, 1.0) * (len(RAMP) - 1)
    stops = np.arange(len(RAMP))
    return np.stack([np.interp(place, stops, RAMP[:, part]) for part in range(3)], axis=-1).round().astype(np.uint8)
