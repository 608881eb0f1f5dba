"""What classes are called."""

from typing import Any

from l3cli.artifacts.table import TransformTable
from l3cli.classes import chroma, contrast, level, saturation
from l3cli.classes.features import FURTHER, Feature, further_features

# as documents call the features
AXES: dict[str, Feature] = {"level": level, "contrast": contrast, "chroma": chroma, "saturation": saturation, **FURTHER}


def heading(axis: str, entry: dict[str, Any]) -> str:
    """What a row of a table begins with, of an entry that the feature `axis` has made."""
    return AXES[axis].heading(entry)


def class_name(table: TransformTable, index: int) -> str:
    """Where a class applies, such as "site (1, 2) g, level 3 (0.002–0.003 of full scale), contrast 0, chroma 5"."""
    place = table.first.rule.split(index)
    row, col = divmod(place.site, table.cfa.shape[1])
    channel = table.channels[table.cfa[row, col]]
    stem = f"site ({row}, {col}) {channel}", level.name(table, place.level), contrast.name(table, place.contrast)
    return ", ".join((*stem, *further_names(table, place.further), kind_name(table, place.kind)))


def further_names(table: TransformTable, together: int) -> list[str]:
    """The value of each further feature in text, in order."""
    values = table.first.rule.split_further(together)
    return [
        feature.name(table, value) for (feature, _), value in zip(further_features(table.first.rule), values, strict=True)
    ]


def kind_name(table: TransformTable, kind: int) -> str:
    """ "chroma K", or "saturated A+B": the pattern of channels nearest to all that share the saturation case."""
    case = int(table.first.rule.case(kind))
    return saturation.name(table, case) if case else chroma.name(table, kind)
