"""What classes are called."""

from typing import Any

from l3cli.artifacts.table import TransformTable
from l3cli.classes import chroma, contrast, level, saturation

AXES = {"level": level, "contrast": contrast, "chroma": chroma, "saturation": saturation}  # as documents call the features


def heading(axis: str, entry: dict[str, Any]) -> str:
    """What a row of a table begins with, of an entry that the feature `axis` has made."""
    return AXES[axis].heading(entry)


def class_name(table: TransformTable, index: int) -> str:
    """Where a class applies, such as "site (1, 2) g, level 3 (0.002–0.003 of full scale), contrast 0, chroma 5"."""
    place = table.first.rule.split(index)
    row, col = divmod(place.site, table.cfa.shape[1])
    channel = table.channels[table.cfa[row, col]]
    features = level.name(table, place.level), contrast.name(table, place.contrast), kind_name(table, place.kind)
    return ", ".join((f"site ({row}, {col}) {channel}", *features))


def kind_name(table: TransformTable, kind: int) -> str:
    """ "chroma K", or "saturated A+B": the pattern of channels nearest to all that share the saturation case."""
    case = int(table.first.rule.case(kind))
    return saturation.name(table, case) if case else chroma.name(table, kind)
