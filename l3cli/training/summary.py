"""Summaries of tables and class recipes, as figures and as lines of text."""

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

LISTED_CLASSES = 8  # number of noisiest classes to list


def insight(table: TransformTable) -> dict[str, Any]:
    """Return the figures of a table in plain Python types.

    Parameters
    ----------
    table : TransformTable

    Returns
    -------
    dict
        Figures of the first layer and of all lights together, except `later`, `lights` and `noises`:

        * ``classes``: numbers of all, trained, thin (fewer patches than taps) and filled (no patches) classes
        * ``kinds``: name and number of patches of each chroma and saturation case
        * ``features``: the same for each value of each feature beyond level, contrast, saturation and chroma, if the
          rule has any
        * ``noise_gain``: √Σw² of each output, median and worst over the trained classes
        * ``dc_gain``: what a uniform unit signal of one channel adds to each output, median over trained unsaturated classes
        * ``condition``: condition number, median and worst over the trained classes
        * ``worst``: the trained classes with the largest noise gain, of Y if there is a Y
        * ``later``: `refinement_layer` of each further layer
        * ``lights``: names and colour temperatures (K) of single lights with transforms of their own, if any
        * ``noises``: analog gain and remaining fraction of the noise of further noise sets, if any
        * ``spectra``: window (pixels) and brightness reach of the smoothing of spectra, if any
    """
    trained, rule = table.first.samples > 0, table.first.rule
    taps = rule.patch**2
    noise_gain = np.sqrt((table.first.weights.astype(np.float64) ** 2).sum(axis=2))
    place = rule.split(np.arange(len(trained)))
    kind = place.kind
    judged = noise_gain[:, table.outputs.index("Y")] if "Y" in table.outputs else noise_gain.max(axis=1)
    order = np.argsort(np.where(trained, -judged, np.inf), kind="stable")[: int(trained.sum())]
    # sites that are mirror images share their training: the first of them stands for all
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
        **({"lights": [_light(light) for light in table.lights]} if table.lights else {}),
        **({"noises": [{**vars(each.noise), "name": str(each.noise)} for each in table.noises]} if table.noises else {}),
    }


def _light(light: SceneLight) -> dict[str, Any]:
    return {"name": light.name, "kelvin": round(temperature(light.white_point[:3])[0])}


def refinement_layer(layer: PlaneLayer, outputs: tuple[str, ...]) -> dict[str, Any]:
    """Return the figures of a refinement layer.

    Parameters
    ----------
    layer : PlaneLayer
    outputs : tuple of str

    Returns
    -------
    dict
        Numbers of classes, side of the windows in pixels, number of planes, levels and structures, and the noise gain as in
        `insight`. Structure rules add their strengths and directions. Tree rules add leaves, depth and the number of nodes
        for each test.
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
    """Return the features by which a rule distinguishes structures."""
    if isinstance(rule, StructureRule):
        return {"strengths": rule.strengths, "directions": DIRECTIONS}
    nodes = np.bincount(rule.test[rule.branch > 0], minlength=len(EVERY)).tolist()
    commonest = sorted((index for index, count in enumerate(nodes) if count), key=lambda index: -nodes[index])
    tests = {EVERY[index].name: nodes[index] for index in commonest}
    return {"leaves": rule.structures, "depth": rule.depth, "tests": tests}


def _values_of_features(table: TransformTable, combination: NDArray[np.int64]) -> dict[str, list[dict[str, Any]]]:
    """Return the name and the number of patches of each value of each feature that the recipe added."""
    every = {}
    for (module, feature), value in zip(
        features_of(table.first.rule), table.first.rule.split_features(combination), strict=True
    ):
        patches = np.bincount(value, weights=table.first.samples, minlength=feature.size).tolist()
        every[feature.name] = [{"name": module.name(table, index), "patches": count} for index, count in enumerate(patches)]
    return every


def _spread(values: NDArray[np.float64], names: tuple[str, ...]) -> dict[str, dict[str, float]]:
    """Return the median and the largest value of each column of `values` (class, name)."""
    if not len(values):
        return {name: {"median": 0.0, "worst": 0.0} for name in names}
    return {
        name: {"median": float(np.median(column)), "worst": float(column.max())}
        for name, column in zip(names, values.T, strict=True)
    }


def _dc_gain(table: TransformTable, chosen: NDArray[np.bool_]) -> dict[str, dict[str, float]]:
    """Return {output: {channel: gain}}, the median over the chosen classes of the summed weights of each channel."""
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


OUTPUTS = 3  # number of outputs of a picture table
WEIGHT, OTHERS = 4, 12  # bytes per weight or intercept, and per class for its sample count and condition


def learned(insight: dict[str, Any]) -> list[str]:
    """Return lines of text about the classes, patches and gains in the result of `insight`."""
    classes = insight["classes"]
    figures = " · ".join(
        f"{output} {gain['median']:.3g}, {gain['worst']:.3g}" for output, gain in insight["noise_gain"].items()
    )
    lines = [
        f"{classes['all']} classes: {classes['trained']} trained, {classes['thin']} of them on fewer patches than taps; "
        f"{classes['filled']} without patches of their own",
        *(
            "patches: " + " · ".join(f"{value['name']} {value['patches']:.0f}" for value in values)
            for values in (insight["kinds"], *insight.get("features", {}).values())
        ),
        f"noise gain √Σw² (median, worst class): {figures}",
        f"condition (median, worst class): {insight['condition']['median']:.2g}, {insight['condition']['worst']:.2g}",
        "gain of a flat signal (median of unsaturated classes):",
    ]
    for output, gains in insight["dc_gain"].items():
        lines.append(f"  {output}: " + "  ".join(f"{channel} {gain:+.3f}" for channel, gain in gains.items()))
    lines.append("noisiest classes:")
    lines += [
        f"  {worst['noise_gain']:8.3g}  {worst['class']}: {worst['patches']:.0f} patches, condition {worst['condition']:.2g}"
        for worst in insight["worst"]
    ]
    for number, layer in enumerate(insight["later"], 2):
        lines += _refine(number, layer)
    if spectra := insight.get("spectra"):
        side, reach = spectra["window"], spectra["reach"]
        lines.append(f"spectra smoothed over {side} × {side} pixels of like brightness, within {100 * reach:.3g} %")
    if lights := insight.get("lights"):
        named = " · ".join(f"{light['name']} {light['kelvin']} K" for light in lights)
        lines.append(f"transforms of single lights: {named}")
    if noises := insight.get("noises"):
        lines.append("transforms for other noise: " + " · ".join(each["name"] for each in noises))
    return lines


def _refine(number: int, layer: dict[str, Any]) -> list[str]:
    """Return lines of text about a refinement layer."""
    classes, side = layer["classes"], layer["side"]
    gains = " · ".join(f"{output} {gain['median']:.3g}, {gain['worst']:.3g}" for output, gain in layer["noise_gain"].items())
    return [
        f"layer {number}: {classes['all']} classes: {classes['trained']} trained, "
        f"{classes['filled']} without patches of their own; {side} × {side} × {layer['planes']} taps",
        f"  {_kinds(layer)}",
        f"  noise gain √Σw² (median, worst class): {gains}",
    ]


def _kinds(layer: dict[str, Any]) -> str:
    """Describe the features by which a refinement layer distinguishes unsaturated pixels."""
    if "leaves" in layer:
        tests = ", ".join(f"{name} {count}" for name, count in layer["tests"].items())
        by_test = f"; nodes by test: {tests}" if tests else ""
        return f"leaves of a tree: {layer['leaves']}, depth {layer['depth']}{by_test}"
    return (
        f"{layer['levels']} levels; {layer['structures']} structures: flat, {layer['strengths']} strengths × (none + "
        f"{layer['directions']} directions)"
    )


def class_meaning(recipe: TrainingRecipe, source: RecipeSource) -> Meaning:
    """Return the `class_figures` of a recipe, with no lines of text."""
    return class_figures(recipe, source.camera), []


def class_figures(recipe: TrainingRecipe, camera: CameraModel | None) -> dict[str, Any]:
    """Return the figures of a class recipe, ready for JSON.

    Parameters
    ----------
    recipe : TrainingRecipe
    camera : CameraModel or None
        Camera for which the size of the table is computed, if any.

    Returns
    -------
    dict
        Classes per site of each layer, with the largest possible number of saturation cases. With a camera, also the size of
        the table in bytes.
    """
    classes = recipe.classes
    levels, contrasts = level.edge_shares(classes).size + 1, len(classes.contrasts) + 1
    cases = classes.max_cases if camera is None else min(classes.max_cases, 2 ** len(camera.channels))
    sizes: dict[str, int] = {}
    if camera is not None:
        rule = make_rule(classes, camera, np.zeros(2 ** len(camera.channels), np.uint16))  # the rule of the pilot sample
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
    """Return the number of classes per site of a refinement layer."""
    if layer.leaves:
        return layer.leaves + cases - 1
    structures = 1 + len(layer.strengths) * (1 + DIRECTIONS)
    return -(-levels // layer.level_step) * (structures + cases - 1)


def class_lines(classes: dict[str, Any], width: int | None) -> list[str]:
    """Return lines of text about the figures of a class recipe."""
    features = "".join(f" × {size} values of {name}" for name, size in classes["features"].items())
    kinds = f"({classes['chromas']} chromas + {classes['saturation_cases'] - 1} saturation cases at most)"
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
        lines.append(f"for {classes['camera']}: {classes['sites']} sites; a table of three outputs has up to {size}")
    return lines
