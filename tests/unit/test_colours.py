"""Colours: white points, transfer curves, exposure and orientation of pictures, charts and illuminants, colour matrices."""

import re

import numpy as np
import pytest

from l3cli.errors import RecipeError
from l3cli.frames.frame import RawFrame, upright
from l3cli.physics import charts, spectra
from l3cli.physics.display import (
    SRGB_FROM_XYZ,
    delta_e_2000,
    exposure_scale,
    fit_through,
    lab,
    refinement,
    scene_white,
    srgb_codes,
    srgb_decoded,
    white_percentile,
    xyz_from_srgb_matrix,
)
from l3cli.physics.spaces import BT2020_CURVE, SRGB_CURVE, Curve
from l3cli.rendering.display import Display, encode, make_display, require_xyz
from l3cli.rendering.opencl.layout import _literal, curve_pieces
from l3cli.rendering.renderer import BACKENDS, make_renderer
from tests.helpers.cameras import BAYER
from tests.helpers.tables import random_table


def test_scene_white_is_shown_neutral_and_full() -> None:
    white = spectra.white_point("A")
    for bits in (8, 16):
        picture = encode(white[:, None, None], make_display(white, 1.0, bits))
        assert picture.tolist() == [[[2**bits - 1] * 3]]


def test_srgb_curve_at_known_values() -> None:
    linear = np.array([0.0, 0.002, 0.0031308, 0.18, 0.5, 1.0, 1.5, -1.0])
    picture = encode(np.stack([linear[None]] * 3), Display(np.eye(3), 8))
    assert picture[0, :, 0].tolist() == [0, 7, 10, 118, 188, 255, 255, 0]


def test_srgb_and_its_inverse() -> None:
    codes = np.arange(256)
    assert srgb_codes(srgb_decoded(codes / 255)).tolist() == codes.tolist()
    np.testing.assert_allclose(xyz_from_srgb_matrix() @ SRGB_FROM_XYZ, np.eye(3), atol=1e-12)


def test_automatic_exposure_maps_the_99th_percentile_to_white() -> None:
    luminance = np.linspace(0, 2, 101)[None]
    assert exposure_scale(luminance) == pytest.approx(1 / 1.98)
    assert exposure_scale(np.zeros((2, 2))) == 1.0


def test_scene_white_by_name_and_chromaticity() -> None:
    np.testing.assert_allclose(scene_white("0.25,0.5"), [0.5, 1.0, 0.5])
    np.testing.assert_allclose(scene_white("D65"), spectra.white_point("D65"))
    for wrong in ("0.3,", "0.3,0.8", "0,0.3", "moonlight"):
        with pytest.raises(RecipeError, match=r"white|illuminant"):
            scene_white(wrong)


def test_pictures_need_xyz() -> None:
    with pytest.raises(RecipeError, match=r"\.exr"):
        require_xyz(("r", "g", "b"))
    table = random_table(BAYER, outputs=("Y",))
    frame = RawFrame("f", np.zeros((2, 2), np.uint16), table.black_level, table.white_level)
    for backend in BACKENDS:
        with pytest.raises(RecipeError, match="X, Y and Z"):
            make_renderer(backend, table).picture(frame, Display(np.eye(3), 8))


def test_upright_turns_as_libraw_does() -> None:
    pixels = np.array([[1, 2, 3], [4, 5, 6]])
    assert upright(pixels, 3).tolist() == [[6, 5, 4], [3, 2, 1]]
    assert upright(pixels, 5).tolist() == np.rot90(pixels).tolist() == [[3, 6], [2, 5], [1, 4]]
    assert upright(pixels, 6).tolist() == np.rot90(pixels, -1).tolist() == [[4, 1], [5, 2], [6, 3]]


@pytest.mark.parametrize("kind", [np.float32, np.float64])
def test_the_percentile_shown_white_is_numpys(kind: type) -> None:
    rng = np.random.default_rng(0)
    for size in (1, 2, 50, 51, 99, 100, 101, 102, 199, *rng.integers(1, 20000, 100).tolist()):
        values: np.ndarray = rng.gamma(1.0, size=(size, 1)).astype(kind)
        exact = np.percentile(values.astype(np.float64), 99)  # of float32, versions of numpy round it differently
        assert white_percentile(values) == (exact if kind is np.float64 else pytest.approx(exact, rel=3e-7))
    assert np.isnan(white_percentile(np.array([np.nan, *range(500)], kind)))


@pytest.mark.parametrize("curve", [SRGB_CURVE, BT2020_CURVE])
def test_parabolas_follow_the_curve(curve: Curve) -> None:
    """What encoding.cl does with them, in float32."""
    macros = curve_pieces(curve, 255)
    terms = np.array([term.rstrip("f") for term in str(macros["CURVE_PIECES"]).split(",")], np.float32).reshape(3, 32)
    share, start, end = np.float32(str(macros["CURVE_SHARE"])[:-1]), np.float32(2**-8), np.float32(1 - 2**-24)
    linear = np.linspace(-0.1, 1.1, 1_000_001).astype(np.float32)
    u = np.clip(linear * share + start, start, end)
    piece = u.view(np.int32) >> 21 & 31
    codes = (terms[2][piece] * u + terms[1][piece]) * u + terms[0][piece]
    expected = 255 * curve.encoded(linear.astype(np.float64)) + 0.5
    assert np.abs(codes - expected).max() < 3e-5 * 255
    assert (codes.min(), codes.max()) == (pytest.approx(0.5, abs=1e-6), pytest.approx(255.5, abs=0.01))
    assert codes.max() < 256
    assert np.mean(codes.astype(int) != expected.astype(int)) < 0.002


@pytest.mark.parametrize("value", [0.0, 1.0, -1.0, 4.5, 1e-12, -266132.977])
def test_numbers_are_literals_of_single_precision(value: float) -> None:
    """OpenCL C has no 0f: fits give whole numbers on some machines."""
    assert re.fullmatch(r"-?\d\.\d+e[+-]\d+f", _literal(value))
    assert np.float32(_literal(value)[:-1]) == np.float32(value)


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
def test_a_chart_without_published_reflectances_states_how_to_give_them(name: str) -> None:
    """Of ColorChecker SG colour-science has colours under D50 alone; no reflectance is invented for them."""
    colour = spectra.colour_science()
    assert not any("SG" in each for each in colour.SDS_COLOURCHECKERS)
    with pytest.raises(RecipeError, match=r"the reflectances of this chart are not published.*layout = \[10, 14\]"):
        charts.chart(name, WAVELENGTH)


COARSE = np.arange(400.0, 701.0, 20.0)


@pytest.mark.parametrize(
    ("name", "cure"),
    [
        ("d65", 'did you mean "D65"'),
        ("LED B3", '"LED-B3"'),
        ("tungsten", "common illuminants are A,"),
        ("x" * 500, "common illuminants are A,"),
    ],
)
def test_an_unknown_light_is_one_short_line(name: str, cure: str) -> None:
    with pytest.raises(RecipeError, match="is unknown") as caught:
        spectra.illuminant(name, COARSE)
    line = str(caught.value)
    assert cure in line
    assert len(line) < 220
    assert f'the documentation lists all {len(spectra.illuminant_names())} ("Illuminants")' in line


VISIBLE = np.arange(400.0, 701.0, 10.0)
LIBRARY = spectra.reflectance_library(VISIBLE)[::4]
LIGHT = spectra.illuminant("D65", VISIBLE)
TO_XYZ = spectra.xyz_weights(VISIBLE) * LIGHT
WHITE = TO_XYZ.sum(axis=1) / TO_XYZ[1].sum()
XYZ = LIBRARY @ TO_XYZ.T / TO_XYZ[1].sum()


def channels(count: int) -> np.ndarray:
    """Of the surfaces (surface, channel) in Gaussian bands, a white's 1."""
    centres = np.linspace(440.0, 620.0, count)[:, None]
    weights = np.exp(-0.5 * ((VISIBLE - centres) / 35.0) ** 2) * LIGHT
    return np.asarray(LIBRARY @ weights.T / weights.sum(axis=1))


@pytest.mark.parametrize("count", [3, 4, 9])
def test_the_white_is_met_and_colours_get_nearer(count: int) -> None:
    seen = channels(count)
    start = fit_through(seen, XYZ, np.ones(count), WHITE, 1e-4)
    np.testing.assert_allclose(start.sum(axis=1), WHITE, rtol=1e-9)
    ours = refinement(seen @ start.T, XYZ, WHITE)
    np.testing.assert_allclose(ours @ WHITE, WHITE, rtol=1e-9)
    before, after = (delta_e_2000(lab(seen @ m.T, WHITE), lab(XYZ, WHITE)) for m in (start, ours @ start))
    assert np.square(after).mean() < np.square(before).mean() - 1e-4


def test_a_camera_that_sees_as_the_eye_is_found_exactly() -> None:
    truth = np.array([[0.9, 0.2, -0.1], [-0.3, 1.2, 0.1], [0.0, 0.1, 0.8]])
    found = fit_through(XYZ @ truth.T, XYZ, truth @ WHITE, WHITE)
    np.testing.assert_allclose(found, np.linalg.inv(truth), atol=1e-9)
    np.testing.assert_allclose(refinement(XYZ, XYZ, WHITE), np.eye(3), atol=1e-6)


def test_noise_is_not_amplified() -> None:
    """Nine smooth channels say little more than four: without a word of noise large weights of either sign cancel."""
    seen = channels(9)
    free, stored = (fit_through(seen, XYZ, np.ones(9), WHITE, noise) for noise in (0.0, 1e-3))
    assert np.abs(stored).sum() < 0.2 * np.abs(free).sum()
