"""Channels with different exposures or gains: recipe, readout, classes, kernels, baselines and calibration."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from l3cli.artifacts.camera import CameraModel, Readout
from l3cli.artifacts.camera_recipe import ChannelRecipe, channel_faults, load_camera, readout_of, settings_of
from l3cli.artifacts.layers import PLANE_STEP, PLANE_TOP
from l3cli.artifacts.store import load, save
from l3cli.artifacts.training_set import TrainingFrame
from l3cli.calibration import model
from l3cli.classes.contrast import noise_of_grey
from l3cli.classes.decide import label_mosaic
from l3cli.classes.features import ClassRecipe
from l3cli.classes.level import clipped_mean, stored_edges, unclipped_level
from l3cli.classes.rule import make_rule
from l3cli.classes.saturation import choose_cases, spared_cases
from l3cli.errors import InputFileError, RecipeError
from l3cli.evaluation.basic import least_sensitive, merged, merges, most_sensitive
from l3cli.frames.frame import RawFrame
from l3cli.frames.measurement import Body
from l3cli.physics import spectra
from l3cli.rendering.opencl.renderer import OpenCLRenderer
from l3cli.rendering.reference import ReferenceRenderer
from l3cli.simulation.sensor import expose
from l3cli.training.highlights import grey_patches
from l3cli.training.recipe import LayerRecipe, TrainingRecipe, for_camera
from l3cli.training.sums import empty_sums
from tests.helpers.calls import Refused
from tests.helpers.cameras import random_camera
from tests.helpers.paths import CONFIGS
from tests.helpers.tables import random_table, with_first, with_refinement

CFA = [[0, 0, 2, 2], [1, 1, 3, 3], [2, 2, 0, 0], [3, 3, 1, 1]]  # channels 0 and 2 behind one filter, 1 and 3 behind another
FILTERS = (0, 1, 0, 1)


def camera(exposure: float = 1 / 16, gain: float = 1.0, bits: int = 12) -> CameraModel:
    """Two filters, each with a channel as it is and one that is exposed and amplified apart."""
    readout = Readout(
        channel_exposure=np.array([1.0, 1.0, exposure, exposure]),
        channel_gain=np.array([1.0, 1.0, gain, gain]),
        channel_read_noise=np.array([5.0, 5.0, 2.0, 2.0]),
        same_filter=np.array(FILTERS),
    )
    plain = random_camera(CFA, 4, bits, 64.0)
    noise = replace(plain.noise, well_capacity=1e6, dark_current=0.0)
    return replace(plain, rows=400, cols=400, noise=noise, readout=readout)


# ------------------------------------------------------------------------------------------------ recipe and model


def test_a_recipe_s_channels_come_into_the_camera(tmp_path: Path) -> None:
    model = load_camera(recipe_of("quad_bayer_hdr"))
    assert model.readout is not None
    assert model.readout.channel_exposure.tolist() == [1, 1, 1, 1 / 16, 1 / 16, 1 / 16]
    np.testing.assert_array_equal(model.responsivity[3:], model.responsivity[:3])
    np.testing.assert_allclose(model.signal_weights[3:], model.signal_weights[:3] / 16)
    twin = load_camera(recipe_of("quad_bayer"))
    assert model.saturation_exposure == pytest.approx(twin.saturation_exposure)
    save(model, tmp_path / "camera.h5")
    assert load(CameraModel, tmp_path / "camera.h5").sensitivity.tolist() == model.sensitivity.tolist()


def recipe_of(name: str) -> Path:
    return Path(__file__).parents[2] / "configs/cameras" / f"{name}.toml"


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("exposure = 0.0625", "exposure = 16.0", "channel.rs.exposure is 16.0; use at most 1"),
        ('like = "r"', 'like = "x"', '"x" is not a channel of cfa.channels'),
        ('like = "r"', 'like = "rs"', 'is "rs", a channel without its own curve'),
        ("[channel.rs]", "[channel.rz]", '"rz" is not a channel of cfa.channels'),
        ("exposure = 0.0625", "gain = 0.5", "channel.rs.gain is 0.5; use at least 1"),
        ("exposure = 0.0625", "exposures = 0.5", "exposures"),
    ],
)
def test_wrong_channels_are_refused_in_a_line(old: str, new: str, message: str, tmp_path: Path, refused: Refused) -> None:
    (tmp_path / "camera.toml").write_text(recipe_of("quad_bayer_hdr").read_text().replace(old, new, 1))
    error = refused(2, "simulate", "small", "--camera", tmp_path / "camera.toml", "-o", tmp_path / "set.h5")
    assert message in error
    assert error.count("\n") <= 1


def test_no_longest_exposure_is_a_fault() -> None:
    channel = {"a": ChannelRecipe(exposure=0.5), "b": ChannelRecipe(exposure=0.25)}
    assert "no channel has the exposure 1" in next(iter(channel_faults(channel, ["a", "b"]))).message


# ----------------------------------------------------------------------------------------------------------- sensor


def test_channels_clip_and_scatter_separately() -> None:
    model = camera(1 / 8, 2.0)
    electrons = np.full((400, 400), 0.8 * model.full_scale, np.float32)  # of the long channels
    short = model.channel_map(electrons.shape) >= 2
    electrons[short] /= 8
    frame = expose(model, 2 * electrons, 0.01, np.random.default_rng(1))  # twice as bright as the long channels hold
    assert (frame[~short] == model.white_level).mean() > 0.99
    seen = frame[short].astype(np.float64) - model.black_level
    expected = 2.0 * model.gain * 2 * electrons[short][0]
    assert seen.mean() == pytest.approx(expected, rel=2e-3)
    noise = model.noise_variance(np.array(expected), channel=np.array(2))
    assert seen.var() == pytest.approx(float(noise), rel=0.03)
    assert noise > 1.5 * model.noise_variance(np.array(expected))  # than at the gain of the others


# ---------------------------------------------------------------------------------------------------------- classes


def test_the_level_of_clipped_channels_is_reported_by_the_others() -> None:
    model = camera(1 / 16)
    share = np.geomspace(1e-3, 15.9, 50)
    means = clipped_mean(share, model.sensitivity)
    np.testing.assert_allclose(unclipped_level(means, model.sensitivity), share * model.sensitivity.mean(), rtol=1e-9)
    assert (np.diff(stored_edges(share, model, 0).astype(int)) > 0).all()
    alike = np.ones(4)
    assert unclipped_level(share, alike) is share
    noise = noise_of_grey(np.array([0.5, 2.0]), model, 0.0)
    span = model.white_level - model.black_level
    one = model.noise_variance(np.array(2.0 / 16 * span), channel=np.array(2))
    assert noise[1] == pytest.approx(float(one) / 2)  # half of the channels are clipped, and have none
    learning = for_camera(TrainingRecipe(), model).learning
    assert learning.brightest == pytest.approx(2.5 * 16 * model.sensitivity.mean())
    with pytest.raises(RecipeError, match=r"differ by a factor of 32.*use a class recipe with one layer"):
        for_camera(TrainingRecipe(layer=(LayerRecipe(),)), camera(1 / 32))
    for_camera(TrainingRecipe(layer=(LayerRecipe(),)), camera(1 / 16))
    with pytest.raises(RecipeError, match=r"differ by a factor of 8.*at most 4; use a class recipe with two layers"):
        for_camera(TrainingRecipe(layer=(LayerRecipe(), LayerRecipe())), camera(1 / 8))  # of which 16-bit planes hold a half


def test_planes_hold_four_times_what_fills_the_least_sensitive_channel() -> None:
    for exposure in (1 / 16, 1 / 8, 1 / 4, 0.9):
        model = camera(exposure)
        assert (PLANE_TOP + 1) * PLANE_STEP * model.output_unit >= 4 * model.saturation_exposure / model.sensitivity.min()
    assert camera(1 / 4).output_unit == model.output_unit == model.saturation_exposure


@pytest.mark.parametrize(
    ("name", "asked", "radius"), [("nona_bayer_hdr", 2, 3), ("quad_bayer_hdr", 2, 2), ("nona_bayer_hdr", 0, 0)]
)
def test_every_site_sees_every_channel_clip(name: str, asked: int, radius: int) -> None:
    model = load_camera(recipe_of(name))
    rule = make_rule(ClassRecipe(patch=9, saturation_radius=asked), model, np.arange(64, dtype=np.uint16))
    assert rule.saturation_radius == radius
    clipped = np.full((24, 24), model.white_level, np.uint16)
    cases = rule.case(rule.split(label_mosaic(clipped, rule, model.cfa, 6) % rule.classes_per_site).kind)
    assert (np.unique(cases).size == 1) == (radius > 0)


def test_a_filter_is_lost_only_where_all_its_channels_clip() -> None:
    occurrences = np.zeros(16, np.int64)
    occurrences[[0b0000, 0b0001, 0b0011, 0b0101, 0b1111]] = 1000, 100, 100, 100, 100
    cases = choose_cases(occurrences, 12, FILTERS)
    assert cases[[0b0001, 0b0011]].tolist() == [1, 2]
    assert spared_cases(cases, FILTERS) == 2
    lost = [code for code in range(16) if code & 0b0101 == 0b0101 or code & 0b1010 == 0b1010]
    assert cases[lost].min() > 2
    assert cases[[code for code in range(16) if code not in lost]].max() == 2
    assert spared_cases(choose_cases(occurrences, 12), range(4)) == 0


def test_greys_are_taught_by_the_filters_that_are_lost() -> None:
    model = camera(1 / 16)
    cases = choose_cases(np.full(16, 100), 16, FILTERS)
    rule = make_rule(ClassRecipe(patch=5, levels=8), model, cases, spared_cases=spared_cases(cases, FILTERS))
    window = model.channel_map((5, 5)).ravel().astype(np.int64)
    signal = np.array([1.0, 0.8, 1 / 16, 0.05])
    sums, levels = empty_sums(rule, 3, model), (model.black_level, model.white_level)
    taught = grey_patches(sums, rule, window, np.ones(3), *levels, signal, FILTERS, model.sensitivity)
    kinds = rule.split(np.array(sorted(taught))).kind
    assert (rule.lost(kinds) == 0).any()
    assert (rule.lost(kinds) > 0).any()


def test_kernels_agree_with_the_reference() -> None:
    model, rng = camera(1 / 16), np.random.default_rng(5)
    table = random_table(np.asarray(CFA, np.uint8), bits=12, black_level=64.0)
    cases = choose_cases(np.full(16, 100), 6, FILTERS)
    rule = make_rule(ClassRecipe(patch=5, levels=8, chromas=1), model, cases, spared_cases=spared_cases(cases, FILTERS))
    classes = table.cfa.size * rule.classes_per_site
    weights = rng.normal(size=(classes, 3, 25)).astype(np.float32) / 5
    table = with_first(
        table,
        rule=rule,
        weights=weights,
        intercept=np.zeros((classes, 3), np.float32),
        samples=np.ones(classes),
        condition=np.ones(classes, np.float32),
    )
    table = with_refinement(replace(table, camera=model), 3)
    assert table.later[0].rule.cases == rule.cases - rule.spared_cases
    light = np.exp(rng.normal(0.0, 1.5, (60, 70))) * model.full_scale / 2
    light *= model.sensitivity[model.channel_map(light.shape)]
    frame = RawFrame("frame", expose(model, light, 0.01, rng), 64.0, model.white_level)
    reference, kernel = ReferenceRenderer(table), OpenCLRenderer(table)
    label = label_mosaic(frame.values, rule, table.cfa, 4)
    kinds = rule.split(label).kind
    assert ((rule.case(kinds) > 0) & (rule.lost(kinds) == 0)).mean() > 0.1
    np.testing.assert_array_equal(kernel.labels(frame), reference.labels(frame))
    np.testing.assert_allclose(kernel.outputs(frame), reference.outputs(frame), atol=1e-3)


# -------------------------------------------------------------------------------------------------------- baselines


def test_exposures_are_merged_without_what_clips() -> None:
    model, rng = camera(1 / 16), np.random.default_rng(3)
    level = np.full((40, 40), 4.0 * model.full_scale)
    level[:, :20] = 0.4 * model.full_scale
    electrons = level * model.sensitivity[model.channel_map(level.shape)]
    raw = expose(model, electrons, 0.01, rng)
    frame = TrainingFrame(
        electrons=np.zeros((4, 40, 40), np.float32), raw=raw, target=np.zeros((3, 40, 40), np.float32),
        white=np.ones(3), scene="s", illuminant="D65", luminance=1.0, exposure=0.01, seed=(0,),
    )  # fmt: skip
    balance = 1 / (model.full_scale * model.sensitivity)
    clipped = np.minimum(level, model.full_scale) / model.full_scale
    planes = np.stack([clipped, clipped, level / model.full_scale, level / model.full_scale])
    whole = merged(planes, frame, model, balance)
    np.testing.assert_allclose(whole[:, :, :14], 0.4, rtol=1e-6)
    np.testing.assert_allclose(whole[:, :, 26:], 4.0, rtol=1e-6)
    assert most_sensitive(planes, frame, model, balance)[:, 0, -1].tolist() == [1.0] * 4
    assert least_sensitive(planes, frame, model, balance)[:, 0, -1].tolist() == [4.0] * 4
    assert list(merges(model)) == ["basic", "long", "short"]
    assert list(merges(camera(1.0, 8.0))) == ["basic", "high gain", "low gain"]
    assert list(merges(replace(model, readout=None))) == ["basic"]


# ------------------------------------------------------------------------------------------------------ calibration


def a_body(model: CameraModel) -> Body:
    return Body("b", 400, 400, 5e-6, 12, model.channels, model.cfa, model.optics, model.readout)


def test_settings_that_frames_contradict_are_refused() -> None:
    body, error = a_body(camera(0.25, 4.0)), np.full(4, 0.001)
    model.check_gains(np.array([0.2, 0.2, 0.8, 0.8]), error, body)
    with pytest.raises(InputFileError, match=r"a relative gain of 2 for channel x?\w+, .* correct .channel\.\w+\.gain"):
        model.check_gains(np.array([0.2, 0.2, 0.4, 0.8]), error, body)
    curves = np.ones((4, 5))
    model.check_exposures(curves, body)
    curves[2] *= 2
    with pytest.raises(InputFileError, match=r"relative exposure time of channel b is 0\.5"):
        model.check_exposures(curves, body)


def test_a_measurement_file_reports_the_settings_back() -> None:
    model = camera(0.25, 4.0)
    keys = settings_of(model.readout, model.channels)
    assert list(keys) == [model.channels[2], model.channels[3]]
    again = readout_of(keys, model.channels, 5.0)
    assert again is not None
    assert model.readout is not None
    for name in ("channel_exposure", "channel_gain", "same_filter"):
        np.testing.assert_array_equal(getattr(again, name), getattr(model.readout, name))


def test_an_amplified_channel_gives_as_many_times_the_signal() -> None:
    """And fills its range at as much less light: white fills the brightest channel at the saturation exposure."""
    camera = load_camera(CONFIGS / "cameras/dual_iso.toml")
    usual, amplified = (camera.channels.index(name) for name in ("g", "gh"))
    np.testing.assert_allclose(camera.signal_weights[amplified], 16 * camera.signal_weights[usual])
    white = spectra.at_luminance(spectra.illuminant("D65", camera.wavelength), camera.wavelength, camera.saturation_exposure)
    signals = camera.signal_weights @ white
    assert signals.argmax() == amplified
    assert signals.max() == pytest.approx(camera.full_scale)
