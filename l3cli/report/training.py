"""The section of a report about a training set: its scenes, illuminants, raw levels and colours."""

from collections import Counter
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.camera import CameraModel
from l3cli.artifacts.training_set import TrainingPair, TrainingSet, TrainingSetReader
from l3cli.physics.display import XYZ
from l3cli.report import colours
from l3cli.report.drawing import Axis, Plot, spanning
from l3cli.report.parts import (
    Block,
    Data,
    Figure,
    Figures,
    Gallery,
    Jpeg,
    Key,
    Picture,
    Section,
    Subsection,
    Table,
    Text,
    fitted,
    thumbnail,
)
from l3cli.system.text import counted, tidy

Array = NDArray[np.floating]
MAX_PICTURES = 24  # maximum number of targets shown as pictures
LEVEL_EDGES = np.geomspace(1e-3, 1.0, 37)  # bin edges of the raw signal, as fractions of full scale
SATURATED = 0.985  # raw values at or above this fraction of full scale count as saturated (docs/method.md#saturation-cases)
CELL_SIZE = 0.01  # width and height of a cell in the chromaticity diagram, in units of x and y
CELLS_PER_SIDE = 100  # number of cells along x and along y
MIN_RELATIVE_LUMINANCE = 1e-4  # luminance, relative to white, below which pixels are omitted from the diagram


@dataclass
class Survey:
    """Statistics of a training set, collected in one pass over its frames."""

    # (caption, alternative text, sRGB picture (row, col, 3)) of some frames
    pictures: list[tuple[str, str, NDArray[np.uint8]]] = field(default_factory=list)
    levels: list[Array] = field(default_factory=list)  # for each channel, the number of pixels in each bin of LEVEL_EDGES
    below: int = 0  # number of pixels below the first bin
    saturated: int = 0  # number of saturated pixels
    pixels: int = 0  # total number of pixels
    sizes: Counter = field(default_factory=Counter)  # number of frames by size
    lights: dict = field(default_factory=dict)  # by illuminant: (white, luminance in cd/m², exposure in s) of each frame
    chromaticity: Array = field(default_factory=lambda: np.zeros((CELLS_PER_SIDE, CELLS_PER_SIDE)))  # (x, y) pixel counts
    pairs: int = 0  # number of captured frames, which are paired with target pictures


def training_section(reader: TrainingSetReader, name: str, role: str, limit: int, jpeg: Jpeg) -> Section:
    """Build the section about a training set.

    Parameters
    ----------
    reader : TrainingSetReader
        The open training set.
    name : str
        Name of the file.
    role : str
        Result of `given.role_of`: sentences about the tables that were trained or evaluated on the set, or "".
    limit : int
        Maximum total size of all pictures in bytes.
    jpeg : callable
        JPEG encoder, see `parts.Jpeg`.

    Returns
    -------
    Section
        Illuminants and raw levels, and also pictures and chromaticities of the targets if the targets are XYZ.
    """
    head = reader.head
    survey = survey_of(reader)
    about = f"{counted(len(reader), 'frame')} of {head.camera.name} with {survey.pixels / 1e6:.3g} million pixels."
    parts = [
        Subsection("Scenes", _scene_blocks(reader, survey, limit, jpeg)),
        Subsection("Illuminants, raw levels and colours", _light_blocks(head, survey)),
    ]
    return Section(f"Training set: {name}", " ".join(filter(None, (about, role, f"From {name}."))), tuple(parts))


def survey_of(reader: TrainingSetReader) -> Survey:
    """Collect statistics of all frames, with only one frame in memory at a time."""
    head, survey = reader.head, Survey()
    chosen = set(np.unique(np.linspace(0, len(reader) - 1, min(MAX_PICTURES, len(reader))).round().astype(int)).tolist())
    survey.levels = [np.zeros(len(LEVEL_EDGES) - 1) for _ in head.camera.channels]
    survey.pairs = len(reader) - reader.simulated
    for index, frame in enumerate(map(reader.pair, range(len(reader)))):
        survey.sizes[f"{frame.raw.shape[1]} × {frame.raw.shape[0]}"] += 1
        light = survey.lights.setdefault(frame.illuminant, [])
        light.append((frame.white, frame.luminance, frame.exposure))
        _count_levels(survey, frame, head.camera)
        if head.outputs == XYZ:
            _count_colours(survey, frame)
            if index in chosen:
                alt = f"Target of {frame.scene} under {frame.illuminant}, {tidy(frame.luminance)} cd/m², as sRGB."
                survey.pictures.append(
                    (
                        f"{frame.scene}, {frame.illuminant}, {tidy(frame.luminance)} cd/m²",
                        alt,
                        thumbnail(frame.target, frame.white),
                    )
                )
    return survey


def _count_levels(survey: Survey, frame: TrainingPair, camera: CameraModel) -> None:
    """Add a frame's raw values to the channels' histograms. Values above the white level count in the last bin."""
    signal = (frame.raw.astype(np.float64) - camera.black_level) / (camera.white_level - camera.black_level)
    rows, cols = camera.cfa.shape
    for (row, col), channel in np.ndenumerate(camera.cfa):
        at_site = signal[row::rows, col::cols]
        survey.levels[channel] += np.histogram(np.clip(at_site, None, 1.0), LEVEL_EDGES)[0]
    survey.pixels += signal.size
    survey.below += int((signal < LEVEL_EDGES[0]).sum())
    survey.saturated += int((signal >= SATURATED).sum())


def _count_colours(survey: Survey, frame: TrainingPair) -> None:
    """Add a target's chromaticities to the histogram, except for pixels below MIN_RELATIVE_LUMINANCE."""
    total = frame.target.sum(axis=0)
    bright = (frame.target[1] > MIN_RELATIVE_LUMINANCE * frame.white[1]) & (total > 0)
    x, y = (frame.target[part][bright] / total[bright] for part in (0, 1))
    edges = np.linspace(0, CELLS_PER_SIDE * CELL_SIZE, CELLS_PER_SIDE + 1)
    survey.chromaticity += np.histogram2d(x, y, (edges, edges))[0]


def _scene_blocks(reader: TrainingSetReader, survey: Survey, limit: int, jpeg: Jpeg) -> tuple[Block, ...]:
    sizes = ", ".join(f"{size} ({count})" for size, count in sorted(survey.sizes.items()))
    rows = [("Frames", str(len(reader))), ("Frame sizes in pixels (number of frames)", sizes)]
    if survey.pairs:
        rows.append(("Real frames, paired with a target", str(survey.pairs)))
    rows += [("Outputs", ", ".join(reader.head.outputs)), ("Target", reader.head.target_description)]
    table = Table("Contents of the training set", ("quantity", "value"), tuple(rows))
    if not survey.pictures:
        return (table, Text("The report shows no pictures, because the targets are not XYZ."))
    pictures = []
    for caption, alt, pixels in survey.pictures:
        uri, size = fitted(pixels, limit // MAX_PICTURES, jpeg)
        pictures.append(Picture(uri, *size, caption, alt))
    chosen = f"{len(pictures)} of {len(reader)} frames, evenly spaced" if len(pictures) < len(reader) else "All frames"
    shown = f"{chosen}. The pictures show the targets in sRGB. The white of each frame is adapted to D65."
    return (table, Text(shown), Gallery(tuple(pictures)))


def _light_blocks(head: TrainingSet, survey: Survey) -> tuple[Block, ...]:
    rows = []
    for light, frames in sorted(survey.lights.items()):
        white = np.mean([white for white, _, _ in frames], axis=0)
        xy = ", ".join(f"{value:.4f}" for value in (white / white.sum())[:2]) if white.size == 3 else "–"
        luminance, exposure = ([frame[part] for frame in frames] for part in (1, 2))
        rows.append((light, str(len(frames)), xy, _range(luminance), _range([1e3 * value for value in exposure])))
    headings = ("illuminant", "frames", "white x, y", "luminance of white (cd/m²)", "exposure (ms)")
    figures = [_level_figure(head.camera, survey)] + ([_chromaticity_figure(survey)] if head.outputs == XYZ else [])
    return (Figures(tuple(figures)), Table("Illuminants", headings, tuple(rows)))


def _range(values: list[float]) -> str:
    """Format the range of values, or a single number if both ends are equal after rounding."""
    low, high = tidy(min(values)), tidy(max(values))
    return low if low == high else f"{low}–{high}"


def _level_figure(camera: CameraModel, survey: Survey) -> Figure:
    """Plot each channel's histogram of raw signals."""
    keys = colours.channel_keys(camera)
    shares = [100 * counts / max(counts.sum(), 1) for counts in survey.levels]
    plot = Plot(
        Axis("raw signal above black (fraction of full scale)", 1e-3, 1.0, True),
        spanning("pixels per bin (% of the channel)", np.concatenate(shares), zero=True),
    )
    middles = np.sqrt(LEVEL_EDGES[1:] * LEVEL_EDGES[:-1])
    medians = []
    for key, share, counts in zip(keys, shares, survey.levels, strict=True):
        plot.steps(LEVEL_EDGES, share, key.colour, key.mark, series=key.label)
        if counts.any():
            middle = middles[int(np.searchsorted(np.cumsum(share), 50))]
            medians.append(f"{key.label} {tidy(float(middle), 2)}")
    finding = (
        f"Median signal as a fraction of full scale: {', '.join(medians)}. {100 * survey.saturated / survey.pixels:.2g} % "
        f"of all pixels are saturated, and {100 * survey.below / survey.pixels:.2g} % are below a thousandth of full scale."
    )
    return plot.figure("Raw levels", finding, keys)


def _chromaticity_figure(survey: Survey) -> Figure:
    """Plot the targets' chromaticities in the CIE 1931 diagram.

    The opacity of a cell indicates its fraction of all pixels, in steps of a factor of ten.
    """
    plot = Plot(Axis("CIE 1931 x (1)", -0.04, 0.84), Axis("CIE 1931 y (1)", 0, 0.9), height=434)
    wavelength, locus = colours.spectral_locus()
    closed = np.concatenate([locus, locus[:1]])
    shares = survey.chromaticity / max(survey.chromaticity.sum(), 1)
    keys = []
    for power, opacity in ((-2, 1.0), (-3, 0.75), (-4, 0.5), (-5, 0.3), (-12, 0.15)):
        low, high = 10.0**power, (10.0 ** (power + 1) if power > -6 else 1e-5)
        col, row = np.nonzero((shares >= low) & (shares < (high if power < -2 else 2)))
        if col.size:
            plot.cells(col * CELL_SIZE, row * CELL_SIZE, CELL_SIZE, CELL_SIZE, "var(--one)", opacity)
            name = f"more than {100 * low:g} % of pixels" if power > -6 else "fewer pixels"
            keys.append(Key(name, "var(--one)", "box", opacity))
    plot.line(closed[:, 0], closed[:, 1], "currentColor", width=1.2)
    for nm in (460, 480, 500, 520, 540, 560, 580, 600, 620):
        x, y = locus[int(np.argmin(np.abs(wavelength - nm)))]
        plot.dots(np.array([x]), np.array([y]), "currentColor", size=4, opacity=1)
        plot.label(float(x), float(y), f"{nm} nm")
    primaries = colours.srgb_primaries()
    triangle = np.concatenate([primaries, primaries[:1]])
    plot.line(triangle[:, 0], triangle[:, 1], "var(--muted)", "dashed", 1.2)
    for frames in survey.lights.values():
        white = frames[0][0] / frames[0][0].sum()
        plot.dots(white[:1], white[1:2], "var(--two)", "cross", opacity=1)
    inside, covered = _cover(shares, primaries)
    finding = (
        f"The targets cover {100 * covered:.0f} % of the area of the sRGB triangle (in cells of {CELL_SIZE}), and "
        f"{100 * inside:.3g} % of all pixels are inside the triangle. "
        f"Crosses are the whites of {counted(len(survey.lights), 'illuminant')}."
    )
    keys += [
        Key("sRGB", "var(--muted)", "dashed"),
        Key("spectral locus", "currentColor"),
        Key("white of an illuminant", "var(--two)", "cross"),
    ]
    col, row = np.nonzero(shares)
    cells = zip((col * CELL_SIZE).tolist(), (row * CELL_SIZE).tolist(), shares[col, row].tolist(), strict=True)
    data = Data(("CIE 1931 x (1)", "CIE 1931 y (1)", "fraction of pixels"), tuple(cells))
    return replace(plot.figure("Chromaticities of the targets", finding, tuple(keys)), data=data)


def _cover(shares: Array, triangle: Array) -> tuple[float, float]:
    """Compare chromaticities with a triangle in the diagram, such as the sRGB gamut.

    Parameters
    ----------
    shares : ndarray, (x, y)
        Fraction of all pixels in each cell of the diagram.
    triangle : ndarray, (3, 2)
        Chromaticities x and y of the corners.

    Returns
    -------
    inside : float
        Fraction of all pixels in cells inside the triangle.
    covered : float
        Fraction of the cells inside the triangle that contain at least one pixel.
    """
    centre = (np.arange(CELLS_PER_SIDE) + 0.5) * CELL_SIZE
    points = np.stack(np.meshgrid(centre, centre, indexing="ij"), axis=-1)
    sides = np.roll(triangle, -1, axis=0) - triangle
    rel = points[:, :, None] - triangle
    cross = sides[:, 0] * rel[..., 1] - sides[:, 1] * rel[..., 0]
    within = (cross >= 0).all(axis=2) | (cross <= 0).all(axis=2)
    return float(shares[within].sum()), float((shares[within] > 0).mean())
