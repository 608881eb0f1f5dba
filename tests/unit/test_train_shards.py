"""The division of training among training sets, processes and shards does not change the bytes of the table."""

import dataclasses
import os
import subprocess
import sys
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from l3cli.artifacts.camera import CameraModel
from l3cli.artifacts.store import load, save
from l3cli.artifacts.table import TransformTable
from l3cli.artifacts.training_set import (
    LightSpectrum,
    TrainingFrame,
    TrainingPair,
    TrainingSet,
    TrainingSetReader,
    open_training_set,
    write_training_set,
)
from l3cli.classes.features import ClassRecipe
from l3cli.classes.rule import make_rule
from l3cli.errors import InputFileError
from l3cli.options.commands import TrainOptions
from l3cli.parallel import WorkerPool, workers
from l3cli.physics import spectra
from l3cli.stages.training.passes import Execution, first_pass
from l3cli.stages.training.run import FRAMES, open_run
from l3cli.system.console import Silent
from l3cli.training import training_pass
from l3cli.training.layers import learn
from l3cli.training.patches import colourless_frame
from l3cli.training.recipe import LearningRecipe
from l3cli.training.sums import empty_sums
from l3cli.training.training_pass import (
    BATCH_PATCHES,
    LAST,
    SUM_BYTES,
    TrainingPass,
    frame_blocks,
    spread_patches,
    work_shares,
)
from tests.helpers.calls import L3, Refused
from tests.helpers.training_sets import a_frame, a_set, frame_of_squares, in_shards

SMALL = "[classes]\npatch = 3\nlevels = 4\nchromas = 2\n[learning]\npatches = 2100\nfirst_draws = 1\ndraws = 2\n"

TWO_LAYERS = SMALL.replace("2100", "900") + "[[layer]]\nside = 3\nmosaics = 12\nrows = 500\n"
THREE_LAYERS = (
    TWO_LAYERS + "[[layer]]\nside = 3\nleaves = 3\ntree_rows = 1000\nmosaics = 7\nrows = 500\ncolour_ratios = true\n"
    "bilateral_chroma = true\n"
)


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
    counts, first = spread_patches(patches, frames, shares), 0
    for count, share in sets:
        of_set = counts[first : first + count]
        first += count
        assert len(set(of_set)) == 1
        assert 0 <= sum(of_set) - patches * share / sum(shares) < count
    assert first == len(counts)


def a_pass(bayer: CameraModel, patches: tuple[int, ...], **recipe: Any) -> TrainingPass:
    rule = make_rule(ClassRecipe(**{"patch": 3, "levels": 4, **recipe}), bayer, np.zeros(8, np.uint16))
    head = TrainingSet(camera=bayer, outputs=("X", "Y", "Z"), target_description="")
    return TrainingPass(head, patches, rule, LearningRecipe(darkest=0.003), np.ones(3), 0, LAST)


@given(st.lists(st.integers(1, 120_000), min_size=1, max_size=40))
def test_blocks_hold_every_frame_once_and_bounded_patches(bayer: CameraModel, patches: list[int]) -> None:
    blocks = frame_blocks(patches)
    assert [index for block in blocks for index in block] == list(range(len(patches)))
    for block in blocks:
        assert sum(patches[index] for index in block) <= BATCH_PATCHES + max(patches[index] for index in block)


def test_blocks_are_nearly_equal(bayer: CameraModel) -> None:
    assert frame_blocks((1000,) * 60) == [range(30), range(30, 60)]
    assert [len(block) for block in frame_blocks((100,) * 1030)] == [344, 343, 343]


@given(st.integers(1, 9), st.integers(1, 12), st.integers(1, 9))
def test_work_shares_hold_every_block_of_every_site_once(bayer: CameraModel, jobs: int, count: int, sites: int) -> None:
    pass_, every = a_pass(bayer, (100,) * count), dict.fromkeys(range(0, 3 * sites, 3), 1)
    blocks = [range(index, index + 1) for index in range(count)]
    parts = work_shares(pass_, every, blocks, jobs)
    taken = [(site, block) for part in parts for block, of_block in part.blocks for site in of_block]
    assert sorted(taken, key=str) == sorted(((site, block) for site in every for block in blocks), key=str)
    sizes = [sum(len(of_block) for _, of_block in part.blocks) for part in parts]
    assert max(sizes) - min(sizes) <= 1
    assert len(parts) == min(jobs, len(taken))
    for part in parts:
        assert part.whole == tuple(
            s for s in part.sites if not any(s in other.sites for other in parts if other is not part)
        )
        assert [block[0] for block, _ in part.blocks] == sorted(block[0] for block, _ in part.blocks)
    assert work_shares(pass_, every, [], jobs) == []


def test_work_shares_of_large_sums_have_few_sites(bayer: CameraModel) -> None:
    pass_ = a_pass(bayer, (100,) * 12, patch=15, levels=40, chromas=1, contrasts=(1.1, 1.4, 2.0, 3.5, 7.0))
    assert SUM_BYTES / empty_sums(pass_.rule, 3, pass_.head.camera).moments.nbytes < 5
    blocks = [range(index, index + 1) for index in range(12)]
    for jobs in (1, 2, 3):
        parts = work_shares(pass_, dict.fromkeys(range(9), 1), blocks, jobs)
        assert len(parts) % jobs == 0
        assert max(len(part.sites) for part in parts) <= max(
            2, SUM_BYTES // empty_sums(pass_.rule, 3, pass_.head.camera).moments.nbytes
        )


def lit_set(path: Path, camera: CameraModel, count: int, white: tuple[float, float, float]) -> Path:
    """A training set under another light."""
    head = TrainingSet(camera=camera, outputs=("X", "Y", "Z"), target_description="a known mix of the channels")
    with write_training_set(path, head) as writer:
        for seed in range(count):
            writer.append(dataclasses.replace(a_frame(camera, seed, smooth=False), white=np.array(white)))
    return path


@pytest.mark.usefixtures("same_workers")
def test_same_bytes_for_jobs_and_shards(
    bayer: CameraModel, tmp_path: Path, l3: L3, refused: Refused, monkeypatch: pytest.MonkeyPatch
) -> None:
    """One process, two processes, three shards of each pass merged in any order: the same table to the last bit."""
    training = a_set(tmp_path / "training.h5", bayer, 4, smooth=False)
    more = a_set(tmp_path / "more.h5", bayer, 3, smooth=True)
    monkeypatch.setattr(training_pass, "BATCH_PATCHES", 500)  # two blocks of frames, and the third shard is empty
    small = "[classes]\npatch = 3\nlevels = 4\nchromas = 2\n[learning]\npatches = 1000\nfirst_draws = 1\ndraws = 1\n"
    (tmp_path / "classes.toml").write_text(small)
    run = (training, more, "--classes", tmp_path / "classes.toml", "--seed", 5)
    for jobs in (1, 2):
        assert l3("train", *run, "-o", tmp_path / f"{jobs}.h5", "--jobs", jobs)[0] == 0
    assert (tmp_path / "1.h5").read_bytes() == (tmp_path / "2.h5").read_bytes()
    a, b = ([tmp_path / f"{name}{index}.h5" for index in (1, 2, 3)] for name in "ab")
    first, table = tmp_path / "first.h5", tmp_path / "table.h5"
    for index, path in enumerate(a, start=1):
        assert l3("train", *run, "--shard", f"{index}/3", "-o", path)[0] == 0
    code, _, err = l3("train", "--merge", *a, "-o", first)
    assert code == 0
    assert f"continue training with --shard I/N --first {first}" in err
    for index, path in enumerate(b, start=1):
        assert l3("train", *run, "--shard", f"{index}/3", "--first", first, "-o", path)[0] == 0
    assert l3("train", "--merge", b[2], b[0], b[1], "-o", table)[0] == 0
    assert table.read_bytes() == (tmp_path / "1.h5").read_bytes()
    assert first.read_bytes() != table.read_bytes()
    out = tmp_path / "no.h5"
    assert "--shard 2/3 is missing" in refused(3, "train", "--merge", a[0], a[2], "-o", out)
    assert a[0].name in refused(3, "train", "--merge", a[0], a[1], a[0], a[2], "-o", out)
    assert b[2].name in refused(3, "train", "--merge", a[0], a[1], b[2], "-o", out)
    assert a[0].name in refused(3, "train", a[0], "-o", out)
    other = (*run[:-1], 6, "--shard", "1/3", "--first")
    assert first.name in refused(3, "train", *other, first, "-o", out)
    assert table.name in refused(3, "train", *run, "--shard", "1/3", "--first", table, "-o", out)
    assert l3("train", *run[:-1], 6, "--shard", "1/3", "-o", tmp_path / "foreign.h5")[0] == 0
    assert "foreign.h5" in refused(3, "train", "--merge", tmp_path / "foreign.h5", a[1], a[2], "-o", out)
    for wrong in ("0/3", "4/3", "3", "a/b"):
        assert wrong in refused(2, "train", *run, "--shard", wrong, "-o", out)


@pytest.mark.usefixtures("same_workers")
def test_three_layers_have_the_same_bytes_in_shards(
    bayer: CameraModel, tmp_path: Path, l3: L3, refused: Refused, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A layer by structure and one by a tree, each in a pass of its own, with a set for another gain: by one process, two,
    and in shards, at last more of them than frames; a shard takes only the table of the pass before. All results would be
    accepted from other machines, too."""

    def checked(pool: WorkerPool, function: Any, items: Any, fits: Any) -> Any:
        items = list(items)
        for item, result in zip(items, pool._map(function, items, fits), strict=True):
            assert fits(item, result)
            yield result

    monkeypatch.setattr(WorkerPool, "__call__", checked)
    monkeypatch.setattr(training_pass, "BATCH_PATCHES", 500)  # two blocks of frames, one for each shard
    monkeypatch.setattr(learn, "LAYER_SAMPLES", 2000)  # two of the refinement layers, too
    training = a_set(tmp_path / "training.h5", bayer, 3, smooth=False)
    (tmp_path / "classes.toml").write_text(
        THREE_LAYERS.replace("levels = 4", "levels = 2").replace("draws = 2\n", "draws = 2\nnoise_left = 0.25\n")
    )
    run = (training, "--classes", tmp_path / "classes.toml", "--seed", 5)
    for name, jobs in (("whole", 1), ("whole2", 2)):
        assert l3("train", *run, "-o", tmp_path / f"{name}.h5", "--jobs", jobs)[0] == 0
    assert (tmp_path / "whole.h5").read_bytes() == (tmp_path / "whole2.h5").read_bytes()
    whole = load(TransformTable, tmp_path / "whole.h5")
    assert len(whole.later) == len(whole.conditions[0].later) == 2

    before: tuple = ()
    shards, tables = [], []
    for made in ("first pass", "first layer", "second layer"):
        parts, table, words = in_shards(l3, run, 2, tmp_path, *before)
        assert f"the table of the {made}; continue training with --shard I/N --first {table}" in words
        before = ("--first", table)
        shards.append(parts)
        tables.append(table)
    parts, table, words = in_shards(l3, run, 4, tmp_path, *before)
    assert "continue training with" not in words
    assert table.read_bytes() == (tmp_path / "whole.h5").read_bytes()
    code, words, _ = l3("info", parts[0])
    assert (code, "partial sums of a layer" in words) == (0, True)

    out = tmp_path / "no.h5"
    assert shards[2][1].name in refused(3, "train", "--merge", parts[0], shards[2][1], "-o", out)
    assert table.name in refused(3, "train", *run, "--shard", "1/2", "--first", table, "-o", out)  # nothing follows it
    for of_other_run in tables[1:]:
        call = (*run[:-1], 6, "--shard", "1/2", "--first", of_other_run)
        assert of_other_run.name in refused(3, "train", *call, "-o", out)
    save(dataclasses.replace(load(TransformTable, tables[1]), conditions=()), tmp_path / "one_set.h5")
    assert "one_set.h5" in refused(3, "train", *run, "--shard", "1/2", "--first", tmp_path / "one_set.h5", "-o", out)


def test_a_second_layer_follows_a_single_pass(bayer: CameraModel, tmp_path: Path, l3: L3) -> None:
    training = a_set(tmp_path / "training.h5", bayer, 3, smooth=False)
    (tmp_path / "classes.toml").write_text(TWO_LAYERS.replace("first_draws = 1", "first_draws = 0"))
    run = (training, "--classes", tmp_path / "classes.toml")
    assert l3("train", *run, "-o", tmp_path / "whole.h5")[0] == 0
    _, one_layer, words = in_shards(l3, run, 2, tmp_path)
    assert "is the table of the first layer; continue training with" in words
    _, table, _ = in_shards(l3, run, 2, tmp_path, "--first", one_layer)
    assert table.read_bytes() == (tmp_path / "whole.h5").read_bytes()


def test_a_draft_is_one_layer_of_many_patches_at_few_levels(bayer: CameraModel, tmp_path: Path, l3: L3) -> None:
    """In shards, too; its history says that it is one."""
    training = a_set(tmp_path / "training.h5", bayer, 3, smooth=False)
    (tmp_path / "classes.toml").write_text(TWO_LAYERS.replace("draws = 2\n", "draws = 2\nnoise_left = 0.1\n"))
    run = (training, "--classes", tmp_path / "classes.toml", "--draft")
    assert l3("train", *run, "-o", tmp_path / "whole.h5")[0] == 0
    draft = load(TransformTable, tmp_path / "whole.h5")
    assert (draft.later, draft.conditions, draft.history[-1].options["draft"]) == ((), (), True)
    assert draft.first.samples.sum() == 4 * 270 * 1  # sites, patches, draws
    _, first, _ = in_shards(l3, run, 2, tmp_path)
    assert in_shards(l3, run, 2, tmp_path, "--first", first)[1].read_bytes() == (tmp_path / "whole.h5").read_bytes()


def test_a_training_set_that_is_replaced_during_it_is_noticed(bayer: CameraModel, tmp_path: Path) -> None:
    training, other = a_set(tmp_path / "training.h5", bayer, 2), a_set(tmp_path / "other.h5", bayer, 3)
    run = open_run((training,), TrainOptions())
    with workers(1) as pool:
        execution = Execution(pool, remote=False, console=Silent())
        first_pass(run, execution)
        other.rename(training)
        with pytest.raises(InputFileError, match="has changed during training"):
            first_pass(run, execution)


def test_shares_weigh_training_sets(bayer: CameraModel, tmp_path: Path, l3: L3) -> None:
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
        assert table.first.samples.sum() == 2 * 4 * (6 * -(-700 // 6) + 1400 if shares == "1,2" else 2100)
    assert whites["1,2"] == pytest.approx([(0.8 + 2 * 1.2) / 3, 1.0, (1.0 + 2 * 0.6) / 3], rel=2e-3)
    assert table.history[-1].options == {"seed": 0, "shares": "1"}
    # a set without a share is as if it had not been given
    assert l3("train", many, *run[2:], "--shares", "3", "-o", tmp_path / "alone.h5")[0] == 0
    alone = load(TransformTable, tmp_path / "alone.h5")
    assert (alone.first.weights == table.first.weights).all()
    assert alone.history[-1].inputs == table.history[-1].inputs


@pytest.mark.parametrize("shares", ["1", "1,2,3", "1,-2", "0,0", "1,x", "1,nan", "1,1e999", ""])
def test_wrong_shares_are_one_line(shares: str, bayer: CameraModel, tmp_path: Path, refused: Refused) -> None:
    training = a_set(tmp_path / "training.h5", bayer, 1)
    assert "--shares" in refused(2, "train", training, training, "--shares", shares, "-o", tmp_path / "no.h5")


@pytest.mark.slow
def test_memory_does_not_grow_with_frames_or_jobs(tmp_path: Path, fiveband: CameraModel) -> None:
    """Default rule, 60 and 600 frames, one and two workers: all processes together stay below 1.5 GB."""
    head = TrainingSet(camera=fiveband, outputs=("X", "Y", "Z"), target_description="synthetic")
    with write_training_set(tmp_path / "training.h5", head) as writer:
        for seed in range(60):
            writer.append(frame_of_squares(fiveband, seed))
    for jobs, times in ((1, 1), (1, 10), (2, 1), (2, 10)):
        files = [str(tmp_path / "training.h5")] * times
        command = [sys.executable, "-c", "from l3cli.cli import main; main()", "train", *files, "--jobs", str(jobs)]
        run = subprocess.Popen([*command, "--quiet", "--force", "-o", str(tmp_path / "table.h5")])
        _, status, usage = os.wait4(run.pid, 0)  # the largest of the process and its workers
        run.returncode = os.waitstatus_to_exitcode(status)
        assert run.returncode == 0
        print(f"{60 * times} frames, {jobs} jobs: largest process {usage.ru_maxrss / 1e6:.2f} GB")
        assert usage.ru_maxrss * 1024 * (1 if jobs == 1 else jobs + 1) < 1.5e9


def test_a_small_training_set_is_read_once(
    bayer: CameraModel, tmp_path: Path, l3: L3, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Whatever the passes, of as many frames as there is room for; the others in each. Nothing is held when all is done."""
    training = a_set(tmp_path / "training.h5", bayer, 3)
    (tmp_path / "classes.toml").write_text(SMALL.replace("2100", "300"))
    read: list[int] = []
    frame = TrainingSetReader.frame

    def noted(self: TrainingSetReader, index: int) -> TrainingPair:
        read.append(index)
        return frame(self, index)

    monkeypatch.setattr(TrainingSetReader, "frame", noted)
    with open_training_set(training) as reader:
        size = sum(value.nbytes for value in vars(reader.frame(0)).values() if isinstance(value, np.ndarray))
    monkeypatch.setattr(FRAMES, "most", 2 * size)
    FRAMES.clear()
    read.clear()
    assert l3("train", training, "--classes", tmp_path / "classes.toml", "-o", tmp_path / "table.h5")[0] == 0
    assert sorted(read) == [0, 1, 2, 2, 2]  # by the pilot, and two passes
    assert FRAMES.bytes == 0


def test_what_all_sites_share_is_made_once(
    bayer: CameraModel, tmp_path: Path, l3: L3, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Surfaces under the light once a pass, a frame without colour once in each; three sites are learned."""
    wavelength = spectra.light_grid(bayer.wavelength).astype(np.float64)
    light = LightSpectrum(wavelength, np.full(wavelength.size, 4e13, np.float32))
    head = TrainingSet(camera=bayer, outputs=("X", "Y", "Z"), target_description="a known mix of the channels")
    with write_training_set(tmp_path / "training.h5", head) as writer:
        for seed in range(2):
            writer.append(dataclasses.replace(a_frame(bayer, seed, smooth=False), light=light))
    (tmp_path / "classes.toml").write_text(SMALL + "achromatic = 0.2\n")
    made: list[str] = []

    def noted(frame: TrainingPair, head: TrainingSet) -> TrainingFrame | None:
        made.append("colourless")
        return colourless_frame(frame, head)

    monkeypatch.setattr("l3cli.training.accumulate.colourless_frame", noted)
    monkeypatch.setattr("l3cli.training.goal.plain_surfaces", lambda *about: made.append("surfaces"))
    assert l3("train", tmp_path / "training.h5", "--classes", tmp_path / "classes.toml", "-o", tmp_path / "t.h5")[0] == 0
    assert sorted(made) == ["colourless"] * 4 + ["surfaces"] * 2
