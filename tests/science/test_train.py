"""Training recovers known transforms, sums can be added, and every class has a transform."""

import dataclasses
import json
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from l3cli.artifacts.camera import CameraModel, Noise
from l3cli.artifacts.partial_sums import ClassSums
from l3cli.artifacts.store import load
from l3cli.artifacts.table import TransformTable
from l3cli.artifacts.training_set import LightSpectrum, TrainingFrame, TrainingSet, white_signal, write_training_set
from l3cli.classes.chroma import choose_chromas
from l3cli.classes.decide import label_patches
from l3cli.classes.features import ClassRecipe
from l3cli.classes.names import kind_name
from l3cli.classes.rule import make_rule
from l3cli.classes.saturation import choose_cases
from l3cli.classes.windows import neighbourhoods
from l3cli.errors import L3Error
from l3cli.frames.frame import RawFrame
from l3cli.io.images import read_image
from l3cli.physics import spectra
from l3cli.recipes.load import load_recipe
from l3cli.rendering.renderer import make_renderer
from l3cli.training.accumulate import sum_sites
from l3cli.training.patches import (
    Patches,
    colourless_frame,
    expose_patches,
    levels_at,
    patches_of,
    sample_patches,
)
from l3cli.training.recipe import LayerRecipe, LearningRecipe, TrainingRecipe, for_camera
from l3cli.training.solve import parent_of, parents_of
from l3cli.training.sums import MAX_EXACT_STEPS, PRODUCT_STEP, grid_steps, moment_matrix
from l3cli.training.symmetry import EVERY_ORIENTATION, IDENTITY_ONLY, orientations, site_maps, stabilisers
from l3cli.training.table import add_up
from l3cli.training.training_pass import LAST, TrainingPass
from tests.helpers.calls import L3, Refused
from tests.helpers.paths import CONFIGS
from tests.helpers.training_sets import MIX, a_frame, a_set

SMALL = "[classes]\npatch = 5\nlevels = 6\n[learning]\npatches = 3000\ndraws = 4\n"
XTRANS = np.array([[1, 0, 2, 1, 2, 0], [2, 1, 1, 0, 1, 1], [0, 1, 1, 2, 1, 1]], np.uint8)
XTRANS = np.concatenate([XTRANS, np.roll(XTRANS, 3, axis=1)])


def quiet_camera(camera: CameraModel) -> CameraModel:
    return dataclasses.replace(camera, noise=Noise(0.01, 0.0, 0.0, 0.0, 15000.0))


def test_symmetry_of_known_arrays(fiveband: CameraModel) -> None:
    for cfa, canonical in ((fiveband.cfa, 5), (np.array([[0, 1], [1, 2]]), 3), (np.zeros((1, 1), int), 1), (XTRANS, 8)):
        for patch in (5, 9):
            neighbours = neighbourhoods(cfa, patch, int(cfa.max()) + 1)
            maps = site_maps(neighbours.channel, patch)
            if cfa is not XTRANS:
                assert len({site_map.canonical for site_map in maps}) == canonical
            for site, site_map in enumerate(maps):
                assert (neighbours.channel[site][site_map.permutation] == neighbours.channel[site_map.canonical]).all()


def test_sites_share_their_training_in_allowed_orientations_only() -> None:
    """Where rows must stay rows, as with row noise, the two greens of a Bayer array are trained apart."""
    neighbours = neighbourhoods(np.array([[0, 1], [1, 2]]), 5, 3)
    grid = np.arange(25).reshape(5, 5)
    keep_rows = {tuple(each.ravel()) for each in (grid, grid[::-1], grid[:, ::-1], grid[::-1, ::-1])}
    allowed = tuple(number for number, taps in enumerate(orientations(5)) if tuple(taps) in keep_rows)
    assert len(allowed) == 4
    for group, expected in ((EVERY_ORIENTATION, 3), (allowed, 4), (IDENTITY_ONLY, 4)):
        assert len({site_map.canonical for site_map in site_maps(neighbours.channel, 5, group)}) == expected
    assert [len(stabilisers(neighbours.channel[0], 5, group)) for group in (EVERY_ORIENTATION, allowed, IDENTITY_ONLY)] == [
        8,
        4,
        1,
    ]


def test_orientations_are_the_eight_of_a_square() -> None:
    seen = {tuple(permutation) for permutation in orientations(3)}
    assert len(seen) == 8
    assert all(permutation[4] == 4 for permutation in seen)
    assert len(stabilisers(np.zeros(9, int), 3)) == 8


def test_patches_are_windows_of_the_turned_mosaic(bayer: CameraModel) -> None:
    camera, rng = bayer, np.random.default_rng(4)
    frame = a_frame(camera, 1, smooth=False)
    head = TrainingSet(camera=camera, outputs=("X", "Y", "Z"), target_description="")
    neighbours = neighbourhoods(camera.cfa, 5, 3)
    sample = sample_patches(frame, head, camera.saturation_exposure, neighbours.channel[1], 64, orientations(5), rng)
    # the centre tap is the site's channel whatever the orientation, and the target belongs to the same pixel
    share = frame.electrons / camera.full_scale
    truth = np.einsum("oc,crk->ork", MIX, share)
    for signal, target in zip(sample.signal, sample.target, strict=True):
        row, col = np.argwhere(np.isclose(share[1], signal[12], rtol=1e-6))[0]
        assert target == pytest.approx(truth[:, row, col], rel=1e-4)
        around = share[:, row - 2 : row + 3, col - 2 : col + 3]
        stack = np.take_along_axis(
            np.stack([np.stack([side.ravel()[turn] for turn in orientations(5)]) for side in around]),
            neighbours.channel[1][None, None],
            axis=0,
        )[0]
        assert np.isclose(stack, signal, rtol=1e-6).all(axis=1).any()


def test_patches_without_colour_show_luminance_as_white_is_seen(bayer: CameraModel) -> None:
    wavelength = spectra.light_grid(bayer.wavelength)
    light = LightSpectrum(wavelength.astype(np.float64), np.ones(wavelength.size, np.float32))
    frame = dataclasses.replace(a_frame(bayer, 1, smooth=False), light=light)
    head = TrainingSet(camera=bayer, outputs=("X", "Y", "Z"), target_description="")
    neighbours = neighbourhoods(bayer.cfa, 5, 3)

    def patches(share: float, frame: TrainingFrame = frame, head: TrainingSet = head) -> Patches:
        rng, without = np.random.default_rng(3), colourless_frame(frame, head)
        return patches_of(frame, head, neighbours, 1, 10, rng, achromatic=share, colourless=without)

    sample, window, white = patches(0.3), neighbours.channel[1], white_signal(light, bayer)
    coloured = patches(0.0)
    np.testing.assert_array_equal(patches(0.04).signal, coloured.signal)  # less than one of ten
    assert len(sample.signal) == 10
    assert not np.allclose(sample.signal[:7, 12] / white[window[12]], sample.target[:7, 1], rtol=1e-3)
    grey = sample.signal[7:] / white[window]  # at every tap the luminance there; that of the centre is the target's
    np.testing.assert_allclose(grey[:, 12], sample.target[7:, 1], rtol=1e-5)
    np.testing.assert_allclose(sample.target[7:], sample.target[7:, 1:2] * frame.white / frame.white[1], rtol=1e-5)
    assert np.ptp(grey, axis=1).min() > 0
    for other in (
        patches(0.3, frame=dataclasses.replace(frame, light=None)),
        patches(0.3, head=dataclasses.replace(head, outputs=("r", "g", "b"))),
    ):
        np.testing.assert_array_equal(other.signal, coloured.signal)


def test_exposed_patches_have_the_noise_of_the_camera(bayer: CameraModel) -> None:
    """Mean and variance at every signal, clipped at the white level, and neighbouring taps apart from each other."""
    span = bayer.white_level - bayer.black_level
    signal = np.repeat(np.array([0.0, 0.02, 0.3, 0.8, 2.0], np.float32)[:, None], 60000, axis=1)
    values = expose_patches(signal, bayer, np.random.default_rng(1)).astype(np.float64)
    expected = bayer.noise_variance(signal[:4, 0].astype(np.float64) * span)  # with that of quantisation
    assert values[:4].mean(axis=1) == pytest.approx(bayer.black_level + signal[:4, 0] * span, abs=0.3)
    assert values[:4].var(axis=1) == pytest.approx(expected, rel=0.03)
    assert (values[4] == np.floor(bayer.white_level)).all()
    among = np.asarray(np.corrcoef(values[1:4]))
    assert abs(among[np.triu_indices(3, 1)]).max() < 0.02
    assert abs(np.corrcoef(values[2, :-1], values[2, 1:])[0, 1]) < 0.02
    # more than there are deviates in store
    many = expose_patches(np.full(3 << 19, 0.3, np.float32), bayer, np.random.default_rng(1))
    assert many.astype(np.float64).var() == pytest.approx(expected[2], rel=0.03)


@settings(deadline=None)
@given(st.integers(0, 1000))
def test_levels_cover_the_declared_range(seed: int) -> None:
    recipe = LearningRecipe(darkest=0.003, dark_share=0.1)
    levels = levels_at(recipe, np.random.default_rng(seed).random(4000))
    assert levels.min() >= recipe.darkest / 2
    assert levels.max() <= recipe.brightest
    uniform = np.log(recipe.brightest / recipe.highlight_from) / np.log(recipe.brightest / recipe.darkest)
    expected = recipe.highlight_share + (1 - recipe.highlight_share - recipe.dark_share) * uniform
    assert (levels > recipe.highlight_from).mean() == pytest.approx(expected, abs=0.04)
    assert (levels < recipe.darkest).mean() == pytest.approx(recipe.dark_share, abs=0.02)


@settings(deadline=None)
@given(read=st.floats(0.5, 60), well=st.floats(2000, 60000), prnu=st.floats(0, 0.02))
def test_the_darkest_level_is_where_noise_equals_the_signal(
    fiveband: CameraModel, read: float, well: float, prnu: float
) -> None:
    noise = dataclasses.replace(fiveband.noise, read_noise=read, prnu=prnu)
    camera = dataclasses.replace(fiveband, noise=noise, gain=4095 / well)
    asked = TrainingRecipe(classes=ClassRecipe(lowest_level=1e-5))
    level = for_camera(asked, camera).learning.darkest
    signal = level * (camera.white_level - camera.black_level)
    assert camera.noise_variance(np.array(signal)) == pytest.approx(signal**2, rel=1e-6)
    assert for_camera(TrainingRecipe(), camera).learning.darkest == max(level, 0.001)
    named = TrainingRecipe(learning=LearningRecipe(darkest=0.02))
    assert for_camera(named, camera) == named


def test_rare_saturation_patterns_join_the_nearest_kept_one() -> None:
    occurrences = np.array([10000, 1, 500, 0, 0, 0, 400, 300])  # kept: 0b000, 0b010, 0b110, 0b111
    assert choose_cases(occurrences, 12).tolist() == [0, 3, 1, 3, 2, 3, 2, 3]
    assert choose_cases(occurrences, 2).tolist() == [0, 1, 1, 1, 1, 1, 1, 1]
    assert choose_cases(np.array([5, 0, 0, 0]), 12).tolist() == [0, 0, 0, 0]


@pytest.mark.filterwarnings("error")
def test_few_colours_become_the_chromas() -> None:
    """Charts have few; there is nothing to be said of it, such as that clusters are empty."""
    few = np.array([[0.5, 0.3, 0.2], [0.2, 0.3, 0.5], [0.1, 0.2, 0.7]])
    shares = np.repeat(few, 40, axis=0)
    np.testing.assert_array_equal(choose_chromas(shares, 8, 0), few[::-1])
    assert choose_chromas(shares, 1, 0) is None
    nearest = choose_chromas(np.random.default_rng(0).dirichlet([9, 9, 9], 400), 8, 0)
    assert nearest is not None
    assert nearest.shape == (8, 3)


def test_flat_fields_give_their_true_output(bayer: CameraModel, tmp_path: Path, l3: L3) -> None:
    """Trained on flat fields of any colour, the table returns the known mix of the channels at every level and site."""
    camera = quiet_camera(bayer)
    training = a_set(tmp_path / "training.h5", camera, 40)
    (tmp_path / "classes.toml").write_text(SMALL)
    code, _, err = l3("train", training, "--classes", tmp_path / "classes.toml", "-o", tmp_path / "table.h5")
    assert code == 0, err
    table = load(TransformTable, tmp_path / "table.h5")
    assert np.isfinite(table.first.weights).all()
    assert (np.abs(table.first.weights).sum(axis=(1, 2)) > 0).all()  # no class is left empty
    neighbours = neighbourhoods(camera.cfa, 5, 3)
    rng = np.random.default_rng(9)
    for level in (0.01, 0.1, 0.5):
        share = rng.random(3) * 0.5 + 0.5
        share = level * share / share.mean()
        truth = MIX @ share
        for site in range(4):
            patch = camera.black_level + share[neighbours.channel[site]] * (camera.white_level - camera.black_level)
            label = label_patches(np.rint(patch).astype(np.uint16)[None], table.first.rule, neighbours, site)[0]
            index = site * table.first.rule.classes_per_site + label
            result = table.first.weights[index] @ share[neighbours.channel[site]] + table.first.intercept[index]
            assert result == pytest.approx(truth, rel=0.03, abs=0.002 * level)


def test_sums_are_exact_in_any_order(bayer: CameraModel) -> None:
    """Sums of parts are equal to the last bit however they are grouped, and equal a plain float64 computation."""
    rule = make_rule(ClassRecipe(patch=3, levels=4), bayer, np.zeros(8, np.uint16))
    neighbours = neighbourhoods(bayer.cfa, 3, 3)
    head = TrainingSet(camera=bayer, outputs=("X", "Y", "Z"), target_description="")
    pass_ = TrainingPass(head, (1000,) * 6, rule, LearningRecipe(patches=6000, draws=2, darkest=0.003), np.ones(3), 1, LAST)
    frames = [a_frame(bayer, seed, smooth=False) for seed in range(6)]
    parts = [sum_sites(pass_, [(index, (1,), iter([frame]))], {1: None})[1] for index, frame in enumerate(frames)]
    forward, backward = add_up(pass_, parts), add_up(pass_, parts[::-1])
    nested = add_up(pass_, [add_up(pass_, parts[1::2]), add_up(pass_, parts[::2])])
    for name in ("moments", "noise", "count"):
        assert (getattr(forward, name) == getattr(backward, name)).all()
        assert (getattr(forward, name) == getattr(nested, name)).all()
    steps = grid_steps(rule, bayer, 3)  # every sum is a whole number of steps, far from where float64 would round
    whole = forward.moments.reshape(len(steps), -1, steps.shape[1]) / steps[:, None]
    assert (whole == np.rint(whole)).all()
    assert (forward.noise / PRODUCT_STEP == np.rint(forward.noise / PRODUCT_STEP)).all()
    assert np.abs(whole).max() < MAX_EXACT_STEPS / 1000
    assert forward.count.sum() == 12000
    patches = sample_patches(
        frames[0],
        head,
        bayer.saturation_exposure,
        neighbours.channel[1],
        1000,
        orientations(3),
        np.random.default_rng([1, 2, 0, 1]),
    )
    matrix = np.sum([moment_matrix(row, 13) for row in parts[0].moments], axis=0)
    assert np.linalg.eigvalsh(matrix).min() > 0
    ratio = matrix[10:, 10:].diagonal() / (patches.target.astype(np.float64) ** 2).sum(axis=0)
    assert ratio == pytest.approx(ratio.mean(), rel=0.2)  # outputs are weighed alike
    huge = ClassSums(forward.moments * 2.0**40, forward.noise, forward.count)
    with pytest.raises(L3Error, match="too many patches"):
        add_up(pass_, [huge])


@pytest.mark.parametrize("outputs", [("Y",), ("b1", "b2", "b3", "b4", "b5")])
def test_other_outputs_than_xyz(
    outputs: tuple[str, ...], bayer: CameraModel, tmp_path: Path, l3: L3, refused: Refused
) -> None:
    """Any number of outputs trains in one pass, fills, renders to EXR, and says in its table what it gives."""
    camera, mix = quiet_camera(bayer), np.random.default_rng(2).random((len(outputs), 3)) + 0.1
    head = TrainingSet(camera=camera, outputs=outputs, target_description="synthetic outputs")
    with write_training_set(tmp_path / "training.h5", head) as writer:
        for seed in range(20):
            frame = a_frame(camera, seed, smooth=True)
            share = frame.electrons / camera.full_scale
            target = np.einsum("oc,crk->ork", mix, share) * camera.saturation_exposure / frame.exposure
            writer.append(dataclasses.replace(frame, target=target.astype(np.float32), white=mix.sum(axis=1) * 80))
    (tmp_path / "classes.toml").write_text(SMALL)
    arguments = ("train", tmp_path / "training.h5", "--classes", tmp_path / "classes.toml")
    code, _, err = l3(*arguments, "-o", tmp_path / "table.h5")
    assert code == 0, err
    table = load(TransformTable, tmp_path / "table.h5")
    assert table.outputs == outputs
    assert table.target_description == "synthetic outputs"
    assert table.output_unit == camera.saturation_exposure
    white = mix.sum(axis=1)
    assert table.white_point == pytest.approx(white / (white[0] if outputs == ("Y",) else white.mean()))
    assert (np.abs(table.first.weights).sum(axis=(1, 2)) > 0).all()
    share = np.array([0.3, 0.25, 0.2])
    mosaic = camera.black_level + share[np.tile(camera.cfa, (16, 16))] * (camera.white_level - camera.black_level)
    np.save(tmp_path / "raw.npy", np.rint(mosaic).astype(np.uint16))
    raw, exr = tmp_path / "raw.npy", tmp_path / "linear.exr"
    code, _, err = l3("render", tmp_path / "table.h5", raw, "-o", exr, "--backend", "reference")
    assert code == 0, err
    pixels, names = read_image(exr)
    assert sorted(names) == sorted(outputs)
    planes = {name: pixels[..., index] for index, name in enumerate(names)}
    for name, truth in zip(outputs, mix @ share, strict=True):
        assert planes[name] == pytest.approx(np.full((32, 32), truth), rel=0.03)
    if outputs == ("Y",):  # luminance is shown as grey
        assert l3("render", tmp_path / "table.h5", raw, "-o", tmp_path / "picture.png", "--backend", "reference")[0] == 0
    else:
        assert ", ".join(outputs) in refused(2, "render", tmp_path / "table.h5", raw, "-o", tmp_path / "picture.png")
    # one pass only: two steps
    code, _, err = l3(*arguments, "--shard", "1/1", "-o", tmp_path / "shard.h5")
    assert code == 0, err
    assert l3("train", "--merge", tmp_path / "shard.h5", "-o", tmp_path / "merged.h5")[0] == 0
    assert (tmp_path / "merged.h5").read_bytes() == (tmp_path / "table.h5").read_bytes()


def test_info_states_what_a_table_has_learned(bayer: CameraModel, tmp_path: Path, l3: L3) -> None:
    training = a_set(tmp_path / "training.h5", quiet_camera(bayer), 40)
    (tmp_path / "classes.toml").write_text(SMALL)
    assert l3("train", training, "--classes", tmp_path / "classes.toml", "-o", tmp_path / "table.h5")[0] == 0
    code, out, _ = l3("info", tmp_path / "table.h5", "--json")
    assert code == 0
    table, insight = load(TransformTable, tmp_path / "table.h5"), json.loads(out)["insight"]
    assert insight["classes"]["all"] == len(table.first.weights)
    assert insight["classes"]["filled"] == int((table.first.samples == 0).sum())
    assert insight["classes"]["trained"] + insight["classes"]["filled"] == len(table.first.weights)
    assert sum(kind["patches"] for kind in insight["kinds"]) == table.first.samples.sum() == 4 * 3000 * 4
    # trained on flat fields whose outputs are MIX of the channels, that is what a flat signal gives
    gains = np.array([[insight["dc_gain"][output][channel] for channel in "rgb"] for output in "XYZ"])
    assert gains == pytest.approx(MIX, abs=0.03)
    trained = table.first.samples > 0
    noise = np.sqrt((table.first.weights[trained, 1].astype(np.float64) ** 2).sum(axis=1))
    assert insight["noise_gain"]["Y"] == pytest.approx({"median": np.median(noise), "worst": noise.max()})
    assert insight["worst"][0]["noise_gain"] == pytest.approx(noise.max())
    assert insight["worst"][0]["class"].startswith("site (")
    assert 1 <= insight["condition"]["median"] <= insight["condition"]["worst"]
    assert (table.first.condition[trained] >= 1).all()
    code, out, _ = l3("info", tmp_path / "table.h5")
    assert code == 0
    assert "noisiest classes: " in out
    assert insight["worst"][0]["class"] in out


def test_saturation_cases_are_named_by_their_pattern(fiveband: CameraModel) -> None:
    occurrences = np.zeros(32, np.int64)
    occurrences[[0, 0b00010, 0b10010, 0b11111]] = 1000, 100, 100, 300
    rule = make_rule(ClassRecipe(), fiveband, choose_cases(occurrences, 12))
    first = SimpleNamespace(rule=rule)
    table = SimpleNamespace(first=first, channels=fiveband.channels, cfa=fiveband.cfa, black_level=100.0, white_level=4095.0)
    names = [kind_name(table, kind) for kind in range(rule.kinds)]  # type: ignore[arg-type]
    everything = "saturated " + "+".join(fiveband.channels)
    c, g = fiveband.channels[4], fiveband.channels[1]
    assert names == ["chroma 0", f"saturated {g}", f"saturated {g}+{c}", everything]


def test_wrong_calls_are_one_line(bayer: CameraModel, fiveband: CameraModel, tmp_path: Path, refused: Refused) -> None:
    good = a_set(tmp_path / "good.h5", bayer, 1)
    other = a_set(tmp_path / "other.h5", quiet_camera(bayer), 1)
    tiny = a_set(tmp_path / "tiny.h5", bayer, 1, size=(4, 30))
    empty = a_set(tmp_path / "empty.h5", bayer, 0)
    targets = a_set(tmp_path / "targets.h5", bayer, 1, target="something else")
    out = tmp_path / "table.h5"
    assert "other.h5" in refused(3, "train", good, other, "-o", out)
    assert "targets.h5" in refused(3, "train", good, targets, "-o", out)
    assert "targets.h5" in refused(3, "train", good, targets, "--shard", "1/2", "-o", out)
    assert "4×30" in refused(3, "train", good, tiny, "--shard", "1/2", "-o", out)
    assert "4×30" in refused(3, "train", tiny, "-o", out)
    assert "empty.h5" in refused(3, "train", empty, "-o", out)
    (tmp_path / "classes.toml").write_text("[classes]\nlevel = 3\n")
    assert "`level`" in refused(2, "train", good, "--classes", tmp_path / "classes.toml", "-o", out)
    (tmp_path / "few.toml").write_text("[classes]\nlevels = 50000\n")
    assert "levels" in refused(2, "train", good, "--classes", tmp_path / "few.toml", "-o", out)


def test_a_parent_of_few_patches_leans_on_its_case(bayer: CameraModel) -> None:
    """A handful of patches cannot stand for all colours of a level, as they did for pixels near highlights."""
    rule = make_rule(ClassRecipe(patch=3, levels=6), bayer, np.arange(8).astype(np.uint16))
    thin, thick = (rule.join(level, 0, rule.chromas - 1 + 3) for level in (1, 4))
    count = np.zeros(rule.classes_per_site)
    count[thin], count[thick] = 4, 5000
    one = np.where(np.arange(count.size) == thin, 100.0, 1.0)[:, None]  # what a patch of each class adds
    parents = parents_of(ClassSums(count[:, None] * one, count[:, None] * one, count), rule)
    assert parents.moments[parent_of(thin, rule), 0] == pytest.approx(1.0, abs=5.0)
    assert parents.moments[parent_of(thick, rule), 0] == pytest.approx(1.0, abs=0.1)


def test_plain_areas_may_have_spectra_that_training_lacks(bayer: CameraModel, tmp_path: Path, l3: L3) -> None:
    """Trained on one colour alone, a table of the camera's channels answers any other in plain areas."""
    camera = dataclasses.replace(bayer, noise=Noise(13.0, 0.0, 0.0, 0.0, 15000.0))
    seen, unseen = np.array([0.2, 0.4, 0.3]), np.array([0.28, 0.36, 0.24])
    head = TrainingSet(camera=camera, outputs=camera.channels, target_description="the camera's channels")
    with write_training_set(tmp_path / "training.h5", head) as writer:
        for seed in range(4):
            share = np.broadcast_to(seen[:, None, None], (3, 48, 56)).astype(np.float32)
            target = share * camera.saturation_exposure / 0.01
            electrons = share * np.float32(camera.full_scale)
            writer.append(dataclasses.replace(a_frame(camera, seed, smooth=True), electrons=electrons, target=target))
    (tmp_path / "classes.toml").write_text(SMALL)
    assert l3("train", tmp_path / "training.h5", "--classes", tmp_path / "classes.toml", "-o", tmp_path / "table.h5")[0] == 0
    table = load(TransformTable, tmp_path / "table.h5")
    mosaic = camera.black_level + unseen[np.tile(camera.cfa, (12, 12))] * (camera.white_level - camera.black_level)
    raw = RawFrame("unseen", np.rint(mosaic).astype(np.uint16), camera.black_level, camera.white_level)
    planes = make_renderer("opencl", table).outputs(raw)
    assert planes.mean(axis=(1, 2)) == pytest.approx(unseen, rel=0.04)  # 0.5 without the single bands


def test_the_default_recipe_file_spells_out_the_built_in_default() -> None:
    default = load_recipe(CONFIGS / "classes/default.toml", TrainingRecipe)
    own = LayerRecipe(
        colour_ratios=True,
        level_pool=(0.8, 0.5, 0.2),
        brightness_power=0.65,
        error_power=0.15,
        coarse_chroma=True,
        chroma_noise=1.5,
        strengths=(1.7, 8.0, 40.0),
        strength_pool=0.3,
        parent_patches=80,
        mosaics=4700,
    )
    assert default.layer == (own,)  # powers that a layer does not name are those of [learning]
    for name in ("fast", "best"):
        assert load_recipe(CONFIGS / f"classes/{name}.toml", TrainingRecipe) != default
