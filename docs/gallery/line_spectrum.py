"""Draw the figure of docs/measurement.md#row-and-column-noise-of-real-frames: power spectra of row means.

python docs/gallery/line_spectrum.py colorchart.dng

The file is a raw frame of a Canon EOS 550D, whose border contains masked pixels. The script prints the noise of the masked
pixels, and draws the power spectrum of their row means beside the spectra of two simulated sensors: one with the same noise
of rows and columns, and one with noise of pixels only.
"""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import rawpy
from numpy.typing import NDArray
from pictures import HEIGHT, STYLE, WIDTH, key_line, placed

import l3cli as l3
from l3cli.artifacts.camera import CameraModel, Noise
from l3cli.calibration.noise import LineNoise, line_noise
from l3cli.calibration.statistics import LineSquares, line_squares, mean_squares
from l3cli.frames.measurement import Body
from l3cli.report.drawing import Plot, spanning
from l3cli.report.parts import Key
from l3cli.simulation import sensor
from l3cli.system.files import write_whole

FIRST_ROW, MASKED = 26, slice(8, 144)  # rows from the active area on, and columns of the masked border without its ends
BLACK_LEVEL, WHITE_LEVEL, BITS = 2048.0, 15000.0, 14  # DN
WHITE_FROM = 0.03  # cycles per pixel; the row noise of the frame has no trend above this frequency
GROUPS = 28  # number of points of each spectrum
SIMULATED = 64  # number of simulated frames over which the spectra are averaged
Array = NDArray[np.float64]
LINES = {
    "Canon EOS 550D": ("#1f6fb4", "line"),
    "simulated": ("#c2560c", "dashed"),
    "pixel noise only": ("#57606a", "dotted"),
}
LEGEND, KEY = 24, 140  # px; height of the legend, and distance between its entries


def masked_pixels(path: Path) -> Array:
    """Return the masked pixels at the left border of a raw frame in DN, starting at an even row and an even column."""
    with rawpy.imread(str(path)) as raw:
        return np.asarray(raw.raw_image[FIRST_ROW:, MASKED], np.float64)


def found_noise(values: Array, camera: CameraModel) -> tuple[LineNoise, LineNoise, LineSquares]:
    """Return the noise of rows and of columns, and the mean squares of a single dark frame."""
    c = replace(camera, rows=values.shape[0], cols=values.shape[1])
    body = Body(c.name, c.rows, c.cols, c.pixel_pitch, c.bits, c.channels, c.cfa, c.optics)
    found = mean_squares([line_squares(values, body)], body)
    rows = line_noise([(found.rows, found.pixels, found.row_freedom)], c.cols)
    return rows, line_noise([(found.columns, found.pixels, found.column_freedom)], c.rows), found


def spectrum(frames: list[Array]) -> tuple[Array, Array]:
    """Return spatial frequencies in cycles per pixel, and the standard deviation of row means at each frequency in DN.

    White row means have the same standard deviation at all frequencies. The mean of each parity of rows is subtracted.
    """
    power = []
    for frame in frames:
        means = frame.mean(axis=1)
        means = means - np.where(np.arange(means.size) % 2, means[1::2].mean(), means[::2].mean())
        power.append(np.abs(np.fft.rfft(means, norm="ortho")) ** 2)
    frequency = np.fft.rfftfreq(frames[0].shape[0])[1:-1]
    edges = np.unique(np.geomspace(1, frequency.size + 1, GROUPS + 1).astype(int) - 1)
    starts = edges[:-1]
    counts = np.diff(np.append(starts, frequency.size))
    mean = np.add.reduceat(np.mean(power, axis=0)[1:-1], starts) / counts
    return np.add.reduceat(frequency, starts) / counts, np.sqrt(mean)


def white_rows(values: Array, of_pixels: float) -> tuple[float, float]:
    """Return the white part of the row noise and its standard error in DN, from the spectrum above WHITE_FROM."""
    means = values.mean(axis=1)
    means[::2] -= means[::2].mean()
    means[1::2] -= means[1::2].mean()
    power = np.abs(np.fft.rfft(means, norm="ortho")) ** 2
    high = power[np.fft.rfftfreq(means.size) > WHITE_FROM][:-1]
    deviation = np.sqrt(max(high.mean() - of_pixels / values.shape[1], 0.0))
    return float(deviation), float(high.mean() / np.sqrt(high.size) / (2 * deviation))


def simulated(camera: CameraModel) -> list[Array]:
    dark = np.zeros((camera.rows, camera.cols), np.float32)
    fixed = sensor.fixed_pattern(camera)
    return [
        sensor.read_out(camera, fixed, dark, 0.0, np.random.default_rng(seed)).astype(np.float64)
        for seed in range(SIMULATED)
    ]


def main(path: Path) -> None:
    values = masked_pixels(path)
    bayer = l3.load_camera("bayer")
    rows, columns, found = found_noise(values, bayer)
    pixels = float(np.sqrt(found.pixels))
    for name, line in (("rows", rows), ("columns", columns)):
        print(f"{name}: {line.deviation:.2f} ± {line.error:.2f} DN")
    print(f"pixels: {pixels:.2f} DN; {values.shape[0]} rows, {values.shape[1]} columns")
    white, error = white_rows(values, found.pixels)
    print(f"rows, above {WHITE_FROM} cycles per pixel: {white:.2f} ± {error:.2f} DN")
    noise = Noise(
        pixels, 0.0, 0.0, 0.0, WHITE_LEVEL, row_temporal_noise=rows.deviation, column_temporal_noise=columns.deviation
    )
    camera = replace(
        bayer, rows=values.shape[0], cols=values.shape[1], bits=BITS, gain=1.0, black_level=BLACK_LEVEL,
        white_level=WHITE_LEVEL, noise=noise,
    )  # fmt: skip
    plain = replace(camera, noise=Noise(pixels, 0.0, 0.0, 0.0, WHITE_LEVEL))
    spectra = dict(zip(LINES, (spectrum([values]), spectrum(simulated(camera)), spectrum(simulated(plain))), strict=True))
    every = np.concatenate([each[1] for each in spectra.values()])
    plot = Plot(
        spanning("spatial frequency (cycles per pixel)", spectra["pixel noise only"][0], log=True),
        spanning("standard deviation of row means (DN)", every, zero=True),
    )
    for name, (colour, mark) in LINES.items():
        plot.line(*spectra[name], colour, mark, 2.0)
    keys = [key_line(Key(name, colour, mark), 6) for name, (colour, mark) in LINES.items()]
    legend = "".join(f'<g transform="translate({20 + KEY * number} 0)">{key}</g>' for number, key in enumerate(keys))
    svg = placed(plot.figure("Row means", "Power spectra of row means").svg, 0, LEGEND, WIDTH, HEIGHT)
    drawn = (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {LEGEND + HEIGHT}" width="{WIDTH}" '
        f'height="{LEGEND + HEIGHT}" color="#1b1f24"><style>{STYLE}</style>'
        f'<rect width="{WIDTH}" height="{LEGEND + HEIGHT}" rx="6" fill="#fff"/>{legend}{svg}</svg>\n'
    )
    write_whole(Path(__file__).parents[1] / "line_spectrum.svg", drawn.encode())


if __name__ == "__main__":
    main(Path(sys.argv[1]))
