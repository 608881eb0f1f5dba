"""The gallery is what its figures say, and only of arrays that `l3 init` knows."""

import importlib
import json
import re
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

from tests.helpers.paths import ROOT

FOLDER = ROOT / "docs/gallery"


@pytest.fixture
def gallery(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    monkeypatch.syspath_prepend(str(FOLDER))
    return importlib.import_module("gallery")


@pytest.fixture
def entries() -> dict[str, dict[str, Any]]:
    held: dict[str, dict[str, Any]] = json.loads((FOLDER / "figures.json").read_text(encoding="utf-8"))
    return held


def test_the_page_is_that_of_its_figures(gallery: ModuleType, entries: dict[str, dict[str, Any]]) -> None:
    assert set(entries) <= set(gallery.arrays())
    assert (ROOT / "docs/gallery.md").read_text(encoding="utf-8") == gallery.page(entries, gallery.SCENES)


def test_pictures_are_all_shown() -> None:
    pages = (ROOT / "docs/gallery.md").read_text(encoding="utf-8") + (ROOT / "README.md").read_text(encoding="utf-8")
    shown = set(re.findall(r"gallery/([\w.]+\.(?:jpg|png|svg))\)", pages))
    assert shown == {path.name for path in FOLDER.iterdir() if path.suffix in (".jpg", ".png", ".svg")}


def test_an_array_begun_at_another_pixel_is_shown_once_and_a_wrong_name_makes_nothing(
    gallery: ModuleType, capsys: pytest.CaptureFixture[str]
) -> None:
    assert sorted(gallery.arrays()["bayer"][1]) == ["bayer_bggr", "bayer_gbrg", "bayer_rggb"]
    assert "bayer_rggb" not in gallery.arrays()
    assert gallery.main(["bayre"], 1) == 2
    assert 'no array "bayre"' in capsys.readouterr().err


def test_the_page_says_where_it_loses(gallery: ModuleType, entries: dict[str, dict[str, Any]]) -> None:
    entry = next(iter(entries.values()))
    basic = entry["figures"]["basic"]
    ours = {"mean_delta_e": basic["mean_delta_e"] - 1, "psnr": basic["psnr"] - 1}
    worse = {"x": {**entry, "figures": {"ours": ours, "basic": basic}}}
    assert "Better than ours: basic on x (PSNR)." in gallery.page(worse, gallery.SCENES)


def test_the_largest_arrays_are_begun_first_and_each_by_one_process(
    gallery: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """And figures stand in the order of the recipes, whatever the order in which arrays are done."""
    made = []

    def make(array: Any) -> tuple[dict[str, Any], float]:
        made.append((array.name, array.jobs))
        return {"title": array.name, "summary": "2×2,  3 channels  x", "twins": [], "figures": {}}, 1.0

    def ordered_map(function: Any, items: Any, jobs: int) -> Any:
        assert jobs == 2
        return map(make, items)

    monkeypatch.setattr(gallery, "ordered_map", ordered_map)
    monkeypatch.setattr(gallery, "page", lambda entries, recipes: "")
    monkeypatch.setattr(gallery, "FIGURES", tmp_path / "figures.json")
    monkeypatch.setattr(gallery, "PAGE", tmp_path / "gallery.md")
    assert gallery.main(["bayer", "xtrans", "snapshot16", "bayer"], 2) == 0
    assert made == [("snapshot16", 1), ("xtrans", 1), ("bayer", 1)]
    assert list(json.loads((tmp_path / "figures.json").read_text())) == ["bayer", "snapshot16", "xtrans"]
