"""Execute a design recipe.

`Task` reads the recipe and its files, predicts the errors of arrays, and optimises filters. `designed` ranks the arrays and
collects the results.
"""

import dataclasses
import functools
import itertools
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import optimize

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
from l3cli.recipes.load import load_recipe

ANNEALING_STEPS = 1000  # number of steps of simulated annealing
MAX_REPEATED_FILTERS = 8  # with at most this number of filters, one run of annealing starts from the best 2×2 array
PIXEL_TOLERANCE = 1e-6  # relative tolerance when pixel pitches and f-numbers are compared
BOUNDS = np.array([[400.0, 700.0], [10.0, 150.0], [0.1, 1.0]])  # range of centre (nm), sigma (nm) and peak
VARIABLE_UNITS = np.array([10.0, 10.0, 0.1])  # units of the optimiser's variables: centre (nm), sigma (nm) and peak
START_DEVIATIONS = np.array([25.0, 15.0, 0.0])  # standard deviation of random starts in centre (nm), sigma (nm) and peak
DESCENT = {"maxiter": 60, "eps": 1e-4}  # options for `scipy.optimize.minimize`


@dataclasses.dataclass(frozen=True)
class Task:
    """A design recipe with its scene moments and its files, and the predictions that follow from them.

    Worker processes receive only the two paths. Each process reads the files once.

    Parameters
    ----------
    recipe : Path
        File of the design recipe.
    moments : Path
        File with scene moments from `l3 design moments`.
    """

    recipe: Path
    moments: Path

    def __reduce__(self) -> tuple[Any, ...]:
        return _task, (self.recipe, self.moments)

    @functools.cached_property
    def wanted(self) -> DesignRecipe:
        """The design recipe. Raises RecipeError if it contains an error."""
        recipe = load_recipe(self.recipe, DesignRecipe)
        refuse_first(design_faults(recipe), self.recipe)
        return recipe

    @property
    def names(self) -> list[str]:
        """Filter names, by index."""
        return list(self.wanted.filters)

    @functools.cached_property
    def scenes(self) -> SceneMoments:
        return load(SceneMoments, self.moments)

    @functools.cached_property
    def pixel(self) -> CameraModel:
        return pixel_of(self.wanted.pixel, self.recipe.parent)

    @functools.cached_property
    def curves(self) -> NDArray[np.float64]:
        """Quantum efficiency of the pixel behind each filter: (filter, wavelength)."""
        return filter_curves(self.wanted, self.pixel, self.scenes.wavelength, self.recipe.parent)

    @functools.cached_property
    def lights(self) -> list[LightMoments]:
        """Scene moments under each illuminant of the light levels.

        Raises
        ------
        RecipeError
            If the scene moments were not computed for one of these illuminants.
        """
        known = {light.illuminant: light for light in self.scenes.light}
        for level in self.wanted.level:
            if level.illuminant not in known:
                raise RecipeError(
                    f'level "{level_name(level)}" needs scene moments for the illuminant {level.illuminant}, but '
                    f'{self.moments} contains only {", ".join(known)}; add "{level.illuminant}" to the key "illuminants" of '
                    'the scene recipe, and run "l3 design moments" again'
                )
        return [known[name] for name in dict.fromkeys(level.illuminant for level in self.wanted.level)]

    @functools.cached_property
    def levels(self) -> tuple[Level, ...]:
        """Light levels of the recipe. If the recipe specifies no luminance, it is 100 cd/m²."""
        levels, lights = [], [light.illuminant for light in self.lights]
        for one in self.wanted.level:
            luminance = one.lux / np.pi if one.lux is not None else one.luminance_cd_m2 or 100.0
            place = lights.index(one.illuminant)
            levels.append(Level(level_name(one), place, one.share, luminance, one.exposure_s or 0.0))
        return tuple(levels)

    @functools.cached_property
    def spectra(self) -> list[Seen]:
        """Moments of the principal spectra and outputs under each illuminant."""
        return [spectra_of(light, self.wanted.output, self.wanted.counts, self.curves) for light in self.lights]

    @functools.cached_property
    def problem(self) -> Problem:
        return self.problem_of(self.curves)

    def problem_of(self, curves: NDArray[np.float64]) -> Problem:
        """Return the search problem for filters with the given quantum efficiencies (filter, wavelength)."""
        seen = tuple(seen_by(curves, *each) for each in zip(self.lights, self.spectra, strict=True))
        return Problem(seen, self.levels, noise_of(self.pixel))

    # ------------------------------------------------------------------------------------------------- arrays

    def allowed(self, filters: Sequence[int]) -> bool:
        """Whether an array of these filters has enough independent outputs."""
        responses = self.curves[list(filters)] @ self.lights[0].basis
        return len(filters) >= self.wanted.needed and independent_outputs(responses) >= self.wanted.needed

    def numbered(self, rows: list[str]) -> Cfa:
        """Convert rows of filter names, such as "r g", to filter indices (row, col)."""
        return sites("/".join(rows), self.names)

    def choice(self, pattern: PatternRecipe) -> tuple[list[int], list[int] | None]:
        """Return the filters that a pattern's arrays may contain, and the number of sites of each (None for any number)."""
        filters = [self.names.index(name) for name in (pattern.counts or pattern.filters or self.names)]
        return filters, list(pattern.counts.values()) if pattern.counts else None

    def arrays_of(self, pattern: PatternRecipe, number: int) -> list[Cfa] | None:
        """Return the arrays of a pattern, or None if there are so many that simulated annealing is needed.

        `number` is the index of the pattern, for error messages.

        Raises
        ------
        RecipeError
            If an array in the recipe, or every array of the shape, has too few independent outputs.
        """
        shortage = f"fewer than {self.wanted.needed} independent outputs; add filters"
        where = f"{self.recipe}: pattern {number + 1}"
        if pattern.shape is None:
            given = [self.numbered(rows) for rows in pattern.arrays]
            if wrong := [shown(cfa, self.names) for cfa in given if not self.allowed(np.unique(cfa).tolist())]:
                raise RecipeError(f"{where}: {listed(wrong)} {'has' if len(wrong) == 1 else 'have'} {shortage}")
            return given
        filters, counts = self.choice(pattern)
        every = every_array(pattern.shape, filters, counts, self.allowed) if self.allowed(filters) else []
        if every == []:
            raise RecipeError(f"{where}: every array of this shape has {shortage}, or enlarge the shape")
        return every

    def bayer(self, filters: Sequence[int]) -> list[Cfa]:
        """Return one Bayer array for each combination of three filters with enough independent outputs.

        The filter with the intermediate centre wavelength occupies the two green sites.
        """
        centres = self.curves @ self.scenes.wavelength / self.curves.sum(axis=1)
        threes = (sorted(three, key=lambda each: float(centres[each])) for three in itertools.combinations(filters, 3))
        return [np.array([[green, red], [blue, green]]) for blue, green, red in threes if self.allowed([blue, green, red])]

    def require_same_pixel(self) -> None:
        """Raise InputFileError if the scene moments were computed for another f-number or pixel pitch."""
        wanted, given = (self.pixel.pixel_pitch, self.pixel.optics.f_number), (self.scenes.pixel_pitch, self.scenes.f_number)
        if not np.allclose(wanted, given, rtol=PIXEL_TOLERANCE, atol=0):
            theirs, ours = (f"pixels of {1e6 * pitch:g} µm at f/{f_number:g}" for pitch, f_number in (given, wanted))
            raise InputFileError(
                f'{self.moments} contains scene moments for {theirs}, but the design is for {ours}; run "l3 design moments" '
                f"with ‹camera› {self.recipe}"
            )

    def judged(self, arrays: Sequence[Cfa]) -> dict[str, NDArray]:
        """Predict the errors of arrays, and return them as the entry "errors": (array, level, group)."""
        return {"errors": np.array([self.problem.errors(cfa) for cfa in arrays])}

    def annealed(self, seed: int, which: tuple[int, int]) -> dict[str, NDArray]:
        """Search for the best array of a pattern with one run of simulated annealing.

        Parameters
        ----------
        seed : int
            Random seed.
        which : tuple of int
            Index of the pattern, and index of the run. Run 0 starts from repetitions of the best 2×2 array if possible.
            Other runs start from random arrays.

        Returns
        -------
        dict
            Key "cfa": the array (row, col).
        """
        (number, run), rng = which, np.random.default_rng([seed, *which])
        pattern = self.wanted.pattern[number]
        assert pattern.shape is not None
        (rows, cols), (filters, counts) = pattern.shape, self.choice(pattern)
        sites = rng.permutation(np.repeat(filters, counts)) if counts else rng.choice(filters, rows * cols)
        start = sites.reshape(rows, cols)
        if run == 0 and not counts and not rows % 2 and not cols % 2 and len(filters) <= MAX_REPEATED_FILTERS:
            small = every_array((2, 2), filters, None, self.allowed) or [start[:2, :2]]
            start = np.tile(min(small, key=self.problem.score), (rows // 2, cols // 2))
        return {"cfa": anneal(self.problem, start, filters, bool(counts), self.allowed, rng, ANNEALING_STEPS)}

    # ------------------------------------------------------------------------------------------------- tuning

    def tuned_curves(self, parameters: NDArray[np.float64]) -> NDArray[np.float64]:
        """Compute the quantum efficiencies of all filters, with the given parameters for the optimised filters.

        Parameters
        ----------
        parameters : ndarray, (optimised filter, 3)
            Centre in nm, sigma in nm, and peak of each optimised filter.

        Returns
        -------
        ndarray, (filter, wavelength)
        """
        curves, wavelength = self.curves.copy(), self.scenes.wavelength
        bare = bare_efficiency(self.wanted.pixel.bare, wavelength, self.recipe.parent)
        for name, (centre, sigma, peak) in zip(self.wanted.tuned, parameters.tolist(), strict=True):
            passed = gaussian(wavelength, centre, sigma, peak, self.wanted.filters[name].floor)
            curves[self.names.index(name)] = bare * passed
        return curves

    def descended(self, seed: int, number: int) -> dict[str, NDArray]:
        """Optimise the filters by gradient descent from one starting point.

        The gradient is computed by finite differences. They are as fast as an analytic gradient.

        Parameters
        ----------
        seed : int
            Random seed.
        number : int
            Index of the starting point. Starting point 0 consists of the filters in the recipe. All others are random
            variations of them.

        Returns
        -------
        dict
            Key "score": logarithm of the smallest error. Key "parameters": centre in nm, sigma in nm and peak of each
            optimised filter (optimised filter, 3).
        """
        asked, tuned = self.wanted.optimise, [self.wanted.filters[name] for name in self.wanted.tuned]
        assert asked is not None
        start = np.array([[one.centre_nm, one.sigma_nm, one.peak] for one in tuned], np.float64)
        if number > 0:
            moved = start + START_DEVIATIONS * np.random.default_rng([seed, number]).standard_normal(start.shape)
            start = np.clip(moved, *BOUNDS.T)
        cfa, free = self.numbered(asked.pattern), slice(0, 3 if asked.peaks else 2)
        used = np.unique(cfa)

        def parameters(flat: NDArray[np.float64]) -> NDArray[np.float64]:
            values = start.copy()
            values[:, free] = flat.reshape(len(start), -1) * VARIABLE_UNITS[free]
            return values

        def score(flat: NDArray[np.float64]) -> float:
            problem = self.problem_of(self.tuned_curves(parameters(flat))[used])
            return float(np.log(problem.score(np.searchsorted(used, cfa))))

        bounds = np.tile(BOUNDS[free] / VARIABLE_UNITS[free, None], (len(start), 1))
        begin = (start / VARIABLE_UNITS)[:, free].ravel()
        done = optimize.minimize(score, begin, method="L-BFGS-B", bounds=bounds, options=DESCENT)
        return {"score": np.array(done.fun), "parameters": parameters(done.x)}


@functools.lru_cache(maxsize=1)
def _task(recipe: Path, moments: Path) -> Task:
    """Return the task for a design recipe, cached so that each process reads the files only once."""
    return Task(recipe, moments)


UNITS = {"lab": "ΔE00", "scielab": "ΔE of soft chroma", "luminance": "L*", "linear": "% of white"}
# Number of arrays in a design, in addition to the best Bayer array and the best array at each light level.
LISTED_ARRAYS = 100
SHIFT = 5.0  # shift of a filter in the sensitivity analysis, in nm
DOSES = 10.0 ** np.arange(-2.0, 1.26, 0.25)  # exposures in the plot of error against exposure, in cd s/m²


def designed(task: Task, arrays: Sequence[Cfa], errors: NDArray[np.float64]) -> Design:
    """Rank arrays by their errors, and collect the results in a design.

    Parameters
    ----------
    task : Task
        The task.
    arrays : sequence of ndarray, (row, col)
        The evaluated arrays.
    errors : ndarray, (array, level, group)
        Predicted errors of the arrays.

    Returns
    -------
    Design
        The best LISTED_ARRAYS arrays, the best Bayer array, and the best array at each light level.
    """
    problem, names = task.problem, task.names
    levels = (errors * problem.share).sum(axis=2)
    scores = overall(levels)
    order = np.lexsort((np.arange(len(scores)), np.round(np.log(scores), 9)))
    places = {canonical(cfa): place for place, cfa in enumerate(arrays) if cfa.shape == (2, 2)}

    def best_bayer(filters: Sequence[int]) -> int | None:
        return min((places[canonical(cfa)] for cfa in task.bayer(filters)), key=lambda place: scores[place], default=None)

    best = best_bayer(range(len(names)))
    leaders = [order[0], *([] if best is None else [best]), *levels.argmin(axis=0)]
    listed = [place for place in order.tolist() if place in {*order[:LISTED_ARRAYS].tolist(), *leaders}]
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
    """Compute the relative change in an array's error if the curve of one filter is shifted by SHIFT nm.

    Each filter is shifted in both directions, and the larger change is used.

    Returns
    -------
    ndarray, (filter,)
        Relative change, or 0 for filters that the array does not contain.
    """
    changes, given, grid = np.zeros(len(task.curves)), task.problem.score(cfa), task.scenes.wavelength
    for place in np.unique(cfa):
        for shift in (-SHIFT, SHIFT):
            curves = task.curves.copy()
            curves[place] = np.interp(grid - shift, grid, curves[place])
            changes[place] = max(changes[place], task.problem_of(curves).score(cfa) / given - 1, key=abs)
    return changes
