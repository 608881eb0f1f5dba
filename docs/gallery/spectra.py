"""Draw the figure of docs/measurement.md#reflectances: reflectances of four pixels, estimated from 16 bands.

python docs/gallery/spectra.py table.h5 unseen.h5

tests/studies/test_reflectance_study.py writes the table and the frames.
"""

import sys
from pathlib import Path

import numpy as np
from pictures import HEIGHT, STYLE, WIDTH, key_line, placed

from l3cli.artifacts.store import load
from l3cli.artifacts.table import TransformTable
from l3cli.artifacts.training_set import open_training_set
from l3cli.evaluation.evaluation import raw_of
from l3cli.evaluation.reflectance import Estimates
from l3cli.physics.spectra import SAMPLED
from l3cli.rendering.renderer import make_renderer
from l3cli.report.drawing import Axis, Plot, spanning
from l3cli.report.parts import Key
from l3cli.simulation.frame import frames_like
from l3cli.system.files import write_whole

PIXELS = {"plate": (0, 60, 200), "skin": (3, 85, 90), "orange": (3, 8, 115), "blue": (3, 22, 13)}  # frame, row, column
LINES = {  # colour, dashes and width of the line of each pipeline
    "scene": ("#57606a", "line", 5.0), "table": ("#1f6fb4", "line", 2.0),
    "wiener": ("#c2560c", "dashed", 1.5), "pinv": ("#2b7d46", "dotted", 1.5),
}  # fmt: skip
LEGEND, LINE = 30, 110  # px; height of the legend, and distance between its entries
Spectra = dict[str, np.ndarray]


def spectra_of(table: Path, frames: Path) -> dict[str, Spectra]:
    """Return the reflectance of each pixel in PIXELS, as computed by each pipeline."""
    transforms = load(TransformTable, table)
    renderer, spectra = make_renderer("opencl", transforms), dict[str, Spectra]()
    with open_training_set(frames) as reader:
        estimates = Estimates(reader.head.camera, frames_like(reader.head))
        for name, (index, row, col) in PIXELS.items():
            frame = reader.frame(index)
            ours = renderer.outputs(raw_of(frame, index, reader.head.camera)) * (transforms.output_unit / frame.exposure)
            planes = {"scene": frame.target, "table": ours} | estimates.planes(frame)
            spectra[name] = {pipeline: of[:, row, col] / frame.white for pipeline, of in planes.items()}
    return spectra


def drawing(spectra: dict[str, Spectra]) -> str:
    """Return an SVG file with a legend and one plot per pixel, two plots in a row."""
    parts = []
    for number, (name, curves) in enumerate(spectra.items()):
        plot = Plot(
            Axis("wavelength (nm)", 400.0, 700.0),
            spanning(f"reflectance of {name}", [0.0, *np.concatenate([*curves.values()])]),
        )
        for pipeline, (colour, mark, width) in LINES.items():
            plot.line(SAMPLED, curves[pipeline], colour, mark, width)
        down, across = divmod(number, 2)
        parts.append(placed(plot.figure(name, name).svg, across * WIDTH, LEGEND + down * HEIGHT, WIDTH, HEIGHT))
    keys = [key_line(Key(name, colour, mark), 6) for name, (colour, mark, _) in LINES.items()]
    parts += [f'<g transform="translate({60 + LINE * number} 0)">{key}</g>' for number, key in enumerate(keys)]
    width, height = 2 * WIDTH, LEGEND + 2 * HEIGHT
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" width="{width}" height="{height}" '
        f'color="#1b1f24"><style>{STYLE}</style><rect width="{width}" height="{height}" rx="6" fill="#fff"/>'
        f"{''.join(parts)}</svg>\n"
    )


if __name__ == "__main__":
    write_whole(Path(__file__).parents[1] / "reflectances.svg", drawing(spectra_of(*map(Path, sys.argv[1:]))).encode())
