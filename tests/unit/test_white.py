"""White points of scenes: the illuminant for a grey, the white balance of a table, estimates, and smoothing over time."""

import dataclasses
from fractions import Fraction

import numpy as np
import pytest

from l3cli.artifacts.camera import CameraModel
from l3cli.artifacts.table import TransformTable
from l3cli.errors import InputFileError, L3Error
from l3cli.frames.frame import RawFrame, upright
from l3cli.frames.shading import Shading
from l3cli.io.raw.cfa_codes import neutral_of_channels
from l3cli.physics import correlated_lights, spectra
from l3cli.physics.display import daylight, delta_e_2000, display_white, lab, scene_white
from l3cli.rendering.raw_checks import other_camera
from l3cli.rendering.reference import ReferenceRenderer
from l3cli.rendering.white.scene_white import (
    GreyRenderer,
    Square,
    SteadyWhite,
    WhiteBalance,
    Whites,
    balanced,
    plain_balance,
)
from l3cli.rendering.white.source import AUTO, CAMERA, AutoWhite, CameraWhite, SquareWhite, given_white, white_source
from tests.helpers.cameras import BAYER, FIVE_BAND
from tests.helpers.tables import colorimetric_table, random_table, with_refinement

LIGHTS = ("2500K", "3200K", "A", "D5000K", "D65", "9000K")
ROUNDING = 2e-3  # of signals of 12 bits at two fifths of full scale, as plain areas are rendered: half a DN in 300


@pytest.fixture(scope="module")
def table(bayer: CameraModel) -> TransformTable:
    return colorimetric_table(bayer)


def grey_of(camera: CameraModel, light: str) -> np.ndarray:
    return camera.electron_weights @ spectra.illuminant(light, camera.wavelength)


def scene(
    camera: CameraModel, light: str, share: float = 0.8, shape: tuple[int, int] = (120, 160), seed: int = 3
) -> RawFrame:
    """A frame of measured surfaces, one of them white paint, that fills the brightest channel to `share`; no noise."""
    rng = np.random.default_rng(seed)
    surfaces = spectra.reflectance_library(camera.wavelength)[rng.integers(0, 300, 48)]
    surfaces[:2] = 0.95
    radiance = spectra.illuminant(light, camera.wavelength)
    signals = (surfaces * radiance) @ camera.electron_weights.T
    signals *= share * (camera.white_level - camera.black_level) / grey_of(camera, light).max()
    chosen = rng.integers(0, 48, (shape[0] // 10, shape[1] // 10)).repeat(10, 0).repeat(10, 1)
    channel = np.tile(camera.cfa, (shape[0] // 2, shape[1] // 2))
    values = np.take_along_axis(signals[chosen], channel[..., None], axis=2)[..., 0] + camera.black_level
    raw = np.rint(np.minimum(values, camera.white_level)).astype(np.uint16)
    return RawFrame("scene", raw, camera.black_level, camera.white_level)


def chroma(outputs: np.ndarray, balance: WhiteBalance) -> float:
    """C*ab of outputs as a balance shows them, as light as white."""
    shown = balance.adaptation @ outputs
    return float(np.hypot(*lab(shown / shown[1], display_white())[1:]))


# --------------------------------------------------------------------------------------------------------- lights


@pytest.mark.parametrize(
    ("name", "kelvin"), [("A", 2856), ("2500K", 2500), ("D65", 6504), ("D5000K", 5000), ("9000K", 9000)]
)
def test_temperature_and_distance_of_known_lights(name: str, kelvin: float) -> None:
    found, duv = correlated_lights.temperature(spectra.white_point(name))
    assert found == pytest.approx(kelvin, rel=2e-3)
    assert duv == pytest.approx(0.0032 if name.startswith("D") else 0.0, abs=4e-4)  # daylight lies above the black bodies


@pytest.mark.parametrize("name", LIGHTS)
def test_the_light_of_a_grey_is_found_by_the_responsivities(name: str, bayer: CameraModel, fiveband: CameraModel) -> None:
    """The search steps by 1 mired and 0.01 of green: 1 % of the temperature, 0.002 of the chromaticity. A black body of
    9000 K is taken for the daylight that is nearest to it, which a camera that is no eye sees another way."""
    for camera in (bayer, fiveband):
        light = correlated_lights.light_of_neutral(camera.electron_weights, camera.wavelength, 7 * grey_of(camera, name))
        true = spectra.white_point(name)
        black_body_of_the_sky = name == "9000K"
        assert np.abs(light.xyz[:2] / light.xyz.sum() - true[:2] / true.sum()).max() < (
            0.01 if black_body_of_the_sky else 0.002
        )
        assert light.kelvin == pytest.approx(
            correlated_lights.temperature(true)[0], rel=0.1 if black_body_of_the_sky else 0.01
        )
        assert light.misfit < 0.01


# ----------------------------------------------------------------------------------------------------------- grey


@pytest.mark.parametrize("cfa", [BAYER, FIVE_BAND])
def test_plain_areas_and_squares_are_rendered_as_in_whole_frames(cfa: list) -> None:
    table = with_refinement(random_table(cfa, patch=7), 3)
    rng = np.random.default_rng(1)
    grey, whole = GreyRenderer(table), ReferenceRenderer(table)
    shares = rng.uniform(0.1, 0.6, (3, len(table.channels)))
    side = 8 * table.cfa.shape[0]
    for share, outputs in zip(shares, grey.outputs_of(shares), strict=True):
        values = share[np.tile(table.cfa, (8, 8))] * (table.white_level - table.black_level) + table.black_level
        plain = RawFrame("plain", np.rint(values).astype(np.uint16), table.black_level, table.white_level)
        middle = np.s_[:, side // 2 : side // 2 + table.cfa.shape[0], side // 2 : side // 2 + table.cfa.shape[1]]
        np.testing.assert_allclose(outputs, whole.exact_outputs(plain)[middle].mean(axis=(1, 2)), rtol=1e-9)
    raw = rng.integers(300, 1500, (60, 90)).astype(np.uint16)
    for orientation in range(8):
        frame = RawFrame("frame", raw, table.black_level, table.white_level, (1, 1), orientation)
        shown = upright(np.moveaxis(whole.exact_outputs(frame), 0, -1), orientation)
        for row, col, size in ((30, 31, 12), (6, 8, 13), (shown.shape[0] - 6, 20, 12)):
            top, left = row - size // 2, col - size // 2
            wanted = shown[top : top + size, left : left + size].mean(axis=(0, 1))
            np.testing.assert_allclose(grey.of_part(frame, Square(row, col, size).within(frame).where), wanted, rtol=1e-9)


def test_a_square_is_that_of_the_frame_whose_channels_are_shaded_alike() -> None:
    table, rng = random_table(BAYER, patch=5), np.random.default_rng(4)
    raw = rng.integers(900, 960, (60, 96)).astype(np.uint16)
    colour = rng.integers(-3000, 3000, raw.shape).astype(np.int16)
    shaded = RawFrame("a", raw, table.black_level, table.white_level, shading=Shading(np.ones((60, 7), np.float32), colour))
    plain = dataclasses.replace(shaded.shading_corrected(), shading=None)
    grey, square = GreyRenderer(table), Square(30, 41, 12).within(shaded)
    np.testing.assert_allclose(grey.of_part(shaded, square.where), grey.of_part(plain, square.where), rtol=1e-9)
    np.testing.assert_allclose(grey.signals(shaded, square), grey.signals(plain, square), rtol=1e-9)
    assert not np.allclose(grey.signals(shaded, square), grey.signals(dataclasses.replace(shaded, shading=None), square))


def test_squares_that_are_no_grey(table: TransformTable) -> None:
    rng = np.random.default_rng(2)
    raw = np.full((64, 96), 1000, np.uint16)
    raw[:, 40:60] = int(table.white_level)
    raw[:, 70:] = 64 + rng.integers(0, 4, (64, 26))
    raw[40:, 70:] = rng.choice([300, 2500], (24, 26))
    frame, grey = RawFrame("frame", raw, table.black_level, table.white_level), GreyRenderer(table)
    assert (grey.signals(frame, Square(20, 20, 16).within(frame)) == 1000 - table.black_level).all()
    for square, why in (
        (Square(50, 50, 16), "clipped in 100%"),
        (Square(20, 85, 16), "too dark"),
        (Square(52, 85, 16), r"is not uniform: channel r varies by \d+%"),
        (Square(4, 20, 16), "inside"),
    ):
        with pytest.raises(InputFileError, match=why):
            grey.signals(frame, square.within(frame))
    raw[:, 40:60] = 3800  # a sensor, or whoever wrote the file, clips below the table's white level
    with pytest.raises(InputFileError, match="clipped at 3800 DN, below the white level of 3814"):
        grey.signals(frame, Square(50, 50, 16).within(frame))


def test_a_bright_grey_that_gains_clip_is_neutral_by_its_raw_values(table: TransformTable, bayer: CameraModel) -> None:
    """Under A the gains of a table trained under D65 lift green of a grey at 0.9 beyond the white level."""
    neutral = grey_of(bayer, "A") / grey_of(bayer, "A").max()
    channel = np.tile(bayer.cfa, (30, 40))
    shares = np.where(np.arange(80) < 40, 0.9, 0.3) * neutral[channel]
    raw = np.rint(bayer.black_level + shares * (bayer.white_level - bayer.black_level)).astype(np.uint16)
    frame = RawFrame("frame", raw, bayer.black_level, bayer.white_level)
    whites = Whites(table)
    bright, dim = (whites.of_greys(frame, [Square(30, col, 20).within(frame)]) for col in (20, 60))
    assert dim.balance.gains.max() > 1 / 0.9
    shown = whites.grey.of_part(balanced(frame, table, bright.balance.gains), (slice(20, 40), slice(50, 70)))
    assert chroma(shown, bright.balance) < 1


# -------------------------------------------------------------------------------------------------------- balance


def test_gains_raise_each_channel_above_the_dark_up_to_the_white_level() -> None:
    table = random_table(BAYER, black_level=64.0)
    raw = np.array([[64, 1000, 4095, 3000], [200, 2000, 4095, 70]], np.uint16).repeat(2, 0)
    frame = RawFrame("frame", raw, 60.0, 4095.0, phase=(0, 1), dark=4.0)  # g r / b g
    gains = np.array([1.0, 2.0, 1.5])
    wanted = raw.astype(float)
    channel = np.tile(np.array([[1, 0], [2, 1]]), (2, 2))
    wanted = np.where(raw < 4095, np.minimum(np.rint((wanted - 64) * gains[channel] + 64), 4095), 4095)
    np.testing.assert_array_equal(balanced(frame, table, gains).values, wanted)
    assert balanced(frame, table, np.ones(3)) is frame


@pytest.mark.parametrize("light", LIGHTS)
def test_a_grey_of_the_files_neutral_is_neutral_and_as_bright(light: str, table: TransformTable, bayer: CameraModel) -> None:
    neutral = grey_of(bayer, light)
    balance = Whites(table).of_neutral(3.0 * neutral).balance
    assert balance.gains.min() == 1
    grey = GreyRenderer(table)
    before = grey.outputs_of(0.2 * neutral[None] / neutral.max())[0]
    after = grey.outputs_of(0.2 * (neutral * balance.gains)[None] / neutral.max())[0]
    assert chroma(after, balance) < 0.5
    shown = balance.luminance * balance.adaptation @ after
    assert shown[1] == pytest.approx(before[1], rel=2 * ROUNDING)


@pytest.mark.parametrize("light", ["2500K", "3200K"])
def test_surfaces_are_nearer_to_their_colours_than_by_adaptation_alone(
    light: str, table: TransformTable, bayer: CameraModel
) -> None:
    _, chart = spectra.colorchecker(bayer.wavelength)  # not among the surfaces that the matrix is fitted to
    radiance = spectra.illuminant(light, bayer.wavelength)
    signals, neutral = (chart * radiance) @ bayer.electron_weights.T, bayer.electron_weights @ radiance
    true = (chart * radiance) @ spectra.xyz_weights(bayer.wavelength).T
    white = spectra.xyz_weights(bayer.wavelength) @ radiance
    whites, grey = Whites(table), GreyRenderer(table)
    shown = grey.outputs_of(0.4 * neutral[None] / neutral.max())[0]
    errors = []
    for balance in (plain_balance(shown, 3), whites.of_neutral(neutral).balance):
        seen = grey.outputs_of(0.4 * (signals * balance.gains) / (neutral * balance.gains).max())
        of_white = grey.outputs_of(0.4 * (neutral * balance.gains)[None] / (neutral * balance.gains).max())[0, 1]
        ours = lab(seen @ balance.adaptation.T / of_white, daylight())
        ideal = lab(true @ plain_balance(white, 3).adaptation.T / white[1], daylight())
        errors.append(float(delta_e_2000(ours, ideal).mean()))
    assert errors[1] < 0.75 * errors[0]


@pytest.mark.parametrize(
    "neutral", [(1.0, 0.0, 0.0), (0, 0, 0), (1e-300, 1e-300, 2e-300), (1e9, 1e-9, 1.0), (1.0, 1e-3, 1e3)]
)
def test_neutrals_that_are_none_do_no_harm(neutral: tuple[float, ...], table: TransformTable) -> None:
    """They give a balance of finite numbers, or are refused in a line."""
    try:
        balance = Whites(table).of_neutral(np.array(neutral)).balance
    except InputFileError:
        return
    assert 1 <= balance.gains.min() <= balance.gains.max() <= 8
    assert np.isfinite(balance.adaptation).all()
    assert 0 < balance.luminance < np.inf


# -------------------------------------------------------------------------------------------------------- sources


@pytest.mark.parametrize("light", ["2500K", "3200K", "D65", "9000K"])
def test_the_white_of_a_frame_is_estimated_close_to_its_light(light: str, table: TransformTable, bayer: CameraModel) -> None:
    """Grey-edge and white patch err by several degrees at times; with white paint in the frame by less than 35 mired."""
    auto = AutoWhite(Whites(table))
    frame = scene(bayer, light)
    white = auto.white(frame)
    assert white is not None
    wanted = correlated_lights.temperature(spectra.white_point(light))[0]
    assert abs(1e6 / white.light.kelvin - 1e6 / wanted) < 35
    again = AutoWhite(Whites(table)).white(frame)
    assert again is not None
    np.testing.assert_array_equal(again.balance.adaptation, white.balance.adaptation)


def test_clipped_pixels_do_not_count_for_the_estimate(table: TransformTable, bayer: CameraModel) -> None:
    auto, frame = AutoWhite(Whites(table)), scene(bayer, "3200K")
    raw = frame.values.copy()
    raw[:, :60] = int(bayer.white_level)  # as if it were a magenta light, to a table that does not know
    white, clear = auto.white(dataclasses.replace(frame, values=raw)), auto.white(frame)
    assert white
    assert clear
    assert abs(1e6 / white.light.kelvin - 1e6 / clear.light.kelvin) < 15
    for nothing in (bayer.white_level, bayer.black_level):
        assert auto.white(dataclasses.replace(frame, values=np.full_like(raw, int(nothing)))) is None


def test_what_texts_ask_for(table: TransformTable) -> None:
    assert isinstance(white_source(CAMERA, table), CameraWhite)
    assert isinstance(white_source(AUTO, table), AutoWhite)
    for text in ("10,20", "0,0", "1,1", "10,20,7"):
        assert isinstance(white_source(text, table), SquareWhite)
    for text in ("0.3127,0.329", "D65", "3200K", "0.3,1", "1,0.3"):
        assert white_source(text, table) is None
    for wrong in ("10,20,0", "-1,5", "10,20,30,40", "10,20,", "2000000,5"):
        with pytest.raises(L3Error):
            assert white_source(wrong, table) or given_white(wrong, table)


def test_a_named_light_is_that_which_gives_its_grey(table: TransformTable, bayer: CameraModel) -> None:
    named, measured = given_white("3200K", table), Whites(table).of_neutral(grey_of(bayer, "3200K"))
    assert named is not None
    assert named.modelled
    np.testing.assert_allclose(named.balance.gains, measured.balance.gains, rtol=1e-9)
    np.testing.assert_allclose(named.balance.adaptation, measured.balance.adaptation, atol=0.01)


@pytest.mark.parametrize("light", ["2500K", "3200K", "D5000K"])
def test_a_chromaticity_is_that_of_the_lamp_or_daylight_that_has_it(
    light: str, table: TransformTable, bayer: CameraModel
) -> None:
    """As if the light were named: its search steps by 1 mired and 0.01 of green, 0.3 % of a signal."""
    x, y = spectra.white_point(light)[:2] / spectra.white_point(light).sum()
    given, named = given_white(f"{x:.4f},{y:.4f}", table), given_white(light, table)
    assert given
    assert named
    assert given.modelled
    np.testing.assert_allclose(given.balance.gains, named.balance.gains, rtol=6e-3)
    np.testing.assert_allclose(given.balance.adaptation, named.balance.adaptation, atol=0.015)
    shares = 0.3 * grey_of(bayer, light)[None] / grey_of(bayer, light).max()
    assert chroma(GreyRenderer(table).outputs_of(given.balance.gains * shares)[0], given.balance) < 1


@pytest.mark.parametrize("white", ["0.3127,0.3290", "0.6,0.35", "0.2,0.6", "0.15,0.06", "0.99,0.005", "0.001,0.001"])
def test_the_tables_white_and_colours_that_no_light_has_are_adapted_from(white: str, table: TransformTable) -> None:
    given = given_white(white, table)
    assert given
    assert not given.modelled
    np.testing.assert_array_equal(given.balance.adaptation, plain_balance(scene_white(white), 3).adaptation)
    assert (given.balance.gains == 1).all()


def test_neutrals_are_those_of_the_channels() -> None:
    table = random_table(BAYER)
    neutral = np.array([[1, 1.0], [0, 0.5], [2, 0.7]])  # green first, as some files have it
    pattern = np.array([[1, 0], [2, 1]])
    assert neutral_of_channels(neutral, pattern, (0, 1), table) == (0.5, 1.0, 0.7)
    assert neutral_of_channels(neutral, None, (0, 0), table) == (0.5, 1.0, 0.7)
    assert neutral_of_channels(neutral[:2], pattern, (0, 1), table) is None
    assert neutral_of_channels(None, pattern, (0, 1), table) is None
    named = dataclasses.replace(table, channels=("orange", "g", "b"))
    assert neutral_of_channels(neutral, pattern, (0, 1), named) == (0.5, 1.0, 0.7)  # by its place


# ------------------------------------------------------------------------------------------------------- warnings


def test_white_is_followed_from_the_first_frame_on() -> None:
    steady, start = SteadyWhite(Fraction(10)), plain_balance(daylight(), 3)
    aim = WhiteBalance(np.array([4.0, 1.0, 2.0]), 2 * np.eye(3), 0.5)
    assert steady.balance(None) is None
    assert steady.balance(start) is start
    now = [steady.balance(aim) for _ in range(10)][-1]  # one second
    assert now is not None
    np.testing.assert_allclose(np.log(now.gains), (1 - np.exp(-1)) * np.log(aim.gains), atol=1e-9)
    np.testing.assert_allclose(now.adaptation, start.adaptation + (1 - np.exp(-1)) * (aim.adaptation - start.adaptation))


def test_another_camera_is_reported_by_its_name(table: TransformTable) -> None:
    names = ("Canon", "Canon EOS Kiss X4", "Canon EOS 550D")
    frame = RawFrame("a.dng", np.zeros((4, 4), np.uint16), 0.0, 100.0, taken_by=names)
    known = {"canon 550D": True, "my Kiss": True, "EOS, measured 2026": True, "Canon EOS 550D, 14bit": True}
    others = {"Canon 600D": False, "Canon EOS 5D": False, "Canon X": False, "Canon EOS Kiss X5": False}
    for name, same in (known | others).items():
        assert (other_camera(frame, dataclasses.replace(table, camera_name=name)) == "") is same
