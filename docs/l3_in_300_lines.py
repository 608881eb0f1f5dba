"""L3 (Local, Linear, Learned) for a Bayer camera, from spectra to a picture, with numpy only.

    python l3_in_300_lines.py picture.png

This program draws scenes of dead leaves and simulates a camera with three Gaussian filters. It classifies neighbourhoods of
pixels, learns one linear transform for each class, and renders a frame that was not used for learning. The program
implements the method without refinements: one layer, and classes by level, contrast and saturation, without symmetry and
chroma. For such a table, `render` computes the same outputs as the reference backend of l3cli. The page method.md contains
the equations and their sources. "#level" refers to the section Level of that page.
"""

import struct
import sys
import zlib
from typing import NamedTuple

import numpy as np

# The camera: spectral responsivities, a mosaic, noise.

WAVELENGTH = np.arange(400.0, 701.0, 10.0)  # nm
CFA = np.array([[1, 0], [2, 1]])  # channel of each site of the super-pixel: green red / blue green
RESPONSIVITY = 0.5 * np.exp(
    -(((WAVELENGTH - np.array([[600.0], [540.0], [460.0]])) / 45) ** 2)
)  # (channel, wavelength) e-/photon
FULL_WELL = 8000.0  # e- at the white level
READ_NOISE = 5.0  # e-, standard deviation
BLACK_LEVEL, WHITE_LEVEL = 64, 4095  # DN, of 12 bits
CHANNELS = len(RESPONSIVITY)
SITES = CFA.size


def bell(centre, below, above):
    """Return a Gaussian over wavelength, with the standard deviations `below` and `above` on the two sides of the centre."""
    return np.exp(-0.5 * ((WAVELENGTH - centre) / np.where(centre > WAVELENGTH, below, above)) ** 2)


# Colour matching functions x, y, z (Wyman, Sloan, Shirley 2013, equation 4). The illuminant is a black body of 6500 K, in
# photons.
MATCHING = np.array(
    [
        1.056 * bell(599.8, 37.9, 31.0) + 0.362 * bell(442.0, 16.0, 26.7) - 0.065 * bell(501.1, 20.4, 26.2),
        0.821 * bell(568.8, 46.9, 40.5) + 0.286 * bell(530.9, 16.3, 31.1),
        1.217 * bell(437.0, 11.8, 36.0) + 0.681 * bell(459.0, 26.0, 13.8),
    ]
)
LIGHT = 1 / (WAVELENGTH**4 * np.expm1(1.4388e7 / (WAVELENGTH * 6500)))
TO_SIGNAL = RESPONSIVITY * LIGHT
TO_SIGNAL /= TO_SIGNAL.sum(axis=1).max()  # (channel, wavelength); a white just fills the most sensitive channel
TO_XYZ = MATCHING * LIGHT / WAVELENGTH  # the matching functions apply to energy, not to photons
TO_XYZ /= TO_XYZ[1].sum()  # (output, wavelength); a white has Y = 1


class Frame(NamedTuple):
    """The signals of a scene in all channels of the camera, without mosaic and noise, and the ideal outputs."""

    signal: np.ndarray  # (row, col, channel), as a fraction of full scale
    target: np.ndarray  # (row, col, output): X, Y, Z, where a white has Y = 1


def draw_scene(size, rng):
    """Return a frame of dead leaves: overlapping discs of many sizes with smooth spectra (#procedural-scenes)."""
    reflectance = np.empty((size, size, WAVELENGTH.size))
    row, col = np.mgrid[:size, :size]
    reflectance[:] = draw_spectrum(rng)
    for radius in np.sort(3 / rng.uniform(3 / size, 1, 300))[::-1]:
        centre = rng.uniform(0, size, 2)
        inside = (row - centre[0]) ** 2 + (col - centre[1]) ** 2 < radius**2
        stripes = 1 + 0.3 * rng.random() * np.sin(row * rng.normal() + col * rng.normal())
        reflectance[inside] = np.minimum(draw_spectrum(rng) * stripes[inside, None], 1)
    for axis in (0, 1):  # the lens blurs by a binomial kernel of three pixels
        shifted = np.pad(reflectance, [(1, 1) if each == axis else (0, 0) for each in range(3)], mode="edge")
        before, middle, after = (np.take(shifted, np.arange(size) + step, axis) for step in range(3))
        reflectance = (before + 2 * middle + after) / 4
    return Frame(reflectance @ TO_SIGNAL.T, reflectance @ TO_XYZ.T)


def draw_spectrum(rng):
    """Return a random reflectance (wavelength) between 0 and 1. One in four is grey. The others have a step or a band."""
    height, floor = rng.uniform(0.1, 0.9), rng.uniform(0.02, 0.1)
    if rng.random() < 0.25:
        return np.full(WAVELENGTH.size, height)
    step = np.tanh((WAVELENGTH - rng.uniform(400, 700)) / rng.uniform(15, 60)) * rng.choice([-1, 1])
    other = np.tanh((WAVELENGTH - rng.uniform(400, 700)) / rng.uniform(15, 60)) * rng.choice([-1, 1])
    return floor + height * (1 - floor) * (0.5 + 0.5 * (step if rng.random() < 0.5 else step * other))


def channel_of(rows, cols):
    """Return the channel number (row, col) of every pixel of a mosaic."""
    return CFA[np.arange(rows)[:, None] % CFA.shape[0], np.arange(cols)[None] % CFA.shape[1]]


def mosaic_of(signal):
    """Return the mosaic (row, col) of signals (row, col, channel): for each pixel, the signal behind its filter."""
    rows, cols, _ = signal.shape
    return np.take_along_axis(signal, channel_of(rows, cols)[..., None], axis=2)[..., 0]


def noise_variance(signal):
    """Return the variance of photon noise and read noise (#noise). Signal and noise are fractions of full scale."""
    return np.maximum(signal, 0) / FULL_WELL + (READ_NOISE / FULL_WELL) ** 2


def expose(mosaic, rng):
    """Convert a mosaic (row, col) in fractions of full scale to DN (uint16): add noise, round and clip."""
    electrons = rng.poisson(mosaic * FULL_WELL) + rng.normal(0, READ_NOISE, mosaic.shape)
    values = BLACK_LEVEL + electrons / FULL_WELL * (WHITE_LEVEL - BLACK_LEVEL)
    return np.clip(np.rint(values), 0, WHITE_LEVEL).astype(np.uint16)


# Classes are computed with integers only, so that every computer assigns the same classes (#classes).

PATCH = 7  # side of the neighbourhood in pixels
RADIUS = PATCH // 2
LEVEL_SHARES = np.geomspace(0.002, 0.9, 11)  # boundaries between levels, as fractions of full scale
LEVELS = LEVEL_SHARES.size + 1
CONTRAST = 1.4  # a patch is textured if √(variance of the patch / variance of its noise) is above this value
CONTRASTS = 2
SATURATION = int(np.ceil(BLACK_LEVEL + 0.985 * (WHITE_LEVEL - BLACK_LEVEL)))  # DN
SATURATION_RADIUS = 2  # pixels
CASES = 2**CHANNELS  # one case for each set of saturated channels
CLASSES = SITES * LEVELS * CONTRASTS * CASES
SPAN = WHITE_LEVEL - BLACK_LEVEL  # DN

# Levels are compared in units of 1/(256 × channels) DN, and variances in units of 1/(512 × channels) DN². The variance of
# rounding is 1/12 DN². Because means are rounded down, variances are too large by 1/3 DN² on average.
LEVEL_EDGES = np.rint((BLACK_LEVEL + LEVEL_SHARES * SPAN) * 256 * CHANNELS).astype(np.int64)
LEVEL_CENTRES = np.concatenate([LEVEL_SHARES[:1] / 2, np.sqrt(LEVEL_SHARES[1:] * LEVEL_SHARES[:-1]), [0.95]])
NOISE_OF_LEVEL = noise_variance(LEVEL_CENTRES) * SPAN**2 + 1 / 12 + 1 / 3
CONTRAST_EDGES = np.rint(CONTRAST**2 * NOISE_OF_LEVEL * CHANNELS * 512).astype(np.int64)  # (level)


def padded(mosaic, margin):
    """Extend the mosaic by `margin` mirrored pixels on every side, so that the CFA pattern continues (#rendering)."""
    return np.pad(mosaic, margin, mode="reflect")  # a Bayer pattern that is mirrored about a pixel is unchanged


def windows_of(mosaic, radius):
    """Return the square neighbourhood of every pixel as an array (row, col, tap). The taps are in row-major order."""
    side = 2 * radius + 1
    view = np.lib.stride_tricks.sliding_window_view(padded(mosaic, radius), (side, side))
    return view.reshape(*mosaic.shape, side * side)


def classify(values):
    """Return the class (row, col) and the CFA site (row, col) of every pixel of a raw frame (row, col) in DN."""
    rows, cols = values.shape
    channel = channel_of(rows, cols)
    taps, tap_channel = windows_of(values.astype(np.int64), RADIUS), windows_of(channel, RADIUS)
    inner_taps, inner_channel = windows_of(values, SATURATION_RADIUS), windows_of(channel, SATURATION_RADIUS)
    level_sum = np.zeros((rows, cols), np.int64)
    variance = np.zeros((rows, cols), np.int64)
    case = np.zeros((rows, cols), np.int64)
    for each in range(CHANNELS):
        same_channel = tap_channel == each
        count, total, squares = same_channel.sum(-1), (taps * same_channel).sum(-1), (taps**2 * same_channel).sum(-1)
        scaled = total * ((2 * 65536 + count) // (2 * count))  # 65536 × the mean of the channel
        mean = scaled >> 16
        level_sum += scaled >> 8
        deviation = squares - mean * (2 * total - count * mean)
        variance += np.minimum(deviation * ((2 * 512 + count) // (2 * count)), (2**32 - 1) // CHANNELS)
        case |= ((inner_taps >= SATURATION) & (inner_channel == each)).any(-1).astype(np.int64) << each
    level = np.searchsorted(LEVEL_EDGES, level_sum, side="right")
    contrast = variance > CONTRAST_EDGES[level]
    site = np.arange(rows)[:, None] % CFA.shape[0] * CFA.shape[1] + np.arange(cols)[None] % CFA.shape[1]
    return ((site * LEVELS + level) * CONTRASTS + contrast) * CASES + case, site


# Learning: for each class, compute the affine transform with the smallest expected squared error (#solution).

NOISE_WEIGHT = 1.5  # weight of the noise in the equations; values above 1 give smoother pictures
RIDGE = 1e-5  # ridge, relative to the mean power of a tap
FEWEST = 4 * PATCH**2  # a class with fewer samples uses the equations of a similar class


def learn(frames, exposures, rng):
    """Learn weights (class, output, tap) and intercepts (class, output). Each frame is used once for each exposure factor.

    Classes are determined from noisy values, as in rendering. The moments are computed from signals without noise, and the
    expected noise variance is added to the diagonal. The transforms therefore do not depend on random noise. Signals are
    clipped like the values of pixels, but targets are not clipped.
    """
    size = PATCH**2 + 1  # the intercept is a tap that is always 1
    squares, products, counts = np.zeros((CLASSES, size, size)), np.zeros((CLASSES, size, 3)), np.zeros(CLASSES)
    for frame in frames:
        for exposure in exposures:
            signal = mosaic_of(frame.signal * exposure)
            label, _ = classify(expose(signal, rng))
            taps = windows_of(np.minimum(signal, 1), RADIUS)
            noise = windows_of(np.where(signal < 1, noise_variance(signal), 0), RADIUS)
            inner = slice(RADIUS, -RADIUS), slice(RADIUS, -RADIUS)  # mirrored borders do not occur in scenes
            label, taps, noise, target = (each[inner] for each in (label, taps, noise, frame.target * exposure))
            order = np.argsort(label, axis=None, kind="stable")
            label, taps, noise, target = (each.reshape(label.size, -1)[order] for each in (label, taps, noise, target))
            for one, first, count in zip(*np.unique(label, return_index=True, return_counts=True), strict=True):
                these = slice(first, first + count)
                rows = np.hstack([taps[these], np.ones((count, 1))])
                squares[one] += rows.T @ rows + NOISE_WEIGHT * np.diag(np.append(noise[these].sum(0), 0))
                products[one] += rows.T @ target[these]
                counts[one] += count
    weights = np.zeros((CLASSES, 3, PATCH**2), np.float32)
    intercept = np.zeros((CLASSES, 3), np.float32)
    for one in range(CLASSES):
        source = one if counts[one] >= FEWEST else fullest_neighbour(one, counts)
        ridge = RIDGE * np.trace(squares[source]) / size * np.eye(size)
        solution = np.linalg.solve(squares[source] + ridge, products[source])
        weights[one], intercept[one] = solution[:-1].T, solution[-1]
    return weights, intercept


def fullest_neighbour(one, counts):
    """Return the most similar class of the same site that has enough samples. Its equations replace those of class `one`."""
    by_feature = counts.reshape(SITES, LEVELS, CONTRASTS, CASES)
    site, level, contrast, case = np.unravel_index(one, by_feature.shape)
    distance = abs(np.arange(LEVELS) - level)[:, None, None] + 3 * (np.arange(CONTRASTS) != contrast)[:, None]
    distance = distance + 2 * np.bitwise_count(np.arange(CASES) ^ case)
    found = np.where(by_feature[site] >= FEWEST, distance, 1000).argmin()
    return site * LEVELS * CONTRASTS * CASES + found


# Rendering: one dot product per output (#rendering).


def render(values, weights, intercept):
    """Render a raw frame (row, col) in DN to X, Y, Z (row, col, output).

    The transform of the class of each pixel is applied to the neighbourhood of the pixel.
    """
    label, _ = classify(values)
    taps = windows_of((values - float(BLACK_LEVEL)) / SPAN, RADIUS)
    picture = np.empty((*values.shape, 3))
    for row in range(len(values)):  # row by row, because the transforms of all pixels together would need too much memory
        chosen = weights[label[row]].astype(np.float64)
        picture[row] = np.einsum("pot,pt->po", chosen, taps[row]) + intercept[label[row]]
    return picture


# Display: convert XYZ to sRGB (IEC 61966-2-1), so that a white under the illuminant becomes display white.

XYZ_TO_RGB = np.array([[3.2406, -1.5372, -0.4986], [-0.9689, 1.8758, 0.0415], [0.0557, -0.2040, 1.0570]])


def encode(xyz):
    """Convert X, Y, Z (row, col, output), where a white has Y = 1, to sRGB (row, col, 3) of type uint8."""
    linear = np.clip(xyz @ XYZ_TO_RGB.T / (XYZ_TO_RGB @ TO_XYZ.sum(axis=1)), 0, 1)
    curve = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
    return np.rint(curve * 255).astype(np.uint8)


def write_png(path, pixels):
    """Write sRGB pixels (row, col, 3) of type uint8 to a PNG file."""
    rows, cols, _ = pixels.shape
    lines = np.concatenate([np.zeros((rows, 1), np.uint8), pixels.reshape(rows, -1)], axis=1).tobytes()
    chunks = (b"IHDR", struct.pack(">IIBBBBB", cols, rows, 8, 2, 0, 0, 0)), (b"IDAT", zlib.compress(lines)), (b"IEND", b"")
    with open(path, "wb") as file:
        file.write(b"\x89PNG\r\n\x1a\n")
        for kind, content in chunks:
            file.write(struct.pack(">I", len(content)) + kind + content + struct.pack(">I", zlib.crc32(kind + content)))


def main():
    """Learn a table, render an unseen scene, print its PSNR, and write the picture next to the ideal picture."""
    rng = np.random.default_rng(1)
    weights, intercept = learn([draw_scene(160, rng) for _ in range(20)], (0.02, 0.1, 0.4, 0.8, 1.5), rng)
    unseen = draw_scene(160, rng)
    signal = mosaic_of(unseen.signal * 0.8)
    picture = render(expose(signal, rng), weights, intercept) / 0.8
    error = np.clip(picture, 0, 1) - unseen.target
    print(f"PSNR of X, Y, Z: {-10 * np.log10(np.mean(error**2)):.1f} dB")
    write_png(sys.argv[1] if len(sys.argv) > 1 else "picture.png", encode(np.hstack([picture, unseen.target])))


if __name__ == "__main__":
    main()
