"""Names of classes."""

from typing import Any

from l3cli.artifacts.plane_rules import StructureRule
from l3cli.artifacts.table import PlaneLayer, TransformTable
from l3cli.classes import chroma, contrast, level, saturation, structure
from l3cli.classes.features import FURTHER, Feature, further_features

# features by their names in reports and JSON
AXES: dict[str, Feature] = {"level": level, "contrast": contrast, "chroma": chroma, "saturation": saturation, **FURTHER}


def heading(axis: str, entry: dict[str, Any]) -> str:
    """Return the first cell of a table row for an entry of the feature `axis`."""
    return AXES[axis].heading(entry)


def further_headings(entry: dict[str, Any]) -> list[str]:
    """Return one phrase per further feature in a class's entry, such as "direction 3: along 90°"."""
    return [f"{name} {feature.heading(entry)}" for name, feature in FURTHER.items() if name in entry]


def class_name(table: TransformTable, index: int) -> str:
    """Return the name of a class, such as "site (1, 2) g, level 3 (0.002–0.003 of full scale), contrast 0, chroma 5"."""
    place = table.first.rule.split(index)
    row, col = divmod(place.site, table.cfa.shape[1])
    channel = table.channels[table.cfa[row, col]]
    stem = f"site ({row}, {col}) {channel}", level.name(table, place.level), contrast.name(table, place.contrast)
    return ", ".join((*stem, *further_names(table, place.further), kind_name(table, place.kind)))


def class_words(table: TransformTable, index: int) -> dict[str, str]:
    """Return the value of each feature of a class of the first layer, in words, by feature."""
    rule = table.first.rule
    place = rule.split(index)
    case = int(rule.case(place.kind))
    kind = (
        {"saturation": saturation.name(table, case)}
        if case
        else {"chroma": chroma.heading(chroma.entry(table, place.kind)), "saturation": "none"}
    )
    further = zip((axis.name for axis in rule.axes), further_names(table, place.further), strict=True)
    return {
        "level": level.name(table, place.level).removeprefix("level "),
        "contrast": _of(place.contrast, rule.contrasts, ("flattest", "most textured")),
        **dict(further),
        **kind,
    }


def plane_class_words(table: TransformTable, layer: PlaneLayer, index: int) -> dict[str, str]:
    """Return the value of each feature of a class of a refinement layer, in words, by feature."""
    rule, place = layer.rule, layer.rule.split(index)
    case = int(rule.case(place.kind))
    words = {}
    if isinstance(rule, StructureRule):
        bounds = level.bounds(table)
        last = min((place.level + 1) * rule.level_step, len(bounds) - 1)
        upper, lower = bounds[last], bounds[place.level * rule.level_step]
        words["level"] = f"{place.level} ({lower:.3g}–{upper:.3g} of full scale)"
        if not case:
            words["structure"] = structure.name(rule, place.kind, place.site)
    elif not case:
        words["leaf of the tree"] = f"{place.kind} of {rule.structures}"
    protected = table.first.rule.spared_cases
    if case:
        return words | {"saturation": saturation.name(table, case + protected)}
    return words | {"saturation": "none by which a filter is lost" if protected else "none"}


def _of(index: int, count: int, ends: tuple[str, str]) -> str:
    """Return a value among `count` values in words, with additional words for the first and the last."""
    if count == 1:
        return "not distinguished"
    words = {0: f", the {ends[0]}", count - 1: f", the {ends[1]}"}.get(index, "")
    return f"{index} of 0…{count - 1}{words}"


def further_names(table: TransformTable, further_class: int) -> list[str]:
    """Return the name of each further feature's value, in order."""
    values = table.first.rule.split_further(further_class)
    return [
        feature.name(table, value) for (feature, _), value in zip(further_features(table.first.rule), values, strict=True)
    ]


def kind_name(table: TransformTable, kind: int) -> str:
    """Return "chroma K", or "saturated A+B" with the pattern of channels that is most typical of the saturation case."""
    case = int(table.first.rule.case(kind))
    return saturation.name(table, case) if case else chroma.name(table, kind)
