"""Names and descriptions of classes for reports and JSON."""

from typing import Any

from l3cli.artifacts.layers import PlaneLayer
from l3cli.artifacts.plane_rules import StructureRule
from l3cli.artifacts.table import TransformTable
from l3cli.classes import chroma, contrast, level, saturation, structure
from l3cli.classes.features import FEATURES, DescribedFeature, features_of

# Modules of all features, by the feature's name in reports and JSON.
EVERY_FEATURE: dict[str, DescribedFeature] = {
    "level": level,
    "contrast": contrast,
    "chroma": chroma,
    "saturation": saturation,
    **FEATURES,
}


def heading(feature: str, entry: dict[str, Any]) -> str:
    """Return a row label for a feature value. `entry` is its description from the module of the feature."""
    return EVERY_FEATURE[feature].heading(entry)


def feature_headings(entry: dict[str, Any]) -> list[str]:
    """Return texts such as "direction 3: along 90°" for the additional features in the class description `entry`."""
    return [f"{name} {module.heading(entry)}" for name, module in FEATURES.items() if name in entry]


def class_name(table: TransformTable, index: int) -> str:
    """Name a class of the first layer, as "site (1, 2) g, level 3 (0.002–0.003 of full scale), contrast 0, chroma 5"."""
    place = table.first.rule.split(index)
    row, col = divmod(place.site, table.cfa.shape[1])
    channel = table.channels[table.cfa[row, col]]
    stem = f"site ({row}, {col}) {channel}", level.name(table, place.level), contrast.name(table, place.contrast)
    return ", ".join((*stem, *feature_names(table, place.combination), kind_name(table, place.kind)))


def class_words(table: TransformTable, index: int) -> dict[str, str]:
    """Describe a class of the first layer in words: the value of each feature, by feature name."""
    rule = table.first.rule
    place = rule.split(index)
    case = int(rule.case(place.kind))
    kind = (
        {"saturation": saturation.name(table, case)}
        if case
        else {"chroma": chroma.heading(chroma.entry(table, place.kind)), "saturation": "none"}
    )
    features = zip((feature.name for feature in rule.feature_list), feature_names(table, place.combination), strict=True)
    return {
        "level": level.name(table, place.level).removeprefix("level "),
        "contrast": _of(place.contrast, rule.contrasts, ("flattest", "most textured")),
        **dict(features),
        **kind,
    }


def plane_class_words(table: TransformTable, layer: PlaneLayer, index: int) -> dict[str, str]:
    """Describe a class of a refinement layer in words: the value of each feature, by feature name."""
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
    spared = table.first.rule.spared_cases
    if case:
        return words | {"saturation": saturation.name(table, case + spared)}
    return words | {"saturation": "every filter has an unsaturated channel" if spared else "none"}


def _of(index: int, count: int, ends: tuple[str, str]) -> str:
    """Return a text such as "2 of 0…9". If the index is the first or the last, the matching text of `ends` is appended."""
    if count == 1:
        return "not distinguished"
    words = {0: f", the {ends[0]}", count - 1: f", the {ends[1]}"}.get(index, "")
    return f"{index} of 0…{count - 1}{words}"


def feature_names(table: TransformTable, combination: int) -> list[str]:
    """Return the names of the additional features' values, given the number of their combination."""
    values = table.first.rule.split_features(combination)
    return [module.name(table, value) for (module, _), value in zip(features_of(table.first.rule), values, strict=True)]


def kind_name(table: TransformTable, kind: int) -> str:
    """Return the name of a chroma or saturation case, such as "chroma 5" or "saturated r+g"."""
    case = int(table.first.rule.case(kind))
    return saturation.name(table, case) if case else chroma.name(table, kind)
