"""Scenes from mathematics: dead leaves to train on, and a composition to look at (docs/method.md#procedural-scenes)."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from l3cli.simulation import charts, leaves
from l3cli.simulation.patterns import Patterns, coverage, draw_patterns
from l3cli.simulation.reflectances import palette, surfaces, visible_bands

Array = NDArray[np.floating]
Cube = NDArray[np.float32]  # (row, col, band)

OVERSAMPLING = 2  # scenes are drawn finer and averaged, so that their edges fall between pixels
SMALLEST_RADIUS, LARGEST_RADIUS = 3.0, 150.0  # pixels of the scene
BRIGHTEST = 3.0  # of a perfect white, highlights included
STRIP = 64  # rows drawn at once: a picture's spectra at twice its size would not fit


def grid(wavelength: Array) -> NDArray[np.float64]:
    """Wavelengths (band) in nm that a procedural scene has for a camera: 400–700 by 10, farther where the camera sees."""
    first = np.floor(min(wavelength[0], 400.0) / 10.0) * 10.0
    last = np.ceil(max(wavelength[-1], 700.0) / 10.0) * 10.0
    return np.arange(first, last + 5.0, 10.0)


# -------------------------------------------------------------------------------------------------- dead leaves


@dataclass(frozen=True)
class Coat:
    """How each leaf looks: what it is made of, how light falls on it. Positions are relative to centre and radius."""

    reflectance: NDArray[np.float32]  # (leaf, band)
    brightness: NDArray[np.float32]  # (leaf) logarithm
    slope: NDArray[np.float32]  # (2, leaf) gradient down and across of the logarithm
    hollow: NDArray[np.float32]  # (leaf) fall of the logarithm towards the rim
    texture: NDArray[np.float32]  # (leaf) amplitude of the logarithm
    field: NDArray[np.intp]  # (leaf) texture field
    highlight: NDArray[np.float32]  # (leaf) peak of a white reflection, in perfect whites
    sharpness: NDArray[np.float32]  # (leaf) of the highlight
    position: NDArray[np.float32]  # (2, leaf) of the highlight, down and across


def dead_leaves(rng: np.random.Generator, size: tuple[int, int], wavelength: Array, patterned: float = 0.0) -> Cube:
    """Reflectance (row, col, band) of leaves that hide each other, in light, shadow and gloss; a share `patterned` of them
    carries fine patterns, drawn apart, so that all else is the same with and without."""
    fine = (size[0] * OVERSAMPLING, size[1] * OVERSAMPLING)
    materials = palette(rng, surfaces(tuple(wavelength)))
    smallest = SMALLEST_RADIUS * (4.0 if rng.random() < 0.5 else 1.0)  # half the frames are of larger things
    cover = leaves.dead_leaves(rng, fine, smallest * OVERSAMPLING, LARGEST_RADIUS * OVERSAMPLING)
    coat = _coats(rng, materials, len(cover.radius))
    fields = _texture_fields(rng, fine)
    light = _light(rng, fine)
    patterns = None
    if patterned > 0:
        drawn = rng.spawn(1)[0], patterned, materials, coat.reflectance, OVERSAMPLING
        patterns = draw_patterns(*drawn, visible_bands(wavelength))
    cube = np.empty((*size, wavelength.size), np.float32)
    for top in range(0, size[0], STRIP):
        rows = slice(top * OVERSAMPLING, min(top + STRIP, size[0]) * OVERSAMPLING)
        cube[top : top + STRIP] = _draw(cover, coat, patterns, fields[:, rows], light[rows], rows)
    return _blurred(cube, rng.uniform(0.0, 0.8))


def _coats(rng: np.random.Generator, materials: Array, count: int) -> Coat:
    """Each of `count` leaves is one of the materials (material, band) or, in 40 %, a mixture of two."""
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
        field=rng.integers(TEXTURES, size=count),
        highlight=(glossy * np.exp(rng.uniform(np.log(0.1), np.log(2.7), count))).astype(np.float32),
        sharpness=rng.uniform(4, 60, count).astype(np.float32),
        position=rng.uniform(-0.7, 0.7, (2, count)).astype(np.float32),
    )


# Exponent range of the amplitude spectrum and stretch of the pink textures: from sand to clouds, and a brushed one.
PINK = ((0.3, 0.9, 1.0), (0.8, 1.3, 1.0), (1.6, 1.6, 1.0), (1.0, 1.0, 1.0), (0.6, 0.6, 1.0), (1.1, 1.1, 4.0))
TEXTURES = len(PINK) + 2  # blotches and stripes beside them


def _texture_fields(rng: np.random.Generator, shape: tuple[int, int]) -> NDArray[np.float32]:
    """The textures of one frame, (texture, row, col), each with a variance of about 1."""
    pink = [leaves.pink(rng, shape, rng.uniform(low, high), stretch) for low, high, stretch in PINK]
    return np.stack([*pink, _blotches(rng, shape), _stripes(rng, shape)])


def _blotches(rng: np.random.Generator, shape: tuple[int, int]) -> NDArray[np.float32]:
    """Two tones with sharp borders, as on fur, bark and prints."""
    return np.tanh(8 * leaves.pink(rng, shape, rng.uniform(0.8, 1.8), np.exp(rng.uniform(0.0, 2.0))))


def _stripes(rng: np.random.Generator, shape: tuple[int, int]) -> NDArray[np.float32]:
    """Two tones in wavering stripes, 2 to 14 pixels of the scene a period, as on cloth, blinds and letters."""
    angle, period = rng.uniform(0, np.pi), OVERSAMPLING * np.exp(rng.uniform(np.log(2.0), np.log(14.0)))
    down, across = np.ogrid[: shape[0], : shape[1]]
    position = (across * np.cos(angle) + down * np.sin(angle)) / period
    position = position + rng.uniform(0, 1) * leaves.pink(rng, shape, 1.8)
    return np.where(position % 1 < rng.uniform(0.3, 0.7), 1.0, -1.0).astype(np.float32)


def _light(rng: np.random.Generator, shape: tuple[int, int]) -> NDArray[np.float32]:
    """Relative light (row, col): uneven everywhere, in 30 % of the frames with shadows of soft, ragged edges."""
    logarithm = 0.4 * leaves.pink(rng, shape, 1.8)
    shadows = rng.poisson(1.0) if rng.random() < 0.3 else 0
    down, across = np.ogrid[: shape[0], : shape[1]]
    for _ in range(shadows):
        angle = rng.uniform(0, 2 * np.pi)
        through = rng.uniform(0, 1, 2) * shape
        distance = (across - through[1]) * np.cos(angle) + (down - through[0]) * np.sin(angle)
        ragged = distance + rng.uniform(0, 30) * leaves.pink(rng, shape, 1.2)
        softness = OVERSAMPLING * np.exp(rng.uniform(np.log(0.5), np.log(20.0)))
        logarithm -= (rng.uniform(0.3, 1.6) / (1 + np.exp(-np.clip(ragged / softness, -30, 30)))).astype(np.float32)
    return np.exp(logarithm)


def _draw(
    cover: leaves.Leaves,
    coat: Coat,
    patterns: Patterns | None,
    fields: NDArray[np.float32],
    light: NDArray[np.float32],
    rows: slice,
) -> Cube:
    """Some rows of the picture: reflectance (row, col, band), averaged to the scene's own size."""
    label = cover.label[rows]
    down = np.arange(rows.start, rows.stop, dtype=np.float32)[:, None]
    across = np.arange(label.shape[1], dtype=np.float32)
    amount, gloss = _shading(cover, coat, label, (down, across), fields)
    amount *= light
    if patterns is None:
        cube = _averaged(coat.reflectance, label, amount)
    else:
        share = coverage(patterns, label, down, across)
        cube = _averaged(patterns.first, label, amount * (1 - share))
        cube += _averaged(patterns.second, label, amount * share)
    step = OVERSAMPLING
    cube += gloss.reshape(len(cube), step, -1, step).mean(axis=(1, 3))[..., None]
    return np.minimum(cube, np.float32(BRIGHTEST), out=cube)


def _shading(
    cover: leaves.Leaves, coat: Coat, label: NDArray[np.int32], place: tuple[Array, Array], fields: NDArray[np.float32]
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Of leaves (row, col) at a place (rows, columns): by how much each is brighter than what it is made of, and the light
    that it reflects as a mirror does."""

    def of(values: NDArray[Any]) -> NDArray[Any]:
        return np.take(values, label, mode="clip")

    radius = of(cover.radius)
    v, u = (place[0] - of(cover.row)) / radius, (place[1] - of(cover.col)) / radius
    texture = np.take_along_axis(fields, of(coat.field)[None], axis=0)[0]
    logarithm = of(coat.brightness) + of(coat.slope[0]) * v + of(coat.slope[1]) * u
    logarithm += of(coat.texture) * texture - of(coat.hollow) * np.minimum(u * u + v * v, np.float32(4.0))
    gloss = np.zeros_like(logarithm)
    glossy = np.nonzero(of(coat.highlight))
    leaf = label[glossy]
    distance = (v[glossy] - coat.position[0][leaf]) ** 2 + (u[glossy] - coat.position[1][leaf]) ** 2
    shine = coat.highlight[leaf] * np.exp(np.float32(0.3) * texture[glossy] - coat.sharpness[leaf] * distance)
    gloss[glossy] = shine * (shine > 0.004)  # a highlight ends somewhere
    return np.exp(logarithm), gloss


def _averaged(materials: NDArray[np.float32], label: NDArray[np.int32], amount: NDArray[np.float32]) -> Cube:
    """Mean over each OVERSAMPLING × OVERSAMPLING block of the materials (leaf, band) of a label, times an amount, (row, col)
    both. Most blocks show one leaf: spectra are added up where they do not."""
    step = OVERSAMPLING
    samples = [np.s_[row::step, col::step] for row in range(step) for col in range(step)]
    first = label[samples[0]]
    alike = [label[sample] == first for sample in samples]
    common = sum(amount[sample] * same for sample, same in zip(samples, alike, strict=True))
    cube = np.take(materials, first, axis=0, mode="clip")
    cube *= common[..., None]
    for sample, same in zip(samples[1:], alike[1:], strict=True):
        other = np.nonzero(~same)
        cube[other] += materials[label[sample][other]] * amount[sample][other][:, None]
    cube /= np.float32(len(samples))
    return cube


def _blurred(cube: Cube, sigma: float) -> Cube:
    """A lens is never perfect: Gaussian blur of `sigma` pixels; below 0.2 it would change nothing."""
    from scipy.ndimage import gaussian_filter1d

    if sigma <= 0.2:
        return cube
    return gaussian_filter1d(gaussian_filter1d(cube, sigma, axis=0), sigma, axis=1)


# -------------------------------------------------------------------------------------------------- composition


def composition(rng: np.random.Generator, size: tuple[int, int], wavelength: Array) -> Cube:
    """Reflectance (row, col, band) of a demonstration picture: before dead leaves stand a ColorChecker, a grey ramp, a zone
    plate and slanted bars."""
    cube = dead_leaves(rng, size, wavelength)
    for units, centre, panel in (
        (*CHART_PANEL, charts.colorchecker),
        ((2, 12), (0.30, 0.25), charts.ramp_panel),
        ((7, 7), (0.68, 0.62), charts.zone_plate_panel),
        ((7, 7), (0.30, 0.84), charts.slanted_bars_panel),
    ):
        (top, left), shape = _placed(size, units, centre)
        cube[top : top + shape[0], left : left + shape[1]] = panel(shape, wavelength)
    return cube


CHART_PANEL = (8, 12), (0.66, 0.25)  # of a composition: rows and columns of its 18 × 32 units, centre as a share of the size


def _placed(
    size: tuple[int, int], units: tuple[int, int], centre: tuple[float, float]
) -> tuple[tuple[int, int], tuple[int, int]]:
    """Upper left corner and shape in pixels of a panel of a composition of `size`."""
    unit = min(size[0] // 18, size[1] // 32)
    height, width = units[0] * unit, units[1] * unit
    return (round(size[0] * centre[0] - height / 2), round(size[1] * centre[1] - width / 2)), (height, width)


def chart_places(size: tuple[int, int]) -> list[list[tuple[slice, slice]]]:
    """Where a picture of `size` (rows, cols) may show the 24 patches of a ColorChecker: where one fills it, and that
    of a composition."""
    (top, left), shape = _placed(size, *CHART_PANEL)
    within = [
        (slice(rows.start + top, rows.stop + top), slice(cols.start + left, cols.stop + left))
        for rows, cols in charts.colorchecker_patches(shape)
    ]
    return [charts.colorchecker_patches(size), within]
