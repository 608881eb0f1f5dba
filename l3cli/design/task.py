"""A design recipe with all that it names, and its arrays."""

import dataclasses
import functools
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.camera import CameraModel
from l3cli.artifacts.design import LightMoments, SceneMoments
from l3cli.artifacts.store import load
from l3cli.design.error import Cfa, Level, noise_of, seen_by, wanted_outputs
from l3cli.design.pixel import pixel_of
from l3cli.design.recipe import (
    DesignRecipe,
    PatternRecipe,
    bare_efficiency,
    design_faults,
    filter_curves,
    level_name,
    shown,
    sites_of,
    tuned_filters,
)
from l3cli.design.search import Problem, bayer_arrays, canonical, every_array, independent_outputs
from l3cli.design.tuning import Tuning
from l3cli.errors import InputFileError, RecipeError, listed
from l3cli.recipes.faults import refuse_first
from l3cli.recipes.toml import load_recipe

SAME = 1e-6  # relative; of numbers that agree


@dataclasses.dataclass(frozen=True)
class Task:
    """A design recipe with all that it names, as every process can make it again."""

    recipe: Path
    moments: Path

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
    def centres(self) -> NDArray[np.float64]:
        """Return the centroid (filter) in nm of what each passes."""
        return np.asarray(self.curves @ self.scenes.wavelength / self.curves.sum(axis=1))

    @functools.cached_property
    def levels(self) -> tuple[Level, ...]:
        lights = [light.illuminant for light in self.scenes.light]
        levels = []
        for one in self.wanted.level:
            if one.illuminant not in lights:
                known = f"{self.moments} holds moments under {', '.join(lights)}"
                raise RecipeError(f'level "{level_name(one)}": {known}; gather them under {one.illuminant}')
            luminance = one.lux / np.pi if one.lux is not None else one.luminance_cd_m2 or 100.0
            place = lights.index(one.illuminant)
            levels.append(Level(level_name(one), place, one.share, luminance, one.exposure_s or 0.0))
        return tuple(levels)

    @functools.cached_property
    def tuning(self) -> Tuning:
        """Return the array whose filters are tuned."""
        wanted, asked, wavelength = self.wanted, self.wanted.optimise, self.scenes.wavelength
        assert asked is not None
        tuned = tuned_filters(asked, wanted.filters)
        given = [wanted.filters[name] for name in tuned]
        return Tuning(
            lights=self.scenes.light,
            wanted=[wanted_outputs(wanted.output, wanted.counts, light, self.curves) for light in self.scenes.light],
            levels=self.levels,
            noise=noise_of(self.pixel),
            cfa=self.numbered(asked.pattern),
            curves=self.curves,
            wavelength=wavelength,
            bare=bare_efficiency(wanted.pixel.bare, wavelength, self.recipe.parent),
            tuned=[self.names.index(name) for name in tuned],
            given=np.array([[one.centre_nm, one.sigma_nm, one.peak] for one in given], np.float64),
            floors=[one.floor for one in given],
            peaks=asked.peaks,
        )

    @functools.cached_property
    def problem(self) -> Problem:
        return self.problem_of(self.curves)

    def problem_of(self, curves: NDArray[np.float64]) -> Problem:
        """Return the problem with other filters."""
        wanted, used = self.wanted, {level.light for level in self.levels}
        lights: Sequence[LightMoments] = self.scenes.light
        seen = tuple(
            seen_by(light, curves, wanted_outputs(wanted.output, wanted.counts, light, self.curves))
            for number, light in enumerate(lights)
            if number in used
        )
        order = sorted(used)
        levels = tuple(dataclasses.replace(level, light=order.index(level.light)) for level in self.levels)
        return Problem(seen, levels, noise_of(self.pixel))

    def allowed(self, filters: Sequence[int]) -> bool:
        """Return whether an array of these filters has as many independent outputs as are needed."""
        responses = self.curves[list(filters)] @ self.scenes.light[0].basis
        return len(filters) >= self.wanted.needed and independent_outputs(responses) >= self.wanted.needed

    def numbered(self, rows: list[str]) -> Cfa:
        """Return an array of names as numbers of filters."""
        return np.array([[self.names.index(name) for name in row] for row in sites_of(rows)])

    def filters_of(self, pattern: PatternRecipe) -> list[int]:
        """Return the filters that may stand in a pattern."""
        return [self.names.index(name) for name in (pattern.counts or pattern.filters or self.names)]

    def arrays_of(self, pattern: PatternRecipe, number: int) -> list[Cfa] | None:
        """Return the arrays of a pattern that are judged; None: there are too many, and they are annealed. RecipeError if
        none has as many independent outputs as are needed."""
        needed, where = self.wanted.needed, f"{self.recipe}: pattern {number + 1}"
        if pattern.shape is None:
            listed_arrays = [self.numbered(rows) for rows in pattern.arrays]
            if wrong := [cfa for cfa in listed_arrays if not self.allowed(np.unique(cfa).tolist())]:
                shortage = listed(shown(cfa, self.names) for cfa in wrong)
                raise RecipeError(f"{where}: {shortage} has fewer than {needed} independent outputs; add a filter")
            return listed_arrays
        filters = self.filters_of(pattern)
        if not self.allowed(filters):
            raise RecipeError(f"{where}: its filters have fewer than {needed} independent outputs; add one")
        counts = list(pattern.counts.values()) if pattern.counts else None
        every = every_array(pattern.shape, filters, counts, self.allowed)
        if every == []:
            raise RecipeError(f"{where}: no array of that shape has {needed} independent outputs; make it larger")
        return every

    def best_bayer(self, filters: Sequence[int], places: dict[bytes, int], scores: NDArray[np.float64]) -> int | None:
        """Return the place of the best Bayer array of some filters; None: there is none."""
        keys = map(canonical, bayer_arrays(filters, self.centres))
        return min((places[key] for key in keys if key in places), key=lambda place: scores[place], default=None)

    def require_same_pixel(self) -> None:
        """Raise InputFileError if the moments are of another lens or pixel."""
        pixel, scenes = self.pixel, self.scenes
        for what, unit, ours, theirs in (
            ("pixels", "µm", pixel.pixel_pitch * 1e6, scenes.pixel_pitch * 1e6),
            ("f-number", "", pixel.optics.f_number, scenes.f_number),
        ):
            if abs(ours - theirs) > SAME * ours:
                given = f"{what} of {theirs:g} {unit}".strip()
                raise InputFileError(
                    f"{self.moments} is of {given}, the design of {ours:g}; gather moments with ‹camera› {self.recipe}"
                )
