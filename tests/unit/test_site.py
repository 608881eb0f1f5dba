"""The site of docs/: generated pages are complete, and wrong links and fetches from other sites are detected.

`make docs-build`, which .ci/run calls, runs Sphinx with warnings as errors.
"""

import importlib
import re
from pathlib import Path
from types import ModuleType
from typing import Any

import click
import msgspec
import pytest

from l3cli.cli import COMMANDS, l3
from l3cli.recipes.toml import Recipe
from l3cli.stages.check import KINDS
from tests.helpers.paths import ROOT

SITE = ROOT / "docs/site"


def module(name: str, monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    monkeypatch.syspath_prepend(str(SITE))
    return importlib.import_module(name)


def test_the_command_reference_has_every_option(monkeypatch: pytest.MonkeyPatch) -> None:
    (page,) = module("command_pages", monkeypatch).command_pages().values()
    sections = dict(re.findall(r"^## l3 (\w+)\n(.*?)(?=^## )", page, re.MULTILINE | re.DOTALL))
    assert list(sections) == list(COMMANDS)
    for name, text in sections.items():
        command = l3.get_command(click.Context(l3), name)
        assert command is not None
        shown = [each for each in command.params if isinstance(each, click.Option) and not each.hidden]
        options = {word for each in shown for word in each.opts}
        assert options == set(
            re.findall(r"(?<=[`\s])--?[a-z][\w-]*(?=[ `,])", "\n".join(re.findall("^\\| (`.*?`)", text, re.M)))
        )
    codes = re.findall(r"^\| (\d+) \| \S", page.partition("## Exit codes")[2], re.MULTILINE)
    assert codes == ["0", "1", "2", "3", "4", "130", "143"]


def test_tables_of_formats_are_those_of_the_registries(monkeypatch: pytest.MonkeyPatch) -> None:
    tables = module("format_tables", monkeypatch)
    for page in tables.TABLES:
        text = (ROOT / "docs" / page).read_text(encoding="utf-8")
        assert tables.with_tables(page, text) == text, "run: python docs/site/format_tables.py"


def test_the_pages_of_recipes_have_every_key(monkeypatch: pytest.MonkeyPatch) -> None:
    pages = module("recipe_pages", monkeypatch).recipe_pages()
    for kind in KINDS:
        listed = set(re.findall(r"^\| `(\w+)` \|", pages[f"{kind}.md"], re.MULTILINE))
        titled = set(re.findall(r"`(\w+) = ", pages[f"{kind}.md"]))
        declared = keys(KINDS[kind].recipes)
        assert len(declared) > 10
        assert declared == listed | titled & declared
    assert "## At the top of the file that has `base`\n" in pages["measurements.md"]


def keys(kinds: Any) -> set[str]:
    """All keys of recipes and of the tables below them."""
    found: set[str] = set()
    left, seen = list(kinds), set()
    while left:
        kind = left.pop()
        if isinstance(kind, type) and issubclass(kind, Recipe) and kind not in seen:
            seen.add(kind)
            found |= {field.encode_name for field in msgspec.structs.fields(kind)}
            found |= {tag} if (tag := kind.__struct_config__.tag_field) else set()
            left += [field.type for field in msgspec.structs.fields(kind)]
        left += getattr(kind, "__args__", ())
    return found


@pytest.mark.parametrize(
    ("broken", "fault"),
    [
        ('<a href="none.html">x</a>', "none.html is not there"),
        ('<a href="#none">x</a>', "#none has no such anchor"),
        ('<a href="b.html#none">x</a>', "b.html#none has no such anchor"),
        ('<script src="https://cdn.example/x.js"></script>', "fetches https://cdn.example/x.js"),
        ('<link rel="stylesheet" href="//fonts.example/x.css">', "fetches //fonts.example/x.css"),
        ('<img src="none.png">', "none.png is not there"),
    ],
)
def test_faults_of_a_built_page(broken: str, fault: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    faults = module("built", monkeypatch).faults
    sound = '<h1 id="top">b</h1> <a href="https://example.org/">x</a> <a href="b.html#top">y</a>'
    (tmp_path / "b.html").write_text(sound)
    (tmp_path / "a.html").write_text(sound)
    assert faults(tmp_path) == []
    (tmp_path / "a.html").write_text(sound + broken)
    (line,) = faults(tmp_path)
    assert line == f"a.html: {fault}"
