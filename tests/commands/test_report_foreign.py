"""A report on artifacts that somebody else has named: markup in every name."""

from dataclasses import replace
from pathlib import Path

import pytest

from l3cli.artifacts.camera import CameraModel
from l3cli.artifacts.schema import Stage
from l3cli.artifacts.store import load, save
from l3cli.artifacts.table import TransformTable
from l3cli.artifacts.training_set import open_training_set, write_training_set
from l3cli.cli import run
from tests.helpers.browser import Browser, painted
from tests.helpers.pages import Tags

EVIL = "<script>window.hurt=1</script>\"'&"


@pytest.fixture(scope="module")
def hostile(pipeline: Path, tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """Artifacts with markup in every name that somebody else may choose."""
    folder = tmp_path_factory.mktemp("hostile")
    history = (Stage("<b>calibrate", {"<i>": EVIL}, EVIL, {"<u>frames": ["<s>" * 8]}, "<em>"),)
    channels = ("<b>", "</text><i>", '"><u>&amp;')  # short enough to stand in the drawings
    camera = replace(load(CameraModel, pipeline / "camera.h5"), name=EVIL, channels=channels, history=history)
    table = replace(
        load(TransformTable, pipeline / "table.h5"),
        camera_name=EVIL,
        channels=channels,
        history=history,
        camera=replace(camera, fit=None),
    )
    save(camera, folder / "camera.h5")
    save(replace(table, target_description=EVIL), folder / "table.h5")
    with open_training_set(pipeline / "unseen.h5") as reader:
        head = replace(reader.head, camera=camera, target_description=EVIL, history=history)
        with write_training_set(folder / "un<b>seen.h5", head) as writer:
            for frame in reader:
                writer.append(replace(frame, scene=EVIL, illuminant="D65"))
    return [folder / "camera.h5", folder / "table.h5", folder / "un<b>seen.h5"]


@pytest.fixture(scope="module")
def hostile_page(hostile: list[Path]) -> Path:
    out = hostile[0].parent / "report.html"
    assert run(["report", *map(str, hostile), "-o", str(out), "--quiet"]) == 0
    return out


def test_foreign_names_are_text_and_nothing_else(hostile_page: Path) -> None:
    tags = Tags(hostile_page)
    assert len(tags.all("script")) == 1
    assert not tags.all("b", "i", "u", "s", "em")
    assert all(image["src"] != "x" for image in tags.all("img"))
    assert not [name for _, attributes in tags.starts for name in attributes if name.startswith("on")]
    assert EVIL in tags.text


def test_a_hostile_page_is_painted_like_any_other(tab: Browser, hostile_page: Path, tmp_path: Path) -> None:
    tab.open(hostile_page, 400)
    assert tab.complaints() == []
    assert tab.run("window.hurt") is None
    assert tab.run("document.documentElement.scrollWidth") <= 400
    painted(tab, tmp_path / "page.png")
