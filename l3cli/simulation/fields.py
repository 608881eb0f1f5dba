"""Textures for dead-leaves scenes (docs/method.md#procedural-scenes).

There are two kinds of texture: random fields with natural power spectra, and fine regular patterns.

Random fields are drawn as periodic pieces, and each leaf shows a random part of a piece. Fields as large as the picture
would take four times as long, and leaves with other textures would hide seven eighths of each field.

Fences, windows, blinds, cloth and print repeat every few pixels. A colour filter array turns such fine luminance patterns
into false colour. Dead leaves alone contain almost no fine patterns, so some leaves have a regular pattern.
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

LENGTHS, PHASES = 256, 256  # numbers of different lengths and phases of the random coefficients; 16 random bits select both
SLOW = 1 / 16  # frequency in cycles per pixel, above which a piece has the same power as the whole field
# For each texture: lowest and highest exponent of the amplitude spectrum, and stretch. The textures range from sand to
# clouds. The last texture looks brushed.
PINK = ((0.3, 0.9, 1.0), (0.8, 1.3, 1.0), (1.6, 1.6, 1.0), (1.0, 1.0, 1.0), (0.6, 0.6, 1.0), (1.1, 1.1, 4.0))
BLOTCHES, STRIPES = len(PINK), len(PINK) + 1  # indices of the last two textures, after the textures in PINK
TEXTURES = len(PINK) + 2
WIDEST = 1024  # largest side of a piece in samples, a power of two; leaves are at most 400 samples wide
Array = NDArray[np.floating]

PATTERN_FREQUENCIES = {"grating": 0.4, "lattice": 0.35, "lettering": 0.25}  # relative frequency of each kind of pattern
PERIOD_RANGE = (2.0, 16.0)  # range of the periods in pixels; periods are drawn log-uniformly
DUTIES = (0.15, 0.6)  # range of the width of strokes, relative to their period
NEUTRAL, PALE = 0.5, 0.2  # fraction of patterns that are nearly neutral, and the highest saturation of these patterns
CONTRAST = 0.5  # the reflectance of the strokes is multiplied by exp(CONTRAST · standard normal deviate)
LINE_DISTANCE = (2.0, 3.5)  # distance between two lines of lettering, in periods of the strokes


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
    """Draw a periodic piece of a Gaussian random field, for a picture that is larger than the piece.

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
        Standard deviation of the variations that are too slow to appear within a piece. `level`² and the variance of the
        piece add up to 1.
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
    """Return the amplitude of each coefficient of a real Fourier transform. Frequency 0 has the amplitude 0."""
    amplitude: Field = np.exp(_log_frequencies(shape, direction, longest) * np.float32(-exponent))
    amplitude[0, 0] = 0.0
    return amplitude


def _drawn(rng: np.random.Generator, amplitude: Field, cols: int, variance: float) -> Field:
    """Draw a field of `cols` columns with the given variance, by drawing its Fourier coefficients."""
    spectrum = _normals()[rng.integers(LENGTHS * PHASES, size=amplitude.shape, dtype=np.uint16)]
    spectrum *= amplitude
    alone = [0] if cols % 2 else [0, cols // 2]  # columns that contain the complex conjugates of their own coefficients
    for column in alone:
        mirrored = np.roll(spectrum[::-1, column], 1).conj()
        spectrum[:, column] = (spectrum[:, column] + mirrored) * np.float32(np.sqrt(0.5))
    power = 2 * _power(spectrum) - _power(spectrum[:, alone])
    spectrum *= np.float32(len(amplitude) * cols * np.sqrt(variance / power))  # Parseval's theorem
    field: Field = fft.irfft2(spectrum, s=(len(amplitude), cols), overwrite_x=True)
    return field


@functools.lru_cache(maxsize=1)
def _normals() -> NDArray[np.complex64]:
    """Return LENGTHS · PHASES complex numbers that follow a normal distribution with E|z|² = 1.

    Picking coefficients from this list takes a third of the time of drawing normal random numbers. Each sample of the field
    is a sum of many coefficients and is therefore still Gaussian.
    """
    length = np.sqrt(-np.log((np.arange(LENGTHS) + 0.5) / LENGTHS))
    length /= np.sqrt(np.mean(length**2))
    phase = np.exp(2j * np.pi * (np.arange(PHASES) + 0.5) / PHASES)
    return np.outer(length, phase).reshape(-1).astype(np.complex64)


def _power(spectrum: NDArray[np.complex64]) -> float:
    """Return the sum of |z|². The summation row by row makes the result independent of the number of threads."""
    parts = np.ascontiguousarray(spectrum).view(np.float32)
    return float(np.einsum("ij,ij->i", parts, parts).sum(dtype=np.float64))


@functools.lru_cache(maxsize=4)  # most fields of a scene are isotropic and share one result
def _log_frequencies(shape: tuple[int, int], direction: Direction, longest: float) -> Field:
    """Return the logarithm of the frequency, in cycles per pixel, of each coefficient of a real Fourier transform.

    Frequency components along the direction of elongation are multiplied by the elongation. Frequencies below 1 / `longest`
    are raised to 1 / `longest`.
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
    """Return the power per pixel at frequencies above 0 and up to SLOW. A coefficient with amplitude 1 has power 1."""
    down, across = (np.arange(-int(n * SLOW), int(n * SLOW) + 1, dtype=np.float32) / np.float32(n) for n in shape)
    power = np.exp(_logarithm(down[:, None], across, direction, longest) * np.float32(-2 * exponent))
    power[len(down) // 2, len(across) // 2] = 0.0
    return float(power.sum(dtype=np.float64) / (shape[0] * shape[1]))


def _mean_power(amplitude: Field, cols: int) -> float:
    """Return the mean power of all coefficients, given the amplitudes of a real transform of `cols` columns."""
    columns = np.einsum("ij,ij->j", amplitude, amplitude, dtype=np.float64)
    columns[1 : (cols + 1) // 2] *= 2
    return float(columns.sum() / (len(amplitude) * cols))


@dataclass(frozen=True)
class Textures:
    """The textures of a scene, each with a variance of about 1, and the part of a texture that each leaf shows."""

    pieces: NDArray[np.float32]  # (texture, row, col), periodic
    texture: NDArray[np.intp]  # (leaf,), index of the texture
    start: NDArray[np.int32]  # (leaf,), flat index in `pieces` of the first sample of the texture
    shift: NDArray[np.int32]  # (2, leaf), shift of the texture, in samples down and across
    level: NDArray[np.float32]  # (leaf,), constant that replaces variations that are too slow for a piece
    direction: tuple[float, float]  # stripes per sample, down and across
    waver: float  # standard deviation of the displacement of the stripes, in stripe periods
    duty: float  # fraction of a stripe period that is bright


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
        Index of the texture of each leaf, below TEXTURES.
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
    """Return the value of the texture at each sample.

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

    Returns
    -------
    ndarray, (row, col)
        Value of the texture.
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
    """Reduce the blotches and stripes in `value` to two tones, in place.

    Blotches then have sharp borders, as on fur, bark and prints. Stripes then look like cloth, blinds and letters.
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
    """Regular patterns on leaves. A pattern consists of strokes with a second reflectance.

    Lengths are in samples. Arrays have one value per leaf, unless a shape is stated.
    """

    present: NDArray[np.bool_]  # whether a leaf has a pattern
    first: NDArray[np.float32]  # (leaf, band), reflectance between the strokes, or of the whole leaf if it has no pattern
    second: NDArray[np.float32]  # (leaf, band), reflectance of the strokes
    kind: NDArray[np.intp]  # index into PATTERN_FREQUENCIES
    angle: NDArray[np.float32]  # radians; direction perpendicular to the strokes
    period: NDArray[np.float32]  # (2, leaf), period of the strokes and of the perpendicular bars
    width: NDArray[np.float32]  # (2, leaf), width of the strokes and of the bars
    phase: NDArray[np.float32]  # (2, leaf), phase of the strokes and of the bars, in fractions of a period


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
        Reflectances from which the reflectances of the strokes are chosen.
    reflectance : ndarray, (leaf, band)
        Reflectance of each leaf.
    oversampling : int
        Samples per pixel in each direction.
    drawn : ndarray of bool, (band), or slice
        Bands from which the saturation is calculated.

    Returns
    -------
    Patterns
        Colours and geometry for every leaf, including the leaves without a pattern.
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
    duty[1] = np.where(kind == 2, 1.5 / (along / across), duty[1])  # lettering is blank between the lines
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
    """Return the fraction of each sample that is covered by strokes.

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
        Covered fraction, from 0 to 1. Leaves without a pattern have a fraction of 0.
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
    """Return the fraction of each sample that parallel strokes cover, and the number of the nearest stroke.

    `axis` is 0 for the strokes of a pattern and 1 for the bars perpendicular to the strokes. The coverage is exact for
    strokes parallel to the sampling grid.
    """
    period, width = patterns.period[axis][label], patterns.width[axis][label]
    turns = position / period + patterns.phase[axis][label]
    number = np.floor(turns)
    distance = abs(turns - number - 0.5) * period  # distance from the middle of the nearest stroke, in samples
    covered = np.clip(0.5 + 0.5 * width - distance, 0.0, np.minimum(width, 1.0))
    return covered.astype(np.float32), number.astype(np.int64)


def _coin(one: NDArray[np.int64], other: NDArray[np.int64], label: NDArray[np.integer]) -> NDArray[np.bool_]:
    """Return a reproducible random bit for each pair of numbers on a leaf, computed with a multiplicative hash."""
    mixed = (one * 73856093) ^ (other * 19349663) ^ (label.astype(np.int64) * 83492791)
    return ((mixed * 2654435761) >> 16) & 1 == 1
