"""The page of `l3 report`: sections, figures, drawings, downloads, unusual names, and the display in a browser."""

import itertools
import os
import re
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

from l3cli.artifacts.camera import CameraModel
from l3cli.artifacts.schema import Stage
from l3cli.artifacts.store import load, save
from l3cli.artifacts.table import TransformTable
from l3cli.artifacts.training_set import open_training_set, write_training_set
from l3cli.cli import run
from l3cli.system.text import tidy
from tests.helpers.browser import Browser, painted
from tests.helpers.calls import L3
from tests.helpers.pages import Tags, csv_rows
from tests.helpers.recipes import CLASSES

UNSEEN = """
exposure_share = [0.8, 0.1]
[[scene]]
source = "composition"
size = [128, 192]
count = 2
seed = 5
"""


@pytest.fixture(scope="module")
def stages(pipeline: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with camera.h5, training.h5 and table.h5 of the small Bayer camera, and unseen.h5 of four frames."""
    folder = tmp_path_factory.mktemp("report")
    for name in ("camera", "training", "table"):
        os.link(pipeline / f"{name}.h5", folder / f"{name}.h5")
    (folder / "unseen.toml").write_text(UNSEEN)
    unseen = ["--camera", str(pipeline / "camera.toml"), "-o", str(folder / "unseen.h5"), "--quiet"]
    assert run(["simulate", str(folder / "unseen.toml"), *unseen]) == 0
    return folder


def artifacts(stages: Path) -> list[Path]:
    return [stages / f"{name}.h5" for name in ("camera", "training", "table", "unseen")]


@pytest.fixture(scope="module")
def page(stages: Path) -> Path:
    """The report on everything."""
    assert run(["report", *map(str, artifacts(stages)), "-o", str(stages / "report.html"), "--quiet"]) == 0
    return stages / "report.html"


def test_the_page_holds_every_section_and_stands_alone(page: Path) -> None:
    tags = Tags(page)
    assert page.stat().st_size < 10_000_000
    headings = [tag for tag, _ in tags.starts if re.fullmatch("h[1-6]", tag)]
    assert headings.count("h1") == 1
    assert headings.count("h2") == 7  # pictures, camera, two training sets, table, evaluation, history
    assert all(int(below[1]) <= int(above[1]) + 1 for above, below in itertools.pairwise(headings))
    assert tags.all("html") == [{"lang": "en"}]
    assert not tags.all("link", "iframe", "object")
    assert all((image["src"] or "").startswith("data:image/jpeg;base64,") for image in tags.all("img"))
    assert [attributes for attributes in tags.all("script") if attributes] == []
    assert not re.search(r"https?://", page.read_text())
    for title in (
        "Responsivities",
        "Photon transfer",
        "Measured against predicted",
        "Choice of the smoothing",
        "Raw levels",
        "Chromaticities of the targets",
        "Patches by site",
        "Noise gain",
        "Error by level of the class",
    ):
        assert title in tags.text, title


def test_the_picture_comes_first_with_figures_and_verdict_next_to_it(page: Path) -> None:
    text = page.read_text()
    first = text[text.index("<section") : text.index("</section>")]
    names = re.findall(r"<figcaption>(\w+):", first)
    assert names[:3] == ["ours", "ideal", "basic"]
    aside = first[first.index("<aside") : first.index("</aside>")]
    assert re.search(r'class="score"><strong>\d+\.\d\d</strong> mean ΔE00 of ours, mean over 4 frames', aside)
    assert re.search("<p>Ours is (not )?closer to the ideal than basic in", aside)
    assert aside.count('<th scope="row">') == 9
    assert "The first picture is the frame with the median mean ΔE00 of 4 frames" in first
    assert "The worst and the best frame" in first


def test_drawings_and_pictures_state_what_they_find(page: Path) -> None:
    tags = Tags(page)
    drawings = [svg["aria-label"] or "" for svg in tags.all("svg") if svg.get("role") == "img"]
    pictures = [image["alt"] or "" for image in tags.all("img")]
    assert len(drawings) > 15
    assert len(pictures) > 15
    assert all(re.search(r"\d", words) and len(words) > 20 for words in drawings + pictures)
    assert all(svg.get("role") == "img" or svg.get("aria-hidden") == "true" or "x" in svg for svg in tags.all("svg"))
    assert all(cell.get("scope") in ("row", "col") for cell in tags.all("th"))
    named = {label["for"] for label in tags.all("label")}
    assert {control["id"] for control in tags.all("input", "select")} == named


def test_every_plot_can_be_taken_from_the_page(page: Path, stages: Path) -> None:
    tags = Tags(page)
    links = [link for link in tags.all("a") if "download" in link]
    buttons = [button for button in tags.all("button") if "data-file" in button]
    drawings = [svg for svg in tags.all("svg") if svg.get("role") == "img"]
    assert len(links) == len(buttons) == len(drawings) > 15
    assert all(re.fullmatch(r"[a-z0-9-]+\.csv", link["download"] or "") for link in links)
    files = {link["download"]: csv_rows(link["href"] or "") for link in links}
    assert all(len(rows) > 1 and {len(row) for row in rows} == {len(rows[0])} for rows in files.values())
    rows = files["responsivities.csv"]
    camera = load(CameraModel, stages / "camera.h5")
    assert rows[0] == ["series", "wavelength (nm)", "quantum efficiency (e⁻/photon)"]
    assert [row[0] for row in rows[1:]] == [name for name in camera.channels for _ in camera.wavelength]
    assert np.allclose([float(row[2]) for row in rows[1:]], camera.responsivity.ravel(), rtol=1e-8)


def test_figures_are_those_of_the_artifacts(page: Path, stages: Path, l3: L3) -> None:
    text = Tags(page).text
    camera = load(CameraModel, stages / "camera.h5")
    assert f"{tidy(camera.gain, 5)} DN/e⁻" in text
    table = load(TransformTable, stages / "table.h5")
    assert f"{len(table.first.samples)} classes of patches of 5 × 5 pixels" in text
    assert f"{(table.first.samples > 0).sum()} classes were trained" in text
    _, out, _ = l3("evaluate", stages / "table.h5", stages / "unseen.h5", "--json")
    mean = float(re.search(r'"ours": {\s*"mean_delta_e": ([0-9.]+)', out[out.index('"mean"') :])[1])  # type: ignore[index]
    assert f"Mean ΔE00 over 4 frames: ours {mean:.2f} (" in text
    for stage in table.history:
        assert f"l3 {stage.command}" in text
    assert CLASSES.strip() in text
    assert str(stages) not in page.read_text()


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


LIGHT_AND_DARK = ((1200, False), (400, True))
CONTRASTS = """(() => {
  const canvas = document.createElement('canvas').getContext('2d', {willReadFrequently: true});
  const light = (colour) => {
    canvas.clearRect(0, 0, 1, 1); canvas.fillStyle = colour; canvas.fillRect(0, 0, 1, 1);
    const [r, g, b] = canvas.getImageData(0, 0, 1, 1).data;
    const linear = (v) => (v /= 255) <= 0.04045 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4;
    return 0.2126 * linear(r) + 0.7152 * linear(g) + 0.0722 * linear(b);
  };
  const behind = (e) => {
    if (e.dataset?.on) return e.dataset.on;
    for (; e; e = e.parentElement) {
      const colour = getComputedStyle(e).backgroundColor;
      if (colour !== 'rgba(0, 0, 0, 0)') return colour;
    }
    return 'white';
  };
  const low = [];
  const walker = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
  for (let node; (node = walker.nextNode());) {
    const e = node.parentElement;
    if (!node.data.trim() || !e.checkVisibility() || e.closest('script, option')) continue;
    const style = getComputedStyle(e);
    const [a, b] = [light(e instanceof SVGElement ? style.fill : style.color), light(behind(e))].sort((p, q) => q - p);
    const ratio = (a + 0.05) / (b + 0.05);
    if (ratio < 4.5) low.push(`${ratio.toFixed(2)} ${node.data.trim().slice(0, 40)}`);
  }
  return low;
})()"""


@pytest.mark.parametrize(("width", "dark"), LIGHT_AND_DARK)
def test_every_figure_is_painted_and_readable(tab: Browser, page: Path, tmp_path: Path, width: int, dark: bool) -> None:
    tab.open(page, width, dark)
    assert tab.complaints() == []
    assert tab.run("document.documentElement.scrollWidth") <= width
    for name, pixels in painted(tab, tmp_path / "page.png").items():
        assert pixels.shape[1] <= width, name
        assert np.ptp(pixels.astype(int)) > 40, name
        assert len(np.unique(pixels[..., :3].astype(int) @ [1 << 16, 1 << 8, 1])) > 3, name
    assert tab.run(CONTRASTS) == []
    assert tab.run("getComputedStyle(document.querySelector('svg text.mark')).outlineStyle") == "none"
    luminance = tab.run("getComputedStyle(document.documentElement).backgroundColor")
    assert (luminance != "rgb(255, 255, 255)") == dark


def test_the_slider_divides_and_obeys_the_keyboard(tab: Browser, page: Path) -> None:
    tab.open(page)
    clip = "getComputedStyle(document.querySelector('.over img')).clipPath"
    assert tab.run("document.querySelector('.controls').checkVisibility()")
    half = tab.run(clip)
    tab.run("document.querySelector('.comparison input').focus()")
    for kind in ("rawKeyDown", "keyUp"):
        tab.call("Input.dispatchKeyEvent", type=kind, key="End", code="End", windowsVirtualKeyCode=35)
    assert tab.run("document.querySelector('.comparison input').value") == "100"
    assert tab.run("document.querySelector('.comparison input').getAttribute('aria-valuetext')") == "100 % ours"
    assert tab.run(clip) != half
    choose = "(() => { const s = document.querySelector('.comparison select'); s.value = '2';"
    tab.run(choose + "s.dispatchEvent(new Event('change', {bubbles: true})); })()")
    assert "basic" in tab.run("document.querySelector('.under img').alt")


def test_a_plot_is_saved_as_a_drawing_of_its_own(tab: Browser, page: Path, tmp_path: Path) -> None:
    tab.open(page, dark=True)
    tab.call("Page.setDownloadBehavior", behavior="allow", downloadPath=str(tmp_path))
    for kind in ("button[data-file='responsivities.svg']", "a[download='responsivities.csv']"):
        tab.run(f'document.querySelector("{kind}").click()')
    wanted = [tmp_path / "responsivities.svg", tmp_path / "responsivities.csv"]
    for _ in range(100):
        if all(file.exists() for file in wanted):
            break
        tab.run("new Promise((done) => setTimeout(done, 50))")
    drawing = ElementTree.parse(wanted[0]).getroot()
    words = "".join(drawing.itertext())
    assert drawing.get("width") == "440"
    assert all(text in words for text in ("wavelength (nm)", "#1b1f24"))
    assert [child.text for child in drawing][-6:][1::2] == ["r", "g", "b"]  # the legend, mark by mark
    assert "var(" not in wanted[0].read_text()
    assert wanted[1].read_text().startswith("series,wavelength (nm)")


def test_the_page_works_without_scripts_and_on_paper(tab: Browser, page: Path, tmp_path: Path) -> None:
    tab.open(page, scripts=False)
    tab.call("Emulation.setScriptExecutionDisabled", value=False)
    assert not tab.run("document.querySelector('.controls').checkVisibility()")
    shown = tab.run("[...document.querySelectorAll('.panes img')].filter(e => e.checkVisibility()).length")
    assert shown == tab.run("document.querySelectorAll('.panes img').length") > 5
    tab.open(page)
    tab.call("Emulation.setEmulatedMedia", media="print")
    assert tab.run("[...document.querySelectorAll('.panes img')].every(e => e.checkVisibility())")
    assert not tab.run("document.querySelector('.controls').checkVisibility()")
    assert tab.pdf(tmp_path / "page.pdf").read_bytes().startswith(b"%PDF")
    tab.call("Emulation.setEmulatedMedia", media="")
