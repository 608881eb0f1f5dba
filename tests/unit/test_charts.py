"""Charts by name: reflectances that can be, and the colours that the maker states."""

import numpy as np
import pytest

from l3cli.errors import RecipeError
from l3cli.physics import charts, spectra

WAVELENGTH = np.arange(400.0, 721.0, 10.0)


@pytest.mark.parametrize("name", charts.CHARTS)
def test_reflectances_are_a_charts(name: str) -> None:
    patches, reflectance = charts.chart(name, WAVELENGTH)
    assert len(patches) == 24
    assert reflectance.shape == (24, WAVELENGTH.size)
    assert reflectance.min() > 0
    assert reflectance.max() <= 1
    assert (np.diff(reflectance[18:].mean(axis=1)) < 0).all()  # from white to black


def test_dyes_since_2014_have_the_stated_colours() -> None:
    colour = spectra.colour_science()
    stated = colour.CCS_COLOURCHECKERS[charts.SINCE_2014].data.values()
    truth = np.array([colour.xyY_to_XYZ(patch) for patch in stated])
    weights = spectra.xyz_weights(WAVELENGTH) * spectra.illuminant("D50", WAVELENGTH)
    ours = charts.chart("classic 2014", WAVELENGTH)[1] @ weights.T / weights[1].sum()
    np.testing.assert_allclose(ours, truth, atol=2e-3)
    before = charts.chart("classic", WAVELENGTH)[1]
    assert 0.01 < np.abs(charts.chart("classic 2014", WAVELENGTH)[1] / before - 1).max() < 0.5


def test_an_unknown_chart_is_refused_with_the_nearest() -> None:
    with pytest.raises(RecipeError, match='did you mean "passport"'):
        charts.chart("pasport", WAVELENGTH)


@pytest.mark.parametrize("name", ["SG", "ColorChecker SG", "colorchecker digital sg", "semi gloss"])
def test_a_chart_without_published_reflectances_says_how_to_give_them(name: str) -> None:
    """Of ColorChecker SG colour-science has colours under D50 alone; no reflectance is invented for them."""
    colour = spectra.colour_science()
    assert not any("SG" in each for each in colour.SDS_COLOURCHECKERS)
    with pytest.raises(RecipeError, match=r"reflectances are not; give them as CSV .*layout = \[10, 14\]"):
        charts.chart(name, WAVELENGTH)
