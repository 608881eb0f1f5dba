"""docs/peers.md, from the figures of its parts."""

from collections.abc import Callable, Sequence
from typing import Any

import published

Row = dict[str, Any]
Part = dict[str, Any]  # rows, frames (their scenes), digest (of them), missing (programs), absent (pictures)
DIGITS = {"psnr": 2, "delta_e": 2, "ssim": 4, "angle": 2}
LOWER = ("delta_e", "angle")
METHOD = "method.md"  # beside the page
HEAD = """# Beside other methods

What `l3` makes of mosaics beside what others make of the same: demosaicking methods of PyPI's packages, of LibRaw and of
RawTherapee, a network, and CBM3D. `make peers` measures all of it in one run and writes this page; a method that is not
installed is named. Ours learned from none of the pictures that are shown here.

Where a rival has several settings, each of its figures is that of the setting which is best on these very pictures; ours has
one. LibRaw and RawTherapee are given DNG files whose white balance and colour matrix are exact. Figures are means over
pictures, without 10 pixels at each edge. Seconds are processor time a megapixel, all cores summed, in the same run: what a
picture of 1512² pixels takes more than one of 504², so that no start-up counts (CBM3D: the one of 504² alone); of LibRaw and
RawTherapee the DNG file, too.
"""
TEXTS = {
    "bayer": f"""## Bayer, as published

The codes of RGB pictures are sampled as they are and compared with themselves (CPSNR, all three channels). Ours is the table
of `l3 init benchmark-bayer`, learned from a hundred others. **The last two columns were not measured here**: they are
published figures, on more pictures than the twelve of odd number that ours are of
({published.SOURCE}).
McMaster's eighteen pictures are sampled, too, where they lie in `demosaicking/mcmaster` of the data. LibRaw and RawTherapee
take the codes for light, as every method here does. The network is that of Gharbi and others (2016): no other was found on
PyPI that demosaicks and brings its weights.
""",
    "xtrans": """## X-Trans

The same pictures and the same recipe, sampled through the 6×6 array of X-Trans. LibRaw's *1 pass* and *3 passes*, and those
of RawTherapee, are Markesteijn's method. *bilinear* stands for a Gaussian-weighted mean of each channel's samples.
The network is that of the first table, with the weights for X-Trans that its package brings.
""",
    "bands": f"""## Sixteen bands

A snapshot camera of 16 narrow bands with its noise sees three multispectral scenes and five hyperspectral faces; ours
(`bands`) learned from dead leaves alone. PSNR of 8-bit codes and SSIM are means over the bands, SAM is the mean spectral
angle. How the others work: [Method]({METHOD}#baselines-for-bands).
""",
    "noise": """## Bayer with noise, as raw files

A small sensor (`bayer`, 2.2 µm, 6 000 e⁻) takes a composition of leaves, charts and fine patterns, five faces and four
photographs, none of which training has seen, at a mean signal of 0.2, 0.02 and 0.01 of full scale. Every rival has the true
white balance, the black and dark level, and the matrix that is fitted for camera and light; those that have denoising are
tried without it and at several strengths (but for LibRaw's wavelets, which end the process in rawpy 0.28). The network was
trained without noise; it is shown light as well as sRGB codes. The recipes of ours have been studied on these frames, too.
CBM3D is given the noise of the camera: light is made of one variance before Menon's demosaicking and brought back without
bias, and the spectrum that the noise of a plain frame has after demosaicking is known to it. It takes four minutes a
megapixel, and the licence of its package allows no commercial use. PSNR is that of sRGB as displayed, ΔE00 the mean
CIEDE2000, both against the ideal picture.
""",
}
COLUMNS = {
    "bayer": [("Kodak psnr", "Kodak, odd twelve (dB)"), ("McMaster psnr", "McMaster (dB)")],
    "xtrans": [("Kodak psnr", "Kodak, odd twelve (dB)"), ("McMaster psnr", "McMaster (dB)")],
    "bands": [("bands psnr", "PSNR (dB)"), ("bands ssim", "SSIM"), ("bands angle", "SAM (°)")],
    "noise": [
        (f"{level} {key}", f"{level}: {of}")
        for level in ("0.2", "0.02", "0.01")
        for key, of in (("psnr", "PSNR (dB)"), ("delta_e", "ΔE00"))
    ],
}  # fmt: skip


def page(parts: dict[str, Part]) -> str:
    """The whole page, of the parts that have been measured; the others are named."""
    lacking = [
        f"{TEXTS[name].splitlines()[0].removeprefix('## ')} (`make peers PARTS={name}`)"
        for name in TEXTS
        if name not in parts
    ]
    text = f"\n**Not measured for this page**: {', '.join(lacking)}.\n" if lacking else ""
    return HEAD + common_run(parts) + text + "".join(f"\n{section(name, parts[name])}" for name in TEXTS if name in parts)


def common_run(parts: dict[str, Part]) -> str:
    """The run that all parts are of, if they are of one."""
    runs = {_run(part[key]) for part in parts.values() for key in ("run", "rivals", "timed") if key in part}
    every = f"All of it is of one run: {runs.pop()}." if len(runs) == 1 else "Parts are of several runs; each says of which."
    return f"\n{every} *Source* is a digest of `l3cli/`, `opencl/` and `configs/`.\n"


def origin(part: Part) -> str:
    """The run that a part is of, and those of tables that were trained before it."""
    text = f"Measured: {_run(part['run'])}."
    if "rivals" in part:
        text += f" The others than ours: {_run(part['rivals'])}."
    if "timed" in part:
        text += f" Seconds: {_run(part['timed'])}."
    for name, trained in part["trained"].items():
        if trained is None:
            text += f" The table of {name} was trained by a run that was not noted."
        elif trained["source"] != part["run"]["source"]:
            text += f" The table of {name} was trained on {trained['date']}, source `{trained['source']}`."
    return f"{text}\n"


def _run(run: dict[str, str]) -> str:
    return f"{run['date']}, source `{run['source']}`, {run['machine']}"


def section(name: str, part: Part) -> str:
    """One part: its table, where ours is beaten, what is missing."""
    columns = [(key, title) for key, title in COLUMNS[name] if key in part["rows"][0]["figures"]]
    lines = [TEXTS[name], table(name, columns, part["rows"]), verdict(columns, part["rows"])]
    chosen = [settings(row, columns) for row in part["rows"] if row["settings"]]
    if chosen:
        lines.append(f"Settings other than the plain one: {'; '.join(chosen)}.\n")
    lines += [frame_by_frame(columns, part["frames"], *pair) for pair in _compared(part["rows"])]
    if any("seconds" not in row for row in part["rows"]):
        lines.append("Seconds were not measured of all; `make help` says how they are.\n")
    lines += [f"Not installed: {each}.\n" for each in part["missing"]]
    lines += [f"Not measured, since the pictures are not there: {each}.\n" for each in part["absent"]]
    lines.append(origin(part))
    return "\n".join(lines)


def table(name: str, columns: Sequence[tuple[str, str]], rows: Sequence[Row]) -> str:
    """Measured rows, best first, the best of each column in bold; below them what is published only."""
    printed = published.BAYER if name == "bayer" else {}
    more = [f"published: {title} (dB)" for title in published.PICTURES.values()] if printed else []
    heads = ["method", "program", *(title for _, title in columns), "core-s/MP", *more]
    lines = [_line(heads), _line(["---"] * len(heads))]
    best = {key: _best(key)(row["figures"][key] for row in rows) for key, _ in columns}
    for row in rows:
        cells = [_number(key, row["figures"][key], row["figures"][key] == best[key]) for key, _ in columns]
        method = f"**{row['name']}**" if row["ours"] else row["name"]
        lines.append(_line([method, row["program"], *cells, _seconds(row), *["—"] * len(more)]))
    for method, figures in printed.items():
        cells = ["—"] * (len(columns) + 1)
        lines.append(_line([method, "published", *cells, *(f"*{figures[each]:.2f}*" for each in published.PICTURES)]))
    return "\n".join(lines) + "\n"


def _compared(rows: Sequence[Row]) -> list[tuple[Row, Row]]:
    """Pairs of ours and a rival of which the figures of every frame are stored."""
    stored = [row for row in rows if "by_frame" in row]
    return [(ours, rival) for ours in stored for rival in stored if ours["ours"] and not rival["ours"]]


def frame_by_frame(columns: Sequence[tuple[str, str]], frames: Sequence[str], ours: Row, rival: Row) -> str:
    """Figures of every frame, the better in bold, and on how many ours is better."""
    wins = dict.fromkeys((key for key, _ in columns), 0)
    lines = []
    for place, frame in enumerate(frames):
        cells = []
        for key, _ in columns:
            own, other = (row["by_frame"][key][place] for row in (ours, rival))
            better = own != other and _best(key)(own, other) == own
            wins[key] += better
            cells.append(f"{_number(key, own, better)} / {_number(key, other, other != own and not better)}")
        lines.append(_line([frame, *cells]))
    names = f"{ours['name']} / {rival['name']}"
    heads = [f"frame ({names})", *(title for _, title in columns)]
    counts = [f"{ours['name']} better on", *(f"{won} of {len(frames)}" for won in wins.values())]
    return "\n".join([_line(heads), _line(["---"] * len(heads)), *lines, _line(counts)]) + "\n"


def verdict(columns: Sequence[tuple[str, str]], rows: Sequence[Row]) -> str:
    """By figure who is better than the best of ours, or that nobody is."""
    text = []
    for key, title in columns:
        best = _best(key)
        ours = best(row["figures"][key] for row in rows if row["ours"])
        better = [row for row in rows if not row["ours"] and best(row["figures"][key], ours) != ours]
        for row in better:
            by = abs(row["figures"][key] - ours)
            text.append(f"{row['name']} of {row['program']} in {title}, by {by:.{_digits(key)}f}")
    if text:
        return f"Better than ours: {'; '.join(text)}.\n"
    return "Nothing measured here is better than ours, in any of these figures.\n"


def settings(row: Row, columns: Sequence[tuple[str, str]]) -> str:
    """With which settings the figures of a row were reached."""
    titles = dict(columns)
    chosen: dict[str, list[str]] = {}
    for key, setting in row["settings"].items():
        chosen.setdefault(setting, []).append(titles[key])
    return f"{row['name']} of {row['program']}: " + ", ".join(f"{each} ({', '.join(of)})" for each, of in chosen.items())


def _best(key: str) -> Callable[..., float]:
    return min if key.endswith(LOWER) else max


def _digits(key: str) -> int:
    return DIGITS[key.rpartition(" ")[2]]


def _number(key: str, value: float, best: bool) -> str:
    text = f"{value:.{_digits(key)}f}"
    return f"**{text}**" if best else text


def _seconds(row: Row) -> str:
    return f"{row['seconds']:.2g}" if "seconds" in row else "—"


def _line(cells: Sequence[str]) -> str:
    return f"| {' | '.join(cells)} |"
