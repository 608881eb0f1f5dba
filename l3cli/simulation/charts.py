"""Charts: what a camera is checked with. Colour patches of known or drawn spectra, greys, edges and gratings."""

import numpy as np
from numpy.typing import NDArray

from l3cli.physics import spectra
from l3cli.physics.display import srgb_from_lab
from l3cli.simulation import reflectances
from l3cli.simulation.reflectances import dyed, materials, surfaces

Array = NDArray[np.floating]
Cube = NDArray[np.float32]  # (row, col, band)

BOARD = 0.03  # reflectance of the dark ground of charts
FINER = 8  # samples a pixel's side that edges are averaged from

# ------------------------------------------------------------------------------------------------------- patches


def colorchecker(size: tuple[int, int], wavelength: Array) -> Cube:
    """Return the reflectance (row, col, band) of the classic ColorChecker: 24 patches on a dark board that fills `size`."""
    _, reflectance = spectra.colorchecker(wavelength)
    cube = np.full((*size, wavelength.size), BOARD, np.float32)
    for patch, (rows, cols) in zip(reflectance, colorchecker_patches(size), strict=True):
        cube[rows, cols] = patch
    return cube


def colorchecker_patches(size: tuple[int, int]) -> list[tuple[slice, slice]]:
    """Return the rows and columns of the 24 patches, row by row, on a board of `size` (rows, cols): squares a fifth
    apart."""
    pitch = min(size[0] / 4.2, size[1] / 6.2)
    side = max(1, int(pitch / 1.2))
    corners = [
        (round(size[0] / 2 + (row - 1.5) * pitch - side / 2), round(size[1] / 2 + (col - 2.5) * pitch - side / 2))
        for row in range(4)
        for col in range(6)
    ]
    return [(slice(top, top + side), slice(left, left + side)) for top, left in corners]


def patch_grid(reflectance: Array, rows: int, size: tuple[int, int]) -> Cube:
    """Return the patches (patch, band), row by row in `rows` rows, filling `size`; where there is room, with dark rims."""
    cols = len(reflectance) // rows
    row = np.arange(size[0]) * rows // size[0]
    col = np.arange(size[1]) * cols // size[1]
    cube = reflectance.astype(np.float32)[row[:, None] * cols + col]
    if size[0] >= 4 * rows and size[1] >= 4 * cols:
        cube[np.diff(row, append=-1) != 0] = BOARD
        cube[:, np.diff(col, append=-1) != 0] = BOARD
    return cube


def material_patches(
    kind: str, rng: np.random.Generator, patches: tuple[int, int], size: tuple[int, int], wavelength: Array
) -> Cube:
    """Return a chart of `patches` (rows, cols) draws of one kind of material, "skin" or "leaf", no two alike."""
    drawn = materials(kind, rng, surfaces(tuple(wavelength)), patches[0] * patches[1])
    return patch_grid(drawn, patches[0], size)


def surface_patches(rng: np.random.Generator, patches: tuple[int, int], size: tuple[int, int], wavelength: Array) -> Cube:
    """Return a chart of `patches` (rows, cols) dyed surfaces, vivid and pale, no two alike."""
    return patch_grid(dyed(rng, surfaces(tuple(wavelength)), patches[0] * patches[1]), patches[0], size)


MUNSELL_HUES, MUNSELL_VALUES, MUNSELL_CHROMAS = 20, (30, 50, 70, 85), (8, 20, 35, 55)


def munsell(size: tuple[int, int], wavelength: Array) -> Cube:
    """Return the colours in equal steps of hue (across), lightness and chroma (down) of CIE LCh under D65, as the smoothest
    reflectances; a colour outside sRGB is drawn towards grey until it is inside."""
    hue = np.arange(MUNSELL_HUES) * (2 * np.pi / MUNSELL_HUES)
    value, chroma, hue = (axis.ravel() for axis in np.meshgrid(MUNSELL_VALUES, MUNSELL_CHROMAS, hue, indexing="ij"))
    linear = srgb_from_lab(np.stack([value, chroma * np.cos(hue), chroma * np.sin(hue)], axis=1))
    grey = srgb_from_lab(np.stack([value, 0 * value, 0 * value], axis=1))
    excess = np.maximum((linear - 1) / np.maximum(linear - grey, 1e-9), -linear / np.maximum(grey - linear, 1e-9))
    share = 1 - np.maximum(excess.max(axis=1, keepdims=True), 0)
    inside = np.clip(grey + share * (linear - grey), 0, 1).astype(np.float32)
    reflectance = reflectances.raise_to_spectra(inside[None], np.asarray(wavelength, float), "munsell").reflectance[0]
    return patch_grid(reflectance, len(MUNSELL_VALUES) * len(MUNSELL_CHROMAS), size)


# ------------------------------------------------------------------------------------------- edges, gratings, greys


def slanted_edge(size: tuple[int, int], wavelength: Array, angle: float, dark: float, bright: float) -> Cube:
    """Return a straight edge through the middle, `angle` degrees from the vertical, `dark` on its left (ISO 12233)."""
    down, across = _centred(size, FINER)
    side = across + np.tan(np.radians(angle)) * down > 0
    share = side.reshape(size[0], FINER, size[1], FINER).mean(axis=(1, 3))
    return _grey(dark + (bright - dark) * share, wavelength)


def zone_plate(size: tuple[int, int], wavelength: Array, highest: float) -> Cube:
    """Return the rings about the middle whose frequency grows to `highest` cycles a pixel at the shorter sides."""
    down, across = _centred(size)
    phase = np.pi * highest * (down**2 + across**2) / (min(size) / 2)
    return _grey(0.475 + 0.425 * np.cos(phase), wavelength)


def frequencies(size: tuple[int, int], wavelength: Array, orders: int) -> Cube:
    """Return the columns of gratings, each of twice the frequency of the one to its left up to 0.5 cycles a pixel; their
    contrast falls from 1 at the top to 1/100 at the bottom."""
    across = np.arange(size[1])
    order = across * orders // size[1]
    wave = np.cos(2 * np.pi * across * 0.5 ** (orders - order))
    contrast = 0.01 ** (np.arange(size[0]) / (size[0] - 1))
    return _grey(0.45 * (1 + contrast[:, None] * wave), wavelength)


def grey_ramp(size: tuple[int, int], wavelength: Array, octaves: float) -> Cube:
    """Return greys from 2^-octaves on the left to 1: continuous in the upper half, in steps of half an octave below."""
    position = np.arange(size[1]) / (size[1] - 1)
    steps = max(1, round(2 * octaves))
    stepped = np.floor(np.minimum(position, 1 - 1e-9) * (steps + 1)) / steps
    upper = (np.arange(size[0]) < size[0] // 2)[:, None]
    return _grey(np.exp2(octaves * (np.where(upper, position, stepped) - 1)), wavelength)


# ------------------------------------------------------------------------------------- panels of the composition


def ramp_panel(shape: tuple[int, int], wavelength: Array) -> Cube:
    """Return greys from 1 % to 100 %: continuous above, 16 steps below."""
    position = (np.arange(shape[1]) + 0.5) / shape[1]
    smooth, steps = 0.01 ** (1 - position), 0.01 ** (1 - np.floor(position * 16) / 15)
    panel = np.where((np.arange(shape[0]) < shape[0] // 2)[:, None], smooth, steps)
    return _grey(panel, wavelength)


def zone_plate_panel(shape: tuple[int, int], wavelength: Array) -> Cube:
    """Return the rings that grow finer towards the rim, up to 0.4 cycles a pixel: what any mosaic has trouble with."""
    down, across = _centred(shape)
    panel = zone_plate(shape, wavelength, 0.4)
    panel[down**2 + across**2 >= (min(shape) / 2) ** 2] = BOARD
    return panel


def slanted_bars_panel(shape: tuple[int, int], wavelength: Array) -> Cube:
    """Draw five-degree slanted black and white bars, narrower from left to right (edges for an ISO 12233 reading)."""
    down, across = _centred(shape, 4)
    position = (across + np.tan(np.radians(5)) * down) / shape[1] + 0.5
    bars = np.sin(2 * np.pi * (1.5 * position + 8 * position**3)) > 0
    panel = np.where(bars, 0.8, BOARD).reshape(shape[0], 4, shape[1], 4).mean(axis=(1, 3))
    return _grey(panel, wavelength)


def _centred(shape: tuple[int, int], finer: int = 1) -> tuple[Array, Array]:
    """Return pixel coordinates down and across from the centre of `shape`, sampled `finer` times."""
    down, across = ((np.arange(length * finer) + 0.5) / finer - length / 2 for length in shape)
    return down[:, None], across[None]


def _grey(panel: Array, wavelength: Array) -> Cube:
    return np.repeat(panel.astype(np.float32)[..., None], wavelength.size, axis=2)
