"""Pixels of a crop with their classes and transforms, packed into the page for scripts that show them (pixels.js), and
what other classes the table has (classes.js).

What is packed is deflated and in base64: the length of the head in four bytes, the head as JSON padded to a multiple of
four bytes; then for each layer the largest weight of every class and output (float32), the class of every pixel as an index
into the head's classes (uint16), and the weights (int8) as 127 times the signed square root of their share of the largest.
Weights are those of the first classes of the head, as many as its `with_weights`. All numbers are little-endian.
"""

import base64
import functools
import json
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.camera import CameraModel
from l3cli.artifacts.table import MosaicLayer, PlaneLayer, TransformTable
from l3cli.classes.names import class_words, plane_class_words
from l3cli.report.colours import channel_light, hex_colour
from l3cli.report.parts import Jpeg, Picture, PixelPicker, Pixels

Array = NDArray[np.floating]
SIZES = ((192, 256), (144, 192), (96, 128), (72, 96), (48, 64), (24, 32))  # rows and columns of crops, tried in this order
QUALITY = 95  # of the crop's pictures
PLACES = 8  # of crops along each side of a frame
STEPS = 127  # of the square root of a weight's share of the largest
PLANES = ("X − aY", "Y", "Z − bY")  # that refinement layers read
COMPONENTS = ("first component", "mean", "second component")  # the same of bands


@dataclass(frozen=True)
class Layer:
    """A layer of a table at the pixels of a crop: first the classes that occur there, then others."""

    side: int  # of the windows
    planes: tuple[str, ...]  # names of what is read, in the order of the taps; one: the mosaic
    labels: NDArray[np.integer]  # (row, col) index into what follows
    words: tuple[dict[str, str], ...]  # (class) where each applies
    patches: Array  # (class) that it was trained on; 0: filled from a neighbour
    pixels: NDArray[np.integer]  # (class) of the frame
    weights: Array  # (class, output, tap) of the first classes

    @property
    def cropped(self) -> int:
        """Return the number of classes in the crop."""
        return int(self.labels.max()) + 1


@dataclass(frozen=True)
class Crop:
    """Part of a frame: its first row and column, and what stands there."""

    corner: tuple[int, int]
    frame: tuple[int, int]  # its rows and columns
    layers: tuple[Layer, ...]


@dataclass(frozen=True)
class Sites:
    """The colour filter array that the crop was seen through."""

    cfa: NDArray[np.uint8]  # (cfa_row, cfa_col) channel of each site
    channels: tuple[str, ...]
    colours: tuple[str, ...]  # CSS, (channel)


def crop_of(
    table: TransformTable, camera: CameraModel, labels: list[NDArray[np.integer]], limit: int, more: int = 0
) -> tuple[Crop, str]:
    """Return the crop of most classes, and it packed as text: the largest of SIZES that takes at most `limit` letters, else
    the smallest; then the table's other classes, the most frequent first, in at most `more` letters. `labels` (row, col)
    are the classes of the frame in each layer."""
    sites = Sites(table.cfa, table.channels, tuple(hex_colour(each) for each in channel_light(camera)))
    words = [_words(table, layer) for layer in table.layers]
    for size in SIZES:
        corner = richest(labels[0], size)
        area = tuple(slice(start, start + length) for start, length in zip(corner, size, strict=True))
        crop = _crop(table, words, labels, area)
        text = packed(crop, sites, table.outputs)
        if len(text) <= limit:
            break
    for others in ("all", "frame"):
        left = len(text) + more - len(packed(_crop(table, words, labels, area, others), sites, table.outputs))
        if left >= 0:
            crop = _crop(table, words, labels, area, others, left // len(labels))
            return crop, packed(crop, sites, table.outputs)
    return crop, text


def _crop(
    table: TransformTable,
    words: list[Callable[[int], dict[str, str]]],
    labels: list[NDArray[np.integer]],
    area: tuple[slice, ...],
    others: str = "none",
    letters: int = 0,
) -> Crop:
    """Return part of a frame, with the classes that do not occur there, those of most pixels of the frame first: "none",
    those of the "frame" or "all", with as many of their weights as `letters` for each layer hold."""
    layers = []
    for layer, worded, of in zip(table.layers, words, labels, strict=True):
        read = COMPONENTS if table.components else PLANES
        side, planes = (layer.rule.patch, ("mosaic",)) if isinstance(layer, MosaicLayer) else (layer.side, read)
        taps = side**2 * len(planes)
        pixels = np.bincount(of.ravel(), minlength=len(layer.weights))
        seen, indices = np.unique(of[area], return_inverse=True)
        order = np.argsort(-pixels, kind="stable")
        order = order[~np.isin(order, seen) & ((others == "all") | (pixels[order] > 0) & (others == "frame"))]
        room = letters * 3 // 4 // (layer.weights.shape[1] * (taps + 4))  # weights are hardly deflated
        classes = np.concatenate([seen, order])
        layers.append(
            Layer(
                side=side,
                planes=planes,
                labels=indices.reshape(of[area].shape),
                words=tuple(map(worded, classes.tolist())),
                patches=layer.samples[classes],
                pixels=pixels[classes],
                weights=layer.weights[classes[: len(seen) + room], :, :taps],
            )
        )
    return Crop((area[0].start, area[1].start), labels[0].shape, tuple(layers))


def _words(table: TransformTable, layer: MosaicLayer | PlaneLayer) -> Callable[[int], dict[str, str]]:
    """Return a function of a class of the layer that describes it in words."""
    every = np.arange(len(layer.weights))
    sites = layer.rule.split(every).site.tolist()
    # In the first layer a class has the same words at every site.
    within = layer.rule.within_site(every).tolist() if isinstance(layer, MosaicLayer) else every.tolist()

    @functools.cache
    def place(index: int) -> dict[str, str]:
        return class_words(table, index) if isinstance(layer, MosaicLayer) else plane_class_words(table, layer, index)

    @functools.cache
    def words(index: int) -> dict[str, str]:
        row, col = divmod(sites[index], table.cfa.shape[1])
        site = f"({row}, {col}) {table.channels[table.cfa[row, col]]}"
        return {"class": f"{index} of {len(sites)}", "site": site, **place(within[index])}

    return words


def richest(labels: NDArray[np.integer], size: tuple[int, int]) -> tuple[int, int]:
    """Return the corner of the crop of at most `size` that shows most classes of `labels` (row, col), the first if
    several."""
    best, most = (0, 0), -1
    room = [max(0, whole - part) for whole, part in zip(labels.shape, size, strict=True)]
    tops, lefts = (sorted({length * step // PLACES for step in range(PLACES + 1)}) for length in room)
    for top in tops:
        for left in lefts:
            count = len(np.unique(labels[top : top + size[0], left : left + size[1]]))
            if count > most:
                best, most = (top, left), count
    return best


def packed(crop: Crop, sites: Sites, outputs: tuple[str, ...]) -> str:
    """Return all of it as text."""
    head: dict[str, Any] = {
        "corner": crop.corner,
        "size": crop.layers[0].labels.shape,
        "frame": crop.frame,
        "outputs": outputs,
        "cfa": sites.cfa.tolist(),
        "channels": sites.channels,
        "colours": sites.colours,
        "layers": [
            {
                "side": layer.side,
                "planes": layer.planes,
                "with_weights": len(layer.weights),
                "pixels": np.trim_zeros(layer.pixels, "b").tolist(),
                "classes": [
                    {**words, "training": f"{count:.0f} patches" if count > 0 else "none: filled from a neighbour"}
                    for words, count in zip(layer.words, layer.patches.tolist(), strict=True)
                ],
            }
            for layer in crop.layers
        ],
    }
    text = json.dumps(head, ensure_ascii=False, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 4)
    whole = len(text).to_bytes(4, "little") + text + b"".join(_numbers(layer) for layer in crop.layers)
    return base64.b64encode(zlib.compress(whole, 9)).decode()


def _numbers(layer: Layer) -> bytes:
    largest = np.abs(layer.weights).max(axis=2).astype("<f4")
    share = layer.weights / np.where(largest > 0, largest, 1.0)[..., None]
    weights = np.rint(STEPS * np.sign(share) * np.sqrt(np.abs(share))).astype(np.int8)
    parts = (largest.tobytes(), layer.labels.astype("<u2").tobytes(), weights.tobytes())
    return b"".join(part + b"\0" * (-len(part) % 4) for part in parts)


def picker(anchor: str, crop: Crop, text: str, pictures: dict[str, Pixels], scene: str, jpeg: Jpeg) -> PixelPicker:
    """Return the block of a page: `pictures` of the whole frame by name, `text` what `packed` has made of the crop."""
    (top, left), (rows, cols) = crop.corner, crop.layers[0].labels.shape
    where = f"{cols} × {rows} pixels from row {top}, column {left}"
    shown = []
    for name, picture in pictures.items():
        coded = base64.b64encode(jpeg(np.ascontiguousarray(picture[top : top + rows, left : left + cols]), QUALITY)).decode()
        shown.append(Picture("data:image/jpeg;base64," + coded, rows, cols, name, f"{scene}, {name}: {where}"))
    counts = ", ".join(f"{layer.cropped} of layer {number}" for number, layer in enumerate(crop.layers, 1))
    return PixelPicker(anchor, f"{where}, enlarged. Classes that occur in it: {counts}.", tuple(shown), text)
