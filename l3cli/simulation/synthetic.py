"""The scenes that need no file: which function draws which source."""

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from l3cli.frames.scene import NO_ILLUMINANT, Scene
from l3cli.physics.spectra import COLORCHECKER_WAVELENGTH
from l3cli.simulation import charts, procedural, sources

Wavelength = NDArray[np.float64]
Painter = Callable[[Any, np.random.Generator, Wavelength], NDArray[np.float32]]

PAINTERS: dict[type, Painter] = {
    sources.DeadLeaves: lambda s, rng, nm: procedural.dead_leaves(rng, s.size, nm, s.patterned),
    sources.Composition: lambda s, rng, nm: procedural.composition(rng, s.size, nm),
    sources.Skin: lambda s, rng, nm: charts.material_patches("skin", rng, s.patches, s.size, nm),
    sources.Foliage: lambda s, rng, nm: charts.material_patches("leaf", rng, s.patches, s.size, nm),
    sources.Surfaces: lambda s, rng, nm: charts.surface_patches(rng, s.patches, s.size, nm),
    sources.ColorChecker: lambda s, rng, nm: charts.colorchecker(s.size, nm),
    sources.Munsell: lambda s, rng, nm: charts.munsell(s.size, nm),
    sources.SlantedEdge: lambda s, rng, nm: charts.slanted_edge(s.size, nm, s.angle_deg, s.dark, s.bright),
    sources.ZonePlate: lambda s, rng, nm: charts.zone_plate(s.size, nm, s.highest),
    sources.Frequencies: lambda s, rng, nm: charts.frequencies(s.size, nm, s.orders),
    sources.GreyRamp: lambda s, rng, nm: charts.grey_ramp(s.size, nm, s.octaves),
}


def draw(wanted: sources.WantedScene, seed: int, camera_wavelength: Wavelength) -> Scene:
    """Return the scene `wanted` for a camera that sees `camera_wavelength`: the same for the same `seed`.

    The ColorChecker lies on the wavelengths where it was measured, everything else on procedural.grid.
    """
    source = wanted.source
    measured = isinstance(source, sources.ColorChecker)
    wavelength = COLORCHECKER_WAVELENGTH if measured else procedural.grid(camera_wavelength)
    rng = np.random.default_rng([seed, getattr(source, "seed", 0), wanted.number])
    return Scene(wanted.name, wavelength, PAINTERS[type(source)](source, rng, wavelength), NO_ILLUMINANT)
