"""Beginning of a page: pictures of a table beside the ideal and the basic ones, the verdict and figures beside them."""

from typing import Any

import numpy as np

from l3cli.report.evaluation import NAMES, OURS, figure_text, main_figure
from l3cli.report.parts import Comparison, Front, Key, Picture, Section, Subsection, Table, counted
from l3cli.report.pictures import Jpeg, Pixels, fitted

ERROR_KEY = (  # of the error map's colours, as evaluation draws them
    Key("error map: ΔE00 0", "#000000", "box"),
    Key("2.5", "#460a6e", "box"),
    Key("5", "#be285a", "box"),
    Key("7.5", "#f58c1e", "box"),
    Key("10 and more", "#ffffff", "box"),
)
SEEN = 3  # frames shown of an evaluation: the middle, the worst, the best
Pictures = dict[int, dict[str, Pixels]]  # of some frames by index


def shown_frames(document: dict[str, Any]) -> list[int]:
    """Return the indices of the frames worth showing, by the main figure of ours: the middle one first, then the others of a
    few, else the worst and the best."""
    frames = document["frames"]
    figure = _main(document)
    order = np.argsort([-frame[OURS][figure] for frame in frames], kind="stable").tolist()
    middle = order.pop(len(order) // 2)
    return [middle, *(order if len(order) < SEEN else (order[0], order[-1]))]


def front_section(
    document: dict[str, Any], pictures: Pictures, title: str, anchor: str, limit: int, jpeg: Jpeg,
    below: tuple[Subsection, ...],
) -> Section:  # fmt: skip
    """Return the first section of a page. `document` is that of `l3 evaluate --json`, `pictures` those of the frames of
    `shown_frames` in that order, of which `limit` bytes is what they may take; `below` is shown after the first of them."""
    count = len(document["frames"])
    each = limit // sum(len(frame) for frame in pictures.values())
    comparisons = [_comparison(document, index, names, anchor, each, jpeg) for index, names in pictures.items()]
    first = Front(comparisons[0], *_score(document), verdict(document), _figures(document))
    parts = [Subsection("Ours beside the ideal", (first,)), *below]
    if comparisons[1:]:
        title_of_others = "The worst and the best frame" if count > SEEN else "Other frames"
        parts.append(Subsection(title_of_others, tuple(comparisons[1:])))
    which = "" if count == 1 else f"The first is, of {count} frames, the one of median {NAMES[_main(document)]}."
    return Section(title, which, tuple(parts))


def verdict(document: dict[str, Any]) -> str:
    """Return the pipeline that is nearer to the ideal, in words."""
    count, figure = len(document["frames"]), _main(document)
    sentences = []
    for baseline, wins in document["better"].items():
        lost = [NAMES[name] for name, won in wins.items() if 2 * won <= count]
        if all(won == count for won in wins.values()):
            often = ", in every frame" if count > 1 else ""
            sentences.append(f"Ours is nearer to the ideal than {baseline} by every figure{often}.")
        elif 2 * wins[figure] > count:
            but = f", not by {', '.join(lost)}" if lost else ""
            by = _in_frames(figure, wins[figure], count)
            sentences.append(f"Ours is nearer to the ideal than {baseline} by {by}{but}.")
        else:
            worse = count - wins[figure]
            sentences.append(f"Ours is not nearer to the ideal than {baseline} by {_in_frames(figure, worse, count)}.")
    return " ".join(sentences)


def _in_frames(figure: str, won: int, count: int) -> str:
    return NAMES[figure] + (f" in {won} of {count} frames" if count > 1 else "")


def _main(document: dict[str, Any]) -> str:
    """Return the figure that decides."""
    return str(next(iter(document["frames"][0][OURS])))


def _score(document: dict[str, Any]) -> tuple[str, str]:
    figure, count = _main(document), len(document["frames"])
    over = "" if count == 1 else f", mean over {counted(count, 'frame')}"
    return figure_text(
        figure, document["mean"][OURS][figure]
    ), f"{NAMES[figure]} of ours{over}. A ΔE00 of 1 is just visible."


def _figures(document: dict[str, Any]) -> Table:
    pipelines = document["pipelines"]
    rows = tuple(
        (NAMES[figure], *(figure_text(figure, document["mean"][name][figure]) for name in pipelines))
        for figure in document["frames"][0][OURS]
    )
    return Table("Figures" if len(document["frames"]) == 1 else "Means over the frames", ("figure", *pipelines), rows)


def _comparison(
    document: dict[str, Any], index: int, pictures: dict[str, Pixels], anchor: str, limit: int, jpeg: Jpeg
) -> Comparison:
    frame = document["frames"][index]
    title = f"Frame {index + 1}: {frame['scene']}, {frame['illuminant']}, level {frame['level']:.3f}"
    ordered = sorted(pictures, key=lambda name: (name != OURS, name != "ideal", name == "error"))
    made = tuple(_picture(frame, name, pictures[name], _main(document), limit, jpeg) for name in ordered)
    size = next(iter(pictures.values())).shape[:2]
    return Comparison(f"{anchor}-{index}", title, made, ERROR_KEY, (size[0], size[1]))


def _picture(frame: dict[str, Any], name: str, pixels: Pixels, figure: str, limit: int, jpeg: Jpeg) -> Picture:
    uri, (rows, cols) = fitted(pixels, limit, jpeg)
    scale = pixels.shape[0] // rows
    reduced = f", shown at 1/{scale} of its size" if scale > 1 else ""
    if name == "ideal":
        shows = "the target"
    elif name == "error":
        shows = f"ΔE00 of ours at every pixel, mean {figure_text(figure, frame[OURS][figure])}"
    else:
        shows = f"{NAMES[figure]} {main_figure(frame[name], figure)}"
    caption = f"{name}: {shows}{reduced}"
    return Picture(uri, rows, cols, caption, f"{frame['scene']}, {caption}")
