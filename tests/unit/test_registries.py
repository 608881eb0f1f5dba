"""The registries of raw formats and scene formats: the entries are correct, and an added format is read."""

import re
from pathlib import Path
from typing import get_args

import pytest

from l3cli.cli.render import render
from l3cli.io import scenes
from l3cli.io.raw import files as raw
from l3cli.simulation import sources


def test_every_suffix_of_raw_files_has_one_format() -> None:
    suffixes = [suffix for each in raw.FORMATS for suffix in each.suffixes]
    assert len(suffixes) == len(set(suffixes)) == len(raw.BY_SUFFIX)
    assert all(suffix == suffix.lower() and suffix[0] == "." for suffix in suffixes)


@pytest.mark.parametrize("line", raw.FORMATS, ids=lambda line: line.suffixes[0])
def test_modules_of_raw_formats_do_what_their_lines_state(line: raw.RawFormat) -> None:
    assert hasattr(line._reader, "read") == line.holds_frame
    assert hasattr(line._reader, "rate") == line.has_rate
    assert hasattr(line._reader, "stack") or not line.stackable


def test_the_help_of_render_names_every_raw_format() -> None:
    text = render.help or ""
    for each in raw.FORMATS:
        name = re.match(r"[\w ]+?(?=s? *$|s?,| \()", each.what)
        assert name is not None
        assert name[0] in text or any(suffix in text for suffix in each.suffixes), each.what


@pytest.mark.parametrize("line", scenes.FORMATS, ids=lambda line: line.module)
def test_modules_of_scene_formats_do_what_their_lines_state(line: scenes.SceneFormat) -> None:
    assert callable(line._reader.read)
    assert callable(line._reader.size)
    assert hasattr(line._reader, "files") == line.has_files


def test_every_source_of_files_has_a_format() -> None:
    for source in get_args(sources.Source):
        if issubclass(source, sources.FileSource):
            line = scenes.format_of(source.__struct_config__.tag, Path("any.suffix"))
            assert set(line.keys) <= set(source.__struct_fields__)
