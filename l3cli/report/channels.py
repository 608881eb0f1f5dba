"""Marks and keys of channels and tables of numbers by name, shared by the figures of a camera."""

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.camera import CameraModel
from l3cli.report.parts import Key, Table, tidy, unit

Array = NDArray[np.floating]
MARKS = {"line": "dot", "dashed": "plus", "dotted": "cross"}  # of a line → of a point
ALIKE = 170  # sum of sRGB differences below which two colours are easily taken for one another


def mark_of(strokes: tuple[str, ...], channel: int) -> str:
    """Marks distinguish channels whose colours are alike: the one least used by earlier channels of like colour."""
    used: list[str] = []
    for index in range(channel + 1):
        alike = [mark for mark, stroke in zip(used, strokes, strict=False) if _distance(stroke, strokes[index]) < ALIKE]
        used.append(min(MARKS, key=alike.count))
    return used[channel]


def _distance(one: str, other: str) -> float:
    return float(np.abs(_rgb(one) - _rgb(other)).sum())


def _rgb(colour: str) -> Array:
    return np.array([int(colour[start : start + 2], 16) for start in (1, 3, 5)], dtype=np.float64)


def channel_keys(camera: CameraModel, strokes: tuple[str, ...]) -> tuple[Key, ...]:
    return tuple(Key(name, strokes[index], mark_of(strokes, index)) for index, name in enumerate(camera.channels))


def table_of(caption: str, heading: str, rows: dict[str, dict[str, float]]) -> Table:
    """Return the rows of numbers by name, as calibration's figures hold them."""
    titles = tuple(next(iter(rows.values())))
    body = tuple((name, *(_cell(title, row[title]) for title in titles)) for name, row in rows.items())
    return Table(caption, (heading, *map(unit, titles)), body)


def _cell(title: str, value: float) -> str:
    return f"{value:.5f}" if title.startswith("R²") else tidy(value, 4)
