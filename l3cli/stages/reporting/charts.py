"""The colour chart in frames that a table is judged on."""

from numpy.typing import NDArray

from l3cli.artifacts.training_set import TrainingPair, TrainingSet
from l3cli.report.parts import Figures, Subsection
from l3cli.report.patches import patches_figure, patches_table
from l3cli.simulation.procedural import chart_places


def chart_subsection(frame: TrainingPair, number: int, planes: dict[str, NDArray], head: TrainingSet) -> Subsection | None:
    """The patches of the ColorChecker in frame `number` of a training set and in `planes`, those of every pipeline; None
    where its target shows none."""
    from l3cli.evaluation.patches import holds_chart, patch_colours

    light = head.target_light or frame.light
    size = frame.raw.shape[0], frame.raw.shape[1]
    places = (regions for regions in chart_places(size) if holds_chart(frame, light, regions))
    regions = next(places, None)
    if regions is None:
        return None
    colours = patch_colours(frame, planes, regions)
    ours = next(iter(planes))
    title = f"Patches in frame {number + 1}, {frame.scene}, {frame.illuminant}"
    figure = patches_figure(title, ("ideal", ours), (colours.ideal, colours.shown[ours]), colours.delta_e)
    return Subsection("Colour chart", (Figures((figure,)), patches_table(colours.delta_e)))
