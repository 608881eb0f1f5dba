"""Figures of a calibrated camera as lines and tables of plain text."""

from typing import Any

from l3cli.system.text import columns, figure

SHOWN = 8  # defects listed in the text; JSON and the artifact hold all


def as_text(result: dict[str, Any], width: int | None = None) -> list[str]:
    """`figures`, with `compare` under "truth" if there, as lines of plain text; tables wider than `width` characters are
    divided."""
    truth = result.get("truth")
    lines = []
    for name, entry in result["camera"].items():
        line = f"{name:24}{figure(entry['value'], '.5g'):>12} {entry['unit']:6}"
        if truth:
            known = truth["camera"][name]
            error = "" if known["error %"] is None else f"  error {figure(known['error %'], '+.2f')} %"
            line += f"  true {figure(known['true'], '.5g'):>10}{error}"
        lines.append(line.rstrip())
    for table in (result["channels"], result["lights"], result["bands"], truth["channels"] if truth else {}):
        lines += ["", *_table(table, width)] if table else []
    lines += _photo_lines(result) if result["photos"] else []
    lines += ["", *matrix_lines(result["matrices"], width)] if result.get("matrices") else []
    lines += ["", f"responsivity: {result['responsivity']}"]
    source = "not measured, taken as 0" if "dark current" in result["declared"] else "from the data sheet"
    lines += [f"{source}: {', '.join(result['declared'])}"] if result["declared"] else []
    lines += [f"left out: {capture}" for capture in result["left out"]]
    defects = result["defects"]
    if defects:
        shown = " ".join(f"({row}, {col})" for row, col in defects[:SHOWN]) + (" …" if len(defects) > SHOWN else "")
        lines.append(f"hot and dead pixels left out, row and col: {len(defects)}: {shown}")
    return lines + _correction_lines(result) + _curve_lines(result["curves"], width)


def _curve_lines(curves: dict[str, Any], width: int | None) -> list[str]:
    """Return the peak and width of each channel's curve."""
    rows = []
    for name, curve in curves["channels"].items():
        wide = "–" if curve["FWHM (nm)"] is None else f"{curve['FWHM (nm)']:.0f}"
        rows.append([name, f"{curve['peak (nm)']:g}", wide])
    range_nm = f"{curves['first (nm)']:g}…{curves['last (nm)']:g} nm"
    return ["", f"curves, {range_nm}", *columns(["channel\n", "peak\nnm", "FWHM\nnm"], rows, width)]


def _correction_lines(result: dict[str, Any]) -> list[str]:
    """Return lines on a camera's defect map and flat field."""
    lines = []
    if found := result["defect map"]:
        lines.append("defect map: " + ", ".join(f"{what} {count}" for what, count in found.items()))
    if lost := result["corner fall-off %"]:
        shares = ", ".join(f"{name} {figure(share, '.3g')} %" for name, share in lost.items())
        lines.append(f"flat field: light lost in the darkest corner: {shares}")
    return lines


def matrix_lines(matrices: dict[str, dict[str, dict[str, Any]]], width: int | None = None) -> list[str]:
    """Return lines on the colour errors of measured surfaces that the exported matrices of each light leave."""
    headings = ["light", "matrix", "ΔE00 mean", "95 %", "worst", "of L*", "a*", "b*"]
    rows = [
        [
            light,
            matrix,
            *(figure(each[key], ".2f") for key in ("mean", "95 %", "worst")),
            *(f"{v:.0f}" for v in each["worst L*a*b*"]),
        ]
        for light, kinds in matrices.items()
        for matrix, each in kinds.items()
    ]
    return columns(headings, rows, width)


def _table(rows: dict[str, dict[str, float]], width: int | None) -> list[str]:
    """Return the rows of numbers below two lines of headings: names, and the units that stand in brackets after them."""
    titles = list(next(iter(rows.values())))
    headings = ["channel\n", *("\n".join(title.rstrip(")").partition(" (")[::2]) for title in titles)]
    return columns(headings, [[name, *(figure(row[title], ".5g") for title in titles)] for name, row in rows.items()], width)


def _photo_lines(result: dict[str, Any]) -> list[str]:
    """Return lines on the results of photos of charts, and how to read their bands."""
    lines = [""]
    for name, photo in result["photos"].items():
        light = f"{photo['light']} (guessed)" if photo["guessed"] else photo["light"]
        nearest = "" if photo["nearest"] == photo["light"] else f", nearest of the usual ones {photo['nearest']}"
        lines.append(
            f"{name}: {photo['chart']}, light {light}{nearest}, uneven by {photo['uneven %']:.0f} %, glare up to "
            f"{max(photo['glare %']):.1f} %, patches within {max(photo['misfit %']):.1f} % RMS of the brightest"
        )
    further = result["next light"]
    return [
        *lines,
        f"prior of the curves: {result['prior']}; the curves stay uncertain, colours do not: compare their bands",
        f"one more photo, under {further['light']}, would leave {further['remaining %']:.0f} % of the colours' error",
    ]
