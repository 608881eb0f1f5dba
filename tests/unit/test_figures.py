"""The figures of docs/how-l3-works.md: the drawing of the pipeline is the output of its script."""

import importlib

import pytest

from tests.helpers.paths import ROOT

FOLDER = ROOT / "docs/figures"


def test_the_pipeline_is_drawn_by_its_script(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(FOLDER))
    drawn = importlib.import_module("figures").pipeline()
    assert drawn == (FOLDER / "pipeline.svg").read_text(encoding="utf-8"), "run: python docs/figures/figures.py"
