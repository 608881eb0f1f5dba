"""A report's page in a browser: how it is painted, its slider, its downloads, without scripts and on paper."""

from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

from l3cli.cli import run
from tests.helpers.browser import Browser, painted

LIGHT_AND_DARK = ((1200, False), (1200, True), (400, False), (400, True))
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


@pytest.fixture(scope="module")
def page(pipeline: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The report on all artifacts."""
    artifacts = [str(pipeline / f"{name}.h5") for name in ("camera", "training", "table", "unseen")]
    out = tmp_path_factory.mktemp("painted") / "report.html"
    assert run(["report", *artifacts, "-o", str(out), "--quiet"]) == 0
    return out


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
    said = "".join(drawing.itertext())
    assert drawing.get("width") == "440"
    assert all(text in said for text in ("wavelength (nm)", "#1b1f24"))
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
