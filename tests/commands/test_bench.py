"""l3 bench on small frames: what it prints, what it leaves out without a compiler."""

import functools
import json
import shutil
from importlib.util import find_spec

import numpy as np
import pytest

from l3cli import parallel
from l3cli.classes.recipe import ClassRecipe
from l3cli.rendering import benchmark
from l3cli.rendering.naive import NaiveTransforms
from l3cli.rendering.reference import ReferenceRenderer
from l3cli.simulation import benchmark as simulation
from l3cli.training import benchmark as training
from l3cli.training.recipe import TrainingRecipe
from tests.helpers.calls import L3, Refused
from tests.helpers.cameras import BAYER
from tests.helpers.tables import XYZ, frame_of_all_levels, random_table

FIELDS = {
    "width", "height", "patch", "channels", "outputs", "classes", "backend", "variant", "device", "stages_ms", "frame_ms",
    "mp_per_s",
}  # fmt: skip
STAGES = ["upload", "classes", "transforms", "encode", "download"]


@pytest.fixture(autouse=True)
def small(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(benchmark, "FULL", (benchmark.Case(80, 50, 5, "bayer", "fast"),))
    monkeypatch.setattr(benchmark, "SMALL", (benchmark.Case(40, 30, 5, "bayer", "fast", 2),))
    monkeypatch.setattr(benchmark, "PEER", benchmark.Case(40, 30, 5, "bayer", "fast"))
    monkeypatch.setattr(benchmark, "TINY", (benchmark.Case(20, 10, 5, "bayer", "fast"),))
    monkeypatch.setattr(simulation, "CASES", ())
    monkeypatch.setattr(training, "CASES", ())


def test_json_says_what_was_measured_how(l3: L3, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(training, "CASES", (training.Case(300),))
    monkeypatch.setattr(training, "REPEATS", 1)
    few = functools.partial(TrainingRecipe, classes=ClassRecipe(patch=5, levels=4, chromas=2))  # of many it takes longer
    monkeypatch.setattr(training, "TrainingRecipe", few)
    monkeypatch.setattr(parallel, "alone", lambda function, case: function(case))
    code, out, err = l3("bench", "--json", "--quiet")
    assert (code, err) == (0, "")
    document = json.loads(out)
    assert document["devices"][0].startswith("0: ")
    assert [(result["backend"], result["width"]) for result in document["results"]] == [
        ("opencl", 80), ("opencl", 40), ("reference", 20),
    ]  # fmt: skip
    assert {result["variant"] for result in document["results"]} == {"processor", "graphics", "reference"}
    for result in document["results"]:
        assert set(result) >= FIELDS
        assert list(result["stages_ms"]) == STAGES
        assert all(time >= 0 for time in result["stages_ms"].values())
        assert result["mp_per_s"] == pytest.approx(result["width"] * result["height"] / result["frame_ms"] / 1e3)
    (learned,) = document["train"]
    assert learned["rows_per_s"] == pytest.approx(learned["rows"] / learned["cpu_s"])
    assert sum(learned["stages_ns"].values()) == pytest.approx(1e9 / learned["rows_per_s"])
    assert ("limit_ratio" in document["results"][0]) == (shutil.which("cc") is not None)
    assert "limit_ratio" not in document["results"][1]  # limit.c has three outputs
    for result in document["results"][:2]:
        assert result["stages_sum_ms"] > 0
        assert ("limit_ratio" in result) != ("no_limit" in result)
    peers = [peer["peer"] for peer in document["peers"]]
    assert peers == ["naive kernel", "Menon (colour-demosaicing)"][: 1 + bool(find_spec("colour_demosaicing"))]
    assert all(peer["ratio"] == pytest.approx(peer["theirs"] / peer["ours"]) for peer in document["peers"])
    assert document["five_against_nine"] == {}  # the same frame is not timed with 9×9


def test_patches_of_five_and_nine_are_compared_where_all_else_is_the_same() -> None:
    usual = {"width": 80, "height": 50, "channels": 3, "classes": "fast", "variant": "processor", "backend": "opencl"}
    results = [{**usual, "patch": 5, "frame_ms": 2.0}, {**usual, "patch": 9, "frame_ms": 5.0}]
    others = [{**results[0], "channels": 5}, {**results[0], "width": 90}, {**results[0], "backend": "reference"}]
    assert benchmark.five_against_nine([*others, *results]) == {"80×50 fast": 2.5}


@pytest.mark.parametrize(("phase", "outputs"), [((0, 0), XYZ), ((1, 0), ("a", "b"))])
def test_the_naive_kernel_does_the_same(phase: tuple[int, int], outputs: tuple[str, ...]) -> None:
    table = random_table(BAYER, bits=12, black_level=64.0, outputs=outputs)
    frame = frame_of_all_levels(table, np.random.default_rng(0), (37, 51), phase)
    reference = ReferenceRenderer(table)
    naive = NaiveTransforms(table, "", frame, reference.labels(frame).astype(np.uint32))
    assert naive.milliseconds() > 0
    np.testing.assert_allclose(naive.outputs(), reference.outputs(frame), atol=1e-5)


def test_table_of_one_variant_without_a_compiler(l3: L3, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CC", "no-such-compiler")
    code, out, _ = l3("bench", "--variant", "processor", "--device", "0", "--quiet")
    assert code == 0
    lines = out.splitlines()
    line, comparison = [line for line in lines if "80×50" in line][:2]
    assert "processor" in line
    assert "graphics" not in out
    assert len(line.split()) == 13  # the last would be the ratio to the limit
    assert comparison.endswith("no C compiler (CC or cc)")
    assert any(line.split()[:3] == ["naive", "kernel", "40×30"] for line in lines)


def test_stages_of_two_layers_stand_beside_those_of_one(l3: L3, monkeypatch: pytest.MonkeyPatch) -> None:
    cases = benchmark.FULL[0], benchmark.Case(80, 50, 5, "bayer", "default")
    monkeypatch.setattr(benchmark, "FULL", cases)
    monkeypatch.setattr(benchmark, "FRAMES", 2)
    monkeypatch.setenv("COLUMNS", "200")
    code, out, _ = l3("bench", "--variant", "processor", "--device", "0", "--quiet")
    assert code == 0
    lines = [line.split() for line in out.splitlines()]
    (heading,) = [line for line in lines if "structures" in line]
    one, two = (next(line for line in lines if line[1:5] == ["80×50", "5", name, "3"]) for name in ("fast", "default"))
    assert heading[5:12] == ["upload", "classes", "planes", "structures", "transforms", "encode", "download"]
    assert len(two) == len(one) + 2
    assert all(float(time) > 0 for time in two[7:10])


def test_devices_are_listed_and_wrong_ones_refused(l3: L3, refused: Refused) -> None:
    code, out, _ = l3("bench", "--list")
    assert code == 0
    assert out.startswith("0: ")
    assert json.loads(l3("bench", "--list", "--json")[1])["devices"] == out.splitlines()
    assert "no such device" in refused(4, "bench", "--device", "no such device", "--quiet")


def test_tables_fit_eighty_columns(l3: L3, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    code, out, _ = l3("bench", "--variant", "processor", "--device", "0", "--quiet")
    assert code == 0
    assert max(map(len, out.splitlines()[1:])) <= 80
    assert {"whole", "MP/s", "encode", "download"} <= set(out.split())
