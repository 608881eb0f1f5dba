"""Write docs/peers.md from the results of its parts."""

from collections.abc import Callable, Sequence
from typing import Any

import published

Row = dict[str, Any]
Part = dict[str, Any]  # rows, scenes of the frames, digest of the frames, missing programs, absent pictures
DIGITS = {"psnr": 2, "delta_e": 2, "ssim": 4, "angle": 2, "I": 2, "S0": 2, "DoLP": 2, "AoLP": 1}
LOWER = ("delta_e", "angle", "AoLP")
METHOD = "method.md"  # in the folder of the page
HEAD = """# Other methods

This page is for readers who want to know how l3 compares with other demosaicing methods. All methods process the same
mosaics. The other methods come from PyPI packages, LibRaw and RawTherapee, and include a neural network and the
denoiser CBM3D. None of the test pictures was used to train the l3 tables. The command `make peers` repeats all
measurements and writes this page.

* **Settings.** If a method has several settings, each column contains the result of the setting that is best for this
  column. l3 has only one setting.
* **Raw files.** LibRaw and RawTherapee read DNG files, which contain the exact white balance and colour matrix.
* **Values.** The values are means over all pictures, without the outermost 10 pixels of each picture. The best value in
  each column is bold. A dash means that no value is available.
* **Time.** The column "core-s/MP" contains the CPU time in seconds per megapixel, summed over all cores. All times in a
  table were measured in the same run. To exclude the start-up time, the time for a picture of 504×504 pixels was
  subtracted from the time for a picture of 1512×1512 pixels. CBM3D was measured only on the small picture. The times of
  LibRaw and RawTherapee include the time to write and read the DNG file.
"""
TEXTS = {
    "bayer": f"""## Bayer, as published

The usual benchmark samples a mosaic from the 8-bit values of RGB pictures without any conversion, and compares the
demosaiced picture with the original (CPSNR over all three channels). The l3 table was trained on a hundred other
pictures (`l3 init benchmark-bayer`). The column "Kodak, odd twelve" contains our measurements on the twelve Kodak
pictures with odd numbers.

**We did not measure the last two columns.** These columns contain published values for all pictures of the data sets
({published.SOURCE}).

All methods, including LibRaw and RawTherapee, interpret the 8-bit values as linear. The network is from Gharbi et al.
(2016). We found no other demosaicing network with trained weights on PyPI. If the data folder contains the eighteen
McMaster pictures in `demosaicking/mcmaster`, `make peers` also measures the methods on these pictures.
""",
    "xtrans": """## X-Trans

The Kodak pictures and the class recipe are the same as in the previous section, but the mosaics have the 6×6 X-Trans
array. *1 pass*, *3 passes* and *4 passes* are variants of Markesteijn's method in LibRaw and RawTherapee. *bilinear* is
a Gaussian-weighted mean of the samples of each channel. The network is from Gharbi et al. (2016), with the X-Trans
weights from the package.
""",
    "bands": f"""## Sixteen bands

These results are for a snapshot camera with 16 narrow bands and realistic noise. The test frames show three
multispectral scenes and five hyperspectral faces. The l3 table (`bands`) was trained on dead-leaves scenes only. PSNR
(of 8-bit values) and SSIM are means over the bands. SAM (spectral angle mapper) is the mean spectral angle.
[Method]({METHOD}#baselines-for-bands) describes the other methods.
""",
    "noise": """## Bayer with noise, as raw files

These results are for a small sensor (camera recipe `bayer`: pixels of 2.2 µm with a full-well capacity of 6 000 e⁻). There
are ten scenes: a composition of dead leaves, charts and fine patterns, five faces and four photographs. Each scene is
exposed to mean signals of 0.2, 0.02 and 0.01 of full scale. None of these scenes was used in training. PSNR compares the
displayed sRGB pictures with the ideal pictures. ΔE00 is the mean CIEDE2000 difference.

* **Other methods.** All other methods use the true white balance, black level and dark current, and a colour matrix that
  is fitted for the camera and the illuminant. A method that includes noise reduction is measured without noise
  reduction and at several strengths. LibRaw's wavelet denoising is excluded, because it crashes rawpy 0.28. The
  RawTherapee settings are the strengths of luminance and colour noise reduction, and the median filter.
* **Network.** The network was trained without noise. It is measured on linear values and on sRGB values.
* **CBM3D.** CBM3D uses the camera's noise model, and the power spectrum of the noise after demosaicing. A
  variance-stabilising transform is applied before Menon's demosaicing, and the unbiased inverse transform after CBM3D.
  CBM3D takes four minutes per megapixel. The licence of the package does not allow commercial use.
* **l3.** These frames are among the frames with which we developed the l3 class recipes.
""",
    "polarisation": """## Polarisation

These results are for a monochrome polarisation camera (`polarised`). The scenes are photographs of two scenes behind a
polariser at four angles (Dumoulin et al., 2022), whose green channels are the intensities. The signals of an unpolarised
white are 0.9, 0.1 and 0.02 of full scale. The l3 table was trained on dead-leaves scenes only. *I* is the mean PSNR of
the intensities behind the four polarisers, and *AoLP* is the RMS error of the angle where DoLP exceeds 0.05.

* **Newton** (Li et al., 2019) interpolates differences of channels with Newton's polynomials.
* **IGRI** (Morimatsu et al., 2020) interpolates the residuals of a linear function of the intensity.
* **LMMSE** (Spote et al., 2021) is one linear transform of 9×9 pixels per site. For each scene, it was trained on the
  photographs of the other scene with the same noise.
* **l3.** The class recipe `polarised` was developed with these photographs.
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
    "polarisation": [
        (f"{share} {key}", f"{share}: {key} ({unit})")
        for share in ("0.9", "0.1", "0.02")
        for key, unit in (("I", "dB"), ("S0", "dB"), ("DoLP", "dB"), ("AoLP", "°"))
    ],
}  # fmt: skip


def page(parts: dict[str, Part]) -> str:
    """Return the page with all measured parts. The page lists parts that have not been measured."""
    lacking = [
        f"{TEXTS[name].splitlines()[0].removeprefix('## ')} (`make peers PARTS={name}`)"
        for name in TEXTS
        if name not in parts
    ]
    text = f"\n**Not measured for this page**: {', '.join(lacking)}.\n" if lacking else ""
    return HEAD + common_run(parts) + text + "".join(f"\n{section(name, parts[name])}" for name in TEXTS if name in parts)


def common_run(parts: dict[str, Part]) -> str:
    """Return a sentence about the run of the parts, if all parts come from one run."""
    runs = {_run(part[key]) for part in parts.values() for key in ("run", "rivals", "timed") if key in part}
    every = f"All results come from one run: {runs.pop()}." if len(runs) == 1 else "The sections come from several runs."
    return f"\n{every} *Source* is a digest of the files in `l3cli/`, `opencl/` and `configs/`.\n"


def origin(part: Part) -> str:
    """Return sentences about the run of a part, and about the runs of tables that were trained earlier."""
    text = f"Measured: {_run(part['run'])}."
    if "rivals" in part:
        text += f" Other methods: {_run(part['rivals'])}."
    if "timed" in part:
        text += f" Times: {_run(part['timed'])}."
    for name, trained in part["trained"].items():
        if trained is None:
            text += f" The table of {name} was trained in a run that was not recorded."
        elif trained["source"] != part["run"]["source"]:
            text += f" The table of {name} was trained on {trained['date']}, source `{trained['source']}`."
    return f"{text}\n"


def _run(run: dict[str, str]) -> str:
    return f"{run['date']}, source `{run['source']}`, {run['machine']}"


def section(name: str, part: Part) -> str:
    """Return the section of a part: its table, the methods that are better than l3, and missing programs and pictures."""
    columns = [(key, title) for key, title in COLUMNS[name] if key in part["rows"][0]["figures"]]
    lines = [TEXTS[name], table(name, columns, part["rows"]), verdict(columns, part["rows"])]
    chosen = [settings(row, columns) for row in part["rows"] if row["settings"]]
    if chosen:
        heads = ["method", "program", "setting", "used for"]
        rows = [_line(heads), _line(["---"] * len(heads)), *(line for each in chosen for line in each)]
        lines.append(folded("Best settings, if they differ from the default settings", "\n".join(rows) + "\n"))
    for ours, rival in _compared(part["rows"]):
        title = f"{ours['name']} and {rival['name']} on each frame"
        lines.append(folded(title, frame_by_frame(columns, part["frames"], ours, rival)))
    if any("seconds" not in row for row in part["rows"]):
        lines.append("Times were not measured for all methods; `make help` describes how to measure them.\n")
    lines += [f"Not installed: {each}.\n" for each in part["missing"]]
    lines += [f"Not measured, because the pictures are missing: {each}.\n" for each in part["absent"]]
    lines.append(origin(part))
    return "\n".join(lines)


def table(name: str, columns: Sequence[tuple[str, str]], rows: Sequence[Row]) -> str:
    """Return the table of measured results, with the best value of each column in bold, followed by published results."""
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
    """Return the pairs of a table and a rival for which the metrics of every frame are stored."""
    stored = [row for row in rows if "by_frame" in row]
    return [(ours, rival) for ours in stored for rival in stored if ours["ours"] and not rival["ours"]]


def frame_by_frame(columns: Sequence[tuple[str, str]], frames: Sequence[str], ours: Row, rival: Row) -> str:
    """Return a table of the metrics of every frame, with the better value in bold, and the number of wins of l3."""
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
    """Return sentences that list the methods that are better than the best table, for each metric."""
    text = []
    for key, title in columns:
        best = _best(key)
        ours = best(row["figures"][key] for row in rows if row["ours"])
        better = [row for row in rows if not row["ours"] and best(row["figures"][key], ours) != ours]
        for row in better:
            by = abs(row["figures"][key] - ours)
            text.append(
                f'In the column "{title}", {row["name"]} ({row["program"]}) is better than l3 by {by:.{_digits(key)}f}.'
            )
    if text:
        return f"{' '.join(text)}\n"
    return "None of these methods is better than l3 in any of these columns.\n"


def settings(row: Row, columns: Sequence[tuple[str, str]]) -> list[str]:
    """Return table rows with the setting to which each number of a method belongs."""
    titles = dict(columns)
    chosen: dict[str, list[str]] = {}
    for key, setting in row["settings"].items():
        chosen.setdefault(setting, []).append(titles[key])
    return [_line([row["name"], row["program"], each, ", ".join(of)]) for each, of in chosen.items()]


def folded(title: str, text: str) -> str:
    """Return a part of the page that opens when the reader clicks its title."""
    return f"<details>\n<summary>{title}</summary>\n\n{text}\n</details>\n"


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
