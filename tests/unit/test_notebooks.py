"""The notebooks of docs/ contain no outputs, are short, use only the public API and are listed. Their pages are correct.

`make notebooks`, which .ci/run calls, runs the notebooks.
"""

import ast
import base64
import importlib
import re
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

import l3cli
from tests.helpers.paths import ROOT
from tests.helpers.readme import PAGES

nbformat = pytest.importorskip("nbformat")
NOTEBOOKS = {path.name: nbformat.read(path, as_version=4) for path in sorted((ROOT / "docs/notebooks").glob("*.ipynb"))}
LIBRARIES = {"l3cli", "numpy", "matplotlib", "xarray"}


@pytest.fixture
def execution(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    monkeypatch.syspath_prepend(str(ROOT / "docs/site"))
    return importlib.import_module("execute_notebooks")


@pytest.mark.parametrize("name", NOTEBOOKS)
def test_a_notebook_is_stripped_listed_and_of_the_public_face_alone(name: str, execution: ModuleType) -> None:
    notebook = NOTEBOOKS[name]
    nbformat.validate(notebook)
    assert notebook == execution.stripped(notebook), "python docs/site/execute_notebooks.py --strip mends it"
    (title,) = re.findall(rf"\[([^]]+)\]\(notebooks/{re.escape(name)}\)", PAGES["python.md"])
    assert notebook.cells[0].source.startswith(f"# {title}\n")
    for link in re.findall(r"\]\(([^)#\s]+)", "\n".join(cell.source for cell in notebook.cells)):
        assert "://" in link or (ROOT / "docs/notebooks" / link).is_file(), link
    code = "\n".join(cell.source for cell in notebook.cells if cell.cell_type == "code")
    for node in ast.walk(ast.parse(code)):
        modules = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
        for module in [node.module or ""] if isinstance(node, ast.ImportFrom) else modules:
            assert module.split(".")[0] in LIBRARIES | sys.stdlib_module_names, module
            assert not module.startswith("l3cli."), module
        if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id == "l3":
            assert node.attr in l3cli.__all__


def test_outputs_are_stripped(execution: ModuleType) -> None:
    cell = nbformat.v4.new_code_cell("1", execution_count=3, outputs=[nbformat.v4.new_output("stream", text="1")])
    cell.metadata["scrolled"] = True
    left = execution.stripped(
        nbformat.v4.new_notebook(cells=[cell], metadata={"kernelspec": {"name": "mine", "display_name": "my machine"}})
    )
    assert left.cells[0].outputs == []
    assert left.cells[0].execution_count is None
    assert left.cells[0].metadata == {}
    assert left.metadata == execution.METADATA


def test_a_page_shows_code_next_to_what_it_printed_and_drew(execution: ModuleType, tmp_path: Path) -> None:
    new = nbformat.v4
    outputs = [
        new.new_output("stream", text="one\n"),
        new.new_output("stream", text="two\n"),
        new.new_output("display_data", data={"image/png": base64.b64encode(b"PNG").decode(), "text/plain": "<Figure>"}),
        new.new_output("execute_result", data={"text/plain": "42"}),
    ]
    notebook = new.new_notebook(cells=[new.new_markdown_cell("# A title"), new.new_code_cell("f()", outputs=outputs)])
    assert execution.page(notebook, "x", tmp_path).split("\n\n")[:-1] == [
        "# A title",
        "```python\nf()\n```",
        "```none\none\ntwo\n```",
        "![What the cell above draws](x-1-2.png)",
        "```none\n42\n```",
    ]
    assert (tmp_path / "x-1-2.png").read_bytes() == b"PNG"


def test_a_folder_that_exists_is_left_alone(execution: ModuleType, tmp_path: Path) -> None:
    (tmp_path / "mine.md").write_text("mine")
    assert execution.main(str(tmp_path)) == 2
    assert [path.name for path in tmp_path.iterdir()] == ["mine.md"]


def test_a_notebook_that_fails_is_named(
    execution: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    failing = pytest.importorskip("nbclient.exceptions").CellExecutionError("Traceback: \x1b[31mwhy\x1b[0m", "Error", "why")

    def executed(path: Path) -> Any:
        if path.name == "light.ipynb":
            raise failing
        return NOTEBOOKS[path.name]

    monkeypatch.setattr(execution, "executed", executed)
    assert execution.main(str(tmp_path / "pages")) == 1
    printed = capsys.readouterr().out
    assert "light.ipynb: fails\nTraceback: why" in printed
    assert len(list((tmp_path / "pages").glob("*.md"))) == len(NOTEBOOKS) - 1
