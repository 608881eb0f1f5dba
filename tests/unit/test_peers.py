"""The comparison with other methods: rivals demosaic correctly; the best setting counts; the page lists better rivals."""

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
from l3cli.evaluation.demosaic import bilinear, menon
from l3cli.physics.mosaic import tiled
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
NOISE = [f"{level} {key}" for level in ("0.2", "0.02", "0.01") for key in ("psnr", "delta_e")]


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
    assert 'In the column "PSNR (dB)", x (p) is better than l3 by 1.50.' in lost
    assert 'In the column "SAM (°)", x (p) is better than l3 by 1.50.' in lost
    assert "Not installed: y." in lost
    assert "are missing: z." in lost
    won = page.section("bands", PLAIN | {"rows": [ours, row("x", 39)]})
    assert "None of these methods is better" in won
    assert "| **o** | p | **40.00** | **0.9000** | **10.00** | 0.1 |" in won
    one = page.page({"bands": PLAIN | {"rows": [ours]}})
    assert "**Not measured for this page**: Bayer, as published (`make peers PARTS=bayer`), X-Trans (" in one
    assert "## Sixteen bands" in one
    assert "## X-Trans" not in one
    assert "All results come from one run: 2026-01-02, source `abc`, a processor, 2 cores." in one
    noise = {"rows": [row("o", 40, ours=True, figures=dict.fromkeys(NOISE, 1.0))], "run": RUN | {"date": "2026-01-03"}}
    trained = {"trained": {"o": RUN | {"source": "def"}, "p": None}}
    several = page.page({"bands": PLAIN | {"rows": [ours]} | trained, "noise": PLAIN | noise})
    assert "The sections come from several runs" in several
    assert "The table of o was trained on 2026-01-02, source `def`." in several
    assert "The table of p was trained in a run that was not recorded." in several
    published = page.section("bayer", PLAIN | {"rows": [row("o", 0, ours=True, figures={"Kodak psnr": 41.0})]})
    assert "| CDM-CNN (Tan and others 2017) | published | — | — | *42.04* | *38.98* |" in published.splitlines()


def test_the_page_shows_every_frame_beside_a_rival_that_is_given_the_noise(peers: Callable[[str], ModuleType]) -> None:
    """Ties are won by nobody."""
    figures = dict.fromkeys(NOISE, 1.0)
    ours = row("o", 40, ours=True, figures=figures, by_frame={key: [2.0, 3.0, 4.0] for key in NOISE})
    rival = row("x", 40, figures=figures, by_frame={key: [3.0, 2.0, 4.0] for key in NOISE})
    part = PLAIN | {"frames": ["a", "b", "c"], "rows": [ours, rival, row("y", 40, figures=figures)]}
    lines = peers("peers_page").section("noise", part).splitlines()
    assert f"| a |{' 2.00 / **3.00** | **2.00** / 3.00 |' * 3}" in lines
    assert f"| c |{' 4.00 / 4.00 |' * 6}" in lines
    assert f"| o better on |{' 1 of 3 |' * 6}" in lines


def test_ours_is_measured_again_beside_rivals_as_they_were(
    peers: Callable[[str], ModuleType], monkeypatch: pytest.MonkeyPatch
) -> None:
    script = peers("peers")
    monkeypatch.setattr(script, "judged", lambda *_: [row("o", 43, ours=True, seconds=9.0)])
    monkeypatch.setattr(script, "described", lambda _: {"frames": ["a"], "digest": "1"})
    part = PLAIN | {"rows": [row("x", 42), row("o", 41, ours=True), row("y", 40)], "digest": "1", "missing": ["z"]}
    renewed = {"run": RUN | {"date": "2026-01-05"}} | script.Comparison({}, {}, [], None).renewed(part)
    assert [(each["name"], each["figures"]["bands psnr"]) for each in renewed["rows"]] == [("o", 43), ("x", 42), ("y", 40)]
    assert renewed["rows"][0]["seconds"] == 0.1
    assert "Other methods: 2026-01-02," in peers("peers_page").section("bands", renewed)
    assert "Not installed: z." in peers("peers_page").section("bands", renewed)
    with pytest.raises(SystemExit, match="other frames"):
        script.Comparison({}, {}, [], None).renewed(part | {"digest": "2"})


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


@pytest.mark.parametrize("electrons", [10.0, 100.0, 1000.0])
def test_noise_is_made_one_and_light_comes_back_without_bias(peers: Callable[[str], ModuleType], electrons: float) -> None:
    cbm3d, rng, dark = peers("cbm3d"), np.random.default_rng(1), 16.0
    stable = cbm3d.anscombe(rng.poisson(electrons, 200_000) + rng.normal(0.0, np.sqrt(dark), 200_000), dark)
    assert stable.std() == pytest.approx(1.0, abs=0.04)
    assert cbm3d.inverse_anscombe(stable.mean(), dark) == pytest.approx(electrons, rel=0.01, abs=0.05)


def test_the_spectrum_is_that_of_noise_after_demosaicking(peers: Callable[[str], ModuleType]) -> None:
    """Power adds up to the variance of a frame that was not among those that it was taken of."""
    cbm3d, deviation = peers("cbm3d"), np.array([1.0, 0.7, 0.9])
    power = cbm3d.spectrum((128, 192), GRBG, deviation)
    noise = np.random.default_rng(5).normal(size=(128, 192)) * deviation[tiled(GRBG, (128, 192))]
    planes = np.tensordot(cbm3d.OPPONENT, menon(100 + noise, GRBG), 1)
    np.testing.assert_allclose(power.mean((1, 2)) / (128 * 192), planes.var((1, 2)), rtol=0.1)
    assert power[0, 64, 96] < 0.5 * power[0, 2, 2]  # interpolated: finest detail holds less


def test_cbm3d_gives_channels_back_with_less_noise(peers: Callable[[str], ModuleType]) -> None:
    pytest.importorskip("bm3d")
    rng, electron = np.random.default_rng(2), np.array([0.01, 0.01, 0.02])
    scale = electron[tiled(GRBG, (64, 96))]
    clean = COLOUR[tiled(GRBG, (64, 96))]
    noisy = (rng.poisson(clean / scale) + rng.normal(0.0, 4.0, clean.shape)) * scale
    noise = peers("rivals").Noise(electron, 16.0)
    made = peers("cbm3d").bayer()[0].settings[""].given(noise)(noisy, GRBG)
    np.testing.assert_allclose(made.mean((1, 2)), COLOUR, rtol=0.03)
    assert (made.std((1, 2)) < 0.3 * menon(noisy, GRBG).std((1, 2))).all()


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
    seen: list[Any] = []

    def with_noise(mosaic: NDArray[np.floating], cfa: NDArray[np.uint8], noise: Any) -> NDArray[np.floating]:
        seen.append((mosaic / noise.electron[tiled(cfa, mosaic.shape)], noise.dark))
        return bilinear(mosaic, cfa)

    given = rivals.Rival("given noise", "p", {"": rivals.Denoiser(with_noise)})
    table = random_table(BAYER, bits=12, black_level=64.0, patch=5)
    rows = judging.judged({"s": tmp_path / "set.h5"}, {"ours": table}, [bad, good, given], judging.picture_protocol())
    assert [each["name"] for each in rows if not each["ours"]] == ["good", "given noise", "bad"]
    assert [each["ours"] for each in rows].count(True) == 1
    best = next(each for each in rows if each["name"] == "good")
    assert best["settings"] == {"s psnr": "brighter", "s delta_e": "brighter"}
    assert best["figures"]["s delta_e"] < 15  # hard edges of a small chart
    assert all(each["seconds"] == 1 for each in rows)
    assert [each["name"] for each in rows if "by_frame" in each] == ["given noise", "ours"]
    for each in rows[1], rows[-1]:
        assert np.mean(each["by_frame"]["s delta_e"]) == pytest.approx(each["figures"]["s delta_e"], abs=1e-3)
    for electrons, dark in seen:  # of 4 DN each but for what is dark; 4 e of reading, 2 of fixed pattern, and rounding
        assert np.ptp((electrons * 0.25 + 0.5 - (electrons * 0.25).ravel()[0]) % 1) < 1e-3
        assert dark == pytest.approx(16 + 4 + 16 / 12, abs=0.5)


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
