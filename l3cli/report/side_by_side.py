"""The section of a report that compares several tables, possibly for different colour filter arrays.

The section shows one frame rendered with each table, the mean metrics, and the error by level.
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from l3cli.artifacts.camera import CameraModel
from l3cli.artifacts.schema import equal
from l3cli.frames.scene import shown_alike
from l3cli.physics.figures import FIGURES, figure_text, known_mean
from l3cli.report.camera import array_figure, responsivity_figures
from l3cli.report.drawing import Plot, spanning
from l3cli.report.evaluation import OURS, brightness, level_middles, lit_as, main_of
from l3cli.report.parts import (
    Block,
    Comparison,
    Figure,
    Figures,
    Gallery,
    Jpeg,
    Picture,
    Pixels,
    Section,
    Subsection,
    Table,
    Text,
    fitted,
)
from l3cli.system.text import counted

CAVEAT = "All cameras photograph the same scenes and illuminants. The exposure times of the cameras may differ."
UNKNOWN_SCENES = (
    "The scenes and illuminants have equal names. They may still differ, because some frames, for example real frames, have "
    "no fingerprint."
)
DIFFERENT_SCENES = (
    "frames with equal names show different scenes or illuminants; simulate all training sets with the same recipe and seed"
)
# Scene name, illuminant name and luminance, which identify a frame across training sets.
Place = tuple[str, str, str]


@dataclass(frozen=True)
class Side:
    """A table that was evaluated on a training set."""

    name: str  # name of the table's file
    frames: str  # name of the training set's file
    camera: CameraModel
    document: dict[str, Any]  # output of `l3 evaluate --json`

    @property
    def places(self) -> dict[Place, int]:
        """Index of the first frame with each combination of scene, illuminant and luminance."""
        places: dict[Place, int] = {}
        for index, frame in enumerate(self.document["frames"]):
            places.setdefault((frame["scene"], frame["illuminant"], f"{frame['luminance']:.6g}"), index)
        return places


def shared_places(sides: list[Side]) -> list[Place]:
    """Find the frames on which all tables were evaluated.

    Frames match if they have the same scene name, illuminant name and luminance, and if their fingerprints describe the
    same scene and illuminant. A missing fingerprint matches any fingerprint.

    Parameters
    ----------
    sides : list of Side
        The evaluated tables.

    Returns
    -------
    list of Place
        The common frames, in the order of the first table's frames.
    """
    return [place for place in _alike(sides) if _one_scene(_shown(sides, place))]


def _alike(sides: list[Side]) -> list[Place]:
    """Find frames with a common scene name, illuminant name and luminance, whatever their fingerprints."""
    others = [side.places for side in sides[1:]]
    return [place for place in sides[0].places if all(place in other for other in others)]


def _shown(sides: list[Side], place: Place) -> list[Any]:
    """Return each table's fingerprint of a frame, or None if it is unknown."""
    return [side.document["frames"][side.places[place]]["shown"] for side in sides]


def _one_scene(shown: list[Any]) -> bool:
    """Whether all known fingerprints describe the same scene and illuminant."""
    known = [each for each in shown if each]
    return all(shown_alike(known[0], each) for each in known[1:])


def shared_frame(sides: list[Side], at: float | None = None) -> list[int]:
    """Choose the frame to show for all tables: the common frame with the first table's median ΔE00.

    Parameters
    ----------
    sides : list of Side
        The evaluated tables.
    at : float, optional
        Luminance in cd/m², to which the choice is restricted. [default: all frames]

    Returns
    -------
    list of int
        Index of the frame in each table's evaluation. Empty if the tables have no common frame, or if the main metric of any
        table is not ΔE00, because its outputs are not colours.
    """
    figures, first = {main_of(side.document) for side in sides}, sides[0]
    places = [
        place for place in shared_places(sides) if lit_as(first.document["frames"][first.places[place]]["luminance"], at)
    ]
    if figures != {"mean_delta_e"} or not places:
        return []
    ordered = sorted(places, key=lambda place: _frames(first, [place])[0][OURS]["mean_delta_e"])
    middle = ordered[len(ordered) // 2]
    return [side.places[middle] for side in sides]


def side_by_side_section(
    sides: list[Side], index: list[int], pictures: list[dict[str, Pixels]], limit: int, jpeg: Jpeg
) -> Section:
    """Build the section that compares several tables.

    Parameters
    ----------
    sides : list of Side
        The evaluated tables.
    index : list of int
        Result of `shared_frame`.
    pictures : list of dict
        Each table's pictures of this frame, by name. Empty if `index` is empty.
    limit : int
        Maximum total size of all pictures in bytes.
    jpeg : callable
        JPEG encoder, see `parts.Jpeg`.

    Returns
    -------
    Section
        The frame, the metrics, and the cameras if they differ. The introduction ranks the tables.
    """
    parts = []
    if pictures:
        parts.append(Subsection("One frame, rendered with each table", (_frame_block(sides, index, pictures, limit, jpeg),)))
    shared = shared_places(sides)
    parts.append(Subsection("Metrics", _figure_blocks(sides, shared)))
    if len({side.camera.name for side in sides}) > 1 or len({side.camera.cfa.tobytes() for side in sides}) > 1:
        parts.append(Subsection("Arrays", (Figures(_cameras(sides)),)))
    return Section("Comparison of tables", _verdict(sides, shared), tuple(parts))


def _frames(side: Side, places: list[Place]) -> list[dict[str, Any]]:
    """Return the metrics of the frames at `places`, or of all frames if `places` is empty."""
    frames = side.document["frames"]
    return [frames[side.places[place]] for place in places] if places else list(frames)


def _mean(side: Side, places: list[Place], pipeline: str, figure: str) -> float | None:
    """Return the mean of a metric over the frames from `_frames`, or None if no frame has the metric."""
    return known_mean([frame[pipeline][figure] for frame in _frames(side, places)])


def _verdict(sides: list[Side], shared: list[Place]) -> str:
    """Rank the tables by their mean error over the shared frames, or explain why they cannot be compared.

    The text also states whether the cameras photographed the same scenes, and how many frames were not compared.
    """
    if len({main_of(side.document) for side in sides}) > 1:
        return "The tables have different outputs, so their metrics cannot be compared."
    others = len(_alike(sides)) - len(shared)
    if not shared:
        cause = f" ({DIFFERENT_SCENES})" if others else ""
        return f"The tables were evaluated on different frames{cause}, so their metrics cannot be compared."
    figure = main_of(sides[0].document)
    ranked = sorted(sides, key=lambda side: _mean(side, shared, OURS, figure) or 0.0)
    values = ", ".join(f"{_title(side, sides)} {figure_text(figure, _mean(side, shared, OURS, figure))}" for side in ranked)
    errors = np.array([[frame[OURS][figure] for frame in _frames(side, shared)] for side in ranked])
    won = int((errors[0] <= errors.min(axis=0)).sum())
    frames = "the frame" if len(shared) == 1 else counted(len(shared), "frame")
    known = all(all(_shown(sides, place)) for place in shared)
    caveat = (
        f" {CAVEAT if known else UNKNOWN_SCENES}" if any(not equal(side.camera, sides[0].camera) for side in sides) else ""
    )
    caveat += f" {counted(others, 'frame')} not compared: {DIFFERENT_SCENES}." if others else ""
    often = "" if len(shared) == 1 else f" on average, and in {won} of {len(shared)} frames"
    best = f"{_title(ranked[0], sides)} is closest to the ideal{often}."
    name = FIGURES[figure].heading
    return f"{best} {name[0].upper()}{name[1:]} over {frames} that all training sets contain: {values}.{caveat}"


def _title(side: Side, sides: list[Side]) -> str:
    """Return a table's name, followed by the training set if the table was evaluated on several training sets."""
    alone = [each.name for each in sides].count(side.name) == 1
    return side.name if alone else f"{side.name} on {side.frames}"


def _frame_block(sides: list[Side], index: list[int], pictures: list[dict[str, Pixels]], limit: int, jpeg: Jpeg) -> Block:
    """Show one frame rendered with each table, and the ideal picture. Pictures of the same size get a slider."""
    frames = [side.document["frames"][at] for side, at in zip(sides, index, strict=True)]
    shown = [
        (_title(side, sides), of[OURS], f"mean ΔE00 {frame[OURS]['mean_delta_e']:.2f}")
        for side, of, frame in zip(sides, pictures, frames, strict=True)
    ]
    shown.append(("ideal", pictures[0]["ideal"], "the target"))
    made = []
    for name, pixels, caption in shown:
        uri, size = fitted(pixels, limit // len(shown), jpeg)
        made.append(Picture(uri, *size, f"{name}: {caption}", f"{frames[0]['scene']}, {name}: {caption}"))
    sizes = {pixels.shape[:2] for _, pixels, _ in shown}
    if len(sizes) > 1:
        return Gallery(tuple(made), wide=True)
    title = f"{frames[0]['scene']}, {frames[0]['illuminant']}{brightness(frames[0])}"
    return Comparison("sides", title, tuple(made), size=next(iter(sizes)))


def _figure_blocks(sides: list[Side], shared: list[Place]) -> tuple[Block, ...]:
    figure_names = tuple(sides[0].document["frames"][0][OURS])
    same = len({main_of(side.document) for side in sides}) == 1
    heads = ("table", "frames", "array", *(FIGURES[figure].heading for figure in figure_names if same))
    rows = []
    for side in sides:
        height, width = side.camera.cfa.shape
        cells = tuple(figure_text(figure, _mean(side, shared, OURS, figure)) for figure in figure_names)
        rows.append((side.name, side.frames, f"{height} × {width}, {len(side.camera.channels)} channels", *cells))
    over = "frames that all training sets contain" if shared else "all frames of each training set"
    blocks: list[Block] = [Table(f"Metrics of each table, mean over the {over}", heads, tuple(rows))]
    if not shared:
        blocks.append(
            Text(
                "To compare the tables, add training sets with the same scenes, illuminants and luminances for every camera."
            )
        )
    drawn = _level_figure(sides) if same else None
    return (*blocks, *([Figures((drawn,))] if drawn else []))


def _level_figure(sides: list[Side]) -> Figure | None:
    """Plot the main metric against the class level, one line per table. Return None if a table has only one level."""
    classes = [side.document["by_class"].get("level", []) for side in sides]
    if min(map(len, classes)) < 2:
        return None
    figure = main_of(sides[0].document)
    curves = [(level_middles(entries), np.array([entry[OURS][figure] for entry in entries])) for entries in classes]
    x = spanning(
        "level of the pixel's neighbourhood (fraction of full scale)", np.concatenate([at for at, _ in curves]), log=True
    )
    plot = Plot(x, spanning(FIGURES[figure].heading, np.concatenate([values for _, values in curves]), zero=True))
    series = {_title(side, sides): curve for side, curve in zip(sides, curves, strict=True)}
    ranges = (
        f"{name} {figure_text(figure, of.min())} to {figure_text(figure, of.max())}" for name, (_, of) in series.items()
    )
    finding = f"{FIGURES[figure].heading} over all frames of each training set: {'; '.join(ranges)}."
    return plot.figure("Error by level of the class", finding, plot.curves(series))


def _cameras(sides: list[Side]) -> tuple[Figure, ...]:
    """Draw the colour filter array and the responsivities of each distinct camera."""
    drawn: dict[bytes, Side] = {}
    for side in sides:
        drawn.setdefault(side.camera.cfa.tobytes() + side.camera.responsivity.tobytes(), side)
    names = [side.camera.name for side in drawn.values()]
    figures: list[Figure] = []
    for side in drawn.values():
        camera = side.camera
        name = camera.name if names.count(camera.name) == 1 else f"{camera.name} ({side.name})"
        shown = (array_figure(camera), responsivity_figures(camera)[0])
        figures += [replace(figure, title=f"{figure.title}: {name}") for figure in shown]
    return tuple(figures)
