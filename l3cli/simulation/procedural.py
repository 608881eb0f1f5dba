"""Scenes without a file: dead leaves for training, a composition for viewing, and charts.

See docs/method.md#procedural-scenes.
"""

import functools
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from l3cli.frames.scene import NO_ILLUMINANT, Polarisation, Scene
from l3cli.physics import spectra
from l3cli.physics.display import srgb_from_lab
from l3cli.physics.spectra import COLORCHECKER_WAVELENGTH
from l3cli.simulation import fields, leaves, reflectances, sources
from l3cli.simulation.fields import TEXTURES, Patterns, Textures, coverage, draw_patterns, draw_textures, sampled
from l3cli.simulation.polarisation import NODES, Sheen, draw_sheen, stokes_of
from l3cli.simulation.reflectances import DRAWN, drawn_bands, dyed, materials, palette, surfaces

Array = NDArray[np.floating]
Cube = NDArray[np.float32]  # (row, col, band)

OVERSAMPLING = 2  # samples per pixel in each direction, so that edges need not coincide with pixel borders
SMALLEST_RADIUS, LARGEST_RADIUS = 3.0, 100.0  # range of the leaf radii, in pixels
PAINTS = 0.1  # fraction of the materials in dead leaves that are paints from artists' pigments
MAX_TIMES_WHITE = 3.0  # largest value in a scene, including highlights, relative to a perfect white
STRIP = 8  # rows per batch; small enough that a batch fits in the processor cache
Wavelength = NDArray[np.float64]
Painter = Callable[[Any, np.random.Generator, Wavelength], NDArray[np.float32]]

BOARD = 0.03  # reflectance of the dark board of charts
FINER = 8  # samples per pixel in each direction for straight edges


def grid(wavelength: Array) -> NDArray[np.float64]:
    """Return the wavelengths (nm) at which procedural scenes are drawn for a camera, given the wavelengths of the camera.

    The result contains the wavelengths in DRAWN, and extends them to the range of the camera in steps of 10 nm.
    """
    first = max(np.floor(min(wavelength[0], DRAWN[0]) / 10.0) * 10.0, 10.0)  # not 0: materials divide by the wavelength
    last = np.ceil(max(wavelength[-1], DRAWN[-1]) / 10.0) * 10.0
    return np.arange(first, last + 5.0, 10.0)


# -------------------------------------------------------------------------------------------------- dead leaves


@dataclass(frozen=True)
class Coat:
    """Material and shading of each leaf. Positions are in leaf radii from the leaf's centre, and ln is the natural log."""

    reflectance: NDArray[np.float32]  # (leaf, band)
    brightness: NDArray[np.float32]  # (leaf,), mean ln(brightness)
    slope: NDArray[np.float32]  # (2, leaf), gradient of ln(brightness), down and across
    hollow: NDArray[np.float32]  # (leaf,), decrease of ln(brightness) from the centre to the rim
    texture: NDArray[np.float32]  # (leaf,), amplitude of the texture in ln(brightness)
    highlight: NDArray[np.float32]  # (leaf,), peak of the highlight relative to a perfect white; 0 for matt leaves
    sharpness: NDArray[np.float32]  # (leaf,), sharpness of the highlight
    position: NDArray[np.float32]  # (2, leaf), position of the highlight, down and across


def dead_leaves(rng: np.random.Generator, size: tuple[int, int], wavelength: Array, patterned: float = 0.0) -> Cube:
    """Draw a dead-leaves scene with `drawn_leaves`, and return only its reflectance."""
    return drawn_leaves(rng, size, wavelength, patterned)[0]


def drawn_leaves(
    rng: np.random.Generator,
    size: tuple[int, int],
    wavelength: Array,
    patterned: float = 0.0,
    polarising: np.random.Generator | None = None,
    paints: float = PAINTS,
) -> tuple[Cube, Polarisation | None]:
    """Draw a dead-leaves scene: overlapping leaves with texture, shading, shadows and gloss.

    Parameters
    ----------
    rng : Generator
        Source of the random numbers.
    size : tuple of int
        Rows and columns.
    wavelength : ndarray, (band)
        Wavelengths in nm.
    patterned : float
        Fraction of the leaves with fine regular patterns. Patterns have their own random generator, so this fraction does
        not affect the rest of the scene.
    polarising : Generator, optional
        Source of the random numbers for the polarisation. [default: the light is not polarised]
    paints : float
        Fraction of the materials that are paints from artists' pigments.

    Returns
    -------
    reflectance : ndarray, (row, col, band)
        Reflectance. Highlights may exceed 1.
    polarisation : Polarisation or None
        Polarisation of the light, or None if `polarising` is None.
    """
    fine = (size[0] * OVERSAMPLING, size[1] * OVERSAMPLING)
    materials = palette(rng, surfaces(tuple(wavelength)), paints)
    smallest = SMALLEST_RADIUS * (4.0 if rng.random() < 0.5 else 1.0)  # half of the scenes have no small leaves
    cover = leaves.dead_leaves(rng, fine, smallest * OVERSAMPLING, LARGEST_RADIUS * OVERSAMPLING)
    coat = _coats(rng, materials, len(cover.radius))
    textures = draw_textures(rng, fine, rng.integers(TEXTURES, size=len(cover.radius)), OVERSAMPLING)
    light = _light(rng, fine)
    patterns = None
    if patterned > 0:
        drawn = rng.spawn(1)[0], patterned, materials, coat.reflectance, OVERSAMPLING
        patterns = draw_patterns(*drawn, drawn_bands(wavelength))
    cube = np.empty((*size, wavelength.size), np.float32)
    sheen = None if polarising is None else draw_sheen(polarising, len(cover.radius))
    stokes = np.empty((*size, 1 + 2 * NODES.size if sheen else 0), np.float32)  # mean of S0, then S1 and S2 at each node
    for top in range(0, size[0], STRIP):
        rows, part = slice(top * OVERSAMPLING, min(top + STRIP, size[0]) * OVERSAMPLING), slice(top, top + STRIP)
        _draw(cube[part], cover, coat, patterns, textures, light[rows], rows, sheen, stokes[part])
    blur = rng.uniform(0.0, 0.8)
    if sheen is None:
        return _blurred(cube, blur), None
    stokes = _blurred(stokes, blur)
    ratio = (stokes[..., 1:] / np.maximum(stokes[..., :1], 1e-6)).astype(np.float32)
    return _blurred(cube, blur), Polarisation(NODES, ratio.reshape(*size, 2, NODES.size))


def _coats(rng: np.random.Generator, materials: Array, count: int) -> Coat:
    """Draw the appearance of `count` leaves.

    With a probability of 60 %, a leaf has one of the `materials`. Otherwise it has a mixture of two materials.
    """
    one, other = materials[rng.integers(len(materials), size=(2, count))]
    share = np.where(rng.random(count) < 0.4, rng.random(count), 1.0)[:, None]
    angle = rng.uniform(0, 2 * np.pi, count)
    steepness, hollow = 0.2 * abs(rng.standard_normal((2, count)))
    glossy = rng.random(count) < 0.05
    return Coat(
        reflectance=(one * share + other * (1 - share)).astype(np.float32),
        brightness=(0.4 * rng.standard_normal(count)).astype(np.float32),
        slope=(steepness * np.array([np.sin(angle), np.cos(angle)])).astype(np.float32),
        hollow=hollow.astype(np.float32),
        texture=np.exp(rng.uniform(np.log(0.01), np.log(0.6), count)).astype(np.float32),
        highlight=(glossy * np.exp(rng.uniform(np.log(0.1), np.log(2.7), count))).astype(np.float32),
        sharpness=rng.uniform(4, 60, count).astype(np.float32),
        position=rng.uniform(-0.7, 0.7, (2, count)).astype(np.float32),
    )


def _light(rng: np.random.Generator, shape: tuple[int, int]) -> NDArray[np.float32]:
    """Draw the relative illumination of each sample of a scene.

    The illumination varies smoothly. In 30 % of the scenes, a random number of shadows (possibly none) with soft, ragged
    edges is added.
    """
    logarithm = 0.4 * fields.pink(rng, shape, 1.8)
    shadows = rng.poisson(1.0) if rng.random() < 0.3 else 0
    down, across = np.ogrid[: shape[0], : shape[1]]
    for _ in range(shadows):
        angle = rng.uniform(0, 2 * np.pi)
        through = rng.uniform(0, 1, 2) * shape
        distance = (across - through[1]) * np.cos(angle) + (down - through[0]) * np.sin(angle)
        ragged = distance + rng.uniform(0, 30) * fields.pink(rng, shape, 1.2)
        width = OVERSAMPLING * np.exp(rng.uniform(np.log(0.5), np.log(20.0)))
        logarithm -= (rng.uniform(0.3, 1.6) / (1 + np.exp(-np.clip(ragged / width, -30, 30)))).astype(np.float32)
    return np.exp(logarithm)


def _draw(
    cube: Cube,
    cover: leaves.Leaves,
    coat: Coat,
    patterns: Patterns | None,
    textures: Textures,
    light: NDArray[np.float32],
    rows: slice,
    sheen: Sheen | None,
    stokes: Cube,
) -> None:
    """Compute some rows of a scene, and write their reflectance, including highlights, into `cube`.

    Each pixel is the mean of its samples. Values are limited to MAX_TIMES_WHITE. If `sheen` is not None, the mean of S0 over
    the bands, and S1 and S2 at each node, are written into `stokes`.
    """
    label = cover.label[rows].astype(np.intp)
    down = np.arange(rows.start, rows.stop, dtype=np.float32)[:, None]
    across = np.arange(label.shape[1], dtype=np.float32)
    amount, gloss = _shading(cover, coat, label, (down, across), textures)
    if sheen is not None:
        shade = np.log(amount) - np.take(coat.brightness, label)
        s0 = amount * light * np.take(coat.reflectance.mean(axis=1), label)
        stokes[..., 0] = _block_mean(s0 + gloss)
        each = np.concatenate(stokes_of(sheen, cover, label, (down, across), shade), axis=-1)  # gloss is not polarised
        stokes[..., 1:] = np.stack([_block_mean(s0 * one) for one in np.moveaxis(each, -1, 0)], axis=-1)
    amount *= light
    if patterns is None:
        _average(cube, coat.reflectance, label, amount)
    else:
        share, second = coverage(patterns, label, down, across), np.empty_like(cube)
        _average(cube, patterns.first, label, amount * (1 - share))
        _average(second, patterns.second, label, amount * share)
        cube += second
    shine = _block_mean(gloss)
    glossy = np.nonzero(shine)
    cube[glossy] += shine[glossy][:, None]
    bright = np.nonzero(_block_mean(amount) + shine > MAX_TIMES_WHITE)  # pixels that are implausibly bright
    cube[bright] = np.minimum(cube[bright], np.float32(MAX_TIMES_WHITE))


def _block_mean(values: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return the mean of each block of OVERSAMPLING × OVERSAMPLING samples."""
    step = OVERSAMPLING
    samples = [values[row::step, col::step] for row in range(step) for col in range(step)]
    return functools.reduce(np.add, samples) / np.float32(step**2)


def _shading(
    cover: leaves.Leaves, coat: Coat, label: NDArray[np.intp], place: tuple[Array, Array], textures: Textures
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return each sample's shading, a factor on the reflectance, and its gloss, a specular reflection that is added."""

    def of(values: NDArray[Any]) -> NDArray[Any]:
        return np.take(values, label, mode="clip")

    radius = of(cover.radius)
    v, u = (place[0] - of(cover.row)) / radius, (place[1] - of(cover.col)) / radius
    texture = sampled(textures, label, *place)
    logarithm = of(coat.brightness) + of(coat.slope[0]) * v + of(coat.slope[1]) * u
    logarithm += of(coat.texture) * texture - of(coat.hollow) * np.minimum(u * u + v * v, np.float32(4.0))
    gloss = np.zeros_like(logarithm)
    glossy = np.nonzero(of(coat.highlight))
    leaf = label[glossy]
    distance = (v[glossy] - coat.position[0][leaf]) ** 2 + (u[glossy] - coat.position[1][leaf]) ** 2
    shine = coat.highlight[leaf] * np.exp(np.float32(0.3) * texture[glossy] - coat.sharpness[leaf] * distance)
    gloss[glossy] = shine * (shine > 0.004)  # cuts off the faint tail of the Gaussian
    return np.exp(logarithm), gloss


def _average(cube: Cube, materials: NDArray[np.float32], label: NDArray[np.integer], amount: NDArray[np.float32]) -> None:
    """Average the samples of each pixel, and write the result into `cube`.

    A sample's spectrum is the spectrum of its leaf times a factor. Most pixels show a single leaf. In these pixels, the
    factors are summed first, so that the spectrum needs to be multiplied only once.

    Parameters
    ----------
    cube : ndarray, (row, col, band)
        Array for the result.
    materials : ndarray, (leaf, band)
        Spectrum of each leaf.
    label : ndarray, (row, col)
        Index of the leaf at each sample.
    amount : ndarray, (row, col)
        Factor of each sample.
    """
    step = OVERSAMPLING
    samples = [np.s_[row::step, col::step] for row in range(step) for col in range(step)]
    amount = amount / np.float32(len(samples))
    first = label[samples[0]]
    alike = [label[sample] == first for sample in samples]
    common = sum(amount[sample] * same for sample, same in zip(samples, alike, strict=True))
    np.take(materials, first, axis=0, mode="clip", out=cube)
    cube *= common[..., None]
    for sample, same in zip(samples[1:], alike[1:], strict=True):
        other = np.nonzero(~same)
        cube[other] += materials[label[sample][other]] * amount[sample][other][:, None]


def _blurred(cube: Cube, sigma: float) -> Cube:
    """Blur a scene with a Gaussian of `sigma` pixels, in place, to imitate the lens of a real picture.

    A blur of up to 0.2 pixels has no visible effect and is skipped. The scene is mirrored at its borders. Working row by row
    keeps the data in the processor cache, so this function takes a fifth of the time of scipy.ndimage.
    """
    if sigma <= 0.2:
        return cube
    reach = int(4 * sigma + 0.5)
    weights = np.exp(-0.5 * (np.arange(reach + 1) / sigma) ** 2)
    weights = (weights / (2 * weights.sum() - 1)).astype(np.float32)
    rows, cols, bands = cube.shape
    around = np.pad(np.arange(rows), reach, mode="symmetric").tolist()
    sides = np.pad(np.arange(cols), reach, mode="symmetric")
    scratch, window = np.empty((cols, bands), np.float32), np.empty((reach, cols, bands), np.float32)
    wide = np.empty((cols + 2 * reach, bands), np.float32)  # a vertically blurred row, mirrored at its ends
    for row in range(rows):

        def sharp(at: int, row: int = row) -> Array:  # `window` keeps sharp copies of the rows that are already blurred
            return window[at % reach] if at < row else cube[at]

        line = wide[reach : reach + cols]
        np.multiply(cube[row], weights[0], out=line)
        for step in range(1, reach + 1):
            np.add(sharp(around[row + reach - step]), sharp(around[row + reach + step]), out=scratch)
            line += np.multiply(scratch, weights[step], out=scratch)
        wide[:reach], wide[reach + cols :] = line[sides[:reach]], line[sides[reach + cols :]]
        window[row % reach] = cube[row]
        np.multiply(line, weights[0], out=cube[row])
        for step in range(1, reach + 1):
            np.add(wide[reach - step :][:cols], wide[reach + step :][:cols], out=scratch)
            cube[row] += np.multiply(scratch, weights[step], out=scratch)
    return cube


# -------------------------------------------------------------------------------------------------- composition


def composition(rng: np.random.Generator, size: tuple[int, int], wavelength: Array) -> Cube:
    """Draw the demonstration scene with `drawn_composition`, and return only its reflectance."""
    return drawn_composition(rng, size, wavelength)[0]


def drawn_composition(
    rng: np.random.Generator, size: tuple[int, int], wavelength: Array, polarising: np.random.Generator | None = None
) -> tuple[Cube, Polarisation | None]:
    """Draw the demonstration scene: a ColorChecker, a grey ramp, a zone plate and slanted bars in front of dead leaves.

    Parameters
    ----------
    rng : Generator
        Source of the random numbers.
    size : tuple of int
        Rows and columns.
    wavelength : ndarray, (band)
        Wavelengths in nm.
    polarising : Generator, optional
        As for `drawn_leaves`. The panels are not polarised.

    Returns
    -------
    reflectance : ndarray, (row, col, band)
        Reflectance.
    polarisation : Polarisation or None
        Polarisation of the light, or None if `polarising` is None.
    """
    # Without paints, this scene for tests is the same as before the training scenes got paints.
    cube, polarisation = drawn_leaves(rng, size, wavelength, polarising=polarising, paints=0.0)
    for units, centre, panel in (
        (*CHART_PANEL, colorchecker),
        ((2, 12), (0.30, 0.25), ramp_panel),
        ((7, 7), (0.68, 0.62), zone_plate_panel),
        ((7, 7), (0.30, 0.84), slanted_bars_panel),
    ):
        (top, left), shape = _placed(size, units, centre)
        cube[top : top + shape[0], left : left + shape[1]] = panel(shape, wavelength)
        if polarisation is not None:
            polarisation.ratio[top : top + shape[0], left : left + shape[1]] = 0
    return cube, polarisation


# ColorChecker in a composition of 18 × 32 units: size (rows, columns) in units, and relative position of its centre
CHART_PANEL = (8, 12), (0.66, 0.25)


def _placed(
    size: tuple[int, int], units: tuple[int, int], centre: tuple[float, float]
) -> tuple[tuple[int, int], tuple[int, int]]:
    """Return a panel's upper left corner and shape in a composition, in pixels."""
    unit = min(size[0] // 18, size[1] // 32)
    height, width = units[0] * unit, units[1] * unit
    return (round(size[0] * centre[0] - height / 2), round(size[1] * centre[1] - width / 2)), (height, width)


def chart_places(size: tuple[int, int]) -> list[list[tuple[slice, slice]]]:
    """Return the two places where l3's scenes contain a ColorChecker.

    Parameters
    ----------
    size : tuple of int
        Rows and columns of the picture.

    Returns
    -------
    list of list of (slice, slice)
        Rows and columns of the 24 patches: for a chart that fills the picture, then for the chart in a composition.
    """
    (top, left), shape = _placed(size, *CHART_PANEL)
    within = [
        (slice(rows.start + top, rows.stop + top), slice(cols.start + left, cols.stop + left))
        for rows, cols in colorchecker_patches(shape)
    ]
    return [colorchecker_patches(size), within]


PAINTERS: dict[type, Painter] = {
    sources.DeadLeaves: lambda s, rng, nm: dead_leaves(rng, s.size, nm, s.patterned),
    sources.Composition: lambda s, rng, nm: composition(rng, s.size, nm),
    sources.Skin: lambda s, rng, nm: material_patches("skin", rng, s.patches, s.size, nm),
    sources.Foliage: lambda s, rng, nm: material_patches("leaf", rng, s.patches, s.size, nm),
    sources.Surfaces: lambda s, rng, nm: surface_patches(rng, s.patches, s.size, nm),
    sources.ColorChecker: lambda s, rng, nm: colorchecker(s.size, nm),
    sources.Munsell: lambda s, rng, nm: munsell(s.size, nm),
    sources.SlantedEdge: lambda s, rng, nm: slanted_edge(s.size, nm, s.angle_deg, s.dark, s.bright),
    sources.ZonePlate: lambda s, rng, nm: zone_plate(s.size, nm, s.highest),
    sources.Frequencies: lambda s, rng, nm: frequencies(s.size, nm, s.orders),
    sources.GreyRamp: lambda s, rng, nm: grey_ramp(s.size, nm, s.octaves),
}


POLARISED: dict[type, Callable[..., tuple[Cube, Polarisation | None]]] = {  # scenes that can be polarised
    sources.DeadLeaves: lambda s, rng, nm, polarising: drawn_leaves(rng, s.size, nm, s.patterned, polarising),
    sources.Composition: lambda s, rng, nm, polarising: drawn_composition(rng, s.size, nm, polarising),
}
POLARISATION_SEED = 60  # part of the seed that makes the polarisation independent of the rest of the scene


def draw(wanted: sources.WantedScene, seed: int, camera_wavelength: Wavelength, polarised: bool = False) -> Scene:
    """Draw a procedural scene for a camera. Equal recipes and seeds result in equal scenes.

    Parameters
    ----------
    wanted : WantedScene
        The scene in the recipe.
    seed : int
        Seed of the simulation.
    camera_wavelength : ndarray, (wavelength,)
        Wavelengths of the camera, in nm.
    polarised : bool
        Whether leaves polarise light, for cameras with polarisers. This does not affect the reflectances.

    Returns
    -------
    Scene
        The scene, at the wavelengths returned by `grid`. A ColorChecker has the wavelengths at which it was measured.
    """
    source = wanted.source
    measured = isinstance(source, sources.ColorChecker)
    wavelength = COLORCHECKER_WAVELENGTH if measured else grid(camera_wavelength)
    key = [seed, getattr(source, "seed", 0), wanted.number]
    rng = np.random.default_rng(key)
    if polarised and type(source) in POLARISED:
        polarising = np.random.default_rng([*key, POLARISATION_SEED])
        cube, polarisation = POLARISED[type(source)](source, rng, wavelength, polarising)
        return Scene(wanted.name, wavelength, cube, NO_ILLUMINANT, polarisation=polarisation)
    return Scene(wanted.name, wavelength, PAINTERS[type(source)](source, rng, wavelength), NO_ILLUMINANT)


# ------------------------------------------------------------------------------------------------------- patches


def colorchecker(size: tuple[int, int], wavelength: Array) -> Cube:
    """Return the reflectance of the classic ColorChecker, with 24 patches on a dark board that fills the scene."""
    _, reflectance = spectra.colorchecker(wavelength)
    cube = np.full((*size, wavelength.size), BOARD, np.float32)
    for patch, (rows, cols) in zip(reflectance, colorchecker_patches(size), strict=True):
        cube[rows, cols] = patch
    return cube


def colorchecker_patches(size: tuple[int, int]) -> list[tuple[slice, slice]]:
    """Return the row and column slices of the 24 square patches of a ColorChecker that fills a picture of the given size.

    The patches are listed row by row. The gap between patches is a fifth of the side of a patch.
    """
    pitch = min(size[0] / 4.2, size[1] / 6.2)
    side = max(1, int(pitch / 1.2))
    corners = [
        (round(size[0] / 2 + (row - 1.5) * pitch - side / 2), round(size[1] / 2 + (col - 2.5) * pitch - side / 2))
        for row in range(4)
        for col in range(6)
    ]
    return [(slice(top, top + side), slice(left, left + side)) for top, left in corners]


def patch_grid(reflectance: Array, rows: int, size: tuple[int, int]) -> Cube:
    """Arrange patches (patch, band) in a grid that fills the scene. Large patches get dark borders."""
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
    """Draw a chart of different samples of one type of material.

    Parameters
    ----------
    kind : {"skin", "leaf"}
        Type of material.
    rng : Generator
        Source of the random numbers.
    patches : tuple of int
        Rows and columns of patches.
    size : tuple of int
        Rows and columns of the scene.
    wavelength : ndarray, (band)
        Wavelengths in nm.

    Returns
    -------
    ndarray, (row, col, band)
        Reflectance.
    """
    drawn = materials(kind, rng, surfaces(tuple(wavelength)), patches[0] * patches[1])
    return patch_grid(drawn, patches[0], size)


def surface_patches(rng: np.random.Generator, patches: tuple[int, int], size: tuple[int, int], wavelength: Array) -> Cube:
    """Draw a chart of different dyed surfaces, from vivid to pale.

    Parameters
    ----------
    rng : Generator
        Source of the random numbers.
    patches : tuple of int
        Rows and columns of patches.
    size : tuple of int
        Rows and columns of the scene.
    wavelength : ndarray, (band)
        Wavelengths in nm.

    Returns
    -------
    ndarray, (row, col, band)
        Reflectance.
    """
    return patch_grid(dyed(rng, surfaces(tuple(wavelength)), patches[0] * patches[1]), patches[0], size)


MUNSELL_HUES, MUNSELL_VALUES, MUNSELL_CHROMAS = 20, (30, 50, 70, 85), (8, 20, 35, 55)  # number of hues; L*; C*ab


def munsell(size: tuple[int, int], wavelength: Array) -> Cube:
    """Draw a chart of regularly spaced CIE LCh colours under D65, with smooth reflectances.

    Hue varies along rows, lightness and chroma along columns. Colours outside sRGB are reduced in chroma until they fit.
    """
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
    """Draw a straight, slanted edge through the centre of the scene (ISO 12233).

    Parameters
    ----------
    size : tuple of int
        Rows and columns.
    wavelength : ndarray, (band)
        Wavelengths in nm.
    angle : float
        Angle from the vertical, in degrees.
    dark, bright : float
        Reflectance to the left and to the right of the edge.

    Returns
    -------
    ndarray, (row, col, band)
        Reflectance.
    """
    down, across = _centred(size, FINER)
    side = across + np.tan(np.radians(angle)) * down > 0
    share = side.reshape(size[0], FINER, size[1], FINER).mean(axis=(1, 3))
    return _grey(dark + (bright - dark) * share, wavelength)


def zone_plate(size: tuple[int, int], wavelength: Array, highest: float) -> Cube:
    """Draw a zone plate: concentric rings with a frequency that increases linearly from the centre.

    At the nearest edges of the picture, the frequency is `highest` cycles per pixel.
    """
    down, across = _centred(size)
    phase = np.pi * highest * (down**2 + across**2) / (min(size) / 2)
    return _grey(0.475 + 0.425 * np.cos(phase), wavelength)


def frequencies(size: tuple[int, int], wavelength: Array, orders: int) -> Cube:
    """Draw a row of gratings. Their frequency increases from left to right, and their contrast decreases downwards.

    The frequency doubles from grating to grating, up to 0.5 cycles per pixel in the last grating. The contrast is 1 at the
    top and 1/100 at the bottom.
    """
    across = np.arange(size[1])
    order = across * orders // size[1]
    wave = np.cos(2 * np.pi * across * 0.5 ** (orders - order))
    contrast = 0.01 ** (np.arange(size[0]) / (size[0] - 1))
    return _grey(0.45 * (1 + contrast[:, None] * wave), wavelength)


def grey_ramp(size: tuple[int, int], wavelength: Array, octaves: float) -> Cube:
    """Draw a grey ramp from a reflectance of 2^-octaves on the left to 1 on the right.

    The upper half is continuous. The lower half has steps of half an octave.
    """
    position = np.arange(size[1]) / (size[1] - 1)
    steps = max(1, round(2 * octaves))
    stepped = np.floor(np.minimum(position, 1 - 1e-9) * (steps + 1)) / steps
    upper = (np.arange(size[0]) < size[0] // 2)[:, None]
    return _grey(np.exp2(octaves * (np.where(upper, position, stepped) - 1)), wavelength)


# ------------------------------------------------------------------------------------- panels of the composition


def ramp_panel(shape: tuple[int, int], wavelength: Array) -> Cube:
    """Draw a logarithmic grey ramp from a reflectance of 1 % on the left to 100 % on the right.

    The upper half is continuous, and the lower half has 16 steps.
    """
    position = (np.arange(shape[1]) + 0.5) / shape[1]
    smooth, steps = 0.01 ** (1 - position), 0.01 ** (1 - np.floor(position * 16) / 15)
    panel = np.where((np.arange(shape[0]) < shape[0] // 2)[:, None], smooth, steps)
    return _grey(panel, wavelength)


def zone_plate_panel(shape: tuple[int, int], wavelength: Array) -> Cube:
    """Draw a zone plate with 0.4 cycles per pixel at its rim, a difficult test of demosaicking."""
    down, across = _centred(shape)
    panel = zone_plate(shape, wavelength, 0.4)
    panel[down**2 + across**2 >= (min(shape) / 2) ** 2] = BOARD
    return panel


def slanted_bars_panel(shape: tuple[int, int], wavelength: Array) -> Cube:
    """Draw dark and bright bars that are slanted by 5° and become narrower from left to right.

    The edges are suitable for the slanted-edge method of ISO 12233.
    """
    down, across = _centred(shape, 4)
    position = (across + np.tan(np.radians(5)) * down) / shape[1] + 0.5
    bars = np.sin(2 * np.pi * (1.5 * position + 8 * position**3)) > 0
    panel = np.where(bars, 0.8, BOARD).reshape(shape[0], 4, shape[1], 4).mean(axis=(1, 3))
    return _grey(panel, wavelength)


def _centred(shape: tuple[int, int], finer: int = 1) -> tuple[Array, Array]:
    """Return the positions (down, across) of samples in pixels from the picture's centre.

    The picture has `shape` (rows, columns) pixels, each with `finer` × `finer` samples.
    """
    down, across = ((np.arange(length * finer) + 0.5) / finer - length / 2 for length in shape)
    return down[:, None], across[None]


def _grey(panel: Array, wavelength: Array) -> Cube:
    return np.repeat(panel.astype(np.float32)[..., None], wavelength.size, axis=2)
