"""Encode a crop of a frame in which the reader of a report can inspect each pixel's class and transform.

The data are embedded in the page. The script pixels.js shows a pixel's class and transform, and classes.js lists all
classes.

The data are compressed with deflate and encoded as base64. Before compression, they consist of:

* the length of the header in bytes (uint32),
* the header as JSON, padded with spaces to a multiple of four bytes,
* three arrays per layer, padded with zeros to multiples of four bytes:

  1. the largest absolute weight of each class and output (float32),
  2. the class of each pixel, as an index into the header's list of classes (uint16),
  3. the weights w as sign(w) · 127 · √(|w| / largest) (int8), where `largest` is from the first array.

Only the first `with_weights` classes of the header have weights. All numbers are little-endian.
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
from l3cli.artifacts.layers import MosaicLayer, PlaneLayer
from l3cli.artifacts.table import TransformTable
from l3cli.classes.names import class_words, plane_class_words
from l3cli.physics.stokes import has_stokes, luminance_name
from l3cli.report.colours import channel_light, hex_colour
from l3cli.report.parts import Jpeg, Picture, PixelPicker, Pixels

Array = NDArray[np.floating]
# Rows and columns of the crop, in order of preference.
CROP_SIZES = (
    (192, 256),
    (144, 192),
    (96, 128),
    (72, 96),
    (48, 64),
    (24, 32),
)
JPEG_QUALITY = 95  # JPEG quality of the pictures of the crop
CROP_STEPS = 8  # number of steps along each axis of the frame in the search for the best crop
WEIGHT_SCALE = 127  # integer that represents the largest weight
PLANES = ("X − aY", "Y", "Z − bY")  # input planes of refinement layers in tables with three outputs
COMPONENTS = ("first component", "mean", "second component")  # input planes of the refinement layer in spectral tables


@dataclass(frozen=True)
class Layer:
    """Classes and weights of one layer for the pixels of a crop.

    On class axes, the classes that occur in the crop come first.
    """

    side: int  # side of the window in pixels
    planes: tuple[str, ...]  # names of the input planes, in the order of the taps; ("mosaic",) in the first layer
    labels: NDArray[np.integer]  # (row, col) class of each pixel, as an index along the class axis
    words: tuple[dict[str, str], ...]  # (class,) description of each feature
    patches: Array  # (class,) number of training patches, or 0 if the transform was filled from another class
    pixels: NDArray[np.integer]  # (class,) number of pixels in the whole frame
    weights: Array  # (class, output, tap) weights, possibly omitted for the last classes

    @property
    def cropped(self) -> int:
        """Number of classes that occur in the crop."""
        return int(self.labels.max()) + 1


@dataclass(frozen=True)
class Crop:
    """A crop of a frame, with the classes and weights of all layers."""

    corner: tuple[int, int]  # first row and first column of the crop
    frame: tuple[int, int]  # rows and columns of the whole frame
    layers: tuple[Layer, ...]


@dataclass(frozen=True)
class Sites:
    """The colour filter array of the frame."""

    cfa: NDArray[np.uint8]  # (cfa_row, cfa_col) channel of each site
    channels: tuple[str, ...]  # names of the channels
    colours: tuple[str, ...]  # CSS colour of each channel


def crop_of(
    table: TransformTable, camera: CameraModel, labels: list[NDArray[np.integer]], limit: int, more: int = 0
) -> tuple[Crop, str]:
    """Choose the crop of a frame that contains the most classes, and encode it for the page.

    The crop has the first size in CROP_SIZES that fits `limit` after encoding. Up to `more` characters are used for classes
    outside the crop. If all other classes of the table fit, they are included. Otherwise, the other classes of the frame are
    included if they fit. These classes are sorted by frequency in the frame. The remaining characters are used for their
    weights.

    Parameters
    ----------
    table : TransformTable
        The table.
    camera : CameraModel
        Camera, for the channels' display colours.
    labels : list of ndarray, (row, col)
        Class of every pixel of the frame, one array per layer.
    limit : int
        Maximum length, in characters, of the encoded crop without classes outside the crop.
    more : int
        Maximum number of characters for classes outside the crop.

    Returns
    -------
    crop : Crop
        The crop, with the additional classes.
    text : str
        Result of `packed` for the crop.
    """
    sites = Sites(table.cfa, table.channels, tuple(hex_colour(each) for each in channel_light(camera)))
    words = [_words(table, layer) for layer in table.layers]
    for size in CROP_SIZES:
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
    """Cut a crop out of a frame, and add classes from outside the crop.

    Parameters
    ----------
    table : TransformTable
        The table.
    words : list of callable
        Result of `_words` for each layer.
    labels : list of ndarray, (row, col)
        Class of every pixel of the frame, one array per layer.
    area : tuple of slice
        Rows and columns of the crop.
    others : {"none", "frame", "all"}
        Additional classes: none, the other classes of the frame, or all other classes of the table, sorted by frequency.
    letters : int
        Maximum number of characters per layer for weights of additional classes, starting with the most frequent class.
    """
    layers = []
    for layer, worded, of in zip(table.layers, words, labels, strict=True):
        read = COMPONENTS if table.components else PLANES
        if has_stokes(table.outputs):
            read = "S1", luminance_name(table.outputs), "S2"
        side, planes = (layer.rule.patch, ("mosaic",)) if isinstance(layer, MosaicLayer) else (layer.side, read)
        taps = side**2 * len(planes)
        pixels = np.bincount(of.ravel(), minlength=len(layer.weights))
        seen, indices = np.unique(of[area], return_inverse=True)
        order = np.argsort(-pixels, kind="stable")
        order = order[~np.isin(order, seen) & ((others == "all") | (pixels[order] > 0) & (others == "frame"))]
        # Base64 needs 4 characters for 3 bytes. Compression is ignored, because weights are almost incompressible.
        room = letters * 3 // 4 // (layer.weights.shape[1] * (taps + 4))
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
    """Return a function that describes the features of a class in a layer, given its index."""
    every = np.arange(len(layer.weights))
    sites = layer.rule.split(every).site.tolist()
    # In the first layer, classes that differ only in their site have the same description.
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
    """Find the position of a crop that contains the most classes.

    Parameters
    ----------
    labels : ndarray, (row, col)
        Class of every pixel of the frame.
    size : tuple of int
        Numbers of rows and columns of the crop, which may exceed the size of the frame.

    Returns
    -------
    tuple of int
        First row and first column of the crop, at the first of several equally good positions.
    """
    best, most = (0, 0), -1
    room = [max(0, whole - part) for whole, part in zip(labels.shape, size, strict=True)]
    tops, lefts = (sorted({length * step // CROP_STEPS for step in range(CROP_STEPS + 1)}) for length in room)
    for top in tops:
        for left in lefts:
            count = len(np.unique(labels[top : top + size[0], left : left + size[1]]))
            if count > most:
                best, most = (top, left), count
    return best


def packed(crop: Crop, sites: Sites, outputs: tuple[str, ...]) -> str:
    """Encode a crop as base64 text in the format that the module docstring describes."""
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
                    {**words, "training": f"{count:.0f} patches" if count > 0 else "no patches; filled from a neighbour"}
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
    """Encode the three arrays of a layer, each padded to a multiple of four bytes."""
    largest = np.abs(layer.weights).max(axis=2).astype("<f4")
    share = layer.weights / np.where(largest > 0, largest, 1.0)[..., None]
    weights = np.rint(WEIGHT_SCALE * np.sign(share) * np.sqrt(np.abs(share))).astype(np.int8)
    parts = (largest.tobytes(), layer.labels.astype("<u2").tobytes(), weights.tobytes())
    return b"".join(part + b"\0" * (-len(part) % 4) for part in parts)


def picker(anchor: str, crop: Crop, text: str, pictures: dict[str, Pixels], scene: str, jpeg: Jpeg) -> PixelPicker:
    """Build the block of the page in which the reader selects a pixel.

    Parameters
    ----------
    anchor : str
        HTML anchor of the comparison with the whole frame.
    crop : Crop
        The crop.
    text : str
        Result of `packed` for the crop.
    pictures : dict of str to ndarray, (row, col, 3)
        Pictures of the whole frame, by name.
    scene : str
        Name of the scene, for the alternative texts.
    jpeg : callable
        JPEG encoder, see `parts.Jpeg`.
    """
    (top, left), (rows, cols) = crop.corner, crop.layers[0].labels.shape
    where = f"{cols} × {rows} pixels, starting at row {top}, column {left}"
    shown = []
    for name, picture in pictures.items():
        coded = base64.b64encode(
            jpeg(np.ascontiguousarray(picture[top : top + rows, left : left + cols]), JPEG_QUALITY)
        ).decode()
        shown.append(Picture("data:image/jpeg;base64," + coded, rows, cols, name, f"{scene}, {name}: {where}"))
    counts = ", ".join(f"{layer.cropped} of layer {number}" for number, layer in enumerate(crop.layers, 1))
    return PixelPicker(anchor, f"{where}, enlarged. Classes that occur in this crop: {counts}.", tuple(shown), text)
