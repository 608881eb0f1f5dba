"""The crop of a frame whose pixels can be looked into, with all that a page needs of the table."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.camera import CameraModel
from l3cli.artifacts.layers import MosaicLayer, PlaneLayer
from l3cli.artifacts.table import TransformTable
from l3cli.classes.names import class_words, plane_class_words
from l3cli.frames.frame import RawFrame
from l3cli.rendering.renderer import Renderer
from l3cli.report.colours import channel_light, hex_colour
from l3cli.report.pixels import SIZES, Crop, Layer, Sites, packed, richest

PLANES = ("X − aY", "Y", "Z − bY")  # that later layers read


def crop_of(
    table: TransformTable, camera: CameraModel, renderer: Renderer, raw: RawFrame, limit: int, more: int = 0
) -> tuple[Crop, str]:
    """Return the crop of most classes, and it packed as text: the largest of SIZES that takes at most `limit` letters, else
    the smallest; then the table's other classes, the most frequent first, in at most `more` letters."""
    light = channel_light(camera.responsivity, camera.wavelength)
    sites = Sites(table.cfa, table.channels, tuple(hex_colour(each) for each in light))
    labels = [np.asarray(renderer.labels(raw, number)) for number in range(len(table.layers))]
    for size in SIZES:
        corner = richest(labels[0], size)
        here = tuple(slice(start, start + length) for start, length in zip(corner, size, strict=True))
        layers = [_layer(table, layer, of, of[here]) for layer, of in zip(table.layers, labels, strict=True)]
        crop = Crop(corner, labels[0].shape, tuple(layers))
        text = packed(crop, sites, table.outputs)
        if len(text) <= limit:
            break
    for every in (True, False):
        named = _with_others(table, crop, labels, every, 0)
        left = len(text) + more - len(packed(named, sites, table.outputs))
        if left >= 0:
            crop = _with_others(table, crop, labels, every, left // len(labels))
            return crop, packed(crop, sites, table.outputs)
    return crop, text


def _layer(
    table: TransformTable, layer: MosaicLayer | PlaneLayer, labels: NDArray[np.integer], here: NDArray[np.integer]
) -> Layer:
    """Return the classes `here`, in part of a frame of `labels`."""
    classes, indices = np.unique(here, return_inverse=True)
    side, planes = (layer.rule.patch, ("mosaic",)) if isinstance(layer, MosaicLayer) else (layer.side, PLANES)
    return Layer(
        side=side,
        planes=planes,
        labels=indices.reshape(here.shape),
        words=tuple(_words(table, layer, index) for index in classes.tolist()),
        patches=layer.samples[classes],
        pixels=np.bincount(labels.ravel(), minlength=len(layer.weights))[classes],
        weights=layer.weights[classes, :, : side**2 * len(planes)],
    )


def _with_others(table: TransformTable, crop: Crop, labels: list[NDArray[np.integer]], every: bool, letters: int) -> Crop:
    """Return the crop with the classes that do not occur in it, those of most pixels of the frame first: all of them or
    those that occur in the frame, with as many of their weights as `letters` for each layer hold."""
    layers = []
    for layer, held, of in zip(table.layers, crop.layers, labels, strict=True):
        pixels = np.bincount(of.ravel(), minlength=len(layer.weights))
        order = np.argsort(-pixels, kind="stable")
        others = order[~np.isin(order, of[_within(crop)])]
        if not every:
            others = others[pixels[others] > 0]
        _, outputs, taps = held.weights.shape
        room = letters * 3 // 4 // (outputs * (taps + 4))  # weights are hardly deflated
        more = others[:room]
        layers.append(
            replace(
                held,
                words=held.words + tuple(_words(table, layer, index) for index in others.tolist()),
                patches=np.concatenate([held.patches, layer.samples[others]]),
                pixels=np.concatenate([held.pixels, pixels[others]]),
                weights=np.concatenate([held.weights, layer.weights[more, :, :taps]]),
            )
        )
    return replace(crop, layers=tuple(layers))


def _within(crop: Crop) -> tuple[slice, ...]:
    shape = crop.layers[0].labels.shape
    return tuple(slice(start, start + length) for start, length in zip(crop.corner, shape, strict=True))


def _words(table: TransformTable, layer: MosaicLayer | PlaneLayer, index: int) -> dict[str, str]:
    row, col = divmod(layer.rule.split(index).site, table.cfa.shape[1])
    return {
        "class": f"{index} of {len(layer.weights)}",
        "site": f"({row}, {col}) {table.channels[table.cfa[row, col]]}",
        **(class_words(table, index) if isinstance(layer, MosaicLayer) else plane_class_words(table, layer, index)),
    }
