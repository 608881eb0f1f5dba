"""Arrays of a design ranked, and what a report says of the best."""

import dataclasses
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.design import Design
from l3cli.design.error import Cfa, Level
from l3cli.design.recipe import shown
from l3cli.design.search import canonical
from l3cli.design.task import Task

UNITS = {"lab": "ΔE00", "scielab": "ΔE of soft chroma", "luminance": "L*", "linear": "% of white"}
SHIFT = 5.0  # nm, of a filter that is not as it should be
DOSES = 10.0 ** np.arange(-2.0, 1.26, 0.25)  # cd s/m², of the map of errors over light


def designed(task: Task, arrays: Sequence[Cfa], errors: NDArray[np.float64], top: int) -> Design:
    """Return the design, its best `top` arrays and the best of Bayer's among them."""
    problem, names = task.problem, task.names
    scores = np.array([problem.score(each) for each in errors])
    order = np.lexsort((np.arange(len(scores)), np.round(np.log(scores), 9)))
    places = {canonical(cfa): place for place, cfa in enumerate(arrays) if cfa.shape == (2, 2)}
    listed_places = list(order[:top])
    best = task.best_bayer(range(len(names)), places, scores)
    if best is not None and best not in listed_places:
        listed_places.append(best)
    dyes = [task.best_bayer(np.unique(arrays[place]).tolist(), places, scores) for place in listed_places]
    levels = (errors * problem.share).sum(axis=2)
    leaders = [order[0], *([] if best is None else [best]), *levels.argmin(axis=0)]
    mapped = list(dict.fromkeys(int(place) for place in leaders))
    over_light = [Level("", problem.levels[0].light, None, float(dose), 1.0) for dose in DOSES]
    light = dataclasses.replace(problem, levels=tuple(over_light), noise=dataclasses.replace(problem.noise, dark=0.0))
    return Design(
        name=task.wanted.name,
        unit=UNITS[task.wanted.counts if task.wanted.output == "XYZ" else "linear"],
        wavelength=task.scenes.wavelength,
        filters=tuple(names),
        efficiency=task.curves,
        levels=tuple(level.name for level in problem.levels),
        groups=task.scenes.groups,
        share=problem.share,
        tried=len(arrays),
        patterns=tuple(shown(arrays[place], names) for place in listed_places),
        error=errors[listed_places],
        dyes=np.array([np.zeros(len(problem.levels)) if each is None else levels[each] for each in dyes]),
        sensitivity=sensitivity(task, arrays[order[0]]),
        dose=DOSES,
        mapped=tuple(shown(arrays[place], names) for place in mapped),
        map_error=np.array([(light.errors(arrays[place]) * light.share).sum(axis=1) for place in mapped]),
        bayer=-1 if best is None else listed_places.index(best),
        pixel=task.pixel,
    )


def sensitivity(task: Task, cfa: Cfa) -> NDArray[np.float64]:
    """Return by how much (filter) the error of an array changes, relative, if one filter lies SHIFT nm off."""
    changes, given = np.zeros(len(task.curves)), task.problem.score(task.problem.errors(cfa))
    for place in np.unique(cfa):
        for shift in (-SHIFT, SHIFT):
            curves = task.curves.copy()
            curves[place] = np.interp(task.scenes.wavelength - shift, task.scenes.wavelength, curves[place])
            problem = task.problem_of(curves)
            change = problem.score(problem.errors(cfa)) / given - 1
            changes[place] = max(changes[place], change, key=abs)
    return changes
