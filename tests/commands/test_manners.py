"""Behaviour that users see in all commands: help, completion, progress, suggestions, warnings, logs, outputs and seeds."""

import json
import os
import re
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import click
import numpy as np
import pytest

from l3cli import __version__
from l3cli.artifacts.camera import CameraModel
from l3cli.artifacts.store import load
from l3cli.artifacts.table import TransformTable
from l3cli.cli import COMMANDS, l3, terminal
from l3cli.errors import suggestion
from l3cli.frames.frame import RawFrame
from l3cli.io.decoder_process import SECCOMP
from l3cli.rendering.exposure import RangeMeter
from l3cli.system.console import HEADING
from l3cli.system.text import columns
from tests.helpers.calls import L3, Refused
from tests.helpers.paths import CONFIGS
from tests.helpers.recipes import CLASSES
from tests.helpers.tables import with_first
from tests.helpers.terminal import in_terminal

UNITS = re.compile(r"\b(DN|nm|pixels?|seconds?|a second|a degree|Number|numbers|Rate factor|Bytes)\b", re.IGNORECASE)


def command(name: str) -> click.Command:
    subcommand = l3.get_command(click.Context(l3), name)
    assert subcommand is not None
    return subcommand


def called(line: str) -> click.Context:
    """A command line `l3 …` as click takes it, without doing it."""
    import shlex

    program, name, *arguments = shlex.split(line)
    assert program == "l3"
    return command(name).make_context(name, arguments, parent=click.Context(l3, info_name="l3"))


# ----------------------------------------------------------------------------------------------------------- help


@pytest.mark.parametrize("name", list(COMMANDS))
def test_help_has_an_example_and_units_and_fits_eighty_columns(name: str, l3: L3, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    code, out, err = l3(name, "--help")
    assert (code, err) == (0, "")
    assert max(map(len, out.splitlines())) <= 80
    (example,) = re.findall(r"^  Example: (l3 .*)$", out, re.MULTILINE)
    called(example.partition(" && ")[0])
    for option in command(name).params:
        if isinstance(option, click.Option):
            assert len(option.help or "") > 10, option.name
            if isinstance(option.type, click.types.IntParamType | click.types.FloatParamType):
                assert UNITS.search(f"{option.help} {option.metavar}"), f"{name} {option.name} has no unit"
                assert option.metavar, f"{name} {option.name}"


def test_versions_and_devices(l3: L3, refused: Refused, monkeypatch: pytest.MonkeyPatch) -> None:
    assert l3("--version")[1].split() == ["l3,", "version", __version__]
    code, out, err = l3("info", "--version", "--json")
    assert (code, err) == (0, "")
    document = json.loads(out)
    assert document["l3"] == document["run"]["l3"] == __version__
    assert document["python"] == ".".join(map(str, sys.version_info[:3]))
    assert document["devices"][0].startswith("0: ")
    assert document["decoding"].startswith("in an isolated process with limits on time and memory, ")
    plain = l3("info", "--version")[1]
    for name, version in document["libraries"].items():
        assert f"  {name} {version or 'is not installed'}\n" in plain
    for holds, words in (
        (("Landlock ABI 7", SECCOMP), "limits on time and memory, Landlock ABI 7, seccomp"),
        ((SECCOMP,), "limits on time and memory, no Landlock in this kernel, seccomp"),
        ((), "limits on time and memory, no Landlock in this kernel, no seccomp"),
    ):
        monkeypatch.setattr("l3cli.io.decoder_process.measures", lambda path, holds=holds: holds)
        assert words in " ".join(l3("info", "--version")[1].split())
    monkeypatch.setitem(sys.modules, "pyopencl", None)
    assert 'pip install "pyopencl[pocl]"' in l3("info", "--version")[1]
    assert "specify either" in refused(2, "info")
    assert "specify either" in refused(2, "info", "x.h5", "--version")


# ----------------------------------------------------------------------------------------------------- completion


def completed(words: str) -> list[str]:
    """What the shell is offered for the last of `words`, by a process that imports nothing heavy."""
    code = (
        "import sys, atexit\n"
        "atexit.register(lambda: print('heavy', *({'numpy', 'h5py', 'colour', 'rich', 'msgspec'} & set(sys.modules))))\n"
        "from l3cli.cli import main; main()"
    )
    asked = {"_L3_COMPLETE": "bash_complete", "COMP_WORDS": words, "COMP_CWORD": str(words.count(" "))}
    environment = {**os.environ, **asked}
    run = subprocess.run(
        [sys.executable, "-c", code], env=environment, capture_output=True, text=True, timeout=600, check=True
    )
    *offered, heavy = run.stdout.splitlines()
    assert heavy == "heavy"
    return offered


def test_completion_offers_commands_options_words_and_files_at_once() -> None:
    assert completed("l3 ") == [f"plain,{name}" for name in COMMANDS]
    assert completed("l3 ca") == ["plain,calibrate"]
    assert set(completed("l3 train --s")) == {"plain,--shares", "plain,--shard", "plain,--seed", "plain,--scheduler"}
    assert completed("l3 render table.h5 frame.dng --codec h26") == ["plain,h264", "plain,h265"]
    assert completed("l3 simulate scenes.toml --camera cam") == ["file,cam"]
    assert completed("l3 init rgb") == ["plain,rgbir", "plain,rgbir4x4", "plain,rgbw", "plain,rgbw4x4"]
    assert completed("l3 report camera") == ["file,camera"]


def test_bash_completes_with_the_line_of_the_docs(tmp_path: Path) -> None:
    program = tmp_path / "l3"
    program.write_text(f'#!/bin/sh\nexec {sys.executable} -c "from l3cli.cli import main; main()" "$@"\n')
    program.chmod(0o755)
    page = (CONFIGS.parent / "docs/commands.md").read_text()
    (line,) = re.findall(r'^    (eval "\$\(.*bash_source.*?\)")', page, re.MULTILINE)
    script = f'{line}\nCOMP_WORDS=(l3 eval) COMP_CWORD=1\n_l3_completion l3\necho "${{COMPREPLY[@]}}"'
    path = f"{tmp_path}:{os.environ['PATH']}"
    environment = {**os.environ, "PATH": path}
    run = subprocess.run(["bash", "-c", script], env=environment, capture_output=True, text=True, timeout=600)
    assert (run.stdout, run.stderr) == ("evaluate\n", "")


@pytest.mark.parametrize(("shell", "word"), [("zsh", "compdef"), ("fish", "complete --no-files --command l3")])
def test_the_scripts_of_other_shells(
    shell: str, word: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("_L3_COMPLETE", f"{shell}_source")
    with pytest.raises(SystemExit) as stop:
        l3.main([], prog_name="l3")
    assert stop.value.code == 0
    assert word in capsys.readouterr().out
    assert f"_L3_COMPLETE={shell}_source" in (CONFIGS.parent / "docs/commands.md").read_text()


# ---------------------------------------------------------------------------------------------------- suggestions


def test_suggestions_name_the_nearest_or_all() -> None:
    assert suggestion("d56", ["D65", "D50", "A"]) == 'did you mean "D65" or "D50"?'
    assert suggestion("zzz", ["D65", "A"]) == "use one of D65, A"
    many = suggestion("zzz", [f"name {number}" for number in range(1000)])
    assert many.startswith("use one of name 0, name 1, ")
    assert many.endswith(" …")
    assert len(many) < 300


# ------------------------------------------------------------------------------------------------------- progress


class Clock:
    """A clock that goes on by `step` seconds whenever it is read."""

    def __init__(self, step: float) -> None:
        self.now, self.step = 0.0, step

    def __call__(self) -> float:
        self.now += self.step
        return self.now


def logged(
    total: int | None, count: int, step: float, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> list[str]:
    monkeypatch.setattr(time, "monotonic", Clock(step))
    capsys.readouterr()
    assert list(terminal.Terminal().progress(range(count), total, "frames")) == list(range(count))
    return capsys.readouterr().err.splitlines()


def test_a_log_hears_of_progress_now_and_then(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    lines = logged(1000, 1000, 1.0, monkeypatch, capsys)
    assert len(lines) == 9  # what comes when all is done, the command itself says
    assert lines[0] == "frames: 100 of 1000, 1 min 40 s elapsed, 10 %, 1 per second, 15 min 0 s left"
    assert logged(10, 10, 0.5, monkeypatch, capsys) == []  # over before anybody wonders
    slow = logged(4, 4, 4000.0, monkeypatch, capsys)
    assert len(slow) == 3
    assert slow[0] == "frames: 1 of 4, 1 h 6 min elapsed, 25 %, 1 h 6 min each, 3 h 20 min left"
    endless = logged(None, 5000, 1.0, monkeypatch, capsys)
    assert endless[0] == "frames: 600, 10 min 0 s elapsed, 1 per second"
    assert len(endless) == 8


def test_quiet_is_quiet(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setattr(time, "monotonic", Clock(100.0))
    assert list(terminal.ErrorsOnly().progress(range(100), 100, "frames")) == list(range(100))
    assert capsys.readouterr().err == ""


BAR = """
import time
from l3cli.cli.terminal import Terminal
for _ in Terminal().progress(range(3), 3, "simulations"):
    time.sleep(0.15)
"""


@pytest.mark.parametrize(("environment", "coloured"), [({}, True), ({"NO_COLOR": "1"}, False)])
def test_a_terminal_gets_a_bar_that_fits(environment: dict[str, str], coloured: bool) -> None:
    shown = in_terminal([sys.executable, "-c", BAR], environment)
    lines = re.split(r"[\r\n]+", re.sub(r"\x1b\[[\d;?]*[A-Za-z]", "", shown))
    assert any(re.fullmatch(r"simulations +━* +0/3 0 % 0:00:00 *", line) for line in lines)  # before the first is done
    assert any(re.fullmatch(r"simulations ━+ 3/3 100 %, .* per second, 0 s left 0:00:0\d *", line) for line in lines)
    assert bool(re.search(r"\x1b\[(3|9)\dm", shown)) == coloured
    assert max(map(len, lines)) <= 80


def test_a_terminal_that_can_do_nothing_gets_no_bar() -> None:
    assert in_terminal([sys.executable, "-c", BAR], {"TERM": "dumb"}) == ""


# --------------------------------------------------------------------------------------------------------- tables


def test_columns_are_divided_where_they_do_not_fit() -> None:
    headings, rows = ["scene", "ours\nΔE00", "basic\nΔE00"], [["leaves", "1.5", "12.25"], ["mean", "1.5", "12.25"]]
    assert columns(headings, rows) == [
        "        ours  basic",
        "scene   ΔE00   ΔE00",
        "leaves   1.5  12.25",
        "mean     1.5  12.25",
    ]
    assert columns(headings, rows, 15) == [
        "        ours",
        "scene   ΔE00",
        "leaves   1.5",
        "mean     1.5",
        "",
        "        basic",
        "scene    ΔE00",
        "leaves  12.25",
        "mean    12.25",
    ]
    assert columns(headings, rows, 1) == columns(headings, rows, 15)  # what cannot fit is not lost


def test_tables_fit_a_terminal_of_eighty_columns(
    pipeline: Path, tmp_path: Path, l3: L3, monkeypatch: pytest.MonkeyPatch
) -> None:
    judged = tmp_path / "evaluation.json"
    table, unseen = pipeline / "table.h5", pipeline / "unseen.h5"
    judged.write_text(l3("evaluate", table, unseen, "--json")[1])
    wide = l3("evaluate", table, unseen)[1]
    assert max(map(len, wide.splitlines())) > 100  # a pipe takes whole tables
    monkeypatch.setenv("COLUMNS", "80")
    measurements = pipeline / "lab/MEASUREMENTS.toml"
    for call in (
        ("evaluate", table, unseen),
        ("calibrate", measurements, "--truth", pipeline / "camera.toml", "-o", tmp_path / "camera.h5"),
        ("compare", judged, judged),
        ("info", table),
        ("info", pipeline / "camera.h5"),
        ("info", pipeline / "training.h5"),
        ("info", "--version"),
        ("init",),
    ):
        code, out, _ = l3(*call)
        assert code == 0
        too_long = [line for line in out.splitlines() if len(line) > 80]
        assert too_long == [], call
        assert call[0] != "evaluate" or "95 %" in out


# ------------------------------------------------------------------------------------------------- input warnings


def test_frames_that_the_table_was_not_made_for_are_warned_of(pipeline: Path, tmp_path: Path, l3: L3) -> None:
    raw = next((pipeline / "unseen").glob("*_raw.tif"))
    render = ("render", pipeline / "table.h5", raw, "--backend", "reference", "-o")
    assert l3(*render, tmp_path / "fine.png") == (0, "", "")
    code, _, err = l3(*render, tmp_path / "clipped.png", "--white-level", "1200")
    assert code == 0
    assert re.fullmatch(rf"warning: {re.escape(str(raw))}: \d+% of the pixels are clipped .* --white-level\n", err)
    assert l3(*render, tmp_path / "quiet.png", "--white-level", "1200", "--quiet")[2] == ""
    err = l3(*render, tmp_path / "a.png", "--white", "0.4476,0.4074")[2]
    assert err.startswith("warning: --white 0.4476,0.4074 is far from the mean training illuminant")
    assert err.endswith("the illuminant or to the ROW,COL of a grey area\n")
    assert l3(*render, tmp_path / "modelled.png", "--white", "A")[2] == ""  # the table's camera says what it sees of it
    assert l3(*render, tmp_path / "d.png", "--white", "D60")[2] == ""
    unseen = l3("evaluate", pipeline / "table.h5", pipeline / "training.h5", "--backend", "reference")[2]
    assert "was trained on" in unseen
    assert "another --seed" in unseen


def frames_of(table: TransformTable, level: float, count: int) -> Iterator[RawFrame]:
    """Noisy grey frames at a share of full scale."""
    rng = np.random.default_rng(0)
    for number in range(count):
        mean = table.black_level + level * (table.white_level - table.black_level)
        values = np.clip(rng.normal(mean, 2.0, (60, 90)), 0, 4095).astype(np.uint16)
        yield RawFrame(f"frame {number}", values, table.black_level, table.white_level)


def test_levels_without_training_are_counted(pipeline: Path, capsys: pytest.CaptureFixture[str]) -> None:
    from dataclasses import replace

    from l3cli.rendering.raw_checks import FrameWarnings

    table = load(TransformTable, pipeline / "table.h5")
    samples = table.first.samples.reshape(table.cfa.size, table.first.rule.levels, -1).copy()
    samples[:, 2:5] = 100.0
    samples[:, :2] = samples[:, 5:] = 0.0
    part = replace(with_first(table, samples=samples.ravel()), camera=None)
    meter = RangeMeter(part)
    dark, middle, bright = (meter.outside(next(frames_of(part, level, 1))) for level in (0.0, 0.01, 0.7))
    assert (dark.darker, dark.brighter, middle.darker, middle.brighter) == (1.0, 0.0, 0.0, 0.0)
    assert (bright.darker, bright.brighter, bright.saturated) == (0.0, 1.0, 0.0)
    low, high = meter.learned_range()
    assert 0.001 < low < 0.01 < high < 0.2
    warnings = FrameWarnings(part)
    for frame in (*frames_of(part, 0.7, 3), *frames_of(part, 0.01, 2)):
        warnings.measure(frame)
    (line,) = warnings.lines()
    assert line.startswith("frame 0 (the worst of 3 affected frames, 5 in total): 100% of the pixels are brighter than")
    assert line.endswith("increase learning.brightest and train again")


LINE = re.compile(r"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\dZ (info|warning|error) (\w+) (.*)")


def lines(log: Path) -> list[tuple[str, str, str]]:
    heading, *rest = log.read_text().splitlines()
    assert heading.encode() + b"\n" == HEADING
    return [match.groups() for line in rest if (match := LINE.fullmatch(line)) or pytest.fail(line)]  # type: ignore[misc]


def test_a_log_holds_what_is_reported_also_quietly_and_the_error_that_ends_a_run(
    l3: L3, pipeline: Path, tmp_path: Path
) -> None:
    log, out = tmp_path / "l3.log", tmp_path / "table.h5"
    train = ("train", pipeline / "training.h5", "--classes", pipeline / "classes.toml", "-o", out, "--log", log)
    code, _, answer = l3(*train)
    assert code == 0
    stored = lines(log)
    assert {command for _, command, _ in stored} == {"train"}
    assert [message for _, _, message in stored if message in answer.splitlines()] == answer.splitlines()
    assert any(re.fullmatch(r"sums: \d+ done in \S+ s", message) for _, _, message in stored)
    code, _, answer = l3(*train)  # the table is there
    assert code == 1
    assert lines(log)[: len(stored)] == stored
    assert lines(log)[-1] == ("error", "train", answer.strip().removeprefix("l3: "))
    before = len(lines(log))
    assert l3(*train, "--force", "--quiet") == (0, "", "")
    assert len(lines(log)) > before


def test_warnings_have_their_level(l3: L3, pipeline: Path, tmp_path: Path) -> None:
    np.save(tmp_path / "bright.npy", np.full((64, 64), 3814, np.uint16))
    call = ("render", pipeline / "table.h5", tmp_path / "bright.npy", "-o", tmp_path / "a.png", "--log", tmp_path / "l3.log")
    assert l3(*call)[0] == 0
    assert any(level == "warning" and "clipped" in message for level, _, message in lines(tmp_path / "l3.log"))


@pytest.mark.parametrize("kind", ["input", "folder", "link to an input"])
def test_what_is_no_log_is_never_written_to(kind: str, pipeline: Path, tmp_path: Path, refused: Refused) -> None:
    raw = tmp_path / "frame.npy"
    np.save(raw, np.full((64, 64), 300, np.uint16))
    (tmp_path / "link").symlink_to(raw)
    before = raw.read_bytes()
    log = {"input": raw, "folder": tmp_path, "link to an input": tmp_path / "link"}[kind]
    error = refused(2, "render", pipeline / "table.h5", raw, "-o", tmp_path / "a.png", "--log", log)
    assert "is not an l3 log" in error
    assert raw.read_bytes() == before


def test_a_log_that_cannot_be_written_is_reported_before_any_work(pipeline: Path, tmp_path: Path, refused: Refused) -> None:
    call = ("render", pipeline / "table.h5", tmp_path / "a.npy", "-o", tmp_path / "a.png")
    assert "cannot be written" in refused(1, *call, "--log", tmp_path / "nowhere/l3.log")


def test_the_history_names_every_stage(pipeline: Path) -> None:
    table = load(TransformTable, pipeline / "table.h5")
    camera = load(CameraModel, pipeline / "camera.h5")
    assert [stage.command for stage in table.history] == ["calibrate", "simulate", "train"]
    assert table.history[0] == camera.history[0]
    assert table.history[2].recipe == CLASSES
    text = json.dumps([stage.__dict__ for stage in table.history])
    assert str(pipeline) not in text


def test_an_existing_output_is_refused_before_any_work(pipeline: Path, refused: Refused) -> None:
    raw = next((pipeline / "unseen").glob("*_raw.tif"))
    for arguments in (
        ("lab", pipeline / "camera.toml", "-o", pipeline / "lab"),
        ("calibrate", pipeline / "lab/MEASUREMENTS.toml", "-o", pipeline / "camera.h5"),
        ("simulate", pipeline / "scenes.toml", "--camera", pipeline / "camera.h5", "-o", pipeline / "training.h5"),
        ("train", pipeline / "training.h5", "-o", pipeline / "table.h5"),
        ("render", pipeline / "table.h5", raw, "-o", pipeline / "picture.png"),
    ):
        before = {path: path.stat().st_mtime_ns for path in pipeline.rglob("*")}
        assert "--force" in refused(1, *arguments)
        assert {path: path.stat().st_mtime_ns for path in pipeline.rglob("*")} == before
