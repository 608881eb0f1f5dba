"""Filters of one array tuned: centres, widths and heights of Gaussians, by the gradient of the error in closed form
(docs/method.md#designs).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.design import LightMoments
from l3cli.design.error import EMPTY, NOTHING, RIDGE, Cfa, Level, Noise, Wanted, exposure, site_filters
from l3cli.design.moments import SIDE
from l3cli.design.recipe import gaussian

Array = NDArray[np.float64]

CENTRES, SIGMAS, LEAST_PEAK = (400.0, 700.0), (10.0, 150.0), 0.1  # nm, nm, 1
STEPS = np.array([10.0, 10.0, 0.1])  # nm, nm, 1: by which parameters are scaled
SPREAD = np.array([25.0, 15.0, 0.0])  # nm, nm, 1: of random starts about the given filters
ITERATIONS = 60


def error_gradient(
    light: LightMoments, wanted: Wanted, curves: Array, cfa: Cfa, noise: Noise, level: Level
) -> tuple[float, Array]:
    """Return the error of an array, over all groups, and its gradient (filter, wavelength) by quantum efficiencies."""
    taps, terms, base = SIDE**2, light.terms, curves @ light.basis
    number = np.maximum(light.patches, 1.0)
    moment = light.moment[wanted.weighting] / number[:, None, None]
    inner = moment[:, : taps * terms, : taps * terms].reshape(-1, taps, terms, taps, terms)
    targets = (wanted.rows @ moment[:, taps * terms :, : taps * terms]).reshape(len(moment), -1, taps, terms)
    square = np.einsum("yi,Kij,yj->K", wanted.rows, moment[:, taps * terms :, taps * terms :], wanted.rows, optimize=True)
    means = (light.mean[wanted.weighting] / number[:, None]).reshape(-1, taps, terms)
    weight = (light.weight[wanted.weighting] / number)[:, None]
    white = curves @ light.white_photons
    brightest = max(np.unique(cfa).tolist(), key=lambda each: float(white[each]))
    dose, seconds = exposure(level, noise, float(white[brightest]))
    dark = noise.dark / level.luminance if level.share is not None else 0.0  # e- a cd s/m²
    floor = noise.floor + noise.dark * seconds
    total, by_base, by_dose = 0.0, np.zeros_like(base), 0.0
    sites = site_filters(cfa)
    diagonal, each = np.eye(taps, dtype=bool), np.arange(taps)
    for filters in sites:
        tap = base[filters]
        half = np.einsum("pi,Kpiqj->Kpqj", tap, inner, optimize=True)
        matrix, own = np.einsum("Kpqj,qj->Kpq", half, tap), half[:, each, each]
        power, mean = np.einsum("Kpp->Kp", matrix), np.einsum("Kpj,pj->Kp", means, tap)
        clipped = mean / np.maximum(weight, 1e-12) * dose > noise.full
        ridge = RIDGE * power.mean(axis=1, keepdims=True)
        variance = floor * weight / dose**2 + mean / dose + noise.prnu**2 * power + ridge
        noisy = matrix + EMPTY * (light.patches == 0)[:, None, None] * diagonal
        noisy[:, diagonal] += np.where(clipped, NOTHING * power, variance)
        cross = np.einsum("Kyqj,qj->Kqy", targets, tap)
        solved = np.linalg.solve(noisy, cross)  # (group, tap, output)
        error = np.sqrt(np.maximum(square - np.einsum("Kqy,Kqy->K", cross, solved), 1e-12))
        total += float(light.share @ error) / len(sites)
        slope = light.share / (2 * error * len(sites))
        loud = np.square(solved).sum(axis=2)  # (group, tap)
        free = np.where(clipped, 0.0, loud)
        gradient = 2 * np.einsum("Kpy,Kqy,Kpqj->Kqj", solved, solved, half, optimize=True)
        gradient -= 2 * np.einsum("Kqy,Kyqj->Kqj", solved, targets)
        gradient += free[..., None] * means / dose
        twice = noise.prnu**2 * free + NOTHING * np.where(clipped, loud, 0.0) + RIDGE * free.mean(axis=1, keepdims=True)
        gradient += 2 * twice[..., None] * own
        np.add.at(by_base, filters, np.einsum("K,Kqj->qj", slope, gradient))
        fall = 2 * noise.floor * weight / dose**3 + mean / dose**2 + dark * weight / dose**2
        if level.share is not None:
            by_dose -= float(slope @ (free * fall).sum(axis=1))
    by_curve = by_base @ light.basis.T
    if level.share is not None:  # dose = share · full / white
        by_curve[brightest] -= by_dose * dose / white[brightest] * light.white_photons
    return total, by_curve


@dataclass(frozen=True)
class Tuning:
    """The filters of an array that are tuned, and what it is judged by."""

    lights: Sequence[LightMoments]
    wanted: Sequence[Wanted]  # of each light
    levels: Sequence[Level]
    noise: Noise
    cfa: Cfa
    curves: Array  # (filter, wavelength) quantum efficiencies as given
    wavelength: Array
    bare: Array  # (wavelength) quantum efficiency without a filter
    tuned: Sequence[int]  # filters
    given: Array  # (tuned filter, 3) centre, sigma and peak
    floors: Sequence[float]  # of their transmittances
    peaks: bool  # whether heights are tuned too

    def curves_of(self, parameters: Array) -> Array:
        """Return the quantum efficiencies (filter, wavelength) with such centres, sigmas and peaks (tuned filter, 3)."""
        curves = self.curves.copy()
        for place, (centre, sigma, peak), floor in zip(self.tuned, parameters, self.floors, strict=True):
            curves[place] = self.bare * gaussian(self.wavelength, centre, sigma, peak, floor)
        return curves

    def score(self, parameters: Array) -> tuple[float, Array]:
        """Return the mean, over levels, of the error's logarithm, and its gradient (tuned filter, 3)."""
        curves, total, by_curve = self.curves_of(parameters), 0.0, np.zeros_like(self.curves)
        for level in self.levels:
            light, wanted = self.lights[level.light], self.wanted[level.light]
            error, gradient = error_gradient(light, wanted, curves, self.cfa, self.noise, level)
            total += float(np.log(error)) / len(self.levels)
            by_curve += gradient / error / len(self.levels)
        slopes = np.zeros_like(parameters)
        for row, (place, (centre, sigma, peak), floor) in enumerate(zip(self.tuned, parameters, self.floors, strict=True)):
            off = (self.wavelength - centre) / sigma
            bell = self.bare * np.exp(-0.5 * off**2)
            height = peak - floor
            shapes = np.array([height * bell * off / sigma, height * bell * off**2 / sigma, bell])
            slopes[row] = shapes @ by_curve[place]
        return total, slopes

    def descend(self, start: Array) -> tuple[float, Array]:
        """Return the least score that a start (tuned filter, 3) leads to within bounds, and its parameters."""
        from scipy import optimize

        free = slice(0, 3 if self.peaks else 2)

        def by_steps(flat: Array) -> tuple[float, Array]:
            parameters = start.copy()
            parameters[:, free] = flat.reshape(len(start), -1) * STEPS[free]
            score, slopes = self.score(parameters)
            return score, (slopes * STEPS)[:, free].ravel()

        bounds = [CENTRES, SIGMAS, (LEAST_PEAK, 1.0)][free] * len(start)
        scaled = np.array(bounds) / np.tile(STEPS[free], len(start))[:, None]
        begin, most = (start / STEPS)[:, free].ravel(), {"maxiter": ITERATIONS}
        done = optimize.minimize(by_steps, begin, jac=True, method="L-BFGS-B", bounds=scaled, options=most)
        best = start.copy()
        best[:, free] = done.x.reshape(len(start), -1) * STEPS[free]
        return float(done.fun), best


def random_start(given: Array, rng: np.random.Generator) -> Array:
    """Return centres, sigmas and peaks (tuned filter, 3) about the given ones."""
    moved = given + SPREAD * rng.standard_normal(given.shape)
    return np.clip(moved, [CENTRES[0], SIGMAS[0], LEAST_PEAK], [CENTRES[1], SIGMAS[1], 1.0])
