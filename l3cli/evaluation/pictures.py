"""Pictures of an evaluated frame: pipelines, target, error map, and colours of chart patches."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.training_set import LightSpectrum, TrainingPair
from l3cli.physics import spectra
from l3cli.physics.display import displayed, displayed_delta_e, scene_xyz, srgb_codes, white_luminance

Array = NDArray[np.floating]
Picture = NDArray[np.uint8]
Region = tuple[slice, slice]  # rows and columns of a patch
INNER = 0.5  # evaluated fraction of a patch's height and width; the lens blurs the rest
MAX_PATCH_SIGMA = 0.01  # limit for the target's standard deviation within a chart patch, as a fraction of white
MAX_PATCH_ERROR = 0.02  # limit for the difference between a chart patch and its nominal value, as a fraction of white
ERROR_WHITE = 10.0  # ΔE00 that is white in an error map; 0 is black
# sRGB of the error map, in steps of 2.5 ΔE00
RAMP = np.array([[0, 0, 0], [70, 10, 110], [190, 40, 90], [245, 140, 30], [255, 255, 255]])


def frame_pictures(frame: TrainingPair, planes: dict[str, Array]) -> dict[str, Picture]:
    """Convert the results of all pipelines to sRGB pictures, with the display exposure of the target.

    Parameters
    ----------
    frame : TrainingPair
        Frame with its target.
    planes : dict of str to ndarray, (3, row, col)
        XYZ of each pipeline in the unit of the target, by name. The first pipeline must be the table.

    Returns
    -------
    dict of str to ndarray, (row, col, 3)
        8-bit sRGB picture of each pipeline, of the target ("ideal"), and the `error_map` of the table ("error").
    """
    scale = white_luminance(frame.target[1])
    ideal = displayed(frame.target, frame.white, scale)
    shown = {name: displayed(of, frame.white, scale) for name, of in planes.items()}
    ours = next(iter(shown.values()))
    pictures = {name: srgb_codes(linear) for name, linear in shown.items()}
    return {**pictures, "ideal": srgb_codes(ideal), "error": error_map(displayed_delta_e(ours, ideal))}


def planes_of(picture: Array, frame: TrainingPair) -> Array:
    """Convert the picture of another program (a rival) to XYZ in the unit of the target.

    The picture is scaled to the luminance of the target by a least-squares fit over all unclipped pixels.

    Parameters
    ----------
    picture : ndarray, (row, col, 3)
        Linear sRGB, with any exposure.
    frame : TrainingPair
        Frame with its target.

    Returns
    -------
    ndarray, (3, row, col)
        XYZ planes.
    """
    planes = scene_xyz(picture, frame.white, 1.0)
    shown, wanted = (of[1][picture.max(axis=2) < 1.0] for of in (planes, frame.target))
    square = float((shown**2).sum())
    return planes * (float((shown * wanted).sum()) / square if square > 0 else frame.white[1])


def error_map(difference: Array) -> Picture:
    """Convert ΔE00 (row, col) to a false-colour picture (row, col, 3) in 8-bit sRGB.

    0 is black, 2.5 is purple, 5 is red, 7.5 is orange, and 10 or more is white.
    """
    place = np.clip(difference / ERROR_WHITE, 0.0, 1.0) * (len(RAMP) - 1)
    stops = np.arange(len(RAMP))
    return np.stack([np.interp(place, stops, RAMP[:, part]) for part in range(3)], axis=-1).round().astype(np.uint8)


# ---------------------------------------------------------------------------------------------------- patches of a chart


@dataclass(frozen=True)
class PatchColours:
    """Displayed colours of chart patches, in the ideal picture and for each pipeline."""

    ideal: Array  # (patch, 3) linear sRGB
    shown: dict[str, Array]  # pipeline → (patch, 3) linear sRGB
    delta_e: dict[str, Array]  # pipeline → (patch,) ΔE00 from the ideal


def holds_chart(frame: TrainingPair, light: LightSpectrum | None, regions: list[Region]) -> bool:
    """Whether a frame's target shows the patches of a ColorChecker in the given regions.

    Parameters
    ----------
    frame : TrainingPair
        Frame with its XYZ target.
    light : LightSpectrum or None
        Illuminant of the target. With None, the result is False.
    regions : list of (slice, slice)
        Rows and columns of each patch. With fewer than 4 rows or columns in a patch, the result is False.
    """
    if light is None or any(min(rows.stop - rows.start, cols.stop - cols.start) < 4 for rows, cols in regions):
        return False
    wavelength = light.wavelength
    _, reflectance = spectra.colorchecker(wavelength)
    weights = spectra.xyz_weights(wavelength) * light.radiance
    expected = reflectance @ weights.T / weights[1].sum()
    patches = [frame.target[:, rows, cols].astype(np.float64) / frame.white[1] for rows, cols in map(inner, regions)]
    even = max(float(patch.std(axis=(1, 2)).max()) for patch in patches) < MAX_PATCH_SIGMA
    means = np.array([patch.mean(axis=(1, 2)) for patch in patches])
    return even and bool(np.abs(means - expected).max() < MAX_PATCH_ERROR)


def patch_colours(frame: TrainingPair, planes: dict[str, Array], regions: list[Region]) -> PatchColours:
    """Average the displayed colours of each patch, in the target and in every pipeline's picture.

    All pictures have the display exposure of the target.

    Parameters
    ----------
    frame : TrainingPair
        Frame with its target.
    planes : dict of str to ndarray, (3, row, col)
        XYZ of each pipeline in the unit of the target, by name.
    regions : list of (slice, slice)
        Rows and columns of each patch.
    """
    scale = white_luminance(frame.target[1])
    ideal = displayed(_means(frame.target, regions), frame.white, scale)
    shown = {name: displayed(_means(of, regions), frame.white, scale) for name, of in planes.items()}
    errors = {name: displayed_delta_e(of, ideal)[0] for name, of in shown.items()}
    return PatchColours(ideal[0], {name: of[0] for name, of in shown.items()}, errors)


def inner(region: Region) -> Region:
    """Return the central part of a patch, INNER times as high and wide."""
    rows, cols = (
        slice(each.start + round(cut), each.stop - round(cut))
        for each in region
        for cut in [(each.stop - each.start) * (1 - INNER) / 2]
    )
    return rows, cols


def _means(planes: Array, regions: list[Region]) -> Array:
    """Return the patch means as an image with one row, (3, 1, patch)."""
    means = [planes[:, rows, cols].mean(axis=(1, 2), dtype=np.float64) for rows, cols in map(inner, regions)]
    return np.array(means).T[:, None]
