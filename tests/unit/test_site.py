"""The site of docs/: what is made of declarations names all of them, and a link or a fetch that is wrong is noticed.

Sphinx itself, with warnings as errors, is run by `make docs-build`, which .ci/run does.
"""

import importlib
import re
import shutil
from pathlib import Path
from types import ModuleType
from typing import Any

import click
import msgspec
import pytest

from l3cli.cli import COMMANDS, l3
from l3cli.recipes.toml import Recipe
from l3cli.stages.checking.kinds import KINDS
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


def test_a_site_may_be_built_inside_docs_again_and_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    gather = module("gather", monkeypatch)
    for name in (*gather.FRONT, *gather.AS_THEY_ARE, "README.md", "docs/python.md", "notebooks/one.md"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text(f"# {name}\n")
    monkeypatch.setattr(gather, "ROOT", tmp_path)
    monkeypatch.setattr(gather, "EXECUTED", tmp_path / "notebooks")
    for name in ("command_pages", "recipe_pages", "artifact_pages", "licence_pages"):
        monkeypatch.setattr(gather, name, dict)
    for folder in ("out", "out", "other"):
        built = tmp_path / "docs" / folder
        shutil.rmtree(built / "pages", ignore_errors=True)
        (built / gather.BUILT).mkdir(parents=True, exist_ok=True)
        gather.gather(built / "pages")
        names = {path.relative_to(built / "pages").as_posix() for path in (built / "pages").rglob("*.md")}
        assert names == {*gather.FRONT.values(), "index.md", "python.md", "notebooks/one.md"}


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


def test_the_page_of_artifacts_has_every_dataset_with_its_unit(monkeypatch: pytest.MonkeyPatch) -> None:
    (page,) = module("artifact_pages", monkeypatch).artifact_pages().values()
    for row in (
        "| `responsivity` | float64 | channel, wavelength | e-/photon |",
        "| `frames/00000/raw` | uint16 | row, col | DN |",
        "| `first/rule/patch` |",
        "| (`later/0/weights`) |",
        "| (`camera/pixel_pitch`) | float64 | — | m |",
    ):
        assert row in page.replace("\\", ""), row


def test_licences_are_stated(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("packaging")
    (page,) = module("licence_pages", monkeypatch).licence_pages().values()
    rows = re.findall(r"^\| `([\w-]+)`.*?\| ([\w.+]+) \| (.+) \|$", page, re.MULTILINE)
    assert {"numpy", "pyopencl", "pocl-binary-distribution", "h5py"} <= {name for name, *_ in rows}
    unstated = [name for name, _, licence in rows if licence.startswith("not stated")]
    assert unstated in ([], ["pocl-binary-distribution"])


def test_links_of_the_pages_lead_within_the_site(monkeypatch: pytest.MonkeyPatch) -> None:
    relinked = module("gather", monkeypatch).relinked
    assert relinked("[a](docs/method.md) [b](CONTRIBUTING.md)") == "[a](method.md) [b](contributing.md)"
    assert relinked("[a](../CHANGELOG.md) [b](../README.md)") == "[a](changelog.md) [b](index.md)"
    assert relinked("[a](limits.md)") == "[a](limits.md)"
    assert relinked("[a](notebooks/light.ipynb)") == "[a](notebooks/light.md)"


def test_a_page_that_no_table_of_contents_names_is_in_the_last(monkeypatch: pytest.MonkeyPatch) -> None:
    contents = module("gather", monkeypatch).contents
    assert ":caption: More\n\nnew-page\n```" in contents({"tutorial", "new-page", "reference/camera"})


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


def test_a_style_that_fetches_is_a_fault(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "s.css").write_text('@import "https://fonts.example/f.css"; a { background: url(data:image/png;base64,xx) }')
    assert module("built", monkeypatch).faults(tmp_path) == ["s.css: fetches https://fonts.example/f.css"]
