"""The page of the gallery, from the figures of its arrays."""

from typing import Any

Entries = dict[str, dict[str, Any]]  # by name of the recipe
NAMES = {"ours": "l3", "malvar": "Malvar", "menon": "Menon"}
HEAD = """# Gallery

This page is for readers who want to see what l3 does with an array before they try it. It shows one picture for each
array that `l3 init` knows.

For each array, l3 trains a table from the recipes alone, with the scenes of `{scenes}` and the class recipe that
`l3 init` chooses. The simulated camera then takes a picture of a scene that is not in the training, under D65, with a
perfect white at 0.9 of full scale. The rendered picture is compared with the *ideal* picture, as displayed.
`make gallery` makes this page and its pictures.

The other methods do not learn:

* *basic* interpolates each channel by itself, balances the white and applies a colour matrix.
* *Malvar* and *Menon* are demosaicking methods for arrays with Bayer's layout.
* *long*, *short*, *high gain* and *low gain* are *basic* with the pixels of one exposure or one gain only.

"""
PICTURES = """![Filters and responsivities of {title}](gallery/{name}.svg)

| original size: raw and ideal above, l3 and basic below |
|---|
| ![{title}: raw and ideal, below them l3 and basic](gallery/{name}.jpg) |

| the same, a crop enlarged 4 times |
|---|
| ![{title}, enlarged: raw and ideal, below them l3 and basic](gallery/{name}_crop.png) |
"""


def page(entries: Entries, scenes: str) -> str:
    """docs/gallery.md."""
    sections = [section(name, entry) for name, entry in entries.items()]
    return HEAD.format(scenes=scenes) + table(entries) + "\n" + verdict(entries) + "\n\n" + "\n".join(sections)


def table(entries: Entries) -> str:
    """Figures of all arrays, with those of the best that learns nothing."""
    rows = [
        "| array | class recipe | l3: mean ΔE00 | l3: PSNR (dB) | basic: mean ΔE00 | basic: PSNR (dB) |",
        "|---|---|---|---|---|---|",
    ]
    for name, entry in entries.items():
        cells = [f"{entry['figures'][of][key]:.2f}" for of in ("ours", "basic") for key in ("mean_delta_e", "psnr")]
        rows.append(f"| [{name}](#{name}) | {entry['classes']} | {' | '.join(cells)} |")
    return "\n".join(rows) + "\n"


def verdict(entries: Entries) -> str:
    """Where a pipeline that learns nothing is better."""
    lost = []
    for name, entry in entries.items():
        ours = entry["figures"]["ours"]
        for rival, of in entry["figures"].items():
            better = [
                text
                for text, better in (
                    ("ΔE00", of["mean_delta_e"] < ours["mean_delta_e"]),
                    ("PSNR", of["psnr"] > ours["psnr"]),
                )
                if better
            ]
            if better:
                lost.append(f"{NAMES.get(rival, rival)} on {name} ({', '.join(better)})")
    if lost:
        return f"Better than l3: {'; '.join(lost)}."
    return "On no array is one of these methods better than l3, in ΔE00 or in PSNR."


def section(name: str, entry: dict[str, Any]) -> str:
    """One array."""
    figures = "; ".join(
        f"{NAMES.get(each, each)} {of['mean_delta_e']:.2f} and {of['psnr']:.2f} dB" for each, of in entry["figures"].items()
    )
    twins = ", ".join(f"`{twin}`" for twin in entry["twins"])
    also = f" Recipes for the same array that begin at another pixel: {twins}." if twins else ""
    period, _, about = entry["summary"].rpartition("  ")
    pictures = PICTURES.format(name=name, title=entry["title"])
    return f"## {name}\n\n{about} ({' '.join(period.split())}).{also}\n\nMean ΔE00 and PSNR: {figures}.\n\n{pictures}"
