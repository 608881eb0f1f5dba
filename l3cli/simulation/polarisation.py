"""Polarisation of dead leaves, for cameras with polarisers (docs/method.md#polarised-scenes).

Each leaf has one of five kinds of surface, in the proportions SHARES. The kinds differ in the degree and the angle of linear
polarisation:

matt       weakly polarised, with an angle that changes little over the leaf
smooth     reflections from a curved dielectric: the degree follows from Fresnel's equations, the angle from the curvature
flat       reflections from a plane such as a window, with nearly constant degree and angle
sky        a degree that increases linearly across the leaf, as in the sky
plastic    transparent, birefringent plastic in polarised light, with a degree and angle that depend on the wavelength

Metals are smooth leaves with a low degree.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from l3cli.simulation.leaves import Leaves

Floats = NDArray[np.float32]

MATT, SMOOTH, FLAT, SKY, PLASTIC = range(5)
SHARES = (0.64, 0.18, 0.10, 0.05, 0.03)  # fraction of the leaves with each kind of surface
NODES = np.array([450.0, 550.0, 650.0])  # nm; wavelengths at which polarisation is computed
INDEX = 1.5  # refractive index of smooth surfaces
MAX_DEGREE = 0.95
MATT_DEGREE = 0.1  # largest degree of matt leaves
# Fraction of the leaves whose polarisation is drawn separately for each wavelength of NODES. Real surfaces reflect light
# from several sources, such as sky and sun, whose colours and angles of polarisation differ. If most leaves were polarised
# equally at all wavelengths, a table of a colour camera would infer the polarisation of one colour from the pixels of the
# other colours.
COLOURED = 0.8
CALM = 0.2  # fraction of scenes with weak polarisation, and also the factor that reduces their degrees of polarisation
RIM = 0.98  # limit of the sine of the angle of incidence near the rim of smooth leaves


@dataclass(frozen=True)
class Sheen:
    """Polarisation of each leaf. Positions on a leaf are in leaf radii from its centre."""

    kind: NDArray[np.intp]  # (leaf) MATT, SMOOTH, FLAT, SKY or PLASTIC
    degree: Floats  # (leaf) degree of polarisation, or its largest value on the leaf
    angle: Floats  # (leaf) angle of polarisation at the centre, in radians
    # (2, leaf) vertical and horizontal change of the angle per leaf radius; for SKY, direction of increasing degree
    slope: Floats
    # (leaf) exponent p with degree ∝ brightness^-p; 1 if all polarised light is reflected at the surface itself
    albedo_power: Floats
    colour: NDArray[np.complex64]  # (node, leaf) factor of S1 + i S2 at each wavelength of NODES; not used for PLASTIC
    # (3, leaf) in cycles at 550 nm: value at the centre, vertical and horizontal change per leaf radius
    retardance: Floats


def draw_sheen(rng: np.random.Generator, count: int) -> Sheen:
    """Draw the polarisation of `count` leaves."""
    kind = rng.choice(len(SHARES), count, p=SHARES)
    strong, metal = rng.uniform(0.05, MAX_DEGREE, count), rng.random(count) < 0.3
    strong = np.where(metal & (kind == SMOOTH), 0.35 * strong, strong)
    degree = np.where(kind == MATT, MATT_DEGREE * rng.random(count) ** 2, strong)
    calm = CALM if rng.random() < CALM else 1.0
    angle, slope = rng.uniform(0, np.pi, count), 0.25 * rng.standard_normal((2, count))
    albedo_power = rng.random(count)
    coloured, drawn = rng.random(count) < COLOURED, rng.standard_normal((2, NODES.size, count))
    return Sheen(
        kind=kind,
        degree=(calm * degree).astype(np.float32),
        angle=angle.astype(np.float32),
        slope=slope.astype(np.float32),
        albedo_power=albedo_power.astype(np.float32),
        colour=np.where(coloured, drawn[0] + 1j * drawn[1], 1).astype(np.complex64),
        retardance=rng.normal(0.0, 1.0, (3, count)).astype(np.float32),
    )


def fresnel_degree(sine: Floats) -> Floats:
    """Return the degree of polarisation of light reflected by a dielectric, from the sine of the angle of incidence."""
    cosine = np.sqrt(1 - sine**2)
    refracted = np.sqrt(1 - (sine / INDEX) ** 2)
    across = ((cosine - INDEX * refracted) / (cosine + INDEX * refracted)) ** 2
    along = ((INDEX * cosine - refracted) / (INDEX * cosine + refracted)) ** 2
    return np.asarray((across - along) / (across + along), np.float32)


def stokes_of(
    sheen: Sheen, cover: Leaves, label: NDArray[np.intp], place: tuple[NDArray, NDArray], shade: Floats
) -> tuple[Floats, Floats]:
    """Compute the Stokes ratios S1/S0 and S2/S0 of each sample of a scene.

    Parameters
    ----------
    sheen : Sheen
        Polarisation of each leaf.
    cover : Leaves
        Position and radius of each leaf.
    label : ndarray, (row, col)
        Index of the leaf at each sample.
    place : tuple of ndarray
        Row (row, 1) and column (col,) of the samples.
    shade : ndarray, (row, col)
        Natural logarithm of each sample's brightness, relative to the mean of its leaf.

    Returns
    -------
    tuple of ndarray, (row, col, node)
        The ratios at the wavelengths NODES.
    """

    def of(values: NDArray) -> NDArray:
        return np.take(values, label)

    radius, kind = of(cover.radius), of(sheen.kind)
    down, across = (place[0] - of(cover.row)) / radius, (place[1] - of(cover.col)) / radius
    along = of(sheen.slope[0]) * down + of(sheen.slope[1]) * across
    angle = 2 * (of(sheen.angle) + np.where(kind == SKY, 0, along))
    first, second = np.cos(angle), np.sin(angle)
    degree = of(sheen.degree) * np.exp(-of(sheen.albedo_power) * np.clip(shade, -1.5, 1.5))
    degree *= np.where(kind == SKY, np.clip(0.5 + 2 * along, 0, 1), 1)
    curved = np.nonzero(kind == SMOOTH)
    v, u = down[curved], across[curved]
    square = np.maximum(u * u + v * v, np.float32(1e-12))
    # Reflected light is polarised perpendicular to the plane of incidence, which contains the direction to the leaf's
    # centre.
    first[curved], second[curved] = (v * v - u * u) / square, 2 * u * v / square
    degree[curved] *= fresnel_degree(np.minimum(np.sqrt(square), np.float32(RIM)))
    degree = np.minimum(degree, np.float32(MAX_DEGREE))
    light = (degree * (first + 1j * second))[..., None] * np.moveaxis(np.take(sheen.colour, label, axis=1), 0, -1)
    light *= np.minimum(1, MAX_DEGREE / np.maximum(np.abs(light), np.float32(1e-6)))
    one, two = light.real, light.imag
    clear = np.nonzero(kind == PLASTIC)
    if clear[0].size:
        leaf = label[clear]
        cycles = (
            sheen.retardance[0][leaf] + sheen.retardance[1][leaf] * down[clear] + sheen.retardance[2][leaf] * across[clear]
        )
        axis = (angle[clear] - 2 * sheen.angle[leaf])[:, None]  # twice the angle of the slowly varying fast axis
        source = 2 * sheen.angle[leaf][:, None]  # twice the angle of the polarised light behind the plastic
        # Retardance preserves the Stokes component along the fast axis and converts the other one partly to circular light.
        kept = np.cos(source - axis)
        turned = np.sin(source - axis) * np.cos(2 * np.pi * cycles[:, None] * (550.0 / NODES))
        strength = np.minimum(sheen.degree[leaf], np.float32(MAX_DEGREE))[:, None]
        one[clear] = strength * (kept * np.cos(axis) - turned * np.sin(axis))
        two[clear] = strength * (kept * np.sin(axis) + turned * np.cos(axis))
    return one.astype(np.float32), two.astype(np.float32)
