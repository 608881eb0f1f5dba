"""What is shown: whites, the sRGB curve, automatic exposure, orientation."""

import numpy as np
import pytest

from l3cli.errors import RecipeError
from l3cli.frames.frame import RawFrame, upright
from l3cli.physics import spectra
from l3cli.physics.display import (
    exposure_scale,
    scene_white,
    srgb_codes,
    srgb_decoded,
    srgb_from_xyz_matrix,
    white_percentile,
    xyz_from_srgb_matrix,
)
from l3cli.rendering.display import Display, encode, make_display, require_xyz
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
    np.testing.assert_allclose(xyz_from_srgb_matrix() @ srgb_from_xyz_matrix(), np.eye(3), atol=1e-12)


def test_known_colour_in_srgb() -> None:
    """CIE XYZ of sRGB red, IEC 61966-2-1."""
    picture = encode(np.array([0.4124, 0.2126, 0.0193]).reshape(3, 1, 1), make_display(spectra.white_point("D65"), 1.0, 8))
    assert np.abs(picture[0, 0].astype(int) - [255, 0, 0]).max() <= 1


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
        with pytest.raises(RecipeError, match="X, Y, Z"):
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
        assert white_percentile(values) == float(np.percentile(values, 99))
    assert np.isnan(white_percentile(np.array([np.nan, *range(500)], kind)))
