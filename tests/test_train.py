"""Training: known truth is recovered, sums add, every class is filled, the same bytes come out whatever made them."""

import dataclasses
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from l3cli import classify
from l3cli.artifacts.base import load
from l3cli.artifacts.camera import CameraModel, Noise
from l3cli.artifacts.table import TransformTable
from l3cli.artifacts.training_set import TrainingFrame, TrainingSet, write_training_set
from l3cli.config import load_recipe
from l3cli.train.kinds import choose_cases
from l3cli.train.patches import draw_levels, sample_patches
from l3cli.train.recipe import LearningRecipe, TrainingRecipe
from l3cli.train.symmetry import orientations, site_maps, stabilisers
from tests.conftest import CONFIGS

MIX = np.array([[0.4, 0.2, 0.1], [0.2, 0.7, 0.1], [0.0, 0.1, 0.9]])  # the truth: XYZ of the channels at the same pixel
SMALL = "[classes]\npatch = 5\nlevels = 6\n[learning]\npatches = 3000\ndraws = 4\n"
XTRANS = np.array([[1, 0, 2, 1, 2, 0], [2, 1, 1, 0, 1, 1], [0, 1, 1, 2, 1, 1]], np.uint8)
XTRANS = np.concatenate([XTRANS, np.roll(XTRANS, 3, axis=1)])


def quiet_camera(camera: CameraModel) -> CameraModel:
    return dataclasses.replace(camera, noise=Noise(0.01, 0.0, 0.0, 0.0, 15000.0), gain=camera.gain * 1.0)


def a_frame(camera: CameraModel, seed: int, smooth: bool, size: tuple[int, int] = (48, 56)) -> TrainingFrame:
    """A frame whose target is MIX applied to its channels, in the table's unit."""
    rng = np.random.default_rng(seed)
    shape = (3, 1, 1) if smooth else (3, *size)
    share = np.broadcast_to(rng.random(shape) * 0.7 + 0.1, (3, *size)).astype(np.float32)
    target = np.einsum("oc,crk->ork", MIX, share) * camera.white_dose / 0.01
    return TrainingFrame(
        electrons=(share * camera.full_scale).astype(np.float32),
        raw=np.zeros(size, np.uint16),
        target=target.astype(np.float32),
        white=np.array([95.0, 100.0, 109.0]),
        scene=f"frame {seed}",
        illuminant="D65",
        luminance=100.0,
        exposure=0.01,
        seed=(0, seed),
    )


def a_set(path: Path, camera: CameraModel, count: int, smooth: bool = True, size: tuple[int, int] = (48, 56)) -> Path:
    head = TrainingSet(camera=camera, outputs=("X", "Y", "Z"), target_description="a known mix of the channels")
    with write_training_set(path, head) as writer:
        for seed in range(count):
            writer.append(a_frame(camera, seed, smooth, size))
    return path


def test_symmetry_of_known_arrays(fiveband: CameraModel) -> None:
    for cfa, canonical in ((fiveband.cfa, 5), (np.array([[0, 1], [1, 2]]), 3), (np.zeros((1, 1), int), 1), (XTRANS, 8)):
        for patch in (5, 9):
            near = classify.neighbourhoods(cfa, patch, int(cfa.max()) + 1)
            maps = site_maps(near.channel, patch)
            if cfa is not XTRANS:
                assert len({site_map.canonical for site_map in maps}) == canonical
            for site, site_map in enumerate(maps):
                assert (near.channel[site][site_map.permutation] == near.channel[site_map.canonical]).all()


def test_orientations_are_the_eight_of_a_square() -> None:
    seen = {tuple(permutation) for permutation in orientations(3)}
    assert len(seen) == 8
    assert all(permutation[4] == 4 for permutation in seen)
    assert len(stabilisers(np.zeros(9, int), 3)) == 8


def test_patches_are_windows_of_the_turned_mosaic(bayer: CameraModel) -> None:
    camera, rng = bayer, np.random.default_rng(4)
    frame = a_frame(camera, 1, smooth=False)
    head = TrainingSet(camera=camera, outputs=("X", "Y", "Z"), target_description="")
    near = classify.neighbourhoods(camera.cfa, 5, 3)
    sample = sample_patches(frame, head, camera.white_dose, near.channel[1], 64, orientations(5), rng)
    # the centre tap is the site's own channel whatever the orientation, and the target belongs to the same pixel
    share = frame.electrons / camera.full_scale
    truth = np.einsum("oc,crk->ork", MIX, share)
    for signal, target in zip(sample.signal, sample.target, strict=True):
        row, col = np.argwhere(np.isclose(share[1], signal[12], rtol=1e-6))[0]
        assert target == pytest.approx(truth[:, row, col], rel=1e-4)
        around = share[:, row - 2 : row + 3, col - 2 : col + 3]
        stack = np.take_along_axis(
            np.stack([np.stack([side.ravel()[turn] for turn in orientations(5)]) for side in around]),
            near.channel[1][None, None],
            axis=0,
        )[0]
        assert np.isclose(stack, signal, rtol=1e-6).all(axis=1).any()


@settings(deadline=None)
@given(st.integers(0, 1000))
def test_levels_cover_the_declared_range(seed: int) -> None:
    recipe = LearningRecipe()
    levels = draw_levels(recipe, 4000, np.random.default_rng(seed))
    assert levels.min() >= recipe.darkest
    assert levels.max() <= recipe.brightest
    uniform = np.log(recipe.brightest / recipe.highlight_from) / np.log(recipe.brightest / recipe.darkest)
    expected = recipe.highlight_share + (1 - recipe.highlight_share) * uniform
    assert (levels > recipe.highlight_from).mean() == pytest.approx(expected, abs=0.04)


def test_rare_saturation_patterns_join_the_nearest_kept_one() -> None:
    occurrences = np.array([10000, 1, 500, 0, 0, 0, 400, 300])  # kept: 0b000, 0b010, 0b110, 0b111
    assert choose_cases(occurrences, 12).tolist() == [0, 3, 1, 3, 2, 3, 2, 3]
    assert choose_cases(occurrences, 2).tolist() == [0, 1, 1, 1, 1, 1, 1, 1]
    assert choose_cases(np.array([5, 0, 0, 0]), 12).tolist() == [0, 0, 0, 0]


def test_flat_fields_give_their_true_output(bayer: CameraModel, tmp_path: Path, l3: Callable) -> None:
    """Trained on flat fields of any colour, the table returns the known mix of the channels at every level and site."""
    camera = quiet_camera(bayer)
    training = a_set(tmp_path / "training.h5", camera, 40)
    (tmp_path / "classes.toml").write_text(SMALL)
    code, _, err = l3("train", training, "--classes", tmp_path / "classes.toml", "-o", tmp_path / "table.h5")
    assert code == 0, err
    table = load(TransformTable, tmp_path / "table.h5")
    assert np.isfinite(table.weights).all()
    assert (np.abs(table.weights).sum(axis=(1, 2)) > 0).all()  # no class is left empty
    near = classify.neighbourhoods(camera.cfa, 5, 3)
    rng = np.random.default_rng(9)
    for level in (0.01, 0.1, 0.5):
        share = rng.random(3) * 0.5 + 0.5
        share = level * share / share.mean()
        truth = MIX @ share
        for site in range(4):
            patch = camera.black + share[near.channel[site]] * (camera.white - camera.black)
            label = classify.label_patches(np.rint(patch).astype(np.uint16)[None], table.rule, near, site)[0]
            index = site * table.rule.classes_per_site + label
            result = table.weights[index] @ share[near.channel[site]] + table.intercept[index]
            assert result == pytest.approx(truth, rel=0.03, abs=0.002 * level)


def test_same_bytes_for_one_and_two_jobs(bayer: CameraModel, tmp_path: Path, l3: Callable) -> None:
    training = a_set(tmp_path / "training.h5", bayer, 4, smooth=False)
    (tmp_path / "classes.toml").write_text(SMALL)
    for jobs in (1, 2):
        arguments = ("--classes", tmp_path / "classes.toml", "-o", tmp_path / f"{jobs}.h5", "--jobs", jobs, "--seed", 5)
        assert l3("train", training, *arguments)[0] == 0
    assert (tmp_path / "1.h5").read_bytes() == (tmp_path / "2.h5").read_bytes()
    assert l3("train", training, "--classes", tmp_path / "classes.toml", "-o", tmp_path / "3.h5", "--seed", 6)[0] == 0
    assert (tmp_path / "1.h5").read_bytes() != (tmp_path / "3.h5").read_bytes()


def test_wrong_calls_are_one_line(bayer: CameraModel, fiveband: CameraModel, tmp_path: Path, refused: Callable) -> None:
    good = a_set(tmp_path / "good.h5", bayer, 1)
    other = a_set(tmp_path / "other.h5", quiet_camera(bayer), 1)
    tiny = a_set(tmp_path / "tiny.h5", bayer, 1, size=(4, 30))
    empty = a_set(tmp_path / "empty.h5", bayer, 0)
    out = tmp_path / "table.h5"
    assert "different cameras" in refused(3, "train", good, other, "-o", out)
    assert "smaller than the 9×9 patch" in refused(3, "train", tiny, "-o", out)
    assert "holds no frames" in refused(3, "train", empty, "-o", out)
    assert "does not exist" in refused(3, "train", tmp_path / "no.h5", "-o", out)
    assert "Missing option '-o'" in refused(2, "train", good)
    (tmp_path / "classes.toml").write_text("[classes]\nlevel = 3\n")
    assert "unknown key `level` in [classes]" in refused(2, "train", good, "--classes", tmp_path / "classes.toml", "-o", out)
    (tmp_path / "few.toml").write_text("[classes]\nlevels = 50000\n")
    assert "more levels than values" in refused(2, "train", good, "--classes", tmp_path / "few.toml", "-o", out)
    assert "exists; add --force" in refused(1, "train", good, "-o", other)
    camera = _camera_of(other, tmp_path)
    assert "holds a camera model; give the file written by" in refused(3, "train", camera, "-o", out)


def _camera_of(training: Path, tmp_path: Path) -> Path:
    """A file of another kind: the training set's camera alone."""
    from l3cli.artifacts.base import save
    from l3cli.artifacts.training_set import open_training_set

    with open_training_set(training) as reader:
        save(reader.head.camera, tmp_path / "camera.h5")
    return tmp_path / "camera.h5"


def test_plain_areas_show_no_cfa_pattern(bayer: CameraModel, tmp_path: Path, l3: Callable) -> None:
    """Trained on noise, where every site learns something else, flat patches of any colour come out alike at all sites."""
    training = a_set(tmp_path / "training.h5", bayer, 3, smooth=False)
    (tmp_path / "classes.toml").write_text(SMALL)
    assert l3("train", training, "--classes", tmp_path / "classes.toml", "-o", tmp_path / "table.h5")[0] == 0
    table = load(TransformTable, tmp_path / "table.h5")
    near = classify.neighbourhoods(bayer.cfa, 5, 3)
    member = near.channel[:, :, None] == np.arange(3)
    weights = table.weights.reshape(4, -1, 3, 25).astype(np.float64)
    response = np.einsum("skot,stc->skoc", weights, member)
    own = table.samples.reshape(4, -1).min(axis=0) > 0  # classes that every site has seen
    assert own.sum() > 5
    spread = np.ptp(response[:, own], axis=0)
    assert spread.max() < 2e-3 * np.abs(response[:, own]).max()


def test_the_default_recipe_file_spells_out_the_built_in_default() -> None:
    assert load_recipe(CONFIGS / "classes/default.toml", TrainingRecipe) == TrainingRecipe()
    for name in ("fast", "best"):
        assert load_recipe(CONFIGS / f"classes/{name}.toml", TrainingRecipe) != TrainingRecipe()
