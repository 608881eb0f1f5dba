"""Draw the figures of the gallery: grids of pictures, and SVG files with the filters and responsivities of a camera."""

import re

import numpy as np
import OpenImageIO as oiio
from numpy.typing import NDArray

from l3cli.artifacts.camera import CameraModel
from l3cli.artifacts.training_set import TrainingPair
from l3cli.physics.display import srgb_codes
from l3cli.report import colours
from l3cli.report.camera import array_figure, responsivity_figures
from l3cli.report.drawing import DASHES, HEIGHT, WIDTH
from l3cli.report.parts import Key

Picture = NDArray[np.uint8]  # (row, col, 3) encoded sRGB
GAP = 4  # white pixels between pictures
LABEL_HEIGHT, LABEL_SIZE = 26, 17  # px; height of the white strip above a labelled picture, and of its letters

SIDE, KEY, MARGIN = 300, 150, 10  # px in a drawing: side of the array, width of the legend, margin
CELL_SIDE = 90  # px; largest side of a filter
LINE = 17  # px; height of a line in the legend
# Each drawing contains this style and a white background, because the styles of a page do not apply to its pictures.
STYLE = (
    "text{font:12px system-ui,'Segoe UI',Roboto,'DejaVu Sans',sans-serif;fill:#1b1f24}.grid{stroke:#d0d7de;fill:none}"
    ".axis{stroke:#57606a;fill:none}.mark{paint-order:stroke;stroke:#fff;stroke-width:3px;stroke-linejoin:round}"
)


def raw_picture(frame: TrainingPair, camera: CameraModel) -> Picture:
    """Return the mosaic as a picture from the black level to the white level. Each pixel has the colour of its filter."""
    share = np.clip((frame.raw - camera.black_level) / (camera.white_level - camera.black_level), 0.0, 1.0)
    light = colours.channel_light(camera)
    rows, cols = (np.arange(length) % period for length, period in zip(frame.raw.shape, camera.cfa.shape, strict=True))
    picture: Picture = srgb_codes(share[..., None] * light[camera.cfa[np.ix_(rows, cols)]])
    return picture


def enlarged(picture: Picture, corner: tuple[int, int], size: tuple[int, int], factor: int) -> Picture:
    """Return the crop of `size` (rows, cols) at `corner`, enlarged by `factor`."""
    crop = picture[corner[0] : corner[0] + size[0], corner[1] : corner[1] + size[1]]
    return crop.repeat(factor, axis=0).repeat(factor, axis=1)


def labelled(picture: Picture, label: str) -> Picture:
    """Return the picture with a white strip above it that contains the label."""
    strip = oiio.ImageBuf(oiio.ImageSpec(picture.shape[1], LABEL_HEIGHT, 3, "uint8"))
    oiio.ImageBufAlgo.fill(strip, (1.0, 1.0, 1.0))
    baseline = LABEL_HEIGHT - 8
    if not oiio.ImageBufAlgo.render_text(strip, 2, baseline, label, LABEL_SIZE, textcolor=(0.1, 0.1, 0.1)):
        raise OSError(strip.geterror())
    return np.concatenate([strip.get_pixels("uint8"), picture])


def grid(pictures: list[list[Picture]]) -> Picture:
    """Join rows of pictures, with gaps. The pictures of a row must have equal heights, and the rows equal widths."""
    rows = [_joined(row, axis=1) for row in pictures]
    return _joined(rows, axis=0)


def _joined(pictures: list[Picture], axis: int) -> Picture:
    shape = list(pictures[0].shape)
    shape[axis] = GAP
    between = np.full(shape, 255, np.uint8)
    parts = [part for picture in pictures for part in (between, picture)][1:]
    return np.concatenate(parts, axis=axis)


def drawing(camera: CameraModel) -> str:
    """Return an SVG file with one period of the array, the responsivities and a legend."""
    array, curves = array_figure(camera), responsivity_figures(camera)[0]
    side = min(SIDE, CELL_SIDE * max(camera.cfa.shape))
    left, legend = MARGIN + SIDE + MARGIN, MARGIN + SIDE + MARGIN + WIDTH + MARGIN
    size = f"{legend + KEY} {max(SIDE, HEIGHT, LINE * len(curves.legend)) + 2 * MARGIN}"
    width, height = size.split()
    keys = "".join(key_line(key, MARGIN + LINE * index) for index, key in enumerate(curves.legend))
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {size}" width="{width}" height="{height}" color="#1b1f24">'
        f"<style>{STYLE}</style>"
        f'<rect width="{width}" height="{height}" rx="6" fill="#fff"/>'
        f"{placed(array.svg, MARGIN, MARGIN, side, side)}{placed(curves.svg, left, MARGIN, WIDTH, HEIGHT)}"
        f'<g transform="translate({legend} 0)">{keys}</g></svg>\n'
    )


def placed(svg: str, x: int, y: int, width: int, height: int) -> str:
    """Return an SVG drawing as an element of another drawing, scaled into a box and aligned at its upper left corner."""
    view = re.match(r'<svg (viewBox="[^"]+")[^>]*>', svg)
    assert view is not None
    box = f'x="{x}" y="{y}" width="{width}" height="{height}" preserveAspectRatio="xMinYMin meet"'
    return f"<svg {box} {view[1]}>{svg[view.end() :]}"


def key_line(key: Key, y: int) -> str:
    line = f'<path d="M0,{y + 8}h24" stroke="{key.colour}" stroke-width="2"{DASHES[key.mark]}/>'
    return f'{line}<text x="30" y="{y + 12}">{key.label}</text>'
