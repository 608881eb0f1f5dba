"""Summaries of a table and of a class recipe in figures and lines of text."""

from typing import Any

import numpy as np

from l3cli.artifacts.camera import CameraModel
from l3cli.artifacts.plane_rules import DIRECTIONS
from l3cli.artifacts.table import RATIO_TAPS
from l3cli.classes import level
from l3cli.classes.rule import make_rule
from l3cli.system.text import counted, size_text
from l3cli.training.recipe import LayerRecipe, TrainingRecipe

OUTPUTS = 3  # of pictures, and planes that later layers read
WEIGHT, OTHERS = 4, 12  # bytes of a weight or intercept; of the number of samples and the condition of a class


def learned(insight: dict[str, Any]) -> list[str]:
    """Lines about classes, patches and gains of a table, from its `insight`."""
    classes = insight["classes"]
    figures = " · ".join(
        f"{output} {gain['median']:.3g}, {gain['worst']:.3g}" for output, gain in insight["noise_gain"].items()
    )
    lines = [
        f"{classes['all']} classes: {classes['trained']} trained, {classes['thin']} of them on fewer patches than taps; "
        f"{classes['filled']} without patches of their own",
        *(
            "patches: " + " · ".join(f"{value['name']} {value['patches']:.0f}" for value in values)
            for values in (insight["kinds"], *insight.get("further", {}).values())
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
    return lines


def _refine(number: int, layer: dict[str, Any]) -> list[str]:
    """Lines about a layer after the first."""
    classes, side = layer["classes"], layer["side"]
    gains = " · ".join(f"{output} {gain['median']:.3g}, {gain['worst']:.3g}" for output, gain in layer["noise_gain"].items())
    return [
        f"layer {number}: {classes['all']} classes: {classes['trained']} trained, "
        f"{classes['filled']} without patches of their own; {side} × {side} × {layer['planes']} taps",
        f"  {_apart(layer)}",
        f"  noise gain √Σw² (median, worst class): {gains}",
    ]


def _apart(layer: dict[str, Any]) -> str:
    """Return the features by which a later layer distinguishes pixels where nothing is saturated."""
    if "leaves" in layer:
        tests = ", ".join(f"{name} {count}" for name, count in layer["tests"].items())
        by_test = f"; nodes by test: {tests}" if tests else ""
        return f"leaves of a tree: {layer['leaves']}, depth {layer['depth']}{by_test}"
    return (
        f"{layer['levels']} levels; {layer['structures']} structures: flat, {layer['strengths']} strengths × (none + "
        f"{layer['directions']} directions)"
    )


def class_figures(recipe: TrainingRecipe, camera: CameraModel | None) -> dict[str, Any]:
    """Return the classes of each layer, those near saturation at their most, and the bytes of the table for a camera, ready
    for JSON."""
    classes = recipe.classes
    levels, contrasts = level.edge_shares(classes).size + 1, len(classes.contrasts) + 1
    cases = classes.max_cases if camera is None else min(classes.max_cases, 2 ** len(camera.channels))
    further: dict[str, int] = {}
    if camera is not None:
        rule = make_rule(classes, camera, np.zeros(2 ** len(camera.channels), np.uint16))  # as the pilot has it
        further = {axis.name: axis.size for axis in rule.axes}
    chromas = max(1, classes.chromas)
    first = levels * contrasts * int(np.prod(list(further.values()), initial=1)) * (chromas + cases - 1)
    layers = [{"classes_per_site": first, "taps": classes.patch**2}]
    for each in recipe.layer:
        taps = OUTPUTS * each.side**2 + RATIO_TAPS * each.colour_ratios
        layers.append({"classes_per_site": _refinement_classes(each, levels, cases), "taps": taps})
    document = {
        "levels": levels, "contrasts": contrasts, "further": further, "chromas": chromas, "saturation_cases": cases,
        "patch": classes.patch, "layers": layers, "patches": recipe.learning.patches,
        "per_light": recipe.learning.per_light,
    }  # fmt: skip
    if camera is not None:
        sites = camera.cfa.size
        size = sum(each["classes_per_site"] * (OUTPUTS * (each["taps"] + 1) * WEIGHT + OTHERS) for each in layers)
        sets = 2 if recipe.learning.noise_left else 1
        document |= {"camera": camera.name, "sites": sites, "table_bytes": sets * sites * size}
    return document


def _refinement_classes(layer: LayerRecipe, levels: int, cases: int) -> int:
    """Return the classes a site of a later layer: leaves of a tree, or structures at every level."""
    if layer.leaves:
        return layer.leaves + cases - 1
    structures = 1 + len(layer.strengths) * (1 + DIRECTIONS)
    return -(-levels // layer.level_step) * (structures + cases - 1)


def class_lines(classes: dict[str, Any], width: int | None) -> list[str]:
    """Return the figures of a class recipe as lines."""
    further = "".join(f" × {size} values of {name}" for name, size in classes["further"].items())
    kinds = f"({classes['chromas']} chromas + {classes['saturation_cases'] - 1} saturation cases at most)"
    lines = []
    for number, layer in enumerate(classes["layers"], 1):
        how = (
            f": {classes['levels']} levels × {counted(classes['contrasts'], 'contrast')}{further} × {kinds}"
            if number == 1
            else ""
        )
        lines.append(f"layer {number}: {layer['classes_per_site']} classes a site of {layer['taps']} taps{how}")
    if "table_bytes" in classes:
        size = size_text(classes["table_bytes"])
        lines.append(f"for {classes['camera']}: {classes['sites']} sites; a table of three outputs has up to {size}")
        if classes["per_light"]:
            lines.append("and as much again for each light of the training")
    return lines
