"""HTML summaries of artifacts for notebooks: lists of all fields with their axes, units and meanings."""

from collections.abc import Iterator
from html import escape
from typing import Any

import numpy as np

from l3cli.artifacts.schema import Spec, declared, instances, is_stored

MAX_VALUES = 8  # longer arrays are summarised by their range
MAX_LETTERS = 60  # longer texts are truncated


def html(title: str, content: Any) -> str:
    """Summarise an artifact, or any dataclass with fields declared by `data` and `group`, as HTML.

    Parameters
    ----------
    title : str
        Heading, such as the repr of the artifact.
    content : dataclass
        The instance to summarise.
    """
    return f"<div><strong>{escape(title)}</strong>{''.join(_fields(content))}</div>"


def _fields(content: Any) -> Iterator[str]:
    """Yield a table of the datasets, then a collapsed block for each group."""
    fields = [(name, spec, getattr(content, name)) for name, spec in declared(type(content))]
    rows = [(name, _shape(spec, value), spec.unit, _preview(value), spec.doc) for name, spec, value in fields
            if isinstance(spec, Spec) and is_stored(content, name, spec)]  # fmt: skip
    if rows:
        cells = ("".join(f'<td style="text-align:left">{escape(cell)}</td>' for cell in row) for row in rows)
        yield f"<table>{''.join(f'<tr>{line}</tr>' for line in cells)}</table>"
    for name, spec, value in fields:
        for place, each in ({} if isinstance(spec, Spec) else instances(name, value)).items():
            heading = f"{escape(place)} <em>{type(each).__name__}</em>"
            yield f"<details><summary>{heading}</summary>{''.join(_fields(each))}</details>"


def _shape(spec: Spec, value: Any) -> str:
    axes = ", ".join(f"{axis}: {length}" for axis, length in zip(spec.axes, np.shape(value), strict=True))
    return f"{spec.dtype} ({axes})" if axes else spec.dtype


def _preview(value: Any) -> str:
    """Format a value. A long array is summarised by its smallest and its largest value."""
    array = np.asarray(value)
    if array.dtype.kind == "U":
        text = ", ".join(array.ravel()[:MAX_VALUES].tolist())
        cut = array.size > MAX_VALUES or len(text) > MAX_LETTERS
        return f"{text[:MAX_LETTERS]}…" if cut else text
    if array.size > MAX_VALUES:
        return f"{array.min():g} … {array.max():g}"
    return ", ".join(str(each) if array.dtype.kind == "b" else f"{each:g}" for each in array.ravel().tolist())
