"""l3 bench on small frames."""

import json

import pytest

from l3cli.rendering import benchmark
from tests.helpers.calls import L3, Refused

FIELDS = {
    "width", "height", "patch", "channels", "outputs", "classes", "backend", "variant", "device", "stages_ms", "frame_ms",
    "mp_per_s",
}  # fmt: skip
STAGES = ["upload", "classes", "transforms", "encode", "download"]


@pytest.fixture(autouse=True)
def small(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(benchmark, "FULL", (benchmark.Case(80, 50, 5, "bayer", "fast"),))
    monkeypatch.setattr(benchmark, "SMALL_CASES", (benchmark.Case(20, 10, 5, "bayer", "fast"),))


def test_json_states_what_was_measured_how(l3: L3) -> None:
    code, out, err = l3("bench", "--json", "--quiet")
    assert (code, err) == (0, "")
    document = json.loads(out)
    assert document["devices"][0].startswith("0: ")
    assert [(result["backend"], result["width"]) for result in document["results"]] == [("opencl", 80), ("reference", 20)]
    graphics = json.loads(l3("bench", "--json", "--quiet", "--variant", "graphics")[1])["results"]
    assert [(result["backend"], result["variant"]) for result in graphics] == [("opencl", "graphics")]
    for result in document["results"]:
        assert set(result) >= FIELDS
        assert list(result["stages_ms"]) == STAGES
        assert all(time >= 0 for time in result["stages_ms"].values())
        assert result["mp_per_s"] == pytest.approx(result["width"] * result["height"] / result["frame_ms"] / 1e3)
    assert all(result["stages_sum_ms"] > 0 for result in (document["results"][0], *graphics))


def test_stages_of_two_layers_stand_next_to_those_of_one(l3: L3, monkeypatch: pytest.MonkeyPatch) -> None:
    cases = benchmark.FULL[0], benchmark.Case(80, 50, 5, "bayer", "default")
    monkeypatch.setattr(benchmark, "FULL", cases)
    monkeypatch.setattr(benchmark, "FRAMES", 2)
    monkeypatch.setenv("COLUMNS", "200")
    code, out, _ = l3("bench", "--variant", "processor", "--device", "0", "--quiet")
    assert code == 0
    lines = [line.split() for line in out.splitlines()]
    (heading,) = [line for line in lines if "structures" in line]
    one, two = (next(line for line in lines if line[1:6] == ["80×50", "3", "5", name, "3"]) for name in ("fast", "default"))
    stages = "upload classes planes structures coarse chroma transforms chroma encode download"
    assert " ".join(heading[6:16]) == stages
    assert len(two) == len(one) + 4
    assert all(float(time) > 0 for time in two[8:11])


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
