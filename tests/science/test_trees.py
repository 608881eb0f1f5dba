"""A second layer with a decision tree: the same result for any division of work, storage, rendering, and invalid trees."""

import json
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from l3cli.artifacts.camera import CameraModel
from l3cli.artifacts.layers import PlaneLayer
from l3cli.artifacts.store import load
from l3cli.artifacts.table import TransformTable
from l3cli.artifacts.training_set import TrainingPair, TrainingSet, write_training_set
from l3cli.cli import run
from l3cli.frames.frame import RawFrame
from l3cli.rendering.opencl.renderer import OpenCLRenderer
from l3cli.rendering.reference import ReferenceRenderer
from l3cli.training.layers import rules
from tests.helpers.calls import L3, Refused
from tests.helpers.cameras import bayer_camera
from tests.helpers.training_sets import MIX, a_set

SCENES = 'exposure_share = [0.9]\n[[scene]]\nsource = "dead leaves"\nsize = [64, 64]\ncount = 6\n'
CLASSES = "[classes]\npatch = 3\nlevels = 4\nchromas = 2\n[learning]\npatches = 1000\nfirst_draws = 0\ndraws = 2\n"
LAYER = "[[layer]]\nside = 3\nleaves = 8\ntree_rows = 2000\nmosaics = 12\nrows = 1000\n"
Trained = Callable[..., tuple[TransformTable, str]]


@pytest.fixture(scope="module")
def leaves(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A training set of small dead leaves of a Bayer camera."""
    folder = tmp_path_factory.mktemp("leaves")
    (folder / "scenes.toml").write_text(SCENES)
    (folder / "camera.toml").write_text(bayer_camera())
    made = ("simulate", folder / "scenes.toml", "--camera", folder / "camera.toml", "-o", folder / "training.h5", "--quiet")
    assert run([str(each) for each in made]) == 0
    return folder / "training.h5"


@pytest.fixture
def trained(tmp_path: Path, l3: L3) -> Trained:
    """Train on a set with a recipe: the table, and what was said."""

    def train(training: Path, recipe: str, *options: object) -> tuple[TransformTable, str]:
        (tmp_path / "classes.toml").write_text(recipe)
        output = tmp_path / "table.h5"
        code, _, err = l3("train", training, "--classes", tmp_path / "classes.toml", "-o", output, "--force", *options)
        assert code == 0, err
        return load(TransformTable, output), err

    return train


def require_backends_agree(table: TransformTable) -> None:
    """Of a small frame of edges and noise, partly saturated."""
    rng = np.random.default_rng(0)
    share = np.kron(rng.uniform(0, 1.2, (4, 5)), np.ones((8, 9))) * rng.normal(1, 0.05, (32, 45))
    values = np.clip(table.black_level + share * (table.white_level - table.black_level), 0, 2**table.bits - 1)
    frame = RawFrame("edges", values.astype(np.uint16), table.black_level, table.white_level)
    reference, device = ReferenceRenderer(table), OpenCLRenderer(table)
    np.testing.assert_array_equal(device.labels(frame, 1), reference.labels(frame, 1))
    np.testing.assert_allclose(device.outputs(frame), reference.exact_outputs(frame), rtol=0, atol=1e-4)


def tree_of(table: TransformTable) -> PlaneLayer:
    """The second layer, whose rule must be a tree."""
    (layer,) = table.later
    assert layer.tree is not None
    return layer


def test_a_tree_is_grown_and_rendered_by_both_backends(leaves: Path, trained: Trained, tmp_path: Path, l3: L3) -> None:
    table, words = trained(leaves, CLASSES + LAYER)
    rule = tree_of(table).rule
    assert 4 <= rule.structures <= 8
    assert f"{rule.structures} leaves" in words
    assert "later/0/tree/threshold" in l3("info", tmp_path / "table.h5")[1]
    require_backends_agree(table)
    assert_info_and_report_show_the_tree(table, tmp_path, l3)


def assert_info_and_report_show_the_tree(table: TransformTable, tmp_path: Path, l3: L3) -> None:
    rule = tree_of(table).tree
    assert rule is not None
    code, out, _ = l3("info", tmp_path / "table.h5")
    assert code == 0
    line = next(line for line in out.splitlines() if "nodes by test" in line)
    assert line.startswith(f"  leaves of a tree: {rule.structures}, depth {rule.depth}; nodes by test: ")
    (later,) = json.loads(l3("info", tmp_path / "table.h5", "--json")[1])["insight"]["later"]
    assert (later["leaves"], later["depth"], later["structures"]) == (rule.structures, rule.depth, rule.structures)
    assert sum(later["tests"].values()) == rule.structures - 1
    assert list(later["tests"].values()) == sorted(later["tests"].values(), reverse=True)
    assert l3("report", tmp_path / "table.h5", "-o", tmp_path / "report.html")[0] == 0
    assert f"{rule.structures} leaves of a tree of depth {rule.depth}" in (tmp_path / "report.html").read_text()


@pytest.mark.parametrize(("noise", "side"), [("none", 3), ("analytic", 5)])
def test_splits_are_judged_by_small_windows_where_there_is_no_noise(
    noise: str, side: int, leaves: Path, trained: Trained, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Filters learned for the leaves have the whole windows."""
    seen: list[int] = []
    grow = rules.grow

    def watched(samples: Sequence[rules.TreeSamples], *further: Any) -> rules.Tree:
        seen.extend(one.columns.shape[1] - rules.OUTPUTS for one in samples)
        return grow(samples, *further)

    monkeypatch.setattr(rules, "grow", watched)
    table, _ = trained(leaves, CLASSES + f'noise = "{noise}"\n' + LAYER.replace("side = 3", "side = 5"))
    assert set(seen) == {3 * side**2}
    assert tree_of(table).weights.shape[2] == 75


def test_a_tree_of_one_leaf_is_a_layer_like_others(bayer: CameraModel, trained: Trained, tmp_path: Path, l3: L3) -> None:
    training = a_set(tmp_path / "small.h5", bayer, 1, smooth=False, size=(32, 32))
    layer = (
        LAYER.replace("leaves = 8", "leaves = 1")
        .replace("mosaics = 12", "mosaics = 1")
        .replace("tree_rows = 2000", "tree_rows = 1000")
    )
    table, _ = trained(training, CLASSES + layer)
    rule = tree_of(table).rule
    assert (rule.structures, rule.kinds) == (1, rule.cases)
    assert "leaves of a tree: 1, depth 0\n" in l3("info", tmp_path / "table.h5")[1]
    assert l3("report", tmp_path / "table.h5", "-o", tmp_path / "report.html")[0] == 0


@pytest.mark.parametrize("rule", ["leaves = 8", "strengths = [3]"])
def test_frames_without_inner_pixels_are_one_line(rule: str, bayer: CameraModel, tmp_path: Path, refused: Refused) -> None:
    """A refinement layer learns only from pixels whose neighbourhoods lie within their mosaic."""
    training = a_set(tmp_path / "small.h5", bayer, 1, smooth=False, size=(8, 8))
    (tmp_path / "classes.toml").write_text(CLASSES + LAYER.replace("leaves = 8", rule))
    words = refused(1, "train", training, "--classes", tmp_path / "classes.toml", "-o", tmp_path / "no.h5", "--quiet")
    assert "simulate more or larger frames" in words


def test_a_tree_is_grown_from_real_pairs(bayer: CameraModel, trained: Trained, tmp_path: Path) -> None:
    """Whose mosaics are theirs: no turns, no noise that is drawn."""
    rng = np.random.default_rng(2)
    with write_training_set(tmp_path / "pairs.h5", TrainingSet(bayer, ("X", "Y", "Z"), "a known mix")) as writer:
        for number in range(4):
            share = np.kron(rng.uniform(0.05, 0.8, (3, 8, 9)), np.ones((10, 10))).astype(np.float32)
            row, col = np.ogrid[:80, :90]
            signal = np.take_along_axis(share, bayer.cfa[row % 2, col % 2][None].astype(np.intp), 0)[0]
            noisy = bayer.black_level + signal * (bayer.white_level - bayer.black_level) + rng.normal(0, 8, (80, 90))
            target = np.einsum("oc,crk->ork", MIX, share) * bayer.saturation_exposure / 0.01
            about: dict[str, Any] = {"white": np.array([95.0, 100.0, 109.0]), "scene": f"pair {number}", "illuminant": "D65"}
            writer.append(
                TrainingPair(noisy.astype(np.uint16), target.astype(np.float32), **about, luminance=100.0, exposure=0.01)
            )
    table, _ = trained(tmp_path / "pairs.h5", CLASSES + LAYER)
    assert tree_of(table).rule.structures > 2


def test_without_noise_the_noise_weights_weigh_nothing(leaves: Path, trained: Trained) -> None:
    """As one expects of a switch: nobody has to set those of the first layer to zero as well. The second layer's weigh what
    rounding to whole DN does to its planes, which is left."""
    tables = []
    for weight in (0.0, 50.0):
        weights = f"luminance_noise = {weight}\nchroma_noise = {weight}\n"
        table, _ = trained(
            leaves, f'{CLASSES}noise = "none"\nlevel_power = 0\n{weights}{LAYER}luminance_noise = 0\nchroma_noise = 0\n'
        )
        tables.append(table)
    np.testing.assert_array_equal(tables[0].first.weights, tables[1].first.weights)
    np.testing.assert_array_equal(tables[0].later[0].weights, tables[1].later[0].weights)
    noisy, _ = trained(
        leaves, f"{CLASSES}luminance_noise = 0\nchroma_noise = 0\n{LAYER}luminance_noise = 0\nchroma_noise = 0\n"
    )
    assert not np.array_equal(noisy.first.weights, tables[0].first.weights)


@pytest.mark.parametrize(
    ("was", "line", "why"),
    [
        ("leaves = 8", "leaves = -1", "layer[1].leaves is -1; use at least 0"),
        ("leaves = 8", "leaves = 2049", "layer[1].leaves is 2049; use at most 2048"),
        ("tree_rows = 2000", "tree_rows = 999", "layer[1].tree_rows is 999; use at least 1000"),
        ("draws = 2\n", "draws = 2\nlevel_power = -1\n", "learning.level_power is -1; use at least 0"),
    ],
)
def test_wrong_keys_are_one_line(
    was: str, line: str, why: str, bayer: CameraModel, tmp_path: Path, refused: Refused
) -> None:
    training = a_set(tmp_path / "training.h5", bayer, 1)
    (tmp_path / "classes.toml").write_text((CLASSES + LAYER).replace(was, line, 1))
    assert why in refused(2, "train", training, "--classes", tmp_path / "classes.toml", "-o", tmp_path / "no.h5")
