"""Pictures of an evaluated frame: the result of every pipeline, the ideal, an error map, and the colours of a chart."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.training_set import LightSpectrum, TrainingPair
from l3cli.physics import spectra
from l3cli.physics.display import displayed, displayed_delta_e, scene_xyz, srgb_codes, white_luminance

Array = NDArray[np.floating]
Picture = NDArray[np.uint8]
Region = tuple[slice, slice]  # rows and columns of a patch
INNER = 0.5  # fraction of a patch's side that is evaluated; pixels near the edges mix with the surroundings
EVEN = 0.01  # largest standard deviation of the target within a patch, relative to white
ALIKE = 0.02  # largest difference between the mean of a patch and its value on the chart, relative to white
ERROR_WHITE = 10.0  # ΔE00 shown as white in an error map; 0 is black
RAMP = np.array([[0, 0, 0], [70, 10, 110], [190, 40, 90], [245, 140, 30], [255, 255, 255]])  # sRGB, in steps of 2.5 ΔE00


def frame_pictures(frame: TrainingPair, planes: dict[str, Array]) -> dict[str, Picture]:
    """Return pictures of a frame, all at the target's exposure.

    Parameters
    ----------
    frame : TrainingPair
        Frame with its target.
    planes : dict of str to ndarray, (3, row, col)
        Pipeline → XYZ in the target's unit. The first pipeline is the table.

    Returns
    -------
    dict of str to ndarray, (row, col, 3)
        8-bit sRGB picture of each pipeline, and of the target ("ideal"), and the `error_map` of the table ("error").
    """
    scale = white_luminance(frame.target[1])
    ideal = displayed(frame.target, frame.white, scale)
    shown = {name: displayed(of, frame.white, scale) for name, of in planes.items()}
    ours = next(iter(shown.values()))
    pictures = {name: srgb_codes(linear) for name, linear in shown.items()}
    return {**pictures, "ideal": srgb_codes(ideal), "error": error_map(displayed_delta_e(ours, ideal))}


def planes_of(picture: Array, frame: TrainingPair) -> Array:
    """Convert another pipeline's picture of a frame to XYZ planes (3, row, col) in the target's unit.

    The picture (row, col, 3) is linear sRGB of any brightness. Its luminance is scaled to that of the target by least
    squares over the pixels that do not clip.
    """
    planes = scene_xyz(picture, frame.white, 1.0)
    shown, wanted = (of[1][picture.max(axis=2) < 1.0] for of in (planes, frame.target))
    square = float((shown**2).sum())
    return planes * (float((shown * wanted).sum()) / square if square > 0 else frame.white[1])


def error_map(difference: Array) -> Picture:
    """Convert ΔE00 (row, col) to colours (row, col, 3).

    0 is black, 2.5 purple, 5 red, 7.5 orange, and 10 or more is white.
    """
    place = np.clip(difference / ERROR_WHITE, 0.0, 1.0) * (len(RAMP) - 1)
    stops = np.arange(len(RAMP))
    return np.stack([np.interp(place, stops, RAMP[:, part]) for part in range(3)], axis=-1).round().astype(np.uint8)


# ---------------------------------------------------------------------------------------------------- patches of a chart


@dataclass(frozen=True)
class PatchColours:
    """Displayed colours of chart patches in the ideal and in each pipeline, as linear sRGB (patch, 3), and ΔE00 (patch)."""

    ideal: Array
    shown: dict[str, Array]
    delta_e: dict[str, Array]


def holds_chart(frame: TrainingPair, light: LightSpectrum | None, regions: list[Region]) -> bool:
    """Whether the target (XYZ) shows the patches of a ColorChecker.

    Parameters
    ----------
    frame : TrainingPair
        Frame with its target.
    light : LightSpectrum or None
        Illuminant of the target.
    regions : list of (slice, slice)
        Rows and columns of the patches.
    """
    if light is None or any(min(rows.stop - rows.start, cols.stop - cols.start) < 4 for rows, cols in regions):
        return False
    wavelength = light.wavelength
    _, reflectance = spectra.colorchecker(wavelength)
    weights = spectra.xyz_weights(wavelength) * light.radiance
    expected = reflectance @ weights.T / weights[1].sum()
    patches = [frame.target[:, rows, cols].astype(np.float64) / frame.white[1] for rows, cols in map(inner, regions)]
    even = max(float(patch.std(axis=(1, 2)).max()) for patch in patches) < EVEN
    means = np.array([patch.mean(axis=(1, 2)) for patch in patches])
    return even and bool(np.abs(means - expected).max() < ALIKE)


def patch_colours(frame: TrainingPair, planes: dict[str, Array], regions: list[Region]) -> PatchColours:
    """Return the mean displayed colour of each patch in the target and in every pipeline, at the target's exposure.

    Parameters
    ----------
    frame : TrainingPair
        Frame with its target.
    planes : dict of str to ndarray, (3, row, col)
        Pipeline → XYZ in the target's unit.
    regions : list of (slice, slice)
        Rows and columns of the patches.
    """
    scale = white_luminance(frame.target[1])
    ideal = displayed(_means(frame.target, regions), frame.white, scale)
    shown = {name: displayed(_means(of, regions), frame.white, scale) for name, of in planes.items()}
    errors = {name: displayed_delta_e(of, ideal)[0] for name, of in shown.items()}
    return PatchColours(ideal[0], {name: of[0] for name, of in shown.items()}, errors)


def inner(region: Region) -> Region:
    """Return the central region of a patch."""
    rows, cols = (
        slice(each.start + round(cut), each.stop - round(cut))
        for each in region
        for cut in [(each.stop - each.start) * (1 - INNER) / 2]
    )
    return rows, cols


def _means(planes: Array, regions: list[Region]) -> Array:
    """Return the means (3, 1, patch) of the patches."""
    means = [planes[:, rows, cols].mean(axis=(1, 2), dtype=np.float64) for rows, cols in map(inner, regions)]
    return np.array(means).T[:, None]
