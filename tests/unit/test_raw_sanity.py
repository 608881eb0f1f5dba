"""The phase of the array and the black level, derived from the pixels of simulated and real frames."""

import itertools
import os
from pathlib import Path

import numpy as np
import pytest
import scipy.io

from l3cli.artifacts.camera_recipe import known_arrays, parse_cfa
from l3cli.frames.frame import RawFrame
from l3cli.frames.raw_sanity import array_doubt, black_doubt, phase_doubt
from l3cli.io.frames import raw_content
from l3cli.physics.mosaic import shifted_cfa
from tests.helpers.cameras import BAYER, X_TRANS

RGBW = [[3, 2, 3, 1], [2, 3, 1, 3], [3, 1, 3, 0], [1, 3, 0, 3]]
QUAD = np.repeat(np.repeat(BAYER, 2, 0), 2, 1)
TUNGSTEN = np.array([0.9, 1.0, 0.35, 1.6])  # channels r, g, b, w of a grey
REAL = ("colorchart.dng", "kodak_dc50.kdc", "openisp_test_1920x1080_10bit_u16le_RGGB.raw", "DeviceA_ISO_ISET_Sensor.mat")
MISSTATED = "isetcam_MCC-centered_dng_crop258.mat"  # a crop from an odd column on, with the array of the whole


def frame(cfa: np.ndarray, grey: np.ndarray, black: float = 0.0, seed: int = 0) -> RawFrame:
    """Blotches of all colours with texture and noise."""
    rng = np.random.default_rng(seed)
    shape = (15 * 24, 20 * 24)
    light = np.kron(rng.uniform(0.0, 1.0, (15, 20, 3)), np.ones((24, 24, 1)))
    light *= 1 + 0.3 * np.sin(np.arange(shape[1]) / 2.5)[:, None]
    planes = np.concatenate([light, light.mean(axis=2, keepdims=True)], axis=2) * grey
    sites = np.tile(cfa, (shape[0] // len(cfa), shape[1] // len(cfa[0])))
    signal = 2000.0 * np.take_along_axis(planes, sites[..., None], axis=2)[..., 0]
    values = black + signal + np.sqrt(signal + 9) * rng.standard_normal(shape)
    return RawFrame("frame", np.clip(np.rint(values), 0, 4095).astype(np.uint16), black, 4095.0)


@pytest.mark.parametrize(
    "array", [BAYER, X_TRANS, QUAD, RGBW, [[0, 1], [2, 3]]], ids=["Bayer", "X-Trans", "quad", "RGBW", "2×2"]
)
@pytest.mark.parametrize("grey", [TUNGSTEN, np.array([0.6, 1.0, 0.6, 1.6])], ids=["tungsten", "daylight"])
def test_the_right_phase_of_every_array(array: list[list[int]], grey: np.ndarray) -> None:
    """Every shift is refused, and the true phase named first; but for one that exchanges red and blue where a grey gives
    both alike, which nothing tells, and leaves the true one among those that are named."""
    cfa = np.array(array, np.uint8)
    neutral = grey[: cfa.max() + 1]
    taken = frame(cfa, grey, 64.0)
    exchanged = np.array([2, 1, 0, 3], np.uint8)[cfa] if grey[0] == grey[2] else cfa
    for phase in itertools.product(range(cfa.shape[0]), range(cfa.shape[1])):
        said = shifted_cfa(cfa, phase)
        doubt = phase_doubt(taken, said, neutral)
        if (said == cfa).all() or (said == exchanged).all():
            assert doubt is None, phase
            continue
        assert doubt is not None, phase
        fitting = [shifted_cfa(said, each) for each in doubt.phases]
        assert (fitting[0] == cfa).all() or (grey[0] == grey[2] and any((each == cfa).all() for each in fitting)), phase


NONA = np.repeat(np.repeat(BAYER, 3, 0), 3, 1)
RGB_IR = [[1, 3, 1, 3], [0, 1, 2, 1], [1, 3, 1, 3], [2, 1, 0, 1]]
KNOWN = {name: parse_cfa(each, name) for name, each in known_arrays().items()}
OTHERS = {"quad_bayer": QUAD, "nona": NONA, "xtrans": X_TRANS, "rgbw4x4": RGBW, "rgbir4x4": RGB_IR, "rgbw": [[0, 1], [3, 2]]}
DAYLIGHT = np.array([0.5, 1.0, 0.6, 1.6])


# in daylight red and blue, all that differs in an RGB-IR array tagged as Bayer, are too much alike to tell
@pytest.mark.parametrize(
    ("name", "grey"),
    [(name, grey) for name in OTHERS for grey in (TUNGSTEN, DAYLIGHT) if (name, grey[0]) != ("rgbir4x4", 0.5)],
)
def test_an_array_tagged_as_another_is_doubted_and_the_likely_one_named(name: str, grey: np.ndarray) -> None:
    cfa, tag = np.array(OTHERS[name], np.uint8), np.array(BAYER, np.uint8)
    pixels = frame(cfa, grey, 64.0)
    if cfa.shape == (2, 2) and phase_doubt(pixels, tag) is not None:
        return  # red and blue are so alike that the array seems to begin elsewhere: also a doubt
    doubt = array_doubt(pixels, tag)
    assert doubt is not None
    assert name in doubt.likely(KNOWN | {"nona": NONA})[:2]


@pytest.mark.parametrize("tag", [QUAD, NONA, X_TRANS, RGB_IR, RGBW], ids=["quad", "nona", "X-Trans", "RGB-IR", "RGBW"])
def test_a_bayer_array_tagged_as_another_is_doubted(tag: list[list[int]]) -> None:
    """As another array or as another phase of it."""
    pixels, cfa = frame(np.array(BAYER), TUNGSTEN, 64.0), np.array(tag, np.uint8)
    doubt = array_doubt(pixels, cfa)
    assert doubt is not None or phase_doubt(pixels, cfa) is not None
    assert doubt is None or "bayer" in doubt.likely(KNOWN)[:2]


@pytest.mark.parametrize("name", KNOWN)
def test_an_array_tagged_as_it_is_passes(name: str) -> None:
    cfa = KNOWN[name]
    rng = np.random.default_rng(0)
    filters = rng.uniform(0.2, 1.0, cfa.max() + 1)
    light = np.kron(rng.uniform(0.0, 1.0, (15, 20)), np.ones((24, 24)))
    signal = 3000 * light * filters[np.tile(cfa, (360 // len(cfa) + 1, 480 // len(cfa[0]) + 1))[:360, :480]]
    values = np.rint(64 + signal + np.sqrt(signal + 9) * rng.standard_normal(signal.shape)).clip(0, 4095).astype(np.uint16)
    for top, left in ((0, 0), (1, 0), (2, 3)):
        phase = (top % len(cfa), left % len(cfa[0]))
        assert array_doubt(RawFrame("a", values[top:, left:], 64.0, 4095.0, phase), cfa) is None


def bayer_frame(light: np.ndarray, seed: int = 0) -> RawFrame:
    """Pixels behind a Bayer array of what a grey scene of that light (row, col) gives, with noise."""
    sites = np.tile(BAYER, (light.shape[0] // 2, light.shape[1] // 2))
    signal = 3000 * light * DAYLIGHT[sites]
    noise = np.sqrt(signal + 9) * np.random.default_rng(seed).standard_normal(light.shape)
    return RawFrame("a", np.rint(64 + signal + noise).clip(0, 4095).astype(np.uint16), 64.0, 4095.0)


ROW, COL = np.mgrid[:240, :360]
BLOTCHES = np.random.default_rng(4).uniform(0.1, 0.9, (15, 22))[ROW // 17, COL // 17]
RADIUS = ((ROW - 120) ** 2 + (COL - 180) ** 2) / (120**2 + 180**2)
TRUE_BAYER = {
    "plain": np.full(ROW.shape, 0.3),
    "dark": np.full(ROW.shape, 0.003),
    "shaded": 0.5 / (1 + 3 * RADIUS),
    "slanted fine stripes": np.where((COL * 0.97 + ROW * 0.1) % 5 < 2.5, 0.5, 0.02),
    "noise of full contrast": np.random.default_rng(2).uniform(0, 0.6, ROW.shape),
    "a wedge": np.linspace(0, 0.6, 360) * np.ones(ROW.shape),
    "an edge": np.where(COL < 181, 0.02, 0.6),
}


@pytest.mark.parametrize("name", TRUE_BAYER)
def test_true_bayer_frames_pass(name: str) -> None:
    assert array_doubt(bayer_frame(TRUE_BAYER[name]), np.array(BAYER, np.uint8)) is None


@pytest.mark.parametrize("period", [4, 6, 8, 12])
@pytest.mark.parametrize("line", [ROW, COL], ids=["rows", "columns"])
@pytest.mark.parametrize("contrast", [0.3, 0.99])
def test_stripes_of_an_exact_period_are_no_other_array(period: int, line: np.ndarray, contrast: float) -> None:
    light = 0.3 * (1 + contrast * np.sin(2 * np.pi * line / period + 0.6))
    assert array_doubt(bayer_frame(light), np.array(BAYER, np.uint8)) is None


@pytest.mark.parametrize("period", [4, 8, 12])
@pytest.mark.parametrize("line", [ROW + COL, ROW - COL, 2 * ROW + COL], ids=["falling", "rising", "flat"])
@pytest.mark.parametrize("ratio", [1.2, 2, 25])
def test_slanted_stripes_of_an_exact_period_are_no_other_array(period: int, line: np.ndarray, ratio: float) -> None:
    for light in (np.where(line % period < period / 2, 0.5, 0.5 / ratio), 0.3 + (0.3 - 0.3 / ratio) * np.sin(line)):
        assert array_doubt(bayer_frame(light), np.array(BAYER, np.uint8)) is None


@pytest.mark.parametrize("size", [(2, 2), (4, 4), (2, 4), (4, 6), (3, 3), (3, 2), (3, 6), (6, 3), (1, 2), (2, 1)])
@pytest.mark.parametrize("first", [0, 1])
@pytest.mark.parametrize("ratio", [1.2, 2, 25])
def test_checks_of_an_exact_period_are_no_other_array(size: tuple[int, int], first: int, ratio: float) -> None:
    dark = ((ROW + first) // size[0] + COL // size[1]) % 2 == 0
    for light in (np.where(dark, 0.5 / ratio, 0.5), np.where(dark & (COL < 200), 0.5 / ratio, 0.5)):
        assert array_doubt(bayer_frame(light), np.array(BAYER, np.uint8)) is None


def test_pairs_of_dark_rows_in_a_part_of_the_frame_are_no_other_array() -> None:
    for light in (np.where((ROW % 4 < 2) & (COL < 180), 0.02, 0.5), np.where((ROW % 4 < 2) & (ROW < 120), 0.02, 0.5)):
        assert array_doubt(bayer_frame(light), np.array(BAYER, np.uint8)) is None


@pytest.mark.parametrize("first", range(4))
@pytest.mark.parametrize("ratio", [2, 4, 25])
@pytest.mark.parametrize("textured", [False, True])
def test_pairs_of_dark_rows_with_the_noise_of_one_gain_are_no_other_array(first: int, ratio: float, textured: bool) -> None:
    """Noise tells fences and blinds from sensors with two gains, even if the stripes are locked to the pixels."""
    light = np.where((ROW + first) % 4 < 2, 0.5 / ratio, 0.5)
    if textured:
        light = light * BLOTCHES
    assert array_doubt(bayer_frame(light), np.array(BAYER, np.uint8)) is None


def two_gains(light: np.ndarray, ratio: float, first: int, gain: float) -> RawFrame:
    """A frame of a sensor whose pairs of rows have the gains `gain` and `ratio` · `gain`, in DN per electron."""
    rng = np.random.default_rng(5)
    gains = gain * np.where((ROW + first) % 4 < 2, 1.0, ratio)
    collected = rng.poisson(light * DAYLIGHT[np.tile(BAYER, (120, 180))] * 3000 / (gain * ratio))
    values = 64 + gains * collected + rng.normal(0, 1, light.shape)
    return RawFrame("a", np.rint(values).clip(0, 4095).astype(np.uint16), 64.0, 4095.0)


@pytest.mark.parametrize("first", range(4))
@pytest.mark.parametrize("ratio", [2.2, 4, 16])
@pytest.mark.parametrize("gain", [0.1, 1])
def test_pairs_of_rows_of_two_gains_are_another_array(first: int, ratio: float, gain: float) -> None:
    for light in (np.full(ROW.shape, 0.4), BLOTCHES):
        doubt = array_doubt(two_gains(light, ratio, first, gain), np.array(BAYER, np.uint8))
        assert doubt is not None
        assert "dual_iso" in doubt.likely(KNOWN)[:2]


@pytest.mark.parametrize("first", range(2))
def test_rows_without_measurable_noise_have_two_gains_from_a_ratio_of_2_on(first: int) -> None:
    sites = np.tile(BAYER, (120, 180))
    for ratio, likely in ((1.2, False), (1.8, False), (2.2, True)):
        signal = 3000 * DAYLIGHT[sites] * np.where((ROW + first) % 4 < 2, 0.5 / ratio, 0.5)
        doubt = array_doubt(RawFrame("a", np.rint(64 + signal).astype(np.uint16), 64.0, 4095.0), np.array(BAYER, np.uint8))
        assert (doubt is not None and "dual_iso" in doubt.likely(KNOWN)[:2]) == likely, ratio
        assert likely or doubt is None, ratio


@pytest.mark.parametrize("period", [8, 12, 16, 24])
@pytest.mark.parametrize("places", [[(1, 1)], [(1, 1), (5, 5)], [(0, 0), (1, 1), (4, 4), (5, 5)]])
def test_pixels_for_autofocus_are_no_other_array(period: int, places: list[tuple[int, int]]) -> None:
    light = np.full(ROW.shape, 0.3)
    for row, col in places:
        light[row::period, col::period] *= 0.5
    assert array_doubt(bayer_frame(light), np.array(BAYER, np.uint8)) is None


def test_what_tells_nothing_is_not_doubted() -> None:
    cfa = np.array(BAYER, np.uint8)
    plain = np.full((96, 96), 900, np.uint16)
    for values in (plain, np.full((96, 96), 64, np.uint16), plain[:1, :1], plain[:3, :5]):
        assert phase_doubt(RawFrame("plain", values, 64.0, 4095.0, (0, 1)), cfa, [0.9, 1.0, 0.35]) is None
    noise = np.random.default_rng(0).normal(70, 12, (96, 96)).clip(0).astype(np.uint16)
    assert phase_doubt(RawFrame("dark", noise, 64.0, 4095.0, (0, 1)), cfa) is None
    split = np.full((96, 96), 900, np.uint16)
    split[::2, 1::2] = 950  # the greens of one row, as some sensors give them
    assert phase_doubt(RawFrame("split", split, 64.0, 4095.0), cfa) is None
    assert array_doubt(RawFrame("split", split, 64.0, 4095.0), cfa) is None


def test_a_black_level_of_0_is_doubted_where_all_channels_end_at_one_level() -> None:
    cfa = np.array(BAYER, np.uint8)
    taken = frame(cfa, TUNGSTEN, 256.0)
    black = black_doubt(RawFrame("raised", taken.values, 0.0, 4095.0), cfa)
    assert black is not None
    assert 230 < black < 290
    assert black_doubt(taken, cfa) is None
    assert black_doubt(RawFrame("dark", (taken.values - 256).clip(0), 0.0, 4095.0), cfa) is None
    fog = np.kron(np.ones((48, 48)), np.array([[300, 420], [420, 180]])).astype(np.uint16)  # what light alone leaves
    assert black_doubt(RawFrame("fog", fog, 0.0, 4095.0), cfa) is None


def real(name: str) -> tuple[np.ndarray, float, float, np.ndarray, np.ndarray | None]:
    """Values, black and white level, array as stated, signals of a grey of a real capture."""
    data = Path(os.environ.get("L3_DATA", ""))
    if not os.environ.get("L3_DATA") or not data.is_dir():
        pytest.skip("L3_DATA does not name the folder of real data")
    path = data / "raw" / name
    if path.suffix == ".raw":
        return np.fromfile(path, "<u2").reshape(1080, 1920), 0.0, 1023.0, np.array(BAYER), None
    if path.suffix == ".mat":
        held = scipy.io.loadmat(path, struct_as_record=False, squeeze_me=True)
        if sensor := held.get("isa"):
            return np.rint(sensor.data.volts * 1e4).astype(np.uint16), 0.0, 1e4, sensor.cfa.pattern - 1, None
        return (
            held["digital_values"].astype(np.uint16),
            held["black_level"],
            2**14 - 1.0,
            held["pattern"].astype(int) - 1,
            None,
        )
    content = raw_content(path)
    levels = content["black_level"], content["white_level"]
    neutral = content.get("neutral")
    if neutral is None or np.ptp(neutral[:, 1]) == 0:  # equal signals of all channels tell nothing
        return content["values"], *levels, content["pattern"], None
    return content["values"], *levels, content["pattern"], neutral[:, 1]


@pytest.mark.parametrize("name", REAL)
def test_real_frames_as_they_are_and_with_their_tag_shifted(name: str) -> None:
    values, black, white, pattern, neutral = real(name)
    cfa, taken = pattern.astype(np.uint8), RawFrame(name, values, black, white)
    assert phase_doubt(taken, cfa, neutral) is None
    assert array_doubt(taken, cfa) is None
    assert black_doubt(taken, cfa) is None
    for phase in ((0, 1), (1, 0)):
        doubt = phase_doubt(taken, shifted_cfa(cfa, phase), neutral)
        assert doubt is not None
        assert set(doubt.phases) == {(0, 1), (1, 0)}
        assert doubt.phases[0] == phase or neutral is None
    both = phase_doubt(taken, shifted_cfa(cfa, (1, 1)), neutral)
    assert (both is not None and both.phases == ((1, 1),)) == (neutral is not None)  # red and blue: a grey alone tells


def test_a_real_frame_whose_array_is_misstated() -> None:
    values, black, white, pattern, _ = real(MISSTATED)
    doubt = phase_doubt(RawFrame(MISSTATED, values, black, white), pattern.astype(np.uint8))
    assert doubt is not None
    assert doubt.phases == ((0, 1), (1, 0))
    assert (doubt.stated > 0.06, doubt.least < 0.004) == (True, True)


def test_black_levels_that_real_frames_state_wrongly() -> None:
    for name, black in ((REAL[2], 70), ("kodak_dc50.kdc", 1024), ("colorchart.dng", 0)):
        values, stated, white, pattern, _ = real(name)
        doubt = black_doubt(RawFrame(name, values + np.uint16(black), 0.0, white + black), pattern.astype(np.uint8))
        assert doubt is not None
        assert doubt == pytest.approx(black + stated, abs=0.02 * white)
