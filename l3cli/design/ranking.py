"""Arrays of a design ranked, and what a report says of the best."""

import dataclasses
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.design import GROUPS, Design, overall, shown
from l3cli.design.error import Cfa, Level
from l3cli.design.search import canonical
from l3cli.design.task import Task

UNITS = {"lab": "ΔE00", "scielab": "ΔE of soft chroma", "luminance": "L*", "linear": "% of white"}
LISTED = 100  # arrays, the best ones
SHIFT = 5.0  # nm, of a filter that is not as it should be
DOSES = 10.0 ** np.arange(-2.0, 1.26, 0.25)  # cd s/m², of the map of errors over light


def designed(task: Task, arrays: Sequence[Cfa], errors: NDArray[np.float64]) -> Design:
    """Return the design, its best arrays and the best of Bayer's among them, from errors (array, level, group)."""
    problem, names = task.problem, task.names
    levels = (errors * problem.share).sum(axis=2)
    scores = overall(levels)
    order = np.lexsort((np.arange(len(scores)), np.round(np.log(scores), 9)))
    places = {canonical(cfa): place for place, cfa in enumerate(arrays) if cfa.shape == (2, 2)}

    def best_bayer(filters: Sequence[int]) -> int | None:
        return min((places[canonical(cfa)] for cfa in task.bayer(filters)), key=lambda place: scores[place], default=None)

    best = best_bayer(range(len(names)))
    listed = list(dict.fromkeys([*order[:LISTED].tolist(), *([] if best is None else [best])]))
    dyes = [best_bayer(np.unique(arrays[place]).tolist()) for place in listed]
    leaders = [order[0], *([] if best is None else [best]), *levels.argmin(axis=0)]
    mapped = [arrays[place] for place in dict.fromkeys(map(int, leaders))]
    over_light = tuple(Level("", 0, None, float(dose), 1.0) for dose in DOSES)
    light = dataclasses.replace(problem, levels=over_light, noise=dataclasses.replace(problem.noise, dark=0.0))
    return Design(
        name=task.wanted.name,
        unit=UNITS[task.wanted.counts if task.wanted.output == "XYZ" else "linear"],
        wavelength=task.scenes.wavelength,
        filters=tuple(names),
        efficiency=task.curves,
        levels=tuple(level.name for level in problem.levels),
        groups=GROUPS,
        share=problem.share,
        tried=len(arrays),
        patterns=tuple(shown(arrays[place], names) for place in listed),
        error=errors[listed],
        dyes=np.array([np.zeros(len(problem.levels)) if each is None else levels[each] for each in dyes]),
        sensitivity=sensitivity(task, arrays[order[0]]),
        dose=DOSES,
        mapped=tuple(shown(cfa, names) for cfa in mapped),
        map_error=np.array([light.means(cfa) for cfa in mapped]),
        bayer=-1 if best is None else listed.index(best),
        pixel=task.pixel,
    )


def sensitivity(task: Task, cfa: Cfa) -> NDArray[np.float64]:
    """Return by how much (filter) the error of an array changes, relative, if one filter lies SHIFT nm off."""
    changes, given, grid = np.zeros(len(task.curves)), task.problem.score(cfa), task.scenes.wavelength
    for place in np.unique(cfa):
        for shift in (-SHIFT, SHIFT):
            curves = task.curves.copy()
            curves[place] = np.interp(grid - shift, grid, curves[place])
            changes[place] = max(changes[place], task.problem_of(curves).score(cfa) / given - 1, key=abs)
    return changes
