"""The filters of the backends; all give the same values."""

import importlib
from collections.abc import Callable

from l3cli.artifacts.table import TransformTable
from l3cli.rendering.temporal.chunks import Filter
from l3cli.rendering.temporal.noise import require_noise

FILTERS = {
    "opencl": "l3cli.rendering.temporal.opencl:opencl_filters",
    "reference": "l3cli.rendering.temporal.reference:reference_filters",
}


def filters(backend: str, table: TransformTable, **options: str | None) -> Callable[[], Filter]:
    """Return a function that makes filters of a backend for a table's frames; `options` as for renderer.make_renderer.

    RecipeError if the table does not know its camera's noise, DeviceError if there is no device."""
    module, _, name = FILTERS[backend].partition(":")
    return getattr(importlib.import_module(module), name)(table.cfa.shape, require_noise(table.camera), **options)
