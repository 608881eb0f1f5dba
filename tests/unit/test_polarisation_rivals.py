"""Rivals of polarisation tables: samples are preserved, and uniform light is reproduced exactly."""

import importlib
from types import ModuleType

import numpy as np
import pytest

from l3cli.physics.mosaic import tiled
from tests.helpers.paths import ROOT

MONO = np.array([[0, 1], [2, 3]], np.uint8)
COLOUR = np.array([[0, 1, 4, 5], [2, 3, 6, 7], [4, 5, 8, 9], [6, 7, 10, 11]], np.uint8)
SIDE = 48


@pytest.fixture
def rivals(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    monkeypatch.syspath_prepend(str(ROOT / "docs/peers"))
    return importlib.import_module("polarisation_rivals")


@pytest.mark.parametrize("cfa", [MONO, COLOUR], ids=["monochrome", "colour"])
@pytest.mark.parametrize("name", ["newton", "igri"])
def test_uniform_polarised_light_is_reproduced(rivals: ModuleType, name: str, cfa: np.ndarray) -> None:
    level = np.linspace(0.2, 0.8, int(cfa.max()) + 1)
    planes = getattr(rivals, name)(level[tiled(cfa, (SIDE, SIDE))], cfa)
    np.testing.assert_allclose(planes, np.broadcast_to(level[:, None, None], planes.shape), atol=1e-6)


@pytest.mark.parametrize("name", ["newton", "igri"])
def test_samples_are_kept(rivals: ModuleType, name: str) -> None:
    mosaic, channel = np.random.default_rng(1).random((SIDE, SIDE)), tiled(MONO, (SIDE, SIDE))
    planes = getattr(rivals, name)(mosaic, MONO)
    np.testing.assert_allclose(np.take_along_axis(planes, channel[None].astype(int), 0)[0], mosaic, atol=1e-9)


def test_newton_reproduces_a_cubic_along_a_row(rivals: ModuleType) -> None:
    """The channels differ by a constant, which is the model of the method."""
    place = np.arange(SIDE) / SIDE
    full = np.broadcast_to((place**3 - place)[None], (SIDE, SIDE)) + np.array([0.1, 0.2, 0.3, 0.4])[:, None, None]
    mosaic = np.take_along_axis(full, tiled(MONO, (SIDE, SIDE))[None].astype(int), 0)[0]
    inside = (slice(None), slice(20, 28), slice(20, 28))
    np.testing.assert_allclose(rivals.newton(mosaic, MONO)[inside], full[inside], atol=2e-4)


def test_lmmse_reproduces_the_scene_on_which_it_is_trained(rivals: ModuleType) -> None:
    """If every channel is a multiple of one smooth image, the samples of a site determine all channels."""
    rows, cols = np.mgrid[:SIDE, :SIDE] / SIDE
    scene = np.array([1.0, 0.8, 0.6, 0.4])[:, None, None] * (1 + np.sin(2 * rows + 3 * cols))
    mosaic = np.take_along_axis(scene, tiled(MONO, (SIDE, SIDE))[None].astype(int), 0)[0]
    np.testing.assert_allclose(rivals.lmmse(scene, mosaic, mosaic, MONO)[:, 8:-8, 8:-8], scene[:, 8:-8, 8:-8], atol=1e-3)
