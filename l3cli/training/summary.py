"""Summarise tables and class recipes as dicts for JSON, and as lines of text."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.camera import CameraModel
from l3cli.artifacts.conditions import SceneLight
from l3cli.artifacts.layers import PLANES, PlaneLayer, PlaneRule
from l3cli.artifacts.plane_rules import DIRECTIONS, StructureRule
from l3cli.artifacts.recipe_source import Meaning, RecipeSource
from l3cli.artifacts.table import TransformTable
from l3cli.classes import level
from l3cli.classes.features import features_of
from l3cli.classes.names import class_name, kind_name
from l3cli.classes.rule import make_rule
from l3cli.classes.tree import EVERY
from l3cli.classes.windows import window_channels
from l3cli.physics.correlated_lights import temperature
from l3cli.system.text import counted, size_text
from l3cli.training.recipe import LayerRecipe, TrainingRecipe

LISTED_CLASSES = 8  # number of classes that a summary lists as the noisiest


def insight(table: TransformTable) -> dict[str, Any]:
    """Summarise a table in plain Python types, ready for JSON.

    Parameters
    ----------
    table : TransformTable
        Table to summarise.

    Returns
    -------
    dict
        Unless stated otherwise, the entries describe the first layer's common transforms for all illuminants:

        * ``target``: description of the outputs
        * ``classes``: number of all classes (``all``), of trained classes (``trained``), of trained classes with fewer
          patches than taps (``thin``), and of classes without patches (``filled``)
        * ``kinds``: name and number of patches of each chroma and saturation case
        * ``features``: name and number of patches of each value of each additional feature, such as direction
        * ``noise_gain``: median and maximum of √Σw² over the trained classes, for each output
        * ``dc_gain``: each output for a uniform signal of 1 in one channel and 0 in all others, median over the trained
          unsaturated classes
        * ``condition``: median and maximum of the condition number over the trained classes
        * ``worst``: the trained classes with the largest noise gain in Y, or in any output if there is no Y
        * ``later``: result of `refinement_layer` for each refinement layer
        * ``lights``: name and colour temperature, in K, of each illuminant with separate transforms
        * ``noises``: name, analog gain and noise fraction (after the temporal filter) of each additional set of transforms
        * ``spectra``: settings for smoothing spectra: window in pixels, and largest relative difference in brightness
        * ``chroma_smoothing``: settings for smoothing chroma: largest differences in luminance and chroma

        ``features``, ``lights``, ``noises``, ``spectra`` and ``chroma_smoothing`` are omitted if they do not apply.
    """
    trained, rule = table.first.samples > 0, table.first.rule
    taps = rule.patch**2
    noise_gain = np.sqrt((table.first.weights.astype(np.float64) ** 2).sum(axis=2))
    place = rule.split(np.arange(len(trained)))
    kind = place.kind
    judged = noise_gain[:, table.outputs.index("Y")] if "Y" in table.outputs else noise_gain.max(axis=1)
    order = np.argsort(np.where(trained, -judged, np.inf), kind="stable")[: int(trained.sum())]
    # Symmetric sites have the same transforms. Each class is listed only for the first of these sites.
    _, first = np.unique(np.stack([judged[order], table.first.samples[order]]), axis=1, return_index=True)
    worst = order[np.sort(first)[:LISTED_CLASSES]]
    per_kind = np.bincount(kind, weights=table.first.samples, minlength=rule.kinds)
    return {
        "target": table.target_description,
        "classes": {
            "all": len(trained),
            "trained": int(trained.sum()),
            "thin": int((trained & (table.first.samples < taps)).sum()),
            "filled": int((~trained).sum()),
        },
        "kinds": [{"name": kind_name(table, index), "patches": count} for index, count in enumerate(per_kind.tolist())],
        **({"features": _values_of_features(table, place.combination)} if rule.feature_list else {}),
        "noise_gain": _spread(noise_gain[trained], table.outputs),
        "dc_gain": _dc_gain(table, trained & (rule.case(kind) == 0)),
        "condition": _spread(table.first.condition[trained, None].astype(np.float64), ("all",))["all"],
        "worst": [
            {
                "class": class_name(table, index),
                "noise_gain": float(judged[index]),
                "patches": float(table.first.samples[index]),
                "condition": float(table.first.condition[index]),
            }
            for index in worst.tolist()
        ],
        "later": [refinement_layer(layer, table.outputs) for layer in table.later],
        **({"spectra": {"window": table.spectra.window, "reach": table.spectra.reach}} if table.spectra else {}),
        **({"chroma_smoothing": vars(table.chroma_smoothing)} if table.chroma_smoothing else {}),
        **({"lights": [_light(light) for light in table.lights]} if table.lights else {}),
        **({"noises": [{**vars(each.noise), "name": str(each.noise)} for each in table.noises]} if table.noises else {}),
    }


def _light(light: SceneLight) -> dict[str, Any]:
    return {"name": light.name, "kelvin": round(temperature(light.white_point[:3])[0])}


def refinement_layer(layer: PlaneLayer, outputs: tuple[str, ...]) -> dict[str, Any]:
    """Summarise a refinement layer in plain Python types, ready for JSON.

    Parameters
    ----------
    layer : PlaneLayer
        Layer to summarise.
    outputs : tuple of str
        Names of the outputs of the table.

    Returns
    -------
    dict
        * ``classes``: number of all classes (``all``), of trained classes (``trained``), and of classes without samples
          (``filled``)
        * ``side``: width of the windows in pixels
        * ``planes``, ``levels``, ``structures``: number of planes, levels and structures
        * ``noise_gain``: as in `insight`
        * ``strengths``, ``directions``: number of structure strengths and directions, if structure determines the classes
        * ``leaves``, ``depth``, ``tests``: number of leaves, depth, and number of nodes per test, if a tree determines the
          classes
    """
    trained, rule = layer.samples > 0, layer.rule
    gain = np.sqrt((layer.weights.astype(np.float64) ** 2).sum(axis=2))
    return {
        "classes": {"all": len(trained), "trained": int(trained.sum()), "filled": int((~trained).sum())},
        "side": layer.side,
        "planes": PLANES,
        "levels": rule.levels,
        "structures": rule.structures,
        **_features(rule),
        "noise_gain": _spread(gain[trained], outputs),
    }


def _features(rule: PlaneRule) -> dict[str, Any]:
    """Return the entries of `refinement_layer` that depend on the type of the class rule."""
    if isinstance(rule, StructureRule):
        return {"strengths": rule.strengths, "directions": DIRECTIONS}
    nodes = np.bincount(rule.test[rule.branch > 0], minlength=len(EVERY)).tolist()
    commonest = sorted((index for index, count in enumerate(nodes) if count), key=lambda index: -nodes[index])
    tests = {EVERY[index].name: nodes[index] for index in commonest}
    return {"leaves": rule.structures, "depth": rule.depth, "tests": tests}


def _values_of_features(table: TransformTable, combination: NDArray[np.int64]) -> dict[str, list[dict[str, Any]]]:
    """Return, for each value of each additional feature such as direction, its name and number of patches."""
    every = {}
    for (module, feature), value in zip(
        features_of(table.first.rule), table.first.rule.split_features(combination), strict=True
    ):
        patches = np.bincount(value, weights=table.first.samples, minlength=feature.size).tolist()
        every[feature.name] = [{"name": module.name(table, index), "patches": count} for index, count in enumerate(patches)]
    return every


def _spread(values: NDArray[np.float64], names: tuple[str, ...]) -> dict[str, dict[str, float]]:
    """Return the median and the maximum of each column of `values` (class, name), by column name."""
    if not len(values):
        return {name: {"median": 0.0, "worst": 0.0} for name in names}
    return {
        name: {"median": float(np.median(column)), "worst": float(column.max())}
        for name, column in zip(names, values.T, strict=True)
    }


def _dc_gain(table: TransformTable, chosen: NDArray[np.bool_]) -> dict[str, dict[str, float]]:
    """Return each channel's sum of weights, median over the chosen classes, as {output: {channel: gain}}."""
    windows = window_channels(table.cfa, table.first.rule.patch)
    site = table.first.rule.split(np.arange(len(chosen))).site
    gain = np.full((len(chosen), len(table.outputs), len(table.channels)), np.nan)
    for index in np.unique(site):
        of_site = chosen & (site == index)
        member = windows[index][:, None] == np.arange(len(table.channels))
        gain[of_site] = table.first.weights[of_site] @ member.astype(np.float64)
    median = np.median(gain[chosen], axis=0) if chosen.any() else np.zeros(gain.shape[1:])
    return {
        output: dict(zip(table.channels, values, strict=True))
        for output, values in zip(table.outputs, median.tolist(), strict=True)
    }


OUTPUTS = 3  # number of outputs of a table for pictures
WEIGHT = 4  # bytes per weight or intercept in a file
OTHERS = 12  # bytes per class in a file: sample count (8) and condition number (4)


def learned(insight: dict[str, Any]) -> list[str]:
    """Format the result of `insight` as lines of text."""
    classes = insight["classes"]
    figures = " · ".join(
        f"{output} {gain['median']:.3g}, {gain['worst']:.3g}" for output, gain in insight["noise_gain"].items()
    )
    lines = [
        f"{classes['all']} classes: {classes['trained']} trained ({classes['thin']} of them with fewer patches than taps), "
        f"{classes['filled']} without training patches",
        *(
            "patches: " + " · ".join(f"{value['name']} {value['patches']:.0f}" for value in values)
            for values in (insight["kinds"], *insight.get("features", {}).values())
        ),
        f"noise gain √Σw² (median, maximum over classes): {figures}",
        "condition number (median, maximum over classes): "
        f"{insight['condition']['median']:.2g}, {insight['condition']['worst']:.2g}",
        "output for a uniform signal of 1 in one channel (median over unsaturated classes):",
    ]
    for output, gains in insight["dc_gain"].items():
        lines.append(f"  {output}: " + "  ".join(f"{channel} {gain:+.3f}" for channel, gain in gains.items()))
    lines.append("noisiest classes: noise gain, name, number of patches")
    lines += [
        f"  {worst['noise_gain']:8.3g}  {worst['class']}: {worst['patches']:.0f} patches, condition number "
        f"{worst['condition']:.2g}"
        for worst in insight["worst"]
    ]
    for number, layer in enumerate(insight["later"], 2):
        lines += _refine(number, layer)
    if spectra := insight.get("spectra"):
        side, reach = spectra["window"], spectra["reach"]
        within = f"whose brightness differs by less than {100 * reach:.3g} %"
        lines.append(f"spectra: smoothed over {side} × {side} pixels {within}")
    if smoothing := insight.get("chroma_smoothing"):
        reach, likeness = (f"{100 * smoothing[key]:.3g} %" for key in ("reach", "likeness"))
        lines.append(
            f"chroma: smoothed over neighbours that differ by less than {reach} in luminance and {likeness} in chroma"
        )
    if lights := insight.get("lights"):
        named = " · ".join(f"{light['name']} {light['kelvin']} K" for light in lights)
        lines.append(f"transforms for single illuminants: {named}")
    if noises := insight.get("noises"):
        lines.append("transforms for other noise: " + " · ".join(each["name"] for each in noises))
    return lines


def _refine(number: int, layer: dict[str, Any]) -> list[str]:
    """Format the result of `refinement_layer` for layer `number` as lines of text."""
    classes, side = layer["classes"], layer["side"]
    gains = " · ".join(f"{output} {gain['median']:.3g}, {gain['worst']:.3g}" for output, gain in layer["noise_gain"].items())
    return [
        f"layer {number}: {classes['all']} classes: {classes['trained']} trained, "
        f"{classes['filled']} without training patches; {side} × {side} pixels in {layer['planes']} planes",
        f"  {_kinds(layer)}",
        f"  noise gain √Σw² (median, maximum over classes): {gains}",
    ]


def _kinds(layer: dict[str, Any]) -> str:
    """Describe a refinement layer's classes for unsaturated pixels."""
    if "leaves" in layer:
        tests = ", ".join(f"{name} {count}" for name, count in layer["tests"].items())
        by_test = f"; nodes by test: {tests}" if tests else ""
        return f"leaves of a tree: {layer['leaves']}, depth {layer['depth']}{by_test}"
    return (
        f"{layer['levels']} levels; {layer['structures']} structures: flat, and {layer['strengths']} strengths with "
        f"{layer['directions']} directions or none"
    )


def class_meaning(recipe: TrainingRecipe, source: RecipeSource) -> Meaning:
    """Summarise a class recipe for ``l3 check``. The second result, the list of faults, is always empty."""
    return class_figures(recipe, source.camera), []


def class_figures(recipe: TrainingRecipe, camera: CameraModel | None) -> dict[str, Any]:
    """Summarise a class recipe in plain Python types, ready for JSON.

    Parameters
    ----------
    recipe : TrainingRecipe
        Recipe to summarise.
    camera : CameraModel or None
        Camera for which the size of the table is computed, or None to omit the size.

    Returns
    -------
    dict
        Number of values of each feature, classes per site of each layer, and training settings. ``saturation_cases`` is an
        upper limit. With a camera, ``table_bytes`` is the size of a table with three outputs, in bytes.
    """
    classes = recipe.classes
    levels, contrasts = level.edge_shares(classes).size + 1, len(classes.contrasts) + 1
    cases = classes.max_cases if camera is None else min(classes.max_cases, 2 ** len(camera.channels))
    sizes: dict[str, int] = {}
    if camera is not None:
        # The saturation cases do not affect the sizes.
        rule = make_rule(classes, camera, np.zeros(2 ** len(camera.channels), np.uint16))
        sizes = {feature.name: feature.size for feature in rule.feature_list}
    chromas = max(1, classes.chromas)
    first = levels * contrasts * int(np.prod(list(sizes.values()), initial=1)) * (chromas + cases - 1)
    layers = [{"classes_per_site": first, "taps": classes.patch**2}]
    for each in recipe.layer:
        taps = PLANES * each.side**2 + each.ratio_taps
        layers.append({"classes_per_site": _refinement_classes(each, levels, cases), "taps": taps})
    document = {
        "levels": levels, "contrasts": contrasts, "features": sizes, "chromas": chromas, "saturation_cases": cases,
        "patch": classes.patch, "layers": layers, "patches": recipe.learning.patches,
        "lights": list(recipe.learning.lights),
    }  # fmt: skip
    if camera is not None:
        sites = camera.cfa.size
        size = sum(each["classes_per_site"] * (OUTPUTS * (each["taps"] + 1) * WEIGHT + OTHERS) for each in layers)
        sets = (1 + len(recipe.learning.lights)) * (1 + len(recipe.learning.noises))
        document |= {"camera": camera.name, "sites": sites, "table_bytes": sets * sites * size}
    return document


def _refinement_classes(layer: LayerRecipe, levels: int, cases: int) -> int:
    if layer.leaves:
        return layer.leaves + cases - 1
    structures = 1 + len(layer.strengths) * (1 + DIRECTIONS)
    return -(-levels // layer.level_step) * (structures + cases - 1)


def class_lines(classes: dict[str, Any], width: int | None) -> list[str]:
    """Format the result of `class_figures` as lines of text."""
    features = "".join(f" × {size} values of {name}" for name, size in classes["features"].items())
    kinds = (
        f"({counted(classes['chromas'], 'chroma')} + at most {counted(classes['saturation_cases'] - 1, 'saturation case')})"
    )
    lines = []
    for number, layer in enumerate(classes["layers"], 1):
        how = (
            f": {classes['levels']} levels × {counted(classes['contrasts'], 'contrast')}{features} × {kinds}"
            if number == 1
            else ""
        )
        lines.append(f"layer {number}: {layer['classes_per_site']} classes per site, {layer['taps']} taps{how}")
    if "table_bytes" in classes:
        size = size_text(classes["table_bytes"])
        lines.append(f"for {classes['camera']}: {classes['sites']} sites; a table with three outputs has up to {size}")
    return lines
