"""Textures for dead-leaves scenes (docs/method.md#procedural-scenes).

There are two kinds of texture: random fields with natural power spectra, and fine regular patterns.

Random fields are drawn as periodic pieces, and each leaf shows a random part of a piece. Fields as large as the picture
would take four times as long to draw, and seven eighths of each field would be hidden behind leaves with other textures.

Fences, windows, blinds, cloth and print repeat every few pixels. A colour filter array turns such fine luminance patterns
into false colour. Textured dead leaves contain almost no fine patterns, so some leaves get a regular pattern.
"""

import functools
import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import fft

from l3cli.physics.spectra import with_saturation

Field = NDArray[np.float32]
Direction = tuple[float, float]  # elongation and its angle in radians

LENGTHS, PHASES = 256, 256  # different moduli and phases of the random coefficients; 16 random bits select both
SLOW = 1 / 16  # cycles per pixel; above this frequency, pieces have the power spectrum of a field as large as the picture
# For each texture: lowest and highest exponent of the amplitude spectrum, and stretch. The textures range from sand to
# clouds, and the last one looks brushed.
PINK = ((0.3, 0.9, 1.0), (0.8, 1.3, 1.0), (1.6, 1.6, 1.0), (1.0, 1.0, 1.0), (0.6, 0.6, 1.0), (1.1, 1.1, 4.0))
BLOTCHES, STRIPES = len(PINK), len(PINK) + 1  # indices of the last two textures, after the textures in PINK
TEXTURES = len(PINK) + 2
WIDEST = 1024  # largest side of a piece in samples, a power of two; leaves are at most 400 samples wide
Array = NDArray[np.floating]

PATTERN_FREQUENCIES = {"grating": 0.4, "lattice": 0.35, "lettering": 0.25}  # relative frequency of each kind of pattern
PERIOD_RANGE = (2.0, 16.0)  # pixels; periods are log-uniformly distributed
DUTIES = (0.15, 0.6)  # range of stroke widths, relative to the period
NEUTRAL, PALE = 0.5, 0.2  # fraction of nearly neutral patterns, and their highest saturation
CONTRAST = 0.5  # standard deviation of the logarithm of the random factor on the strokes' reflectance
LINE_DISTANCE = (2.0, 3.5)  # distance between lines of lettering, in stroke periods


def pink(rng: np.random.Generator, shape: tuple[int, int], exponent: float, stretch: float = 1.0) -> Field:
    """Draw a Gaussian random field with an amplitude spectrum ∝ 1/frequency^exponent.

    Parameters
    ----------
    rng : Generator
        Source of the random numbers.
    shape : tuple of int
        Rows and columns.
    exponent : float
        Exponent of the amplitude spectrum.
    stretch : float
        Factor by which the structures are elongated in a random direction; 1 is isotropic.

    Returns
    -------
    ndarray, (row, col)
        The field, with mean 0 and variance 1.
    """
    return _drawn(rng, _amplitudes(shape, exponent, _direction(rng, stretch), max(shape)), shape[1], 1.0)


def piece(
    rng: np.random.Generator, side: int, shape: tuple[int, int], exponent: float, stretch: float = 1.0
) -> tuple[Field, float]:
    """Draw a periodic piece of a Gaussian random field, with the texture of a larger field.

    Parameters
    ----------
    rng : Generator
        Source of the random numbers.
    side : int
        Rows and columns of the piece.
    shape : tuple of int
        Rows and columns of the picture.
    exponent, stretch : float
        As in `pink`.

    Returns
    -------
    piece : ndarray, (side, side)
        The field without its slowest variations.
    level : float
        Standard deviation of the variations that are too slow for a piece. `level`² and the variance of the piece add up
        to 1.
    """
    direction, longest = _direction(rng, stretch), max(shape)
    small = (side, side)
    amplitude = _amplitudes(small, exponent, direction, longest)
    beyond = _slow_power(shape, exponent, direction, longest) - _slow_power(small, exponent, direction, longest)
    share = max(0.0, beyond / (beyond + _mean_power(amplitude, side)))
    return _drawn(rng, amplitude, side, 1.0 - share), float(np.sqrt(share))


def _direction(rng: np.random.Generator, stretch: float) -> Direction:
    return stretch, rng.uniform(0, np.pi) if stretch != 1.0 else 0.0


def _amplitudes(shape: tuple[int, int], exponent: float, direction: Direction, longest: float) -> Field:
    """Return the amplitude 1/frequency^exponent of each coefficient of a real Fourier transform, and 0 at frequency 0."""
    amplitude: Field = np.exp(_log_frequencies(shape, direction, longest) * np.float32(-exponent))
    amplitude[0, 0] = 0.0
    return amplitude


def _drawn(rng: np.random.Generator, amplitude: Field, cols: int, variance: float) -> Field:
    """Draw the Fourier coefficients of a field with `cols` columns and the given variance, and transform them."""
    spectrum = _normals()[rng.integers(LENGTHS * PHASES, size=amplitude.shape, dtype=np.uint16)]
    spectrum *= amplitude
    alone = [0] if cols % 2 else [0, cols // 2]  # columns that need Hermitian symmetry, because the field is real
    for column in alone:
        mirrored = np.roll(spectrum[::-1, column], 1).conj()
        spectrum[:, column] = (spectrum[:, column] + mirrored) * np.float32(np.sqrt(0.5))
    power = 2 * _power(spectrum) - _power(spectrum[:, alone])
    spectrum *= np.float32(len(amplitude) * cols * np.sqrt(variance / power))  # Parseval's theorem
    field: Field = fft.irfft2(spectrum, s=(len(amplitude), cols), overwrite_x=True)
    return field


@functools.lru_cache(maxsize=1)
def _normals() -> NDArray[np.complex64]:
    """Return LENGTHS · PHASES complex numbers that sample a normal distribution with E|z|² = 1.

    Picking coefficients from this list takes a third of the time that drawing normal deviates takes. Each sample of the
    field is a sum of many coefficients, and therefore still Gaussian.
    """
    length = np.sqrt(-np.log((np.arange(LENGTHS) + 0.5) / LENGTHS))
    length /= np.sqrt(np.mean(length**2))
    phase = np.exp(2j * np.pi * (np.arange(PHASES) + 0.5) / PHASES)
    return np.outer(length, phase).reshape(-1).astype(np.complex64)


def _power(spectrum: NDArray[np.complex64]) -> float:
    """Sum |z|² row by row, so that the result does not depend on the number of threads."""
    parts = np.ascontiguousarray(spectrum).view(np.float32)
    return float(np.einsum("ij,ij->i", parts, parts).sum(dtype=np.float64))


@functools.lru_cache(maxsize=4)  # all isotropic fields of a scene share one result
def _log_frequencies(shape: tuple[int, int], direction: Direction, longest: float) -> Field:
    """Return ln(frequency in cycles per pixel) for each coefficient of a real Fourier transform.

    The frequency component in the stretched direction is multiplied by the stretch. Frequencies below 1 / `longest` are
    raised to 1 / `longest`.
    """
    down = fft.fftfreq(shape[0])[:, None].astype(np.float32)
    return _logarithm(down, fft.rfftfreq(shape[1])[None].astype(np.float32), direction, longest)


def _logarithm(down: Field, across: Field, direction: Direction, longest: float) -> Field:
    stretch, angle = direction
    cosine, sine = np.float32(np.cos(angle)), np.float32(np.sin(angle))
    along = (down * cosine + across * sine) * np.float32(stretch)
    power = along**2 + (across * cosine - down * sine) ** 2
    return np.float32(0.5) * np.log(np.maximum(power, np.float32(1.0 / longest**2)))


def _slow_power(shape: tuple[int, int], exponent: float, direction: Direction, longest: float) -> float:
    """Return the power per pixel of all frequencies up to SLOW except 0. A coefficient with amplitude 1 has power 1."""
    down, across = (np.arange(-int(n * SLOW), int(n * SLOW) + 1, dtype=np.float32) / np.float32(n) for n in shape)
    power = np.exp(_logarithm(down[:, None], across, direction, longest) * np.float32(-2 * exponent))
    power[len(down) // 2, len(across) // 2] = 0.0
    return float(power.sum(dtype=np.float64) / (shape[0] * shape[1]))


def _mean_power(amplitude: Field, cols: int) -> float:
    """Return the mean power of all coefficients of a full transform, from the amplitudes of a real transform.

    `cols` is the number of columns of the field.
    """
    columns = np.einsum("ij,ij->j", amplitude, amplitude, dtype=np.float64)
    columns[1 : (cols + 1) // 2] *= 2
    return float(columns.sum() / (len(amplitude) * cols))


@dataclass(frozen=True)
class Textures:
    """The textures of a scene, each with a variance of about 1, and each leaf's position in its texture."""

    pieces: NDArray[np.float32]  # (texture, row, col), periodic
    texture: NDArray[np.intp]  # (leaf,), index of the texture
    start: NDArray[np.int32]  # (leaf,), flat index in `pieces` of the first sample of the texture
    shift: NDArray[np.int32]  # (2, leaf), shift of the texture, in samples down and across
    level: NDArray[np.float32]  # (leaf,), offset that replaces variations that are too slow for a piece
    direction: tuple[float, float]  # spatial frequency of the stripes in cycles per sample, down and across
    waver: float  # standard deviation of the stripes' displacement, in stripe periods
    duty: float  # bright fraction of a stripe period


def draw_textures(
    rng: np.random.Generator, shape: tuple[int, int], texture: NDArray[np.intp], oversampling: int
) -> Textures:
    """Draw the textures of a scene.

    Parameters
    ----------
    rng : Generator
        Source of the random numbers.
    shape : tuple of int
        Rows and columns of the oversampled picture.
    texture : ndarray of int, (leaf)
        Index of each leaf's texture, from 0 to TEXTURES − 1.
    oversampling : int
        Samples per pixel in each direction.
    """
    side = min(WIDEST, 1 << (max(shape) - 1).bit_length())
    pieces = np.empty((TEXTURES, side, side), np.float32)
    level = np.empty(TEXTURES)
    fields = [(rng.uniform(low, high), stretch) for low, high, stretch in PINK]
    fields.append((rng.uniform(0.8, 1.8), np.exp(rng.uniform(0.0, 2.0))))  # blotches
    fields.append((1.8, 1.0))  # displacement of the stripes
    for number, (exponent, stretch) in enumerate(fields):
        pieces[number], level[number] = piece(rng, side, shape, exponent, stretch)
    angle, period = rng.uniform(0, np.pi), oversampling * np.exp(rng.uniform(np.log(2.0), np.log(14.0)))
    return Textures(
        pieces=pieces,
        texture=texture,
        start=(texture * side**2).astype(np.int32),
        shift=rng.integers(side, size=(2, len(texture)), dtype=np.int32),
        level=(level[texture] * rng.standard_normal(len(texture))).astype(np.float32),
        direction=(np.sin(angle) / period, np.cos(angle) / period),
        waver=rng.uniform(0, 1),
        duty=rng.uniform(0.3, 0.7),
    )


def sampled(textures: Textures, label: NDArray[np.integer], down: NDArray, across: NDArray) -> NDArray[np.float32]:
    """Return the texture value of the visible leaf at each sample, (row, col).

    Parameters
    ----------
    textures : Textures
        The textures of the scene.
    label : ndarray of int, (row, col)
        Index of the leaf at each sample.
    down : ndarray, (row, 1)
        Row of each sample.
    across : ndarray, (col)
        Column of each sample.
    """
    side = textures.pieces.shape[1]
    row = (textures.shift[0].take(label) + down.astype(np.int32)) & np.int32(side - 1)
    row *= np.int32(side)
    row += (textures.shift[1].take(label) + across.astype(np.int32)) & np.int32(side - 1)
    row += textures.start.take(label)
    value = textures.pieces.reshape(-1).take(row)
    value += textures.level.take(label)
    _set_contrast(value, textures, label, down, across)
    return value


def _set_contrast(
    value: NDArray[np.float32], textures: Textures, label: NDArray[np.integer], down: NDArray, across: NDArray
) -> None:
    """Reduce blotches and stripes to two tones, in place.

    Blotches get sharp borders, as on fur, bark and prints. Stripes look like cloth, blinds and letters.
    """
    texture = textures.texture.astype(np.uint8).take(label)
    blotched = np.nonzero(texture == BLOTCHES)
    value[blotched] = np.tanh(np.float32(8) * value[blotched])
    striped = np.nonzero(texture == STRIPES)
    position = np.float32(textures.waver) * value[striped]
    position += down[striped[0], 0] * np.float32(textures.direction[0])
    position += across[striped[1]] * np.float32(textures.direction[1])
    position -= np.floor(position)
    value[striped] = np.where(position < textures.duty, np.float32(1.0), np.float32(-1.0))


@dataclass(frozen=True)
class Patterns:
    """Regular patterns on leaves: strokes, and bars perpendicular to them, with a second reflectance.

    Lengths are in samples. Arrays have one value per leaf, unless a shape is stated.
    """

    present: NDArray[np.bool_]  # whether a leaf has a pattern
    first: NDArray[np.float32]  # (leaf, band), reflectance between the strokes, or of the whole leaf without a pattern
    second: NDArray[np.float32]  # (leaf, band), reflectance of the strokes
    kind: NDArray[np.intp]  # index into PATTERN_FREQUENCIES
    angle: NDArray[np.float32]  # radians; direction perpendicular to the strokes
    period: NDArray[np.float32]  # (2, leaf), of the strokes and of the bars
    width: NDArray[np.float32]  # (2, leaf), of the strokes and of the bars
    phase: NDArray[np.float32]  # (2, leaf), of the strokes and of the bars, in fractions of a period


def draw_patterns(
    rng: np.random.Generator,
    share: float,
    materials: Array,
    reflectance: Array,
    oversampling: int,
    drawn: NDArray[np.bool_] | slice = slice(None),
) -> Patterns:
    """Draw the regular patterns of a scene.

    Parameters
    ----------
    rng : Generator
        Source of the random numbers.
    share : float
        Fraction of the leaves that have a pattern.
    materials : ndarray, (material, band)
        Reflectances from which the strokes' reflectances are drawn.
    reflectance : ndarray, (leaf, band)
        Reflectance of each leaf.
    oversampling : int
        Samples per pixel in each direction.
    drawn : ndarray of bool, (band), or slice
        Bands from which the saturation is calculated.

    Returns
    -------
    Patterns
        Reflectances and geometry of all leaves, including leaves without a pattern.
    """
    count = len(reflectance)
    first, second = reflectance.copy(), materials[rng.integers(len(materials), size=count)]
    present = rng.random(count) < share
    pale = present & (rng.random(count) < NEUTRAL)
    saturation = rng.uniform(0.0, PALE, count)
    for leaf in np.flatnonzero(pale):
        first[leaf] = with_saturation(first[leaf], saturation[leaf], drawn)
        second[leaf] = with_saturation(second[leaf], saturation[leaf], drawn)
    second = np.minimum(second * np.exp(CONTRAST * rng.standard_normal(count))[:, None], 1.0)
    across = oversampling * np.exp(rng.uniform(math.log(PERIOD_RANGE[0]), math.log(PERIOD_RANGE[1]), count))
    kind = rng.choice(len(PATTERN_FREQUENCIES), size=count, p=list(PATTERN_FREQUENCIES.values()))
    along = across * np.where(
        kind == 2, rng.uniform(*LINE_DISTANCE, count), np.exp(rng.uniform(np.log(0.5), np.log(3.0), count))
    )
    period = np.maximum([across, along], oversampling * PERIOD_RANGE[0])
    duty = rng.uniform(*DUTIES, (2, count))
    duty[1] = np.where(kind == 2, 1.5 / (along / across), duty[1])  # blank space between lines of lettering
    return Patterns(
        present=present,
        first=first.astype(np.float32),
        second=second.astype(np.float32),
        kind=kind,
        angle=rng.uniform(0, np.pi, count).astype(np.float32),
        period=period.astype(np.float32),
        width=(np.minimum(duty, 0.85) * period).astype(np.float32),
        phase=rng.random((2, count)).astype(np.float32),
    )


def coverage(patterns: Patterns, label: NDArray[np.integer], down: Array, across: Array) -> NDArray[np.float32]:
    """Return the fraction of each sample that is covered by strokes or bars.

    Parameters
    ----------
    patterns : Patterns
        The patterns of the scene.
    label : ndarray of int, (row, col)
        Index of the leaf at each sample.
    down : ndarray, (row, 1)
        Row of each sample.
    across : ndarray, (col)
        Column of each sample.

    Returns
    -------
    ndarray, (row, col)
        Covered fraction from 0 to 1, which is 0 on leaves without a pattern.
    """
    cosine, sine = np.cos(patterns.angle)[label], np.sin(patterns.angle)[label]
    u, v = across * cosine + down * sine, down * cosine - across * sine
    stroke, place = _strokes(patterns, 0, label, u)
    bar, line = _strokes(patterns, 1, label, v)
    kind = patterns.kind[label]
    lattice = np.maximum(stroke, bar)
    lettering = bar * np.where(_coin(place, line, label), stroke, _coin(line, place, label))
    covered = np.choose(kind, [stroke, lattice, lettering])
    return np.where(patterns.present[label], covered, np.float32(0.0)).astype(np.float32)


def _strokes(
    patterns: Patterns, axis: int, label: NDArray[np.integer], position: Array
) -> tuple[NDArray[np.float32], NDArray[np.int64]]:
    """Return the fraction of each sample that parallel strokes cover, and the index of the nearest stroke.

    `axis` is 0 for strokes and 1 for the bars perpendicular to them. The coverage is exact if the strokes are parallel to
    the sampling grid.
    """
    period, width = patterns.period[axis][label], patterns.width[axis][label]
    turns = position / period + patterns.phase[axis][label]
    number = np.floor(turns)
    distance = abs(turns - number - 0.5) * period  # distance from the middle of the nearest stroke, in samples
    covered = np.clip(0.5 + 0.5 * width - distance, 0.0, np.minimum(width, 1.0))
    return covered.astype(np.float32), number.astype(np.int64)


def _coin(one: NDArray[np.int64], other: NDArray[np.int64], label: NDArray[np.integer]) -> NDArray[np.bool_]:
    """Return a reproducible random bit for each pair of stroke numbers on a leaf, from a multiplicative hash."""
    mixed = (one * 73856093) ^ (other * 19349663) ^ (label.astype(np.int64) * 83492791)
    return ((mixed * 2654435761) >> 16) & 1 == 1
