"""The comparison with other methods: rivals give a mosaic's channels back, the best setting counts, the page is that of its
figures and says where ours is beaten."""

import importlib
import json
import re
import shutil
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import l3cli
from l3cli.evaluation.demosaic import bilinear
from l3cli.frames.frame import tiled
from tests.helpers.cameras import BAYER, bayer_camera
from tests.helpers.paths import ROOT
from tests.helpers.tables import random_table

FOLDER = ROOT / "docs/peers"
GRBG = np.array([[1, 0], [2, 1]], np.uint8)
SCENES = 'illuminants = ["D65"]\nexposure_share = [0.9, 0.5]\n[[scene]]\nsource = "colorchecker"\nsize = [48, 72]\n'
RUN = {"date": "2026-01-02", "source": "abc", "machine": "a processor, 2 cores"}
PLAIN = {"run": RUN, "trained": {"o": RUN}, "missing": [], "absent": []}
SHAPE = (120, 160)
COLOUR = np.array([0.9, 0.5, 0.25])
NOISE = [f"{level} {key}" for level in ("0.2", "0.02") for key in ("psnr", "delta_e")]


@pytest.fixture
def peers(monkeypatch: pytest.MonkeyPatch) -> Callable[[str], ModuleType]:
    """The modules of the comparison, by name."""
    monkeypatch.syspath_prepend(str(FOLDER))
    return importlib.import_module


@pytest.fixture
def parts() -> dict[str, dict[str, Any]]:
    stored: dict[str, dict[str, Any]] = json.loads((FOLDER / "figures.json").read_text(encoding="utf-8"))
    return stored


def row(name: str, value: float, ours: bool = False, **more: Any) -> dict[str, Any]:
    figures = {"bands psnr": value, "bands ssim": 0.9, "bands angle": 50 - value}
    return {"name": name, "program": "p", "ours": ours, "figures": figures, "settings": {}, "seconds": 0.1} | more


def plain_mosaic() -> NDArray[np.floating]:
    """One colour all over, seen through a Bayer array."""
    return COLOUR[tiled(GRBG, SHAPE)]


def test_the_page_is_that_of_its_figures(peers: Callable[[str], ModuleType], parts: dict[str, dict[str, Any]]) -> None:
    assert (ROOT / "docs/peers.md").read_text(encoding="utf-8") == peers("peers_page").page(parts)


def test_the_page_states_where_ours_is_beaten_what_is_missing_and_of_which_run_it_is(
    peers: Callable[[str], ModuleType],
) -> None:
    page, ours = peers("peers_page"), row("o", 40, ours=True)
    lost = page.section("bands", PLAIN | {"rows": [row("x", 41.5), ours], "missing": ["y"], "absent": ["z"]})
    assert "Better than ours: x of p in PSNR (dB), by 1.50; x of p in SAM (°), by 1.50." in lost
    assert "Not installed: y." in lost
    assert "are not there: z." in lost
    won = page.section("bands", PLAIN | {"rows": [ours, row("x", 39)]})
    assert "Nothing measured here is better" in won
    assert "| **o** | p | **40.00** | **0.9000** | **10.00** | 0.1 |" in won
    one = page.page({"bands": PLAIN | {"rows": [ours]}})
    assert "**Not measured for this page**: Bayer, as published (`make peers PARTS=bayer`), X-Trans (" in one
    assert "## Sixteen bands" in one
    assert "## X-Trans" not in one
    assert "All of it is of one run: 2026-01-02, source `abc`, a processor, 2 cores." in one
    noise = {"rows": [row("o", 40, ours=True, figures=dict.fromkeys(NOISE, 1.0))], "run": RUN | {"date": "2026-01-03"}}
    trained = {"trained": {"o": RUN | {"source": "def"}, "p": None}}
    several = page.page({"bands": PLAIN | {"rows": [ours]} | trained, "noise": PLAIN | noise})
    assert "Parts are of several runs" in several
    assert "The table of o was trained on 2026-01-02, source `def`." in several
    assert "The table of p was trained by a run that was not noted." in several
    published = page.section("bayer", PLAIN | {"rows": [row("o", 0, ours=True, figures={"Kodak psnr": 41.0})]})
    assert "| CDM-CNN (Tan and others 2017) | published | — | — | *42.04* | *38.98* |" in published.splitlines()


def test_the_best_setting_counts_by_figure(peers: Callable[[str], ModuleType]) -> None:
    means = {"": {"a psnr": 30.0, "a delta_e": 2.0}, "denoised": {"a psnr": 29.0, "a delta_e": 1.5}}
    best = peers("judging").best_settings(means)
    assert best == {"figures": {"a psnr": 30.0, "a delta_e": 1.5}, "settings": {"a delta_e": "denoised"}}


def test_libraw_gives_channels_back(peers: Callable[[str], ModuleType]) -> None:
    rivals = peers("libraw_rivals").bayer(noisy=True)
    assert "AHD" in {rival.name for rival in rivals}
    runs = [rival.settings[""] for rival in rivals] + list(rivals[0].settings.values())
    for demosaic in runs:
        channels = demosaic(plain_mosaic(), GRBG)
        np.testing.assert_allclose(channels, np.broadcast_to(COLOUR[:, None, None], (3, *SHAPE)), atol=1e-3)


@pytest.mark.slow
def test_rawtherapee_gives_channels_back(peers: Callable[[str], ModuleType]) -> None:
    rawtherapee = peers("rawtherapee")
    if shutil.which(rawtherapee.COMMAND) is None:
        pytest.skip("RawTherapee is not installed")
    for rival in rawtherapee.bayer(noisy=True):
        for setting in ("", "colour 5"):
            channels = rival.settings[setting](plain_mosaic(), GRBG)
            np.testing.assert_allclose(channels, np.broadcast_to(COLOUR[:, None, None], (3, *SHAPE)), atol=2e-3)


def test_tables_and_rivals_are_judged_alike(
    peers: Callable[[str], ModuleType], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Rows best first, of means over the frames, and by its setting that is better; a rival that sees no green is last."""
    judging, rivals = peers("judging"), peers("rivals")
    (tmp_path / "camera.toml").write_text(bayer_camera())
    (tmp_path / "scenes.toml").write_text(SCENES)
    l3cli.simulate(tmp_path / "scenes.toml", tmp_path / "camera.toml", tmp_path / "set.h5")
    monkeypatch.setattr(
        judging, "per_megapixel", lambda methods: {name: bool(of(24)()[0].any()) for name, of in methods.items()}
    )
    good = rivals.Rival("good", "p", {"": lambda mosaic, cfa: 0.5 * bilinear(mosaic, cfa), "brighter": bilinear})
    bad = rivals.Rival(
        "bad", "p", {"": lambda mosaic, cfa: bilinear(mosaic, cfa) * np.array([1.0, 0.0, 1.0])[:, None, None]}
    )
    table = random_table(BAYER, bits=12, black_level=64.0, patch=5)
    rows = judging.judged({"s": tmp_path / "set.h5"}, {"ours": table}, [bad, good], judging.picture_protocol())
    assert [each["name"] for each in rows if not each["ours"]] == ["good", "bad"]
    assert [each["ours"] for each in rows].count(True) == 1
    best = next(each for each in rows if each["name"] == "good")
    assert best["settings"] == {"s psnr": "brighter", "s delta_e": "brighter"}
    assert best["figures"]["s delta_e"] < 15  # hard edges of a small chart
    assert all(each["seconds"] == 1 for each in rows)


GALLERY = ROOT / "docs/gallery"


@pytest.fixture
def gallery(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    monkeypatch.syspath_prepend(str(GALLERY))
    return importlib.import_module("gallery")


@pytest.fixture
def entries() -> dict[str, dict[str, Any]]:
    stored: dict[str, dict[str, Any]] = json.loads((GALLERY / "figures.json").read_text(encoding="utf-8"))
    return stored


def test_the_gallery_is_that_of_its_figures(gallery: ModuleType, entries: dict[str, dict[str, Any]]) -> None:
    assert set(entries) <= set(gallery.arrays())
    assert (ROOT / "docs/gallery.md").read_text(encoding="utf-8") == gallery.page(entries, gallery.SCENES)


def test_pictures_are_all_shown() -> None:
    pages = (ROOT / "docs/gallery.md").read_text(encoding="utf-8") + (ROOT / "README.md").read_text(encoding="utf-8")
    shown = set(re.findall(r"gallery/([\w.]+\.(?:jpg|png|svg))\)", pages))
    assert shown == {path.name for path in GALLERY.iterdir() if path.suffix in (".jpg", ".png", ".svg")}
