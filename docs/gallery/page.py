"""The page of the gallery, from the figures of its arrays."""

from typing import Any

Entries = dict[str, dict[str, Any]]  # by name of the recipe
NAMES = {"malvar": "Malvar", "menon": "Menon"}
HEAD = """# Gallery

What `l3` makes of arrays that `l3 init` knows, from their recipes alone. The camera learns from the scenes of `{scenes}` by
the classes that `l3 init` gives it, and takes one picture that training has not seen, under D65, a perfect white at 0.9 of
full scale. *basic* is a pipeline that learns nothing: interpolation of each channel by itself, white balance, colour matrix.
*Malvar* and *Menon* are given of arrays laid out as Bayer's; *long*, *short*, *high gain* and *low gain* are *basic*
from the pixels of one exposure or gain alone. All are compared with the *ideal* picture, as displayed. `make gallery` makes
this page and its pictures.

"""
PICTURES = """![Filters and responsivities of {title}](gallery/{name}.svg)

| 1×: raw, ideal; ours, basic |
|---|
| ![{title}: raw and ideal, below them ours and basic](gallery/{name}.jpg) |

| 4×, a crop of the same |
|---|
| ![{title}, enlarged: raw and ideal, below them ours and basic](gallery/{name}_crop.png) |
"""


def page(entries: Entries, scenes: str) -> str:
    """docs/gallery.md."""
    sections = [section(name, entry) for name, entry in entries.items()]
    return HEAD.format(scenes=scenes) + table(entries) + "\n" + verdict(entries) + "\n\n" + "\n".join(sections)


def table(entries: Entries) -> str:
    """Figures of all arrays, with those of the best that learns nothing."""
    rows = ["| array | classes | ours: mean ΔE00 | PSNR (dB) | basic: mean ΔE00 | PSNR (dB) |", "|---|---|---|---|---|---|"]
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
        return f"Better than ours: {'; '.join(lost)}."
    return "No pipeline that learns nothing is better on any of them, in either figure."


def section(name: str, entry: dict[str, Any]) -> str:
    """One array."""
    figures = "; ".join(
        f"{NAMES.get(each, each)} {of['mean_delta_e']:.2f}, {of['psnr']:.2f} dB" for each, of in entry["figures"].items()
    )
    twins = ", ".join(f"`{twin}`" for twin in entry["twins"])
    also = f" The same array, begun at another pixel: {twins}." if twins else ""
    period, _, about = entry["summary"].rpartition("  ")
    pictures = PICTURES.format(name=name, title=entry["title"])
    return f"## {name}\n\n{about} ({' '.join(period.split())}).{also}\n\nMean ΔE00 and PSNR: {figures}.\n\n{pictures}"
