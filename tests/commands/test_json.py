"""`--json`: every command prints one object with results and run information, even after an error."""

import hashlib
import json
import os
import re
from pathlib import Path
from typing import Any

import click
import numpy as np
import pytest

from l3cli.cli import COMMANDS
from l3cli.cli import l3 as program
from tests.helpers.calls import L3

RUN = {
    "format", "command", "l3", "exit_code", "error", "warnings", "messages", "messages_left_out", "started", "seconds",
    "steps", "inputs", "outputs",
}  # fmt: skip
CALLS = {  # of a folder in which the pipeline has run; {out}: a new one
    "calibrate lab/MEASUREMENTS.toml -o {out}/c.h5": {"camera", "channels"},
    "simulate unseen.toml --camera camera.toml -o {out}/t.h5 --pictures {out}/p": {"training_set", "frames"},
    "train training.h5 --classes classes.toml --shard 1/2 -o {out}/s.h5": {"partial_sums", "shard"},
    "render table.h5 {raw} -o {out}/p.png": {"clips", "frames"},
    "evaluate table.h5 unseen.h5": {"mean", "by_level"},
    "report camera.h5 -o {out}/r.html": {"page"},
    "info table.h5": {"kind", "insight"},
    "info --version": {"libraries"},
    "info --verify table.h5 training.h5": {"different"},
    "export camera.h5 -o {out}/e": {"matrices"},
    "export table.h5 -o {out}/e --to folder": {"files"},
    "bench --list": {"devices"},
    "check camera.toml classes.toml": {"files"},
    "schema camera": {"schema"},
    "lab camera.toml -o {out}/lab": {"measurements"},
    "init": {"recipes"},
    "init bayer {out}/demo": {"folders"},
}


def printed(out: str) -> dict[str, Any]:
    """The object, which says how the command ran and holds neither NaN nor what only terminals read."""
    document: dict[str, Any] = json.loads(out, parse_constant=lambda name: pytest.fail(name))
    assert set(document["run"]) == RUN
    assert out.isascii()
    return document


def digest(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


@pytest.mark.parametrize("sentence", CALLS)
def test_results_and_how_the_command_ran(sentence: str, pipeline: Path, tmp_path: Path, l3: L3) -> None:
    raw, names = next((pipeline / "unseen").glob("*_raw.tif")), {path.name for path in pipeline.iterdir()}
    words = sentence.format(out=tmp_path, raw=raw).split()
    call = [str(pipeline / word) if index and word.partition("/")[0] in names else word for index, word in enumerate(words)]
    code, out, _ = l3(*call, "--json", "--quiet")
    document = printed(out)
    assert (code, document["run"]["exit_code"], document["run"]["error"]) == (0, 0, None)
    assert set(document) >= CALLS[sentence]
    made = {path for path in tmp_path.rglob("[!.]*") if path.is_file()}
    assert {Path(each["path"]): each["sha256"] for each in document["run"]["outputs"]} == {
        path: digest(path) for path in made
    }
    read = [each for files in document["run"]["inputs"].values() for each in files]
    assert all(each["sha256"] == digest(Path(each["path"])) for each in read)
    given = {Path(word) for word in call if Path(word).is_file() and tmp_path not in Path(word).parents}
    assert given <= {Path(each["path"]) for each in read}


def test_comparisons_are_json_too(pipeline: Path, tmp_path: Path, l3: L3) -> None:
    (tmp_path / "e.json").write_text(l3("evaluate", pipeline / "table.h5", pipeline / "unseen.h5", "--json")[1])
    document = printed(l3("compare", tmp_path / "e.json", "--json")[1])
    assert {"curves", "crossings"} < set(document)


def test_errors_end_as_json_with_their_exit_code(
    pipeline: Path, tmp_path: Path, l3: L3, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "there.png").write_text("mine")
    raw = next((pipeline / "unseen").glob("*_raw.tif"))
    for call, code, kind, what in (
        (("render", pipeline / "table.h5", raw, "-o", tmp_path / "there.png"), 1, "failure", "exists; add --force"),
        (("render", pipeline / "table.h5", raw, "-o", "-"), 2, "call", "--json"),
        (("info", "--jsn"), 2, "call", "no option --jsn"),
        (("inf",), 2, "call", 'did you mean "info"'),
        (("info", tmp_path / "there.png"), 3, "input", "there.png"),
        (
            ("render", pipeline / "table.h5", raw, "-o", tmp_path / "p.png", "--device", "none such"),
            4,
            "device",
            "none such",
        ),
    ):
        got, out, err = l3(*call, "--json")
        document = printed(out)
        assert (got, set(document)) == (code, {"run"})
        assert document["run"]["exit_code"] == code
        assert document["run"]["error"]["kind"] == kind
        assert what in document["run"]["error"]["message"]
        assert err == f"l3: {document['run']['error']['message']}\n"

    def interrupt(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("l3cli.stages.information.describe", interrupt)
    got, out, err = l3("info", pipeline / "table.h5", "--json")
    assert (got, printed(out)["run"]["error"]["kind"]) == (130, "interrupted")
    assert err.strip() == "l3: interrupted"


def test_faults_are_results_and_an_error(tmp_path: Path, l3: L3) -> None:
    (tmp_path / "classes.toml").write_text("patch = 4\n")
    code, out, _ = l3("check", tmp_path / "classes.toml", "--json")
    document = printed(out)
    assert (code, document["run"]["error"]["kind"]) == (3, "input")
    assert document["files"][0]["faults"]
    assert document["run"]["inputs"]["recipes"][0]["sha256"] == digest(tmp_path / "classes.toml")


def test_warnings_and_steps_are_kept_also_quietly(pipeline: Path, tmp_path: Path, l3: L3) -> None:
    np.save(tmp_path / "bright.npy", np.full((3, 64, 64), 3814, np.uint16))
    code, out, err = l3("render", pipeline / "table.h5", tmp_path / "bright.npy", "-o", tmp_path / "p", "--json", "--quiet")
    assert (code, err) == (0, "")
    document = printed(out)
    run, (clip,) = document["run"], document["clips"]
    assert any("clipped" in warning for warning in run["warnings"])
    assert clip["warnings"] == run["warnings"]
    assert [(step["what"], step["count"]) for step in run["steps"]] == [("frames", 3)]
    assert run["seconds"] >= run["steps"][0]["seconds"] > 0
    assert (clip["frames"], clip["left_out"], clip["error"]) == (3, 0, None)
    assert clip["frames_per_s"] == pytest.approx(3 / clip["seconds"])


def test_what_changes_during_it_has_no_digest(
    pipeline: Path, tmp_path: Path, l3: L3, monkeypatch: pytest.MonkeyPatch
) -> None:
    table = tmp_path / "table.h5"
    table.write_bytes((pipeline / "table.h5").read_bytes())

    def describe(file: Path) -> dict[str, Any]:
        os.utime(file, (1, 1))
        return {"kind": "", "version": 0, "history": [], "datasets": []}

    monkeypatch.setattr("l3cli.stages.information.describe", describe)
    code, out, err = l3("info", table, "--json")
    run = printed(out)["run"]
    assert code == 0
    assert run["inputs"]["artifact"][0] == {"path": str(table), "bytes": None, "sha256": None}
    assert f"{table} changed" in err
    assert f"{table} changed" in run["warnings"][0]


def test_every_command_speaks_alike_and_help_is_no_json(l3: L3) -> None:
    for name in COMMANDS:
        command = program.get_command(click.Context(program), name)
        assert command is not None
        assert {"console", "as_json"} <= {each.name for each in command.params}
    code, out, _ = l3("info", "--help", "--json")
    assert (code, out[:6]) == (0, "Usage:")
    assert re.search(r"--json\s+Print results", out)
