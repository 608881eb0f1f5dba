"""How training is divided: patches over training sets by their shares."""

import dataclasses
from collections.abc import Callable
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from l3cli.artifacts.base import load
from l3cli.artifacts.camera import CameraModel
from l3cli.artifacts.table import TransformTable
from l3cli.artifacts.training_set import TrainingSet, write_training_set
from l3cli.train.lesson import spread_patches
from tests.test_train import a_frame, a_set

SMALL = "[classes]\npatch = 3\nlevels = 4\n[learning]\npatches = 2100\nfirst_draws = 1\ndraws = 2\n"


def test_patches_are_spread_over_frames_or_by_shares() -> None:
    assert spread_patches(100, [3, 1], None) == (25, 25, 25, 25)
    assert spread_patches(101, [3, 1], None) == (26, 26, 26, 26)
    by_share = spread_patches(210, [2, 7, 1], [Fraction(1), Fraction("0.7"), Fraction("0.4")])
    assert by_share == (50, 50, *[10] * 7, 40)
    assert spread_patches(1, [2, 1], [Fraction(1), Fraction(1, 10**6)]) == (1, 1, 1)  # no frame is idle


@given(st.lists(st.tuples(st.integers(1, 50), st.fractions(0.01, 100)), min_size=1, max_size=5), st.integers(1, 10**6))
def test_every_set_gets_its_share(sets: list[tuple[int, Fraction]], patches: int) -> None:
    """At least its share of the patches, and less than one more a frame; the same on every frame of the set."""
    frames, shares = zip(*sets, strict=True)
    found, first = spread_patches(patches, frames, shares), 0
    for count, share in sets:
        own = found[first : first + count]
        first += count
        assert len(set(own)) == 1
        assert 0 <= sum(own) - patches * share / sum(shares) < count
    assert first == len(found)


def lit_set(path: Path, camera: CameraModel, count: int, white: tuple[float, float, float]) -> Path:
    """A training set under a light of its own."""
    head = TrainingSet(camera=camera, outputs=("X", "Y", "Z"), target_description="a known mix of the channels")
    with write_training_set(path, head) as writer:
        for seed in range(count):
            writer.append(dataclasses.replace(a_frame(camera, seed, smooth=False), white=np.array(white)))
    return path


def test_shares_weigh_training_sets(bayer: CameraModel, tmp_path: Path, l3: Callable) -> None:
    """Patches follow the shares whatever the number of frames, and so does the white of the lights."""
    many, one = lit_set(tmp_path / "a.h5", bayer, 6, (80, 100, 100)), lit_set(tmp_path / "b.h5", bayer, 1, (120, 100, 60))
    (tmp_path / "classes.toml").write_text(SMALL)
    run = (many, one, "--classes", tmp_path / "classes.toml")
    whites = {}
    for shares in ("1,2", "1,0"):
        out = tmp_path / f"{shares}.h5"
        code, _, err = l3("train", *run, "--shares", shares, "-o", out)
        assert code == 0, err
        table = load(TransformTable, out)
        whites[shares] = table.white_point
        assert table.samples.sum() == 2 * 4 * (6 * -(-700 // 6) + 1400 if shares == "1,2" else 2100)
    assert whites["1,2"] == pytest.approx([(0.8 + 2 * 1.2) / 3, 1.0, (1.0 + 2 * 0.6) / 3], rel=2e-3)
    assert table.history[-1].options == {"seed": 0, "shares": "1"}
    # a set without a share is as if it had not been given
    assert l3("train", many, *run[2:], "--shares", "3", "-o", tmp_path / "alone.h5")[0] == 0
    alone = load(TransformTable, tmp_path / "alone.h5")
    assert (alone.weights == table.weights).all()
    assert alone.history[-1].inputs == table.history[-1].inputs


def test_shares_give_the_same_bytes_in_shards(bayer: CameraModel, tmp_path: Path, l3: Callable, refused: Callable) -> None:
    sets = [a_set(tmp_path / f"{count}.h5", bayer, count, smooth=False) for count in (3, 1)]
    text = SMALL.replace("2100", "52000").replace("draws = 2", "draws = 1")  # more than are sorted together
    (tmp_path / "classes.toml").write_text(text)
    run = (*sets, "--classes", tmp_path / "classes.toml", "--shares", "1,0.7", "--seed", 5)
    assert l3("train", *run, "-o", tmp_path / "whole.h5", "--jobs", 2)[0] == 0
    first: tuple = ()
    for name in ("first", "last"):
        shards = [tmp_path / f"{name}{index}.h5" for index in (1, 2)]
        for index, path in enumerate(shards, start=1):
            code, _, err = l3("train", *run, "--shard", f"{index}/2", *first, "-o", path)
            assert code == 0, err
        assert l3("train", "--merge", *shards, "-o", tmp_path / f"{name}.h5")[0] == 0
        first = ("--first", tmp_path / "first.h5")
    assert (tmp_path / "last.h5").read_bytes() == (tmp_path / "whole.h5").read_bytes()
    other = (*run[:-3], "1,0.8", "--seed", 5, "--shard", "1/2")
    assert "is not the first pass of this run" in refused(3, "train", *other, *first, "-o", tmp_path / "no.h5")


@pytest.mark.parametrize(
    ("shares", "why"),
    [
        ("1", "--shares gives 1 shares for 2 training sets"),
        ("1,2,3", "--shares gives 3 shares for 2 training sets"),
        ("1,-2", "shares must not be negative"),
        ("0,0", "one must be above zero"),
        ("1,x", "is no list of numbers"),
        ("1,nan", "is no list of numbers"),
        ("1,1e999", "is no list of numbers"),
        ("", "is no list of numbers"),
    ],
)
def test_wrong_shares_are_one_line(shares: str, why: str, bayer: CameraModel, tmp_path: Path, refused: Callable) -> None:
    training = a_set(tmp_path / "training.h5", bayer, 1)
    assert why in refused(2, "train", training, training, "--shares", shares, "-o", tmp_path / "no.h5")


def test_shares_do_not_go_with_merge(tmp_path: Path, refused: Callable) -> None:
    assert "--merge takes shards alone" in refused(2, "train", "--merge", "a.h5", "--shares", "1", "-o", tmp_path / "no.h5")
