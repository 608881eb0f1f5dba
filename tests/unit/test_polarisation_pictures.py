"""Files and pictures of Stokes parameters."""

from dataclasses import replace

import numpy as np
import pytest

from l3cli.artifacts.table import TransformTable
from l3cli.frames.frame import RawFrame, upright
from l3cli.physics.polarisation_colours import VIRIDIS
from l3cli.physics.stokes import STOKES, aolp, behind, dolp
from l3cli.rendering.opencl.renderer import OpenCLRenderer
from l3cli.rendering.polarisation import SHOWN, in_upright_frame, names_in_files, picture_of, planes_in_files
from l3cli.rendering.reference import ReferenceRenderer
from l3cli.rendering.rendition import Rendition, rendered
from l3cli.rendering.white.source import usual_balance
from l3cli.report.polarisation import polarisation_maps
from tests.helpers.tables import random_table, with_refinement

COLOURS = ("X", "Y", "Z", "S1", "S2")
POLARISED = [[2, 1], [3, 0]]


def light(degree: float, angle: float, shape: tuple[int, int] = (6, 8)) -> np.ndarray:
    """Return S1, S0 and S2 of light with an intensity of 2."""
    double = 2 * np.radians(angle)
    one = 2 * np.array([degree * np.cos(double), 1.0, degree * np.sin(double)])
    return np.broadcast_to(one[:, None, None], (3, *shape)).copy()


def stokes_table(*sides: int) -> TransformTable:
    table = replace(random_table(POLARISED, bits=10, outputs=STOKES), white_point=np.array([0.0, 1.0, 0.0]))
    return with_refinement(table, *sides, ratios=2) if sides else table


@pytest.mark.parametrize("angle", [0.0, 30.0, 90.0, 135.0, 179.0])
def test_files_contain_degree_and_angle(angle: float) -> None:
    assert names_in_files(STOKES) == ("S0", "S1", "S2", "DoLP", "AoLP")
    made = planes_in_files(light(0.3, angle), STOKES)
    np.testing.assert_allclose(made[0], 2)
    np.testing.assert_allclose(made[3], 0.3)
    np.testing.assert_allclose(made[4], angle, atol=1e-9)
    assert names_in_files(COLOURS) == (*COLOURS, "DoLP", "AoLP")
    s1, s0, s2 = light(0.3, angle)
    np.testing.assert_allclose(planes_in_files(np.stack([s0, s0, s0, s1, s2]), COLOURS)[5:], made[3:])
    xyz = np.ones((3, 4, 4))
    assert planes_in_files(xyz, ("X", "Y", "Z")) is xyz


def test_unpolarised_and_dark_areas_have_a_finite_degree() -> None:
    stokes = np.array([[1.0, 0.0, -0.1], [0.0, 0.0, 0.2], [0.0, 0.0, 0.0]])
    assert dolp(stokes).tolist() == [0.0, 0.0, 1.0]
    assert np.isfinite(aolp(stokes)).all()


@pytest.mark.parametrize("orientation", range(8))
def test_angles_are_those_of_the_upright_picture(orientation: int) -> None:
    """A polariser at an angle passes the same light before and after the picture was turned with the polariser."""
    planes = light(0.8, 25.0)
    made = in_upright_frame(planes, STOKES, orientation)
    line = np.zeros((41, 41))  # a line at 25 degrees, which is turned like a picture
    for step in np.linspace(-18, 18, 200):
        line[round(20 - step * np.sin(np.radians(25))), round(20 + step * np.cos(np.radians(25)))] = 1
    rows, cols = np.nonzero(upright(line, orientation))
    slope = np.degrees(np.arctan2(-np.cov(rows, cols)[0, 1], np.cov(cols))) if np.var(cols) > np.var(rows) else None
    if slope is None:
        slope = 90 - np.degrees(np.arctan2(-np.cov(rows, cols)[0, 1], np.cov(rows)))
    found = float(aolp(made[[1, 0, 2]])[0, 0])
    assert abs((found - slope + 90) % 180 - 90) < 1
    np.testing.assert_allclose(dolp(made[[1, 0, 2]]), 0.8)
    assert behind(made[[1, 0, 2]], found)[0, 0] == pytest.approx(1.8)


@pytest.mark.parametrize("shown", SHOWN)
@pytest.mark.parametrize("bits", [8, 16])
def test_pictures_have_a_colour_bar_beside_them(shown: str, bits: int) -> None:
    picture = picture_of(light(0.5, 0.0, (20, 30)), STOKES, shown, bits)
    panels = 3 if shown == "stokes" else 1
    assert picture.shape[0] == 20
    assert panels * 30 < picture.shape[1] < panels * 30 + 20
    assert picture.dtype == (np.uint8 if bits == 8 else np.uint16)
    assert np.ptp(picture[:, : panels * 30 : 30].reshape(20, -1), axis=0).max() == 0


def test_the_hue_is_the_angle_and_the_brightness_the_degree() -> None:
    def colour(degree: float, angle: float) -> list[int]:
        return picture_of(light(degree, angle), STOKES, "aolp", 8)[0, 0].tolist()

    assert colour(0.0, 10.0) == [0, 0, 0]
    assert [colour(1.0, angle) for angle in (0.0, 60.0, 120.0)] == [[255, 0, 0], [0, 255, 0], [0, 0, 255]]
    assert sum(colour(0.25, 60.0)) < sum(colour(0.5, 60.0)) == sum(colour(1.0, 60.0))


@pytest.mark.parametrize("sides", [(), (3,)])
def test_kernels_meet_the_reference(sides: tuple[int, ...]) -> None:
    """Stokes parameters, and the grey picture of the intensity."""
    table = stokes_table(*sides)
    values = np.random.default_rng(2).integers(0, 1024, (40, 48)).astype(np.uint16)
    frame = RawFrame("f", values, table.black_level, table.white_level)
    device, reference = OpenCLRenderer(table), ReferenceRenderer(table)
    truth = reference.exact_outputs(frame)
    np.testing.assert_allclose(device.outputs(frame), truth, atol=1e-5 * np.abs(truth).max())
    rendition = Rendition(usual_balance(table), 0.5, 8)
    pictures = [rendered(each, frame, rendition, 0.5)[0].astype(int) for each in (device, reference)]
    assert all(np.ptp(picture, axis=2).max() == 0 for picture in pictures)
    assert np.abs(pictures[0] - pictures[1]).max() <= 1
    wanted = np.clip(0.5 * truth[1], 0, 1)
    assert np.corrcoef(pictures[1][..., 0].ravel(), wanted.ravel())[0, 1] > 0.9


def test_maps_of_a_report_end_at_a_round_degree() -> None:
    """The colours of the ideal are those of the colour key, and the scale contains nearly all degrees of the ideal."""
    target = light(0.15, 45.0, (20, 20))
    target[:, 0, :3] = light(0.9, 45.0, (1, 3))[:, 0]  # less than 1 % of the pixels
    planes = {"ours": light(0.0, 0.0, (20, 20)), "bilinear": light(0.4, 135.0, (20, 20))}
    maps, scale = polarisation_maps(target, planes, STOKES)
    assert scale == 0.2
    assert {kind: list(pictures) for kind, pictures in maps.items()} == {
        kind: ["ours", "bilinear", "ideal"] for kind in ("DoLP", "AoLP", "S0")
    }
    ends = np.rint(255 * VIRIDIS[[0, -1]])
    np.testing.assert_array_equal(maps["DoLP"]["ours"][5, 5], ends[0])
    np.testing.assert_array_equal(maps["DoLP"]["bilinear"][5, 5], ends[1])  # above the scale
    np.testing.assert_array_equal(maps["AoLP"]["bilinear"][5, 5], [128, 0, 255])  # three quarters of the hues
    np.testing.assert_array_equal(maps["AoLP"]["ideal"][5, 5], np.rint(0.75 * np.array([127.5, 255, 0])))
    assert maps["S0"]["ours"].min() == 255
