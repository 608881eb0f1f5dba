"""The comparison with other methods: rivals give a mosaic's channels back, the best setting counts, the page is that of its
figures and says where ours is beaten."""

import configparser
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
from l3cli.evaluation.demosaic import bilinear, tiled
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


def test_a_source_is_known_by_what_it_holds(peers: Callable[[str], ModuleType], tmp_path: Path) -> None:
    provenance = peers("provenance")
    (tmp_path / "l3cli").mkdir()
    (tmp_path / "l3cli/a.py").write_text("1")
    first = provenance.source(tmp_path)
    (tmp_path / "l3cli/__pycache__").mkdir()
    (tmp_path / "l3cli/__pycache__/a.pyc").write_text("2")
    assert provenance.source(tmp_path) == first
    (tmp_path / "l3cli/a.py").rename(tmp_path / "l3cli/b.py")
    assert provenance.source(tmp_path) != first
    table = tmp_path / "table.h5"
    assert provenance.stamped(table) is None
    provenance.stamp(table)
    assert provenance.stamped(table) == provenance.origin()


def test_the_best_setting_counts_by_figure(peers: Callable[[str], ModuleType]) -> None:
    means = {"": {"a psnr": 30.0, "a delta_e": 2.0}, "denoised": {"a psnr": 29.0, "a delta_e": 1.5}}
    best = peers("judging").best_settings(means)
    assert best == {"figures": {"a psnr": 30.0, "a delta_e": 1.5}, "settings": {"a delta_e": "denoised"}}


def test_what_is_not_installed_is_named(peers: Callable[[str], ModuleType], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(shutil, "which", lambda name: None)
    rivals, rawtherapee = peers("rivals"), peers("rawtherapee")
    with pytest.raises(rivals.NotInstalled):
        rivals.installed("no-such-package")
    left = rivals.Rival("r", "p", {})
    assert rivals.gathered([rawtherapee.xtrans, lambda: [left]]) == ([left], ["RawTherapee"])


def test_libraw_gives_channels_back(peers: Callable[[str], ModuleType]) -> None:
    rivals = peers("libraw_rivals").bayer(noisy=True)
    assert "AHD" in {rival.name for rival in rivals}
    runs = [rival.settings[""] for rival in rivals] + list(rivals[0].settings.values())
    for demosaic in runs:
        channels = demosaic(plain_mosaic(), GRBG)
        np.testing.assert_allclose(channels, np.broadcast_to(COLOUR[:, None, None], (3, *SHAPE)), atol=1e-3)


def test_rawtherapee_is_asked_for_each_method(peers: Callable[[str], ModuleType], monkeypatch: pytest.MonkeyPatch) -> None:
    """Its profiles say the method, and of its denoising nothing or the strengths."""
    rawtherapee = peers("rawtherapee")
    monkeypatch.setattr(rawtherapee, "_program", lambda: "RawTherapee 5.9")
    rivals = rawtherapee.bayer(noisy=True) + rawtherapee.xtrans()
    assert len(rivals) == len(rawtherapee.NOISY) + len(rawtherapee.XTRANS)
    for rival, method in zip(rivals, [*rawtherapee.NOISY, *rawtherapee.XTRANS], strict=True):
        for setting, demosaic in rival.settings.items():
            profile = configparser.ConfigParser()
            profile.read_string(demosaic.args[0])
            assert {profile[array]["method"] for array in ("RAW Bayer", "RAW X-Trans")} == {method}
            denoising = "Directional Pyramid Denoising"
            assert (setting != "") == profile.has_section(denoising)
            if setting:
                luma, chroma, median = rawtherapee.DENOISED[setting]
                words = profile[denoising]
                assert (words["luma"], words["chroma"], words["median"]) == (
                    str(luma),
                    str(chroma),
                    str(median != "").lower(),
                )


@pytest.mark.slow
def test_rawtherapee_gives_channels_back(peers: Callable[[str], ModuleType]) -> None:
    rawtherapee = peers("rawtherapee")
    if shutil.which(rawtherapee.COMMAND) is None:
        pytest.skip("RawTherapee is not installed")
    for rival in rawtherapee.bayer(noisy=True):
        for setting in ("", "colour 5"):
            channels = rival.settings[setting](plain_mosaic(), GRBG)
            np.testing.assert_allclose(channels, np.broadcast_to(COLOUR[:, None, None], (3, *SHAPE)), atol=2e-3)


def test_a_developer_of_another_size_is_refused(peers: Callable[[str], ModuleType]) -> None:
    raw_file = peers("raw_file")
    with pytest.raises(ValueError, match="developed to 30×160"):
        raw_file.through_file(lambda path: np.zeros((3, 30, 160)), plain_mosaic(), GRBG)
    assert raw_file.through_file(lambda path: np.zeros((3, 126, 166)), plain_mosaic(), GRBG).shape == (3, *SHAPE)


def test_seconds_are_those_of_more_pixels(peers: Callable[[str], ModuleType], monkeypatch: pytest.MonkeyPatch) -> None:
    seconds, clock = peers("seconds"), [0.0]
    monkeypatch.setattr(seconds, "core_seconds", lambda: clock[0])

    def prepared(side: int) -> Callable[[], None]:
        def call() -> None:
            clock[0] += 5.0 + 0.3e-6 * side * side  # to start, and 0.3 s/MP
            clock[0] += 100.0 if clock[0] < 100.0 else 0.0  # the first time

        return call

    assert seconds.per_megapixel({"m": prepared}) == pytest.approx({"m": 0.3})
    np.testing.assert_array_equal(seconds.tiled_to(tiled(GRBG, (7, 9)), 20, GRBG.shape), tiled(GRBG, (20, 20)))


def test_the_same_recipe_for_another_array(
    peers: Callable[[str], ModuleType], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The folder of the benchmark, with the CFA of X-Trans; nothing that is there is made again."""
    making, made = peers("making"), []
    monkeypatch.setattr(making.l3cli, "simulate", lambda *given, **more: made.append(given[2].name))
    monkeypatch.setattr(making.l3cli, "train", lambda *given, **more: made.append(given[1].name))
    (tmp_path / "data/demosaicking/kodak").mkdir(parents=True)
    (tmp_path / "work").mkdir()
    (tmp_path / "work/training.h5").touch()
    sets, _ = making.codes(tmp_path / "work", tmp_path / "data", "xtrans", 1)
    assert made == ["kodak.h5", "table.h5"]
    assert set(sets) == {"Kodak"}
    camera = (tmp_path / "work/camera.toml").read_text(encoding="utf-8")
    assert camera.count("pattern = [") == 1
    assert '"g b g g r g"' in camera
    assert f"{tmp_path}/data/demosaicking/kodak/*" in (tmp_path / "work/kodak.toml").read_text(encoding="utf-8")


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


def test_seconds_are_measured_again_without_the_figures(
    peers: Callable[[str], ModuleType], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of the settings that the figures are of; a method that is not here keeps what was measured of it."""
    module, rivals = peers("peers"), peers("rivals")
    seen: list[str] = []

    def put(rows: list[dict[str, Any]], *given: Any) -> None:
        seen.extend(row["name"] for row in rows)
        for each in rows:
            each["seconds"] = 7.0

    monkeypatch.setattr(module, "put_seconds", put)
    rows = [row("x", 41.5), row("gone", 40, seconds=2.0)]
    part = module.Comparison({}, {}, [rivals.Rival("x", "p", {})], None).timed(PLAIN | {"rows": rows})
    assert seen == ["x"]
    assert [(each["name"], each["seconds"], each["figures"]["bands psnr"]) for each in part["rows"]] == [
        ("x", 7.0, 41.5),
        ("gone", 2.0, 40),
    ]
    page = peers("peers_page")
    assert "Seconds: 2026-01-02, source" in page.section("bands", PLAIN | {"rows": [row("o", 1, ours=True)], "timed": RUN})
    del rows[0]["seconds"]
    assert "| — |" in page.section("bands", PLAIN | {"rows": [row("o", 1, ours=True), rows[0]]})


def test_wrong_calls_measure_nothing(
    peers: Callable[[str], ModuleType], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert peers("peers").main(["bayre"], Path("nowhere"), 1) == 2
    assert 'no part "bayre"' in capsys.readouterr().err
    monkeypatch.setenv("L3_DATA", str(tmp_path))
    with pytest.raises(SystemExit, match="demosaicking/kodak is missing; give the folder of the real data in L3_DATA"):
        peers("making").data_folder()


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


def test_an_array_begun_at_another_pixel_is_shown_once_and_a_wrong_name_makes_nothing(
    gallery: ModuleType, capsys: pytest.CaptureFixture[str]
) -> None:
    assert sorted(gallery.arrays()["bayer"][1]) == ["bayer_bggr", "bayer_gbrg", "bayer_rggb"]
    assert "bayer_rggb" not in gallery.arrays()
    assert gallery.main(["bayre"], 1) == 2
    assert 'no array "bayre"' in capsys.readouterr().err


def test_the_page_states_where_it_loses(gallery: ModuleType, entries: dict[str, dict[str, Any]]) -> None:
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
