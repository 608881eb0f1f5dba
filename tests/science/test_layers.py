"""Training of a second layer: recovery of known filters, greys, and sums that do not depend on the division of work."""

import dataclasses
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
from numpy.typing import NDArray

from l3cli.artifacts.camera import CameraModel
from l3cli.artifacts.layers import PLANE_STEP, PLANES, RATIO_TAPS, PlaneLayer
from l3cli.artifacts.partial_sums import LayerSums
from l3cli.artifacts.plane_rules import StructureRule
from l3cli.artifacts.store import load
from l3cli.artifacts.table import TransformTable
from l3cli.artifacts.training_set import open_training_set, white_signal
from l3cli.classes.refinement import label_planes, taps_behind
from l3cli.errors import L3Error
from l3cli.frames.frame import RawFrame
from l3cli.physics.display import lab
from l3cli.recipes.load import load_recipe
from l3cli.rendering.reference import ReferenceRenderer
from l3cli.training.layers.coarse_chroma import LUMINANCES, measured_noise
from l3cli.training.layers.learn import FADED_RESPONSE, LayerPass, add_sums, learn_layer, no_sums, sum_layer
from l3cli.training.layers.mosaics import Seen, mosaics_of, sheets_of
from l3cli.training.layers.rules import gradient_scale, structure_rule
from l3cli.training.layers.samples import GatheredSamples, require_exact, sample_weights
from l3cli.training.recipe import LayerRecipe, LearningRecipe, TrainingRecipe
from l3cli.training.sample_weighting import TARGET_FLOOR
from l3cli.training.sums import PRODUCT_STEP
from l3cli.training.symmetry import orientations, turned_structures
from l3cli.training.table import layer_pass
from tests.helpers.artifacts import a_table
from tests.helpers.calls import L3, Refused
from tests.helpers.paths import CONFIGS
from tests.helpers.training_sets import a_frame, a_set

SIDE = 3
LAYER = "[classes]\npatch = 3\nlevels = 4\n[learning]\npatches = 3000\nfirst_draws = 0\ndraws = 2\n[[layer]]\nside = 3\n"
LEAVES = 'exposure_share = [0.9]\n[[scene]]\nsource = "dead leaves"\nsize = [64, 64]\ncount = 6\n'
UNSPREAD: dict[str, Any] = {"level_pool": (), "parent_patches": 0, "ridge": 1e-9}
# Filters (plane of the output, plane, tap) that answer a white with a white, and turned are others.
TRUTH = np.random.default_rng(3).normal(0, 0.2, (3, 3, SIDE**2))
TRUTH[:, 1, -1] += np.array([0.0, 1.0, 0.0]) - TRUTH[:, 1].sum(axis=-1)


def a_pass(bayer: CameraModel, **recipe: Any) -> LayerPass:
    table = dataclasses.replace(a_table(bayer), camera=bayer)
    layer = LayerRecipe(side=SIDE, **{"rows": 900, **recipe})
    settings = TrainingRecipe(layer=(layer,), learning=LearningRecipe(symmetry=False, darkest=0.003))
    return layer_pass(table, settings, (2,) * 6, seed=1)


def a_rule(layer: LayerPass) -> StructureRule:
    """A rule as if nothing were known of the noise."""
    return structure_rule(layer, gradient_scale(layer, []))


def filtered(planes: NDArray, truth: NDArray = TRUTH) -> NDArray[np.float32]:
    """What filters make (row, col, output) of planes (plane, row, col), zero at the edges."""
    rows, cols = planes.shape[1:]
    made = np.zeros((rows, cols, len(truth)), np.float32)
    windows = np.lib.stride_tricks.sliding_window_view(planes * PLANE_STEP, (SIDE, SIDE), axis=(1, 2))
    made[1:-1, 1:-1] = np.einsum("opt,prct->rco", truth, windows.reshape(*windows.shape[:3], -1))
    return made


AFTER = np.random.default_rng(4).normal(0, 0.3, (3, RATIO_TAPS[-1]))  # behind windows (plane of the output, tap)


def known_sums(layer: LayerPass, rule: StructureRule, noise: float) -> dict[int, LayerSums]:
    """Sums of a random mosaic whose targets are made by TRUTH, seen with `noise` (planes' steps), classes at random."""
    rng = np.random.default_rng(7)
    shape = (240, 260)
    clean = rng.normal(0, 2000, (3, *shape)).round().astype(np.float32)
    noisy = (clean + noise * rng.standard_normal(clean.shape)).round().astype(np.int32)
    planes = filtered(clean)
    behind = np.moveaxis(taps_behind(clean, SIDE, layer.recipe.ratio_taps), 0, -1) * PLANE_STEP
    planes += (behind @ AFTER[:, : layer.recipe.ratio_taps].T).astype(np.float32)
    target = planes @ np.linalg.inv(layer.basis).astype(np.float32)
    site = np.arange(shape[0])[:, None] % 2 * 2 + np.arange(shape[1]) % 2
    label = rule.join(rng.integers(0, rule.levels, shape), rng.integers(0, rule.kinds, shape), site)
    ones = np.ones(shape, np.float32)
    seen = Seen(1, target, np.zeros(shape, np.int64), ones, noisy, clean)
    sums = no_sums(layer, rule)
    gathered = GatheredSamples(sums, rule, layer.reading(SIDE), layer.basis, layer.grid_steps(rule))
    gathered.add(seen, label, seen.inner_pixels(layer.margin), ones)
    gathered.add_up()
    return sums


def in_planes(layer: LayerPass, learned: PlaneLayer) -> NDArray[np.float64]:
    """Filters (class, plane of the output, plane, tap)."""
    weights = np.einsum("cot,op->cpt", learned.weights[..., : learned.window_taps].astype(np.float64), layer.basis)
    return weights.reshape(len(weights), 3, 3, -1)


def test_a_known_filter_is_learned(bayer: CameraModel) -> None:
    """In every class of every site, saturated or not, whatever noise there is if noise does not count."""
    for noise in (0.0, 500.0):
        layer = a_pass(bayer, luminance_noise=0, chroma_noise=0, **UNSPREAD)
        rule = a_rule(layer)
        learned = learn_layer(layer, rule, known_sums(layer, rule, noise))
        assert (learned.samples > 60).all()
        assert in_planes(layer, learned) == pytest.approx(np.broadcast_to(TRUTH, (len(learned.weights), 3, 3, 9)), abs=1e-3)
        assert np.abs(learned.intercept).max() < 1e-3


def test_what_outputs_lack_is_learned_beside_noise(bayer: CameraModel) -> None:
    """That filters make both of planes and of their noise, which the outputs have, too; a white lacks nothing."""
    layer, rng = a_pass(bayer, luminance_noise=1, **UNSPREAD), np.random.default_rng(5)
    table = a_table(bayer)
    layer = dataclasses.replace(layer, outputs=table.first, basis=rng.normal(size=(5, PLANES)), pictures=False)
    truth = rng.normal(0, 0.2, (5, PLANES, SIDE**2))
    truth[:, 1, -1] -= truth[:, 1].sum(axis=-1)
    rule, shape = a_rule(layer), (240, 260)
    clean, noise = (rng.normal(0, size, (PLANES, *shape)).round().astype(np.float32) for size in (2000, 700))
    site = np.arange(shape[0])[:, None] % 2 * 2 + np.arange(shape[1]) % 2
    label = rule.join(rng.integers(0, rule.levels, shape), rng.integers(0, rule.kinds, shape), site)
    none, ones = np.zeros(shape, np.int64), np.ones(shape, np.float32)
    noisy, missing, spread = (clean + noise).astype(np.int32), filtered(clean, truth), -filtered(noise, truth)
    seen = Seen(1, np.zeros((*shape, 5), np.float32), none, ones, noisy, clean, missing, spread)
    sums = no_sums(layer, rule)
    gathered = GatheredSamples(sums, rule, layer.reading(SIDE), layer.basis, layer.grid_steps(rule))
    gathered.add(seen, label, seen.inner_pixels(layer.margin), ones)
    gathered.add_up()
    learned = learn_layer(layer, rule, sums).weights
    assert learned == pytest.approx(np.broadcast_to(truth.reshape(5, -1), learned.shape), abs=1e-3)


@pytest.mark.parametrize("bilateral", [False, True])
def test_so_is_what_light_and_shade_and_pixels_alike_make_of_chroma(bayer: CameraModel, bilateral: bool) -> None:
    """Beside the filters; flat areas are answered alike by all sites, whatever it weighs."""
    kinds = {"colour_ratios": True, "bilateral_chroma": bilateral}
    layer = a_pass(bayer, luminance_noise=0, chroma_noise=0, **kinds, **UNSPREAD)
    rule = a_rule(layer)
    learned = learn_layer(layer, rule, known_sums(layer, rule, 300.0))
    assert learned.ratio_taps == RATIO_TAPS[1 + bilateral]
    assert in_planes(layer, learned) == pytest.approx(np.broadcast_to(TRUTH, (len(learned.weights), 3, 3, 9)), abs=2e-3)
    after = np.einsum("cot,op->cpt", learned.weights[..., learned.window_taps :].astype(np.float64), layer.basis)
    assert after == pytest.approx(np.broadcast_to(AFTER[:, : learned.ratio_taps], after.shape), abs=2e-3)


def test_mosaics_are_seen_together_as_each_by_itself(bayer: CameraModel) -> None:
    """With a layer between, too; and their rows add up to those of each, but for how products of float32 are rounded."""
    layer, frames = a_pass(bayer), [a_frame(bayer, seed, smooth=False) for seed in range(2)]
    rule = a_rule(layer)
    between = learn_layer(layer, rule, sum_layer(layer, rule, [(0, frames)]))
    layer = dataclasses.replace(layer, before=(between,))
    see, several = layer.seer(), [each for frame in frames for each in mosaics_of(frame, 2, layer.exposed, layer.rng(0, 0))]
    (joined,) = sheets_of(several, 2)
    assert [each.count for each in sheets_of(several, 7)] == [1] * 4  # not of whole periods
    jointly, isolated = see(joined), list(map(see, several))
    for name, axis in (("label", 0), ("brightness", 0), ("noisy", 1), ("clean", 1), ("target", 0)):
        each = np.concatenate([getattr(one, name) for one in isolated], axis=axis)
        np.testing.assert_allclose(getattr(jointly, name), each, rtol=1e-5, atol=0.01 if name == "clean" else 0)
    sums = []
    for parts in ([jointly], isolated):
        sums.append(no_sums(layer, rule))
        gathered = GatheredSamples(sums[-1], rule, layer.reading(SIDE), layer.basis, layer.grid_steps(rule))
        for seen in parts:
            label = label_planes(seen.noisy, seen.label, rule, layer.rule)
            weight = sample_weights(seen, layer.basis, layer.white_point, layer.learning, True)
            gathered.add(seen, label, seen.inner_pixels(layer.margin), weight)
        gathered.add_up()
    for site, one in sums[0].items():
        assert (one.count == sums[1][site].count).all()
        for ours, theirs in ((one.moments, sums[1][site].moments), (one.noise, sums[1][site].noise)):
            assert (np.abs(ours - theirs) <= 1e-5 * np.abs(theirs).max(axis=1, keepdims=True) + 1e-6).all()


def test_noise_that_does_not_count_is_not_summed_up(bayer: CameraModel) -> None:
    """The other sums are the same; where there is none and nothing is rescaled, the layer learns from what rendering makes
    of the values."""
    frames, sums = [a_frame(bayer, seed, smooth=False) for seed in range(2)], []
    for weight in (1.0, 0.0):
        layer = a_pass(bayer, luminance_noise=weight, chroma_noise=weight)
        sums.append(sum_layer(layer, a_rule(layer), [(0, frames)]))
    for site, one in sums[0].items():
        np.testing.assert_array_equal(one.moments, sums[1][site].moments)
        np.testing.assert_array_equal(one.count, sums[1][site].count)
        assert one.noise.any() > sums[1][site].noise.any()
    unscaled = msgspec.structs.replace(layer.learning, rescale=False)
    exposed = dataclasses.replace(layer.exposed, noisy=False)
    assert next(mosaics_of(frames[0], 1, exposed, np.random.default_rng(0))).clean is not None
    exposed = dataclasses.replace(exposed, recipe=unscaled)
    for mosaic in sheets_of(mosaics_of(frames[0], 2, exposed, np.random.default_rng(0)), 2):
        seen = layer.seer()(mosaic)
        exact = layer.seer()(dataclasses.replace(mosaic, clean=mosaic.values.astype(np.float32)))
        assert seen.clean is None
        np.testing.assert_array_equal(seen.light, exact.noisy)
        np.testing.assert_allclose(seen.light, exact.light, rtol=0, atol=1)


def test_structures_turn_with_the_picture(bayer: CameraModel) -> None:
    rule = dataclasses.replace(a_rule(a_pass(bayer)), turns=np.ones((1, 2), np.int8))
    planes = np.random.default_rng(0).normal(0, 20, (3, 60, 60)).cumsum(axis=1).cumsum(axis=2).astype(np.int32)
    first, first_rule = np.zeros((60, 60), np.int64), a_pass(bayer).rule
    labels = label_planes(planes, first, rule, first_rule)
    assert np.unique(labels).size > 8
    for number, turn in enumerate(orientations(60)):
        turned = label_planes(planes.reshape(3, -1)[:, turn].reshape(planes.shape), first, rule, first_rule)
        same = turned.ravel() == turned_structures(rule, number)[labels.ravel()[turn]]
        assert same.mean() > 0.98, number  # ties between directions


def test_a_layer_weighs_rows_by_its_own_powers_or_those_of_the_first(bayer: CameraModel) -> None:
    """Errors as they are, relative ones, and what the first layer does where it says nothing."""
    usual, own = a_pass(bayer), a_pass(bayer, brightness_power=1.0, error_power=0.0)
    assert usual.learning == LearningRecipe(symmetry=False, darkest=0.003)
    mosaic = next(mosaics_of(a_frame(bayer, 1, smooth=False), 1, own.exposed, np.random.default_rng(0)))
    seen = own.seer()(mosaic)
    weight = sample_weights(seen, own.basis, own.white_point, own.learning, True)
    relative = np.maximum(seen.target[..., 1], 0) / seen.brightness + TARGET_FLOOR
    assert weight == pytest.approx(1 / (relative * seen.brightness), rel=1e-5)
    ratio = weight / sample_weights(seen, usual.basis, usual.white_point, usual.learning, True)
    assert np.ptp(ratio) > 0.5 * ratio.mean()


def test_mosaics_without_any_error_leave_the_benchmark_sums_exact(bayer: CameraModel) -> None:
    """However many of them a seed draws: all rows of a site are white and of one class."""
    recipe = load_recipe(CONFIGS / "benchmarks/bayer/classes.toml", TrainingRecipe)
    layer = a_pass(bayer)
    rule, shape = a_rule(layer), (40, 40)
    planes = np.zeros((3, *shape), np.int32)
    planes[1] = round(1 / PLANE_STEP)
    target = (np.moveaxis(planes, 0, -1) @ np.linalg.inv(layer.basis) * PLANE_STEP).astype(np.float32)
    none = np.zeros(shape, np.int64)
    seen = Seen(1, target, none, np.ones(shape, np.float32), planes, planes.astype(np.float32))
    weight = sample_weights(seen, layer.basis, layer.white_point, recipe.learning, pictures=False)
    sums = no_sums(layer, rule)
    gathered = GatheredSamples(sums, rule, layer.reading(SIDE), layer.basis, layer.grid_steps(rule))
    gathered.add(seen, none, seen.inner_pixels(layer.margin), weight)
    gathered.add_up()
    wanted = max(each.mosaics * each.rows for each in recipe.layer) / 2  # of green, of whose sites both are learned as one
    whole = LayerSums(sums[0].moments * (wanted / sums[0].count.sum()), sums[0].noise, sums[0].count)
    require_exact(whole, rule, layer.grid_steps(rule))


def test_noise_counts_as_its_weight_states(bayer: CameraModel) -> None:
    """The more it counts the less of it is let through, and the farther are the filters from those that made the targets;
    luminance and chroma each by its weight."""
    power = []
    for weight in (0.0, 1.0, 10.0):
        layer = a_pass(bayer, luminance_noise=weight, chroma_noise=0, **UNSPREAD)
        rule = a_rule(layer)
        power.append((in_planes(layer, learn_layer(layer, rule, known_sums(layer, rule, 2000.0))) ** 2).sum(axis=(0, 2, 3)))
    assert power[0][1] > 1.3 * power[1][1] > 1.6 * power[2][1]
    assert power[2][[0, 2]] == pytest.approx(power[0][[0, 2]], rel=1e-3)


def test_plain_areas_keep_their_colour_where_chroma_comes_from_far_around(bayer: CameraModel) -> None:
    """In every unsaturated class that would fade it, however much noise weighs; the others are what they would be."""
    learned = []
    for coarse in (False, True):
        layer = a_pass(bayer, luminance_noise=5, chroma_noise=5, coarse_chroma=coarse, **UNSPREAD)
        rule = a_rule(layer)
        learned.append(in_planes(layer, learn_layer(layer, rule, known_sums(layer, rule, 2000.0))))
    free = rule.case(rule.split(np.arange(len(learned[0]))).kind) == 0
    before, after = (each.sum(axis=-1) for each in learned)  # (class, plane of the output, plane)
    for plane in (0, 2):
        fades = free & (before[:, plane, plane] < FADED_RESPONSE)
        assert fades.any()
        assert after[fades, plane] == pytest.approx(np.broadcast_to(np.eye(3)[plane], (fades.sum(), 3)), abs=1e-4)
        assert (learned[0][~fades, plane] == learned[1][~fades, plane]).all()


def test_noise_of_greys_is_measured(bayer: CameraModel) -> None:
    """That of the means falls from step to step, and rises with luminance by shot noise; twice the same."""
    layer = a_pass(bayer, coarse_chroma=True)
    variance = measured_noise(layer).variance
    assert (variance == measured_noise(layer).variance).all()
    at = np.exp(np.log(variance @ LUMINANCES ** np.arange(3.0)[:, None]).mean(axis=-1))  # (step, plane)
    assert (np.diff(at, axis=0) < 0).all()
    assert (at[0] > variance[0, :, 0]).all()


def test_white_is_answered_by_white(bayer: CameraModel) -> None:
    """Where nothing is saturated, even if the targets were something else."""
    layer = a_pass(bayer)
    rule = a_rule(layer)
    sums = known_sums(layer, rule, 300.0)
    for one in sums.values():
        one.moments[:] *= np.random.default_rng(0).normal(1.0, 0.01, one.moments.shape[1])
    filters = in_planes(layer, learn_layer(layer, rule, sums))
    free = rule.case(rule.split(np.arange(len(filters))).kind) == 0
    response = filters.sum(axis=-1)[free]  # (class, plane of the output, plane)
    assert response[:, :, 1] == pytest.approx(np.broadcast_to([0.0, 1.0, 0.0], (free.sum(), 3)), abs=1e-5)
    by_site = response.reshape(4, -1, 3, 3)
    assert by_site == pytest.approx(np.broadcast_to(by_site[:1], by_site.shape), abs=1e-5)  # flat areas alike at all sites


def test_sums_are_the_same_however_frames_are_divided(bayer: CameraModel) -> None:
    layer = a_pass(bayer)
    rule = a_rule(layer)
    frames = [a_frame(bayer, seed, smooth=False) for seed in range(6)]

    def summed(*parts: range) -> dict[int, LayerSums]:
        sums = no_sums(layer, rule)
        for part in parts:
            add_sums(sums, sum_layer(layer, rule, [(part.start, [frames[index] for index in part])]))
        return sums

    parts = range(4, 6), range(1), range(1, 4)
    whole, divided = summed(*sorted(parts, key=lambda part: part.start)), summed(*parts)
    steps = layer.grid_steps(rule)[rule.split(np.arange(rule.classes_per_site)).level]
    for site, sums in whole.items():
        for name in ("moments", "noise", "count"):
            assert (getattr(sums, name) == getattr(divided[site], name)).all()
        assert (sums.moments / steps == np.rint(sums.moments / steps)).all()
        assert (sums.noise / PRODUCT_STEP == np.rint(sums.noise / PRODUCT_STEP)).all()
        require_exact(sums, rule, layer.grid_steps(rule))
        huge = LayerSums(sums.moments * 2.0**40, sums.noise, sums.count)
        with pytest.raises(L3Error):
            require_exact(huge, rule, layer.grid_steps(rule))
    inner = layer.exposed.inner
    assert sum(sums.count.sum() for sums in whole.values()) >= 6 * 2 * inner**2 == 6 * 2 * 30**2


def test_greys_get_no_further_cast(bayer_recipe: Path, tmp_path: Path, l3: L3) -> None:
    """Uniform greys of the training light: what tint they have the first layer has given them."""
    training = tmp_path / "training.h5"
    (tmp_path / "scenes.toml").write_text(LEAVES)
    assert l3("simulate", tmp_path / "scenes.toml", "--camera", bayer_recipe, "-o", training)[0] == 0
    few = LAYER.replace("levels = 4", "levels = 4\nchromas = 3").replace("3000", "2000")
    (tmp_path / "classes.toml").write_text(few + "mosaics = 24\nrows = 2000\n")
    assert l3("train", training, "--classes", tmp_path / "classes.toml", "-o", tmp_path / "table.h5")[0] == 0
    table = load(TransformTable, tmp_path / "table.h5")
    assert table.camera is not None
    with open_training_set(training) as reader:
        light = reader.frame(0).light
        assert light is not None
        signal = white_signal(light, table.camera)
    assert signal is not None
    rng = np.random.default_rng(0)
    for level in (0.05, 0.2, 0.8):
        share = np.tile(signal[table.cfa] / signal.max() * level, (24, 24))
        values = np.floor(
            table.black_level + share * (table.white_level - table.black_level) + rng.random(share.shape)
        ).astype(np.uint16)
        chroma, luminance = [], []
        for each in (dataclasses.replace(table, later=()), table):
            outputs = ReferenceRenderer(each).exact_outputs(RawFrame("grey", values, table.black_level, table.white_level))
            mean = outputs[:, 6:-6, 6:-6].mean(axis=(1, 2))
            colour = lab(mean / mean[1], table.white_point)
            chroma.append(float(np.hypot(colour[1], colour[2])))
            luminance.append(mean[1])
        assert chroma[1] < 1.2 * chroma[0] + 0.1, level
        assert luminance[1] == pytest.approx(luminance[0], rel=2e-3)


def test_other_than_three_outputs_get_one_layer(tmp_path: Path, l3: L3) -> None:
    """In two passes where they are the camera's channels, whose spectral angles weigh the rows of the second."""
    training = tmp_path / "training.h5"
    (tmp_path / "scenes.toml").write_text(
        'exposure_share = [0.9]\n[[scene]]\nsource = "dead leaves"\nsize = [40, 40]\n[target]\noutputs = "camera"\n'
    )
    camera = CONFIGS / "cameras/fiveband.toml"
    assert l3("simulate", tmp_path / "scenes.toml", "--camera", camera, "-o", training)[0] == 0
    recipe = LAYER.replace("levels = 4", "levels = 2\nchromas = 2").replace("first_draws = 0", "first_draws = 1")
    recipe = recipe.replace("patch = 3", "patch = 5").replace("3000", "300")
    (tmp_path / "classes.toml").write_text(recipe + "coarse_chroma = true\n")
    run = ("train", training, "--classes", tmp_path / "classes.toml")
    whole, sums, first, table = (tmp_path / f"{name}.h5" for name in ("whole", "sums", "first", "table"))
    for further in (("-o", whole), ("--shard", "1/1", "-o", sums)):
        code, _, err = l3(*run, *further)
        assert code == 0, err
        assert "the refinement layers of the recipe are skipped" in err
    assert l3("train", "--merge", sums, "-o", first)[0] == 0
    assert l3(*run, "--shard", "1/1", "--first", first, "--force", "-o", sums)[0] == 0
    assert l3("train", "--merge", sums, "-o", table)[0] == 0
    once, twice, jointly = (load(TransformTable, path).first.weights for path in (first, table, whole))
    np.testing.assert_array_equal(twice, jointly)
    assert not np.array_equal(once, twice)
    assert load(TransformTable, table).later == ()


def test_bands_get_a_layer_that_corrects_them(tmp_path: Path, l3: L3) -> None:
    """Whole or in shards the same; it takes noise and error off what it has been learned on, and leaves white as it is."""
    training = tmp_path / "training.h5"
    (tmp_path / "scenes.toml").write_text(LEAVES.replace("count = 6", "count = 3") + '[target]\noutputs = "camera"\n')
    assert l3("simulate", tmp_path / "scenes.toml", "--camera", CONFIGS / "cameras/fiveband.toml", "-o", training)[0] == 0
    recipe = (
        LAYER.replace("levels = 4", "levels = 8\nchromas = 2")
        .replace("patch = 3", "patch = 5")
        .replace("3000", "1500\ndarkest = 0.05")
    )
    (tmp_path / "classes.toml").write_text(recipe + "mosaics = 60\nrows = 900\nluminance_noise = 1\n")
    run = ("train", training, "--classes", tmp_path / "classes.toml")
    whole, sums, first, table = (tmp_path / f"{name}.h5" for name in ("whole", "sums", "first", "table"))
    assert l3(*run, "-o", whole)[0] == 0
    assert l3(*run, "--shard", "1/1", "-o", sums)[0] == 0
    assert l3("train", "--merge", sums, "-o", first)[0] == 0
    assert l3(*run, "--shard", "1/1", "--first", first, "--force", "-o", sums)[0] == 0
    assert l3("train", "--merge", sums, "-o", table)[0] == 0
    jointly, merged = load(TransformTable, whole), load(TransformTable, table)
    np.testing.assert_array_equal(jointly.later[0].weights, merged.later[0].weights)
    assert jointly.components is not None
    basis = jointly.components.basis
    assert jointly.white_point @ basis == pytest.approx([0, 1, 0], abs=1e-4)
    rule = jointly.later[0].rule
    free = rule.case(rule.split(np.arange(len(jointly.later[0].weights))).kind) == 0
    of_white = jointly.later[0].weights.reshape(len(free), 5, PLANES, -1)[free, :, 1].sum(axis=-1)
    assert of_white == pytest.approx(np.zeros_like(of_white), abs=1e-4)
    with open_training_set(training) as reader:
        frame = reader.frame(0)
    raw = RawFrame("leaves", frame.raw, jointly.black_level, jointly.white_level)
    unclipped = free[ReferenceRenderer(jointly).labels(raw, 1)]
    error = []
    for each in (dataclasses.replace(jointly, later=()), jointly):
        made = ReferenceRenderer(each).exact_outputs(raw) * (each.output_unit / frame.exposure)
        error.append(np.square(made - frame.target)[:, unclipped].mean())
    assert error[1] < 0.97 * error[0], unclipped.mean()


@pytest.mark.parametrize(
    ("lines", "why"),
    [
        ("side = 4", "layer[1].side is 4; use an odd number"),
        ("[[layer]]\n[[layer]]\n[[layer]]", "layer has 4 values; use at most 3"),
        ("strengths = [3, 2]", "layer[1].strengths must be one or more increasing numbers"),
        ("strengths = [-1, 2]", "layer[1].strengths[1] is -1; use more than 0"),
        ("colour_ratios = true\n[[layer]]", "layer[1].colour_ratios is allowed only in the last layer"),
        ("bilateral_chroma = true\n", "layer[1].bilateral_chroma needs colour_ratios"),
        ("brightness_power = 1.5", "layer[1].brightness_power is 1.5; use at most 1"),
        ("sides = 3", "unknown key `sides` in [layer[1]]"),
    ],
)
def test_a_wrong_layer_is_one_line(lines: str, why: str, bayer: CameraModel, tmp_path: Path, refused: Refused) -> None:
    """That names the key, before anything is learned."""
    training = a_set(tmp_path / "training.h5", bayer, 1)
    layer = LAYER.removesuffix("side = 3\n") if lines.startswith("side ") else LAYER
    (tmp_path / "classes.toml").write_text(f"{layer}{lines}\n")
    assert why in refused(2, "train", training, "--classes", tmp_path / "classes.toml", "-o", tmp_path / "no.h5")


def test_a_layer_learns_from_a_share_of_larger_squares(bayer: CameraModel) -> None:
    frames = [a_frame(bayer, seed, smooth=False) for seed in range(2)]
    dense, sparse = a_pass(bayer, rows=200), a_pass(bayer, rows=200, density=0.5)
    assert (dense.exposed.inner, sparse.exposed.inner) == (15, 20)
    rows = [
        sum(one.count.sum() for one in sum_layer(each, a_rule(each), [(0, frames)]).values()) for each in (dense, sparse)
    ]
    assert rows[1] == pytest.approx(rows[0], rel=0.35)
