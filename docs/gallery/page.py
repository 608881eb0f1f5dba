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
values of the rendered picture and of the ground truth (the *ideal* picture, which l3 computes directly from the scene).
`make gallery` writes this page and its pictures.

For comparison, the frames are also rendered with methods that are not trained:

* *basic* interpolates each channel separately, corrects the white balance and applies a colour matrix.
* *Malvar* and *Menon* are demosaicing methods for arrays with the geometry of a Bayer array.
* *long*, *short*, *high gain* and *low gain* are variants of *basic* that use only the pixels with this exposure or gain.

"""
PICTURES = """![Filters and responsivities of {title}](gallery/{name}.svg)

| Shown at original size. Top: the raw frame and the ground truth. Bottom: the pictures rendered by l3 and by *basic*. |
|---|
| ![{title}. Top: raw frame and ground truth. Bottom: l3 and basic](gallery/{name}.jpg) |

| A part of the same pictures, enlarged 4 times |
|---|
| ![{title}, enlarged. Top: raw frame and ground truth. Bottom: l3 and basic](gallery/{name}_crop.png) |
"""


POLARISED_HEAD = """## Polarisation cameras

The tables for [polarisation cameras](polarisation.md) are the tables of the [test of the
accuracy](polarisation.md#accuracy) with a noise of 1 % of full scale in the dark. They were trained with the scene recipe
of the same name, without blur of the lens. The pictures show the same scene as above, in which most objects polarise light.
The charts and the fine patterns do not polarise light.

The metrics are the PSNR of S0 and of the degree of linear polarisation (DoLP), the RMS error of the angle (AoLP) where the
DoLP exceeds 0.05, and the mean DoLP of unpolarised areas ([Metrics](metrics.md#polarisation)).

*bilinear* interpolates each channel separately, and computes the Stokes parameters by least squares. For the colour camera,
the luminance is the sum of red, green and blue that fits this scene best.

"""
POLARISED_PICTURES = """![Filters and responsivities of {title}](gallery/{name}.svg)

From left to right: the ground truth, l3 and *bilinear*. From top to bottom: the intensity, the DoLP from 0 (dark blue) to
{scale:g} (yellow), and the AoLP as a hue.

| Shown at original size |
|---|
| ![{title}. Intensity, DoLP and AoLP: ground truth, l3 and bilinear](gallery/{name}.jpg) |

| A part of the same pictures, enlarged 4 times |
|---|
| ![{title}, enlarged. Intensity, DoLP and AoLP: ground truth, l3 and bilinear](gallery/{name}_crop.png) |
"""


def page(entries: Entries, scenes: str) -> str:
    """Return the text of docs/gallery.md."""
    polarised = {name: entry for name, entry in entries.items() if "polarisation" in entry}
    colours = {name: entry for name, entry in entries.items() if name not in polarised}
    sections = [section(name, entry) for name, entry in colours.items()]
    text = HEAD.format(scenes=scenes) + table(colours) + "\n" + verdict(colours) + "\n\n" + "\n".join(sections)
    if polarised:
        text += "\n" + POLARISED_HEAD + "\n".join(polarised_section(name, entry) for name, entry in polarised.items())
    return text


def polarised_section(name: str, entry: dict[str, Any]) -> str:
    """Return the section of one polarisation camera."""
    rows = [
        f"| {NAMES.get(each, each)} | {of['psnr_s0']:.2f} | {of['psnr_dolp']:.2f} | {of['aolp_rmse']:.1f} "
        f"| {of['dolp_bias']:.4f} |"
        for each, of in entry["polarisation"].items()
    ]
    errors = "\n".join(["| method | S0 (dB) | DoLP (dB) | AoLP (°) | DoLP bias |", "|---|---|---|---|---|", *rows])
    period, _, about = entry["summary"].rpartition("  ")
    pictures = POLARISED_PICTURES.format(name=name, title=entry["title"], scale=entry["scale"])
    return f"### {name}\n\n{about} ({' '.join(period.split())}).\n\n{errors}\n\n{pictures}"


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
