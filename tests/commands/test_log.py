"""--log FILE: all that a command says, with time, level and command, in a file that is never anything else."""

import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from l3cli.system.console import HEADING
from tests.helpers.calls import L3

LINE = re.compile(r"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\dZ (info|warning|error) (\w+) (.*)")


def lines(log: Path) -> list[tuple[str, str, str]]:
    heading, *rest = log.read_text().splitlines()
    assert heading.encode() + b"\n" == HEADING
    return [match.groups() for line in rest if (match := LINE.fullmatch(line)) or pytest.fail(line)]  # type: ignore[misc]


def test_a_log_holds_what_is_said_also_quietly_and_the_error_that_ends_a_run(l3: L3, pipeline: Path, tmp_path: Path) -> None:
    log, out = tmp_path / "l3.log", tmp_path / "table.h5"
    train = ("train", pipeline / "training.h5", "--classes", pipeline / "classes.toml", "-o", out, "--log", log)
    code, _, said = l3(*train)
    assert code == 0
    held = lines(log)
    assert {command for _, command, _ in held} == {"train"}
    assert [message for _, _, message in held if message in said.splitlines()] == said.splitlines()
    assert any(re.fullmatch(r"sums: \d+ done in \S+ s", message) for _, _, message in held)
    code, _, said = l3(*train)  # the table is there
    assert code == 1
    assert lines(log)[: len(held)] == held
    assert lines(log)[-1] == ("error", "train", said.strip().removeprefix("l3: "))
    before = len(lines(log))
    assert l3(*train, "--force", "--quiet") == (0, "", "")
    assert len(lines(log)) > before


def test_warnings_have_their_level(l3: L3, pipeline: Path, tmp_path: Path) -> None:
    np.save(tmp_path / "bright.npy", np.full((64, 64), 3814, np.uint16))
    call = ("render", pipeline / "table.h5", tmp_path / "bright.npy", "-o", tmp_path / "a.png", "--log", tmp_path / "l3.log")
    assert l3(*call)[0] == 0
    assert any(level == "warning" and "clipped" in message for level, _, message in lines(tmp_path / "l3.log"))


@pytest.mark.parametrize("kind", ["input", "folder", "link to an input"])
def test_what_is_no_log_is_never_written_to(kind: str, pipeline: Path, tmp_path: Path, refused: Callable[..., str]) -> None:
    raw = tmp_path / "frame.npy"
    np.save(raw, np.full((64, 64), 300, np.uint16))
    (tmp_path / "link").symlink_to(raw)
    before = raw.read_bytes()
    log = {"input": raw, "folder": tmp_path, "link to an input": tmp_path / "link"}[kind]
    error = refused(2, "render", pipeline / "table.h5", raw, "-o", tmp_path / "a.png", "--log", log)
    assert "is no log of l3's" in error
    assert raw.read_bytes() == before


def test_a_log_that_cannot_be_written_is_said_before_any_work(
    pipeline: Path, tmp_path: Path, refused: Callable[..., str]
) -> None:
    call = ("render", pipeline / "table.h5", tmp_path / "a.npy", "-o", tmp_path / "a.png")
    assert "cannot be written" in refused(1, *call, "--log", tmp_path / "nowhere/l3.log")
