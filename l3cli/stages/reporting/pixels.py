"""The crop of a frame whose pixels can be looked into, with all that a page needs of the table."""

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.camera import CameraModel
from l3cli.artifacts.layers import MosaicLayer, PlaneLayer
from l3cli.artifacts.table import TransformTable
from l3cli.classes.names import class_words, plane_class_words
from l3cli.frame import RawFrame
from l3cli.rendering.renderer import Renderer
from l3cli.report.colours import channel_light, hex_colour
from l3cli.report.pixels import SIZES, Crop, Layer, Sites, packed, richest

PLANES = ("X − aY", "Y", "Z − bY")  # that later layers read


def crop_of(table: TransformTable, camera: CameraModel, renderer: Renderer, raw: RawFrame, limit: int) -> tuple[Crop, str]:
    """The crop of most classes, and it packed as text: the largest of SIZES that takes at most `limit` letters, else the
    smallest."""
    light = channel_light(camera.responsivity, camera.wavelength)
    sites = Sites(table.cfa, table.channels, tuple(hex_colour(each) for each in light))
    labels = [np.asarray(renderer.labels(raw, number)) for number in range(len(table.layers))]
    for size in SIZES:
        corner = richest(labels[0], size)
        here = tuple(slice(start, start + length) for start, length in zip(corner, size, strict=True))
        crop = Crop(corner, tuple(_layer(table, layer, of[here]) for layer, of in zip(table.layers, labels, strict=True)))
        text = packed(crop, sites, table.outputs)
        if len(text) <= limit:
            break
    return crop, text


def _layer(table: TransformTable, layer: MosaicLayer | PlaneLayer, labels: NDArray[np.integer]) -> Layer:
    classes, indices = np.unique(labels, return_inverse=True)
    words = tuple(
        {
            "class": f"{index} of {len(layer.weights)}",
            **(class_words(table, index) if isinstance(layer, MosaicLayer) else plane_class_words(table, layer, index)),
        }
        for index in classes.tolist()
    )
    side, planes = (layer.rule.patch, ("mosaic",)) if isinstance(layer, MosaicLayer) else (layer.side, PLANES)
    return Layer(side, planes, indices.reshape(labels.shape), words, layer.samples[classes], layer.weights[classes])
