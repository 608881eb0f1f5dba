"""A design recipe with all that it names: its lights and levels, filters, arrays, and the filters that are tuned; and what a
report says of its arrays, ranked."""

import dataclasses
import functools
import itertools
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.camera import CameraModel
from l3cli.artifacts.design import GROUPS, Design, LightMoments, SceneMoments, overall, shown, sites
from l3cli.artifacts.store import load
from l3cli.design.error import Cfa, Level, Seen, noise_of, seen_by, spectra_of
from l3cli.design.recipe import (
    DesignRecipe,
    PatternRecipe,
    bare_efficiency,
    design_faults,
    filter_curves,
    gaussian,
    level_name,
    pixel_of,
)
from l3cli.design.search import Problem, anneal, canonical, every_array, independent_outputs
from l3cli.errors import InputFileError, RecipeError, listed
from l3cli.recipes.faults import refuse_first
from l3cli.recipes.toml import load_recipe

ANNEALING, MOST_REPEATED = 1000, 8  # steps; filters of which all arrays of 2×2 are tried first
SAME = 1e-6  # relative; of numbers that agree
BOUNDS = np.array([[400.0, 700.0], [10.0, 150.0], [0.1, 1.0]])  # nm, nm, 1: centre, sigma and peak of tuned filters
STEPS = np.array([10.0, 10.0, 0.1])  # nm, nm, 1: by which these are scaled
SPREAD = np.array([25.0, 15.0, 0.0])  # nm, nm, 1: of random starts about the given filters
DESCENT = {"maxiter": 60, "eps": 1e-4}


@dataclasses.dataclass(frozen=True)
class Task:
    """A design recipe with all that it names, as every process can make it again."""

    recipe: Path
    moments: Path

    def __reduce__(self) -> tuple[Any, ...]:
        return _task, (self.recipe, self.moments)  # each process reads them once

    @functools.cached_property
    def wanted(self) -> DesignRecipe:
        recipe = load_recipe(self.recipe, DesignRecipe)
        refuse_first(design_faults(recipe), self.recipe)
        return recipe

    @property
    def names(self) -> list[str]:
        """Return the names of the filters, by number."""
        return list(self.wanted.filters)

    @functools.cached_property
    def scenes(self) -> SceneMoments:
        return load(SceneMoments, self.moments)

    @functools.cached_property
    def pixel(self) -> CameraModel:
        return pixel_of(self.wanted.pixel, self.recipe.parent)

    @functools.cached_property
    def curves(self) -> NDArray[np.float64]:
        """Return the quantum efficiency (filter, wavelength)."""
        return filter_curves(self.wanted, self.pixel, self.scenes.wavelength, self.recipe.parent)

    @functools.cached_property
    def lights(self) -> list[LightMoments]:
        """Return the moments under the lights of the levels; RecipeError for a light that there are none under."""
        known = {light.illuminant: light for light in self.scenes.light}
        for level in self.wanted.level:
            if level.illuminant not in known:
                held = f"{self.moments} holds moments under {', '.join(known)}"
                raise RecipeError(f'level "{level_name(level)}": {held}; gather them under {level.illuminant}')
        return [known[name] for name in dict.fromkeys(level.illuminant for level in self.wanted.level)]

    @functools.cached_property
    def levels(self) -> tuple[Level, ...]:
        levels, lights = [], [light.illuminant for light in self.lights]
        for one in self.wanted.level:
            luminance = one.lux / np.pi if one.lux is not None else one.luminance_cd_m2 or 100.0
            place = lights.index(one.illuminant)
            levels.append(Level(level_name(one), place, one.share, luminance, one.exposure_s or 0.0))
        return tuple(levels)

    @functools.cached_property
    def spectra(self) -> list[Seen]:
        """Return what counts under each light, by principal spectra."""
        return [spectra_of(light, self.wanted.output, self.wanted.counts, self.curves) for light in self.lights]

    @functools.cached_property
    def problem(self) -> Problem:
        return self.problem_of(self.curves)

    def problem_of(self, curves: NDArray[np.float64]) -> Problem:
        """Return the problem with other filters (filter, wavelength)."""
        seen = tuple(seen_by(curves, *each) for each in zip(self.lights, self.spectra, strict=True))
        return Problem(seen, self.levels, noise_of(self.pixel))

    # ------------------------------------------------------------------------------------------------- arrays

    def allowed(self, filters: Sequence[int]) -> bool:
        """Return whether an array of these filters has as many independent outputs as are needed."""
        responses = self.curves[list(filters)] @ self.lights[0].basis
        return len(filters) >= self.wanted.needed and independent_outputs(responses) >= self.wanted.needed

    def numbered(self, rows: list[str]) -> Cfa:
        """Return an array of names as numbers of filters."""
        return sites("/".join(rows), self.names)

    def choice(self, pattern: PatternRecipe) -> tuple[list[int], list[int] | None]:
        """Return the filters that may stand in a pattern, and how many of each if that is given."""
        filters = [self.names.index(name) for name in (pattern.counts or pattern.filters or self.names)]
        return filters, list(pattern.counts.values()) if pattern.counts else None

    def arrays_of(self, pattern: PatternRecipe, number: int) -> list[Cfa] | None:
        """Return the arrays of a pattern that are judged; None: there are too many, and they are annealed. RecipeError if
        one that is listed, or all, have fewer independent outputs than are needed."""
        shortage = f"fewer than {self.wanted.needed} independent outputs; add a filter"
        where = f"{self.recipe}: pattern {number + 1}"
        if pattern.shape is None:
            given = [self.numbered(rows) for rows in pattern.arrays]
            if wrong := [shown(cfa, self.names) for cfa in given if not self.allowed(np.unique(cfa).tolist())]:
                raise RecipeError(f"{where}: {listed(wrong)} has {shortage}")
            return given
        filters, counts = self.choice(pattern)
        every = every_array(pattern.shape, filters, counts, self.allowed) if self.allowed(filters) else []
        if every == []:
            raise RecipeError(f"{where}: every array of that shape has {shortage} or make it larger")
        return every

    def bayer(self, filters: Sequence[int]) -> list[Cfa]:
        """Return the arrays of Bayer's pattern of any three filters: the middle one by the wavelength of its centre is on a
        diagonal, the two others beside it."""
        centres = self.curves @ self.scenes.wavelength / self.curves.sum(axis=1)
        threes = (sorted(three, key=lambda each: float(centres[each])) for three in itertools.combinations(filters, 3))
        return [np.array([[green, red], [blue, green]]) for blue, green, red in threes if self.allowed([blue, green, red])]

    def require_same_pixel(self) -> None:
        """Raise InputFileError if the moments are of another lens or pixel."""
        ours, theirs = (self.pixel.pixel_pitch, self.pixel.optics.f_number), (self.scenes.pixel_pitch, self.scenes.f_number)
        if not np.allclose(ours, theirs, rtol=SAME, atol=0):
            given, wanted = (f"pixels of {1e6 * pitch:g} µm at f/{f_number:g}" for pitch, f_number in (theirs, ours))
            text = f"{self.moments} is of {given}, the design of {wanted}"
            raise InputFileError(f"{text}; gather moments with ‹camera› {self.recipe}")

    def judged(self, arrays: Sequence[Cfa]) -> dict[str, NDArray]:
        """Return the errors (array, level, group)."""
        return {"errors": np.array([self.problem.errors(cfa) for cfa in arrays])}

    def annealed(self, seed: int, which: tuple[int, int]) -> dict[str, NDArray]:
        """Return the array that a run of annealing of a pattern comes to, from a random array; the first run, if it can be,
        from the best of a quarter of the sites, repeated."""
        (number, run), rng = which, np.random.default_rng([seed, *which])
        pattern = self.wanted.pattern[number]
        assert pattern.shape is not None
        (rows, cols), (filters, counts) = pattern.shape, self.choice(pattern)
        sites = rng.permutation(np.repeat(filters, counts)) if counts else rng.choice(filters, rows * cols)
        start = sites.reshape(rows, cols)
        if run == 0 and not counts and not rows % 2 and not cols % 2 and len(filters) <= MOST_REPEATED:
            small = every_array((2, 2), filters, None, self.allowed) or [start[:2, :2]]
            start = np.tile(min(small, key=self.problem.score), (rows // 2, cols // 2))
        return {"cfa": anneal(self.problem, start, filters, bool(counts), self.allowed, rng, ANNEALING)}

    # ------------------------------------------------------------------------------------------------- tuning

    def tuned_curves(self, parameters: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the quantum efficiencies (filter, wavelength) with tuned filters (tuned filter, 3)."""
        curves, wavelength = self.curves.copy(), self.scenes.wavelength
        bare = bare_efficiency(self.wanted.pixel.bare, wavelength, self.recipe.parent)
        for name, (centre, sigma, peak) in zip(self.wanted.tuned, parameters.tolist(), strict=True):
            passed = gaussian(wavelength, centre, sigma, peak, self.wanted.filters[name].floor)
            curves[self.names.index(name)] = bare * passed
        return curves

    def descended(self, seed: int, number: int) -> dict[str, NDArray]:
        """Return the least error that a start, the first of them the given filters, leads to within bounds, and its centres,
        sigmas and peaks (tuned filter, 3): by differences, which cost what a gradient does."""
        from scipy import optimize

        asked, tuned = self.wanted.optimise, [self.wanted.filters[name] for name in self.wanted.tuned]
        assert asked is not None
        start = np.array([[one.centre_nm, one.sigma_nm, one.peak] for one in tuned], np.float64)
        if number > 0:
            moved = start + SPREAD * np.random.default_rng([seed, number]).standard_normal(start.shape)
            start = np.clip(moved, *BOUNDS.T)
        cfa, free = self.numbered(asked.pattern), slice(0, 3 if asked.peaks else 2)
        used = np.unique(cfa)

        def parameters(flat: NDArray[np.float64]) -> NDArray[np.float64]:
            values = start.copy()
            values[:, free] = flat.reshape(len(start), -1) * STEPS[free]
            return values

        def score(flat: NDArray[np.float64]) -> float:
            problem = self.problem_of(self.tuned_curves(parameters(flat))[used])
            return float(np.log(problem.score(np.searchsorted(used, cfa))))

        bounds = np.tile(BOUNDS[free] / STEPS[free, None], (len(start), 1))
        begin = (start / STEPS)[:, free].ravel()
        done = optimize.minimize(score, begin, method="L-BFGS-B", bounds=bounds, options=DESCENT)
        return {"score": np.array(done.fun), "parameters": parameters(done.x)}


@functools.lru_cache(maxsize=1)
def _task(recipe: Path, moments: Path) -> Task:
    """Return the task of this process."""
    return Task(recipe, moments)


UNITS = {"lab": "ΔE00", "scielab": "ΔE of soft chroma", "luminance": "L*", "linear": "% of white"}
LISTED = 100  # arrays, the best ones; beside them Bayer's and the best of each level
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
    leaders = [order[0], *([] if best is None else [best]), *levels.argmin(axis=0)]
    listed = [place for place in order.tolist() if place in {*order[:LISTED].tolist(), *leaders}]
    dyes = [best_bayer(np.unique(arrays[place]).tolist()) for place in listed]
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
