"""What is kept from run to run: believed as it was written, and by nobody else; a table from it is the table."""

import os
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from l3cli import kept
from l3cli.artifacts import store
from l3cli.artifacts.schema import Stage, equal
from l3cli.artifacts.store import save
from l3cli.artifacts.table import TransformTable
from l3cli.files import sha256
from l3cli.kept import DIGEST, forget_oldest, read_kept, write_kept
from l3cli.rendering import kept_table
from l3cli.rendering.kept_table import OpenTable, open_table
from l3cli.rendering.opencl import OpenCLRenderer
from tests.helpers.cameras import BAYER
from tests.helpers.tables import frame_of_all_levels, random_table, with_later, with_lights, with_quiet, with_tree


def flip_a_byte(file: Path) -> None:
    content = bytearray(file.read_bytes())
    content[DIGEST + 3] ^= 1
    file.write_bytes(content)


def link(file: Path) -> None:
    file.rename(file.with_name("elsewhere"))
    file.symlink_to(file.with_name("elsewhere"))


def make_pipe(file: Path) -> None:
    file.unlink()
    os.mkfifo(file)


SPOILED: dict[str, Callable[[Path], object]] = {
    "damaged": flip_a_byte,
    "cut": lambda file: os.truncate(file, 40),
    "empty": lambda file: os.truncate(file, 0),
    "longer": lambda file: os.truncate(file, 200),
    "writable by a group": lambda file: file.chmod(0o620),
    "writable by all": lambda file: file.chmod(0o602),
    "a link": link,
    "a pipe": make_pipe,
    "gone": Path.unlink,
}


@pytest.mark.parametrize("how", SPOILED)
def test_what_is_not_as_it_was_kept_is_as_good_as_none(tmp_path: Path, how: str) -> None:
    file = tmp_path / "a.table"
    write_kept(file, [b"some", memoryview(b"thing")])
    assert read_kept(file, 9) == b"something"
    assert read_kept(file, 8) is None  # too large
    SPOILED[how](file)
    assert read_kept(file, 1000) is None


def test_what_another_user_has_written_is_not_believed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_kept(tmp_path / "a", [b"code"])
    monkeypatch.setattr(kept, "TRUSTED", -1)
    assert read_kept(tmp_path / "a", 9) == b"code"
    another = os.geteuid() + 1
    monkeypatch.setattr(os, "geteuid", lambda: another)
    assert read_kept(tmp_path / "a", 9) is None


def test_nobody_else_may_write_what_is_kept_whatever_the_umask(tmp_path: Path) -> None:
    before = os.umask(0)
    try:
        write_kept(tmp_path / "a", [b"code"])
    finally:
        os.umask(before)
    assert (tmp_path / "a").stat().st_mode & 0o777 == 0o600


def test_the_oldest_go_first(tmp_path: Path) -> None:
    for number in range(4):
        file = tmp_path / f"{number}.table"
        write_kept(file, [bytes(100 - DIGEST)])
        os.utime(file, (number, number))
    (tmp_path / "x.program").write_bytes(bytes(1000))
    os.utime(tmp_path / "0.table")  # used again
    forget_oldest(tmp_path, ".table", 250)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["0.table", "3.table", "x.program"]


# --------------------------------------------------------------------------------------------------------- tables

TABLE = replace(random_table(BAYER, patch=3), history=(Stage("train", {"seed": 1}, "a = 1", {"set": ["ab"]}),))
TABLES = {
    "one layer": TABLE,
    "two layers": with_later(TABLE, 3, ratios=True),
    "trees": with_tree(TABLE),
    "quiet set": with_quiet(with_later(TABLE, 3)),
    "lights": with_lights(with_later(TABLE, 3), "A", "D65"),
}


@pytest.fixture
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr(kept_table, "kept_folder", lambda: tmp_path / "cache")
    return tmp_path / "cache"


def opened_and_kept(path: Path, by_noise: bool = False) -> OpenTable:
    opened = open_table(path)
    OpenCLRenderer(opened.table, layouts=opened.layouts, by_noise=by_noise)
    opened.keep()
    return opened


@pytest.mark.parametrize("name", TABLES)
def test_a_kept_table_is_the_table(cache: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str) -> None:
    path = tmp_path / "table.h5"
    save(TABLES[name], path)
    by_noise = TABLES[name].quiet is not None
    first = opened_and_kept(path, by_noise)
    monkeypatch.setattr(store, "load", None)  # is not needed again
    again = open_table(path)
    assert equal(again.table, TABLES[name])
    assert again.table.history == TABLES[name].history
    assert again.digest == first.digest == sha256(path)
    assert [type(value) for _, value in kept_table._fields(again.table)] == [
        type(value) for _, value in kept_table._fields(first.table)
    ]
    arrays = [value for _, value in kept_table._fields(again.table) if isinstance(value, np.ndarray)]
    assert not any(value.flags.writeable for value in arrays)
    renderer = OpenCLRenderer(again.table, layouts=again.layouts, by_noise=by_noise)
    assert not again.layouts.has_news
    frame = frame_of_all_levels(TABLES[name], np.random.default_rng(1), (20, 30))
    usual = OpenCLRenderer(TABLES[name], by_noise=by_noise)
    assert np.array_equal(renderer.outputs(frame), usual.outputs(frame))


def test_another_table_of_the_same_name_is_another_table(cache: Path, tmp_path: Path) -> None:
    path = tmp_path / "table.h5"
    save(TABLE, path)
    opened_and_kept(path)
    other = replace(TABLE, camera_name="other")
    path.unlink()
    save(other, path)
    assert open_table(path).table.camera_name == "other"


def test_a_table_that_is_replaced_while_it_is_read_is_not_kept(
    cache: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path, load = tmp_path / "table.h5", store.load
    save(TABLE, path)

    def replaced(cls: type[TransformTable], path: Path) -> TransformTable:
        path.unlink()
        save(replace(TABLE, camera_name="other"), path)
        return load(cls, path)

    monkeypatch.setattr(store, "load", replaced)
    assert opened_and_kept(path).digest == sha256(path)
    assert not cache.exists()


def test_what_other_code_has_made_is_not_taken(cache: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    save(TABLE, tmp_path / "table.h5")
    opened_and_kept(tmp_path / "table.h5")
    monkeypatch.setattr(kept_table, "_makers", lambda: "newer")
    assert not open_table(tmp_path / "table.h5").layouts.all()
    monkeypatch.setattr(kept_table, "_makers", lambda: "")  # it cannot be told from other code
    assert open_table(tmp_path / "table.h5").file is None


def test_a_table_is_rendered_by_where_none_can_be_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    save(TABLE, tmp_path / "table.h5")
    (tmp_path / "file").touch()
    for folder in (tmp_path / "file" / "below", None):
        monkeypatch.setattr(kept_table, "kept_folder", lambda folder=folder: folder)
        opened_and_kept(tmp_path / "table.h5")
    monkeypatch.setattr(kept_table, "kept_folder", lambda: tmp_path / "cache")
    monkeypatch.setattr(kept_table, "MOST_ONE", 1000)
    opened_and_kept(tmp_path / "table.h5")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["file", "table.h5"]
