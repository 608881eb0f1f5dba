"""Analog gains: noise at each gain, transforms for several gains, and interpolation between gains."""

import dataclasses
import re
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from l3cli.artifacts.camera import AnalogGains, CameraModel, NoiseScale
from l3cli.artifacts.camera_recipe import load_camera
from l3cli.artifacts.conditions import Condition
from l3cli.artifacts.schema import equal
from l3cli.artifacts.store import load, save
from l3cli.artifacts.table import TransformTable
from l3cli.artifacts.training_set import open_training_set, white_signal
from l3cli.classes import contrast, level
from l3cli.frames.frame import NoiseLeft, RawFrame
from l3cli.rendering.conditions import at_gain, nearest_step
from l3cli.rendering.exposure import SteadyExposure
from l3cli.rendering.raw_checks import other_gain
from l3cli.rendering.reference import ReferenceRenderer
from l3cli.rendering.renderer import NoiseRenderer
from l3cli.rendering.temporal.chunks import filters
from l3cli.simulation import sensor
from l3cli.simulation.frame import exposed_again
from l3cli.training.patches import expose_patches
from tests.helpers.calls import L3, Refused
from tests.helpers.paths import CONFIGS
from tests.helpers.training_sets import a_frame

BAYER = CONFIGS / "cameras/bayer.toml"


@pytest.fixture(scope="module")
def several(gain_tables: Path) -> TransformTable:
    return load(TransformTable, gain_tables / "several.h5")


def amplified(camera: CameraModel, before: float, after: float) -> CameraModel:
    """The camera with read noise (e-) before and after an amplifier, known at gains of 1/4 and 64."""
    known = np.array([0.25, 64.0])
    noise = dataclasses.replace(camera.noise, read_noise=float(np.hypot(before, after)))
    return dataclasses.replace(camera, noise=noise, gains=AnalogGains(known, np.hypot(before, after / known), 100.0))


@given(st.floats(0.0, 5.0), st.floats(0.1, 50.0), st.floats(0.3, 60.0), st.floats(0.3, 60.0))
def test_read_noise_at_a_gain_is_that_of_both_sides_of_the_amplifier(
    before: float, after: float, gain: float, more: float
) -> None:
    camera = amplified(load_camera(BAYER), before, after)
    there = camera.at_gain(gain)
    assert there.noise.read_noise == pytest.approx(np.hypot(before, after / gain), rel=1e-6)
    constant, linear, quadratic = there.noise_terms()
    dsnu = camera.noise.dsnu**2 + camera.noise.column_noise**2
    assert constant == pytest.approx((camera.gain * gain) ** 2 * (there.noise.read_noise**2 + dsnu) + 1 / 12)
    assert linear == pytest.approx(gain * camera.noise_terms()[1])
    assert quadratic == camera.noise_terms()[2]
    assert there.full_scale == pytest.approx(camera.full_scale / gain)
    assert there.gain_at(800.0) == pytest.approx(8.0 / gain)
    if 0.3 <= gain * more <= 60:
        twice = there.at_gain(more)
        assert twice.noise.read_noise == pytest.approx(camera.at_gain(gain * more).noise.read_noise, rel=1e-6)


def test_a_step_of_read_noise_is_data() -> None:
    """As of a pixel with two conversion gains: below the step and above it, read noise is what was measured."""
    camera = dataclasses.replace(
        load_camera(BAYER), gains=AnalogGains(np.array([3.9, 4.0, 16.0]), np.array([5.0, 1.5, 1.2]))
    )
    for gain, noise in ((3.9, 5.0), (4.0, 1.5), (16.0, 1.2), (100.0, 1.2)):
        assert camera.at_gain(gain).noise.read_noise == pytest.approx(noise)


def test_a_recipe_names_gains(tmp_path: Path, l3: L3) -> None:
    recipe = BAYER.read_text()
    path = tmp_path / "camera.toml"
    path.write_text(recipe + "\n[gain]\niso = 100\nread_noise_before_e = 1.0\n")
    camera, own = load_camera(path), load_camera(BAYER).noise.read_noise
    assert camera.at_gain(8).noise.read_noise == pytest.approx(np.hypot(1.0, np.sqrt(own**2 - 1) / 8), rel=1e-5)
    assert camera.gain_at(1600) == 16
    save(camera, tmp_path / "camera.h5")
    assert equal(load(CameraModel, tmp_path / "camera.h5"), camera)
    for keys, words in (
        ("gains = [2.0]", "has 1 values, but gain.read_noise_e has 0"),
        ("gains = [1.0]\nread_noise_e = [1.0]", "contains 1, for which noise.read_noise_e already applies"),
        ("gains = [2.0, 2.0]\nread_noise_e = [1.0, 1.0]", "contains 2 more than once"),
        ("read_noise_before_e = 1000.0", "must not exceed noise.read_noise_e"),
        ("iso = -1", "gain.iso is -1"),
    ):
        path.write_text(recipe + f"\n[gain]\n{keys}\n")
        code, found, _ = l3("check", path)
        assert (code, words in found) == (3, True)


def lab_at_speeds(folder: Path, camera: CameraModel, speeds: dict[float, float]) -> str:
    """Dark and white frames of a camera at gains, by the ISO speeds that the measurement file names them with."""
    rng, text = np.random.default_rng(4), ""
    for iso, gain in speeds.items():
        there = camera.at_gain(gain)
        for section, exposures in (("dark", (0.01, 0.5)), ("white", (0.1, 0.2, 0.4, 0.8, 1.6))):
            for number, exposure in enumerate(exposures):
                light = there.full_scale * exposure if section == "white" else 0.0
                names = [f"{section}_{iso:g}_{number}_{frame}.npy" for frame in range(2)]
                for name in names:
                    electrons = np.full((camera.rows, camera.cols), light, np.float32)
                    np.save(folder / name, sensor.expose(there, electrons, exposure, rng))
                text += f"[[{section}]]\nframes = {names}\nexposure_s = {exposure}\niso = {iso:g}\n"
    return text


def test_calibration_measures_gain_and_read_noise_at_each_iso_speed(
    bayer: CameraModel, tmp_path: Path, l3: L3, refused: Refused
) -> None:
    noise = dataclasses.replace(bayer.noise, read_noise=4.0, dark_current=0.0, well_capacity=1e5)
    camera = dataclasses.replace(bayer, noise=noise, gains=AnalogGains(np.array([8.0]), np.array([1.5]), 100.0))
    rows = "\n".join(f"{nm},{1 if nm < 500 else 0.5},{0.4 if nm < 500 else 1},0.3" for nm in range(400, 701, 10))
    (tmp_path / "curves.csv").write_text(f"wavelength_nm,r,g,b\n{rows}\n")
    pattern = [" ".join(camera.channels[site] for site in row) for row in camera.cfa]
    head = (
        f'name = "gains"\n[sensor]\nrows = {camera.rows}\ncols = {camera.cols}\npixel_pitch_um = 5.0\nbits = {camera.bits}\n'
        f"[optics]\nfocal_length_mm = 25.0\nf_number = 2.8\n[cfa]\nchannels = {list(camera.channels)}\n"
        f'pattern = {pattern}\n[curves]\nfile = "curves.csv"\n'
    )
    path = tmp_path / "MEASUREMENTS.toml"
    path.write_text(head + lab_at_speeds(tmp_path, camera, {100.0: 1.0, 800.0: 8.0}))
    code, out, err = l3("calibrate", path, "-o", tmp_path / "camera.h5")
    assert code == 0, err
    assert re.search(r"gain 8\.?\d* +2\.", out)
    made = load(CameraModel, tmp_path / "camera.h5")
    assert made.gains is not None
    assert made.gains.iso == 100
    np.testing.assert_allclose(made.gains.analog_gain, [8.0], rtol=0.03)
    np.testing.assert_allclose(made.gains.gain_read_noise, [1.5], rtol=0.05)
    assert made.noise.read_noise == pytest.approx(4.0, rel=0.05)

    path.write_text(path.read_text().replace("iso = 800", "iso = 1600"))
    assert "8.02" in refused(3, "calibrate", path, "-o", tmp_path / "no.h5")
    path.write_text(path.read_text().replace("iso = 100\n", ""))
    assert "iso" in refused(2, "calibrate", path, "-o", tmp_path / "no.h5")


def test_transforms_at_a_gain_are_those_of_as_much_noise_beside_the_signal(several: TransformTable) -> None:
    """At a gain that is the ratio of two levels each class has the transforms of the level below, where nothing clips;
    edges that follow noise grow with it. Lower gains are its transforms for less noise."""
    assert at_gain(several, 1.0) is several
    assert several.camera is not None
    rule = several.first.rule
    middles = level.centres(level.inner_bounds(rule, several.black_level, several.white_level))
    gain = float(middles[2] / middles[1])
    made = at_gain(several, gain)
    place = rule.split(np.arange(len(several.first.weights)))
    plain, clipped = (place.level == 2) & (place.kind < rule.chromas), place.kind >= rule.chromas
    below = several.first.weights[np.flatnonzero(plain) - rule.contrasts * rule.combinations * rule.kinds]
    np.testing.assert_allclose(made.first.weights[plain], below, atol=0.01 * np.abs(below).max())  # but for rounding to DN
    np.testing.assert_array_equal(made.first.weights[clipped], several.first.weights[clipped])
    edges, before = (each.first.rule.feature_list[0].constants[-rule.levels :] for each in (made, several))
    np.testing.assert_allclose(edges[2], gain * before[1], rtol=0.01)
    assert made.output_unit == pytest.approx(several.output_unit / gain)
    assert equal(made.camera, several.camera.at_gain(gain))

    high = at_gain(several, 16.0)
    left = [each.noise.noise_left for each in high.conditions if each.noise]
    assert left == pytest.approx([1 / 16, 4 / 16, 0.1 / 16])
    assert equal(high.under(high.conditions[0]).first, several.first)
    assert equal(high.under(high.conditions[1]).first, at_gain(several, 4.0).first)


def test_refinement_of_the_dark_is_that_of_signals_of_twice_the_noise(several: TransformTable) -> None:
    """Between two levels; the first layer is that of the darkest level."""
    assert several.camera is not None
    rule = several.first.rule
    middles = level.centres(level.inner_bounds(rule, several.black_level, several.white_level))
    noise = contrast.noise_of_grey(middles, several.camera, several.camera.dark_signal(several.exposure))
    ratios = np.sqrt(noise) / middles / (several.white_level - several.black_level)
    above = int(np.argmax(ratios < 1 / 2))
    share = (ratios[above - 1] - 1 / 2) / (ratios[above - 1] - ratios[above])
    made, later = at_gain(several, 16.0), several.later[0]
    place = later.rule.split(np.arange(len(later.weights)))
    each = [np.flatnonzero((place.level == one) & (place.kind < later.rule.structures)) for one in (0, above - 1, above)]
    mixed = (1 - share) * later.weights[each[1]] + share * later.weights[each[2]]
    np.testing.assert_allclose(made.later[0].weights[each[0]], mixed, atol=1e-3 * np.abs(mixed).max())
    there = rule.split(np.arange(len(several.first.weights)))
    darkest = (there.level == 0) & (there.kind < rule.chromas)
    np.testing.assert_allclose(made.first.weights[darkest], several.first.weights[darkest], rtol=1e-6)


def test_transforms_that_an_older_table_has_for_gains_do_not_count(several: TransformTable) -> None:
    four = at_gain(several, 4.0)
    old = Condition.of(four.first, four.later, None, NoiseScale(4.0))
    table = dataclasses.replace(several, conditions=(old, *several.conditions))
    for gain in (4.0, 16.0):
        assert equal(at_gain(table, gain), at_gain(several, gain))


def test_transforms_exist_at_every_gain(several: TransformTable) -> None:
    for gain in np.geomspace(1 / 1024, 1024, 9).tolist():
        for layer in at_gain(several, gain).layers:
            assert np.isfinite(layer.weights).all()
            assert np.isfinite(layer.intercept).all()
            assert np.abs(layer.weights).max() > 0


def test_a_table_for_its_gain_is_better_than_one_for_another(gain_tables: Path, several: TransformTable) -> None:
    """And nearly as good as one that is learned for that gain alone, at twice less, too."""
    tables = {name: load(TransformTable, gain_tables / f"{name}.h5") for name in ("one", "at16")}
    error: dict[tuple[str, int], float] = {}
    for gain in (8, 16):
        with open_training_set(gain_tables / f"set{gain}.h5") as reader:
            frame, camera = reader.frame(0), reader.head.camera
        raw = RawFrame("frame", frame.raw, camera.black_level, camera.white_level)
        target = frame.target * np.float32(frame.exposure / camera.output_unit)
        for name, table in (*tables.items(), ("several", at_gain(several, gain))):
            outputs = ReferenceRenderer(table).outputs(raw)
            error[name, gain] = float(np.mean((outputs - target)[1, 4:-4, 4:-4] ** 2))
    assert error["several", 16] < 1.3 * error["at16", 16]  # which has seen that frame; measured: 1.26
    for gain in (8, 16):
        assert error["several", gain] < 0.8 * error["one", gain]


def test_frames_are_rendered_by_the_transforms_for_their_gain(several: TransformTable) -> None:
    values = np.random.default_rng(1).integers(300, 3000, (24, 40)).astype(np.uint16)
    frame = RawFrame("frame", values, several.black_level, several.white_level)
    renderer = NoiseRenderer("reference", several)
    for gain in (1.0, 4.0, 5.7, 16.0, 100.0):
        wanted = ReferenceRenderer(at_gain(several, nearest_step(gain))).outputs(frame)
        np.testing.assert_array_equal(renderer.outputs(dataclasses.replace(frame, gain=gain)), wanted)
    assert other_gain(dataclasses.replace(frame, gain=20.0), several) == ""
    for gain in (0.01, 64.0):
        assert "the read noise only for 1 to 16 times" in other_gain(dataclasses.replace(frame, gain=gain), several)
    assert "exceeds the black level (240 DN)" in other_gain(dataclasses.replace(frame, gain=256.0), several)
    unknown = dataclasses.replace(several, camera=None, conditions=())
    assert "does not contain the noise model of its camera" in other_gain(dataclasses.replace(frame, gain=4.0), unknown)
    assert other_gain(frame, unknown) == ""


def test_a_gain_that_changes_from_frame_to_frame_makes_no_step(several: TransformTable) -> None:
    """Of a scene that becomes half as bright while the gain is doubled: greys stay what they are, and noise grows as that of
    transforms for either gain does."""
    assert several.camera is not None
    assert several.light is not None
    rng, renderer, made = np.random.default_rng(3), NoiseRenderer("reference", several), {}
    white = white_signal(several.light, several.camera)
    signal = (0.4 * white / white.max()).astype(np.float32)[several.camera.channel_map((64, 64))]
    for gain in (1.0, 2.0, 4.0):
        values = expose_patches(signal, several.camera.at_gain(gain), rng).astype(np.uint16)
        frame = RawFrame("grey", values, several.black_level, several.white_level, gain=gain)
        made[gain] = renderer.outputs(frame)[1, 8:-8, 8:-8]
    means = [float(each.mean()) for each in made.values()]
    noises = [float(each.std()) for each in made.values()]
    assert max(means) < 1.01 * min(means)
    assert noises[0] < noises[1] < noises[2] < 2 * noises[0]


def test_a_filter_in_time_goes_on_where_the_gain_changes(several: TransformTable) -> None:
    """Of a grey whose gain doubles and falls, once with another exposure time: means follow the scene's, and noise is
    that of the filter, never of a frame alone; kernels agree on every value."""
    assert several.camera is not None
    rng, camera = np.random.default_rng(3), several.camera
    filtered: dict[str, list[RawFrame]] = {"reference": [], "opencl": []}
    makers = {backend: filters(backend, several)() for backend in filtered}
    raw_noise = []
    settings = [(1.0, 0.02)] * 24 + [(2.0, 0.02)] * 24 + [(1.0, 0.02)] * 12 + [(4.0, 0.005)] * 12
    for number, (gain, seconds) in enumerate(settings):
        light = 0.05 * seconds / 0.02 * np.ones((48, 48), np.float32)
        values = expose_patches(gain * light, camera.at_gain(gain), rng).astype(np.uint16)
        raw_noise.append(float(values.std()))
        frame = RawFrame(f"{number}", values, several.black_level, several.white_level, gain=gain, exposure=seconds)
        for backend, made in filtered.items():
            made.append(makers[backend].filtered(frame))
    for ours, theirs in zip(*filtered.values(), strict=True):
        np.testing.assert_array_equal(ours.values, theirs.values)
        assert ours.noise_left is not None
        assert theirs.noise_left is not None
        np.testing.assert_array_equal(ours.noise_left.shares, theirs.noise_left.shares)
    noise = [float(each.values.std()) for each in filtered["reference"]]
    pairs = zip(filtered["reference"], settings, strict=True)
    means = [(float(each.values.mean()) - several.black_level) / (gain * seconds) for each, (gain, seconds) in pairs]
    assert max(means[1:]) < 1.02 * min(means[1:])
    for change, settled in ((24, 47), (48, 59), (60, 71)):
        assert noise[change] < 1.5 * max(noise[settled], 0.3)
        assert noise[change] < 0.5 * raw_noise[change]
    left = [float(each.noise_left.shares.mean()) / each.noise_left.whole for each in filtered["opencl"] if each.noise_left]
    assert left[0] == 1
    assert max(left[20:]) < 0.15
    assert left[60] < 0.6 * left[59]  # as many DN of four times the noise variance


def test_automatic_exposure_follows_the_light_and_not_the_gain() -> None:
    exposure = SteadyExposure(Fraction(25))
    shown = [exposure.scale(0.5 * gain, gain) * 0.5 * gain for gain in (1.0, 1.0, 2.0, 16.0, 1.0)]
    assert shown == pytest.approx([1.0] * 5)


def test_pixels_that_a_filter_has_cleaned_take_the_transforms_for_lower_gains(several: TransformTable) -> None:
    """At a gain of 4, where a sixteenth of its noise is left, those for the camera's own, of a table of no other sets."""
    alone = dataclasses.replace(several, conditions=())
    values = np.random.default_rng(1).integers(300, 3000, (24, 40)).astype(np.uint16)
    left = NoiseLeft(np.full((6, 10), 64, np.uint16), 1024, (4, 4))
    frame = RawFrame("cleaned", values, alone.black_level, alone.white_level, gain=4.0, noise_share=0.25, noise_left=left)
    made = NoiseRenderer("reference", alone).outputs(frame)
    own = dataclasses.replace(frame, gain=1.0, noise_share=1.0, noise_left=None)
    np.testing.assert_array_equal(made, NoiseRenderer("reference", alone).outputs(own))


@given(st.floats(1 / 1000, 1000.0))
def test_gains_are_rendered_within_three_percent(gain: float) -> None:
    assert nearest_step(gain) == pytest.approx(gain, rel=0.03)
    assert nearest_step(nearest_step(gain)) == nearest_step(gain)


def test_a_frame_that_is_exposed_again_has_the_noise_of_its_seed() -> None:
    camera = load_camera(BAYER)
    frame = a_frame(camera, 1, smooth=True)
    once, again, other = (
        exposed_again(each, camera, 4.0).raw for each in (frame, frame, dataclasses.replace(frame, seed=(0, 2)))
    )
    assert (once == again).all()
    assert (once != other).any()
