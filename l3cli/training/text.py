"""Summary of a table in lines of text."""

from typing import Any


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
        lines += _later(number, layer)
    if spectra := insight.get("spectra"):
        side, reach = spectra["window"], spectra["reach"]
        lines.append(f"spectra smoothed over {side} × {side} pixels of like brightness, within {100 * reach:.3g} %")
    if lights := insight.get("lights"):
        named = " · ".join(f"{light['name']} {light['kelvin']} K" for light in lights)
        lines.append(f"transforms of single lights: {named}")
    return lines


def _later(number: int, layer: dict[str, Any]) -> list[str]:
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
        counted = f"; nodes by test: {tests}" if tests else ""
        return f"leaves of a tree: {layer['leaves']}, depth {layer['depth']}{counted}"
    return (
        f"{layer['levels']} levels; {layer['structures']} structures: flat, {layer['strengths']} strengths × (none + "
        f"{layer['directions']} directions)"
    )
