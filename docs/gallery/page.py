"""Write the page of the gallery from the errors of its arrays."""

from typing import Any

Entries = dict[str, dict[str, Any]]  # by name of the recipe
NAMES = {"ours": "l3", "malvar": "Malvar", "menon": "Menon"}
HEAD = """# Gallery

This page is for readers who want to see results before they try l3. It shows one rendered scene for each colour filter
array for which `l3 init` has a recipe.

For each colour filter array, we trained a table with the scene recipe `{scenes}` and the class recipe that `l3 init`
selects. With this table, we rendered a simulated frame of a scene that is not in the training set. The illuminant is
D65, and a perfect white has a signal of 0.9 of full scale. The errors are the differences between the displayed sRGB
values of the rendered picture and of the *ideal* picture. `make gallery` writes this page and its pictures.

For comparison, the frames are also rendered with methods that are not trained:

* *basic* interpolates each channel separately, corrects the white balance and applies a colour matrix.
* *Malvar* and *Menon* are demosaicing methods for arrays with the geometry of a Bayer array.
* *long*, *short*, *high gain* and *low gain* are variants of *basic* that use only the pixels with this exposure or gain.

"""
PICTURES = """![Filters and responsivities of {title}](gallery/{name}.svg)

| Shown at original size. Top: the raw frame and the ideal picture. Bottom: the pictures rendered by l3 and by *basic*. |
|---|
| ![{title}. Top: raw and ideal. Bottom: l3 and basic](gallery/{name}.jpg) |

| A part of the same pictures, enlarged 4 times |
|---|
| ![{title}, enlarged. Top: raw and ideal. Bottom: l3 and basic](gallery/{name}_crop.png) |
"""


def page(entries: Entries, scenes: str) -> str:
    """Return the text of docs/gallery.md."""
    sections = [section(name, entry) for name, entry in entries.items()]
    return HEAD.format(scenes=scenes) + table(entries) + "\n" + verdict(entries) + "\n\n" + "\n".join(sections)


def table(entries: Entries) -> str:
    """Return the table with the errors of l3 and of the basic pipeline for all arrays."""
    rows = [
        "| array | class recipe | l3: mean ΔE00 | l3: PSNR (dB) | basic: mean ΔE00 | basic: PSNR (dB) |",
        "|---|---|---|---|---|---|",
    ]
    for name, entry in entries.items():
        cells = [f"{entry['figures'][of][key]:.2f}" for of in ("ours", "basic") for key in ("mean_delta_e", "psnr")]
        rows.append(f"| [{name}](#{name}) | {entry['classes']} | {' | '.join(cells)} |")
    return "\n".join(rows) + "\n"


def verdict(entries: Entries) -> str:
    """Return a sentence that lists the arrays on which a method without training is better."""
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
        return f"These methods are better than l3: {'; '.join(lost)}."
    return "None of these methods has a lower ΔE00 or a higher PSNR than l3 on any array."


def section(name: str, entry: dict[str, Any]) -> str:
    """Return the section of one array."""
    rows = [
        f"| {NAMES.get(each, each)} | {of['mean_delta_e']:.2f} | {of['psnr']:.2f} |" for each, of in entry["figures"].items()
    ]
    errors = "\n".join(["| method | mean ΔE00 | PSNR (dB) |", "|---|---|---|", *rows])
    twins = ", ".join(f"`{twin}`" for twin in entry["twins"])
    also = f" Other recipes describe the same array, but with a different first pixel: {twins}." if twins else ""
    period, _, about = entry["summary"].rpartition("  ")
    pictures = PICTURES.format(name=name, title=entry["title"])
    return f"## {name}\n\n{about} ({' '.join(period.split())}).{also}\n\n{errors}\n\n{pictures}"
