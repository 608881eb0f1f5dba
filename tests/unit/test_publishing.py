"""Conda recipe, container, workflow, citation and source distribution state the same metadata."""

import re
import tomllib

import pytest

from l3cli import __version__
from tests.helpers.paths import ROOT

yaml = pytest.importorskip("yaml")
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
RENAMED = {"openimageio": "py-openimageio", "pyopencl[pocl]": "pyopencl"}  # on conda-forge


def test_the_conda_recipe_needs_what_the_project_needs() -> None:
    recipe = yaml.safe_load((ROOT / "docs/install/conda/meta.yaml").read_text(encoding="utf-8"))
    needed = {re.sub(r"\s", "", each).lower() for each in PROJECT["project"]["dependencies"]}
    for name, other in RENAMED.items():
        needed = {re.sub(rf"^{re.escape(name)}(?=[<>=]|$)", other, each) for each in needed}
    needed |= {f"python{PROJECT['project']['requires-python']}", "pocl", "__linux"}
    assert {each.replace(" ", "") for each in recipe["requirements"]["run"]} == needed
    built_with = {f"python{PROJECT['project']['requires-python']}", "pip", *PROJECT["build-system"]["requires"]}
    assert {each.replace(" ", "") for each in recipe["requirements"]["host"]} == built_with
    assert recipe["package"]["version"] == PROJECT["project"]["version"] == __version__
    (entry,) = recipe["build"]["entry_points"]
    assert entry.split(" = ")[1] == PROJECT["project"]["scripts"]["l3"]


def test_the_container_copies_what_a_wheel_is_built_from_and_drops_rights() -> None:
    lines = (ROOT / "docs/install/Dockerfile").read_text(encoding="utf-8").splitlines()
    copied = {word for line in lines if line.startswith("COPY") for word in line.split()[1:-1]}
    wheel = PROJECT["tool"]["hatch"]["build"]["targets"]["wheel"]
    assert copied == {"pyproject.toml", "README.md", "LICENSE", *wheel["packages"], *wheel["force-include"]}
    ignored = (ROOT / "docs/install/Dockerfile.dockerignore").read_text(encoding="utf-8").splitlines()
    assert "*" in ignored
    assert {line[1:] for line in ignored if line.startswith("!")} == copied
    assert [line.split()[0] for line in lines if line[:4] in ("FROM", "USER")] == ["FROM", "USER"]
    assert lines.index("USER l3") < lines.index('ENTRYPOINT ["l3"]')


def test_the_paper_is_short_cites_what_it_lists_and_has_the_figures_of_the_comparison() -> None:
    _, head, text = (ROOT / "docs/paper/paper.md").read_text(encoding="utf-8").split("---\n", 2)
    about, listed = yaml.safe_load(head), (ROOT / "docs/paper/paper.bib").read_text(encoding="utf-8")
    assert about["bibliography"] == "paper.bib"
    assert about["title"] == yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))["title"]
    assert 250 <= len(text.split()) <= 1000
    assert set(re.findall(r"@(\w+\d{4})", text)) == set(re.findall(r"^@\w+{(\w+),", listed, re.MULTILINE))
    table = [line for line in text.splitlines() if re.match(r"\| (Bayer|X-Trans|sixteen)", line)]
    figures = {number for line in table for number in re.findall(r"(?<= )\d+\.\d+|(?<= )\d+(?= \|)", line)}
    compared = re.findall(r"[\d.]+", (ROOT / "docs/peers.md").read_text(encoding="utf-8"))
    assert len(table) == 5
    assert len(figures) > 15
    assert figures <= set(compared)


def test_the_citation_is_of_this_version() -> None:
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
    code, data = PROJECT["project"]["license"].split(" AND ")
    assert (citation["version"], citation["license"], data) == (__version__, code, "Apache-2.0")
