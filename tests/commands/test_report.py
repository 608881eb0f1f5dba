"""`l3 report`: what it takes and refuses, what the page holds, and how a browser paints it."""

import base64
import csv
import html.parser
import itertools
import re
from collections.abc import Callable, Iterator
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
from l3cli.io.images import read_image
from l3cli.report.downloads import csv_uri, file_stem
from l3cli.report.drawing import Axis, spanning, tick_text
from l3cli.report.front import verdict
from l3cli.report.labels import Places
from l3cli.report.parts import Data, tidy
from l3cli.report.pictures import fitted, reduced
from tests.helpers.browser import CHROMIUM, Browser

SCENES = """
exposure_share = [0.9]
illuminants = ["D65", "A"]
[[scene]]
source = "dead leaves"
size = [96, 96]
count = 3
"""
UNSEEN = """
exposure_share = [0.8, 0.1]
[[scene]]
source = "composition"
size = [128, 192]
count = 2
seed = 5
"""
CLASSES = "[classes]\npatch = 5\nlevels = 8\nchromas = 2\n[learning]\npatches = 4000\n"
EVIL = "<script>window.hurt=1</script>\"'&"


@pytest.fixture(scope="module")
def stages(fine_bayer_recipe: Path, lab_folder: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with camera.h5, training.h5, table.h5 and unseen.h5 of the small Bayer camera."""
    folder = tmp_path_factory.mktemp("report")
    for name, text in {"scenes": SCENES, "unseen": UNSEEN, "classes": CLASSES}.items():
        (folder / f"{name}.toml").write_text(text)

    def l3(*arguments: object) -> None:
        assert run([str(argument) for argument in (*arguments, "--quiet")]) == 0

    l3("calibrate", lab_folder / "MEASUREMENTS.toml", "-o", folder / "camera.h5")
    l3("simulate", folder / "scenes.toml", "--camera", folder / "camera.h5", "-o", folder / "training.h5")
    l3("train", folder / "training.h5", "--classes", folder / "classes.toml", "-o", folder / "table.h5")
    l3("simulate", folder / "unseen.toml", "--camera", fine_bayer_recipe, "-o", folder / "unseen.h5")
    return folder


def artifacts(stages: Path) -> list[Path]:
    return [stages / f"{name}.h5" for name in ("camera", "training", "table", "unseen")]


@pytest.fixture(scope="module")
def page(stages: Path) -> Path:
    """The report on everything."""
    assert run(["report", *map(str, artifacts(stages)), "-o", str(stages / "report.html"), "--quiet"]) == 0
    return stages / "report.html"


class Tags(html.parser.HTMLParser):
    """Start tags with their attributes in order, and all text."""

    def __init__(self, page: Path) -> None:
        super().__init__()
        self.starts: list[tuple[str, dict[str, str | None]]] = []
        self.text = ""
        self.feed(page.read_text())

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.starts.append((tag, dict(attrs)))

    def handle_data(self, data: str) -> None:
        self.text += data

    def all(self, *tags: str) -> list[dict[str, str | None]]:
        return [attributes for tag, attributes in self.starts if tag in tags]


# --------------------------------------------------------------------------------------------------------- the page


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
        "Levels",
        "Chromaticities of the targets",
        "Patches by site",
        "Noise gain",
        "Error over the class's level",
    ):
        assert title in tags.text, title


def test_the_picture_comes_first_with_figures_and_verdict_beside_it(page: Path) -> None:
    text = page.read_text()
    first = text[text.index("<section") : text.index("</section>")]
    names = re.findall(r"<figcaption>(\w+):", first)
    assert names[:3] == ["ours", "ideal", "basic"]
    aside = first[first.index("<aside") : first.index("</aside>")]
    assert re.search(r'class="score"><strong>\d+\.\d\d</strong> mean ΔE00 of ours, mean over 4 frames', aside)
    assert re.search("<p>Ours is (not )?nearer to the ideal than basic by", aside)
    assert aside.count('<th scope="row">') == 7
    assert "The first is, of 4 frames, the one of median mean ΔE00" in first
    assert "The worst and the best frame" in first


def test_a_verdict_says_by_which_figures_and_how_often() -> None:
    def said(frames: int, **wins: int) -> str:
        figures = {"ours": dict.fromkeys(wins, 1.0)}
        return verdict({"frames": [figures] * frames, "better": {"basic": wins}})

    assert said(1, mean_delta_e=1, ssim=1) == "Ours is nearer to the ideal than basic by every figure."
    assert said(3, mean_delta_e=3, ssim=3) == "Ours is nearer to the ideal than basic by every figure, in every frame."
    some = "Ours is nearer to the ideal than basic by mean ΔE00 in 3 of 4 frames"
    assert said(4, mean_delta_e=3, ssim=3) == f"{some}."
    assert said(4, mean_delta_e=3, ssim=2) == f"{some}, not by SSIM (1)."
    assert said(1, mean_delta_e=0, ssim=1) == "Ours is not nearer to the ideal than basic by mean ΔE00."


def test_drawings_and_pictures_say_what_they_find(page: Path) -> None:
    tags = Tags(page)
    drawings = [svg["aria-label"] or "" for svg in tags.all("svg") if svg.get("role") == "img"]
    pictures = [image["alt"] or "" for image in tags.all("img")]
    assert len(drawings) > 15
    assert len(pictures) > 15
    assert all(re.search(r"\d", said) and len(said) > 20 for said in drawings + pictures)
    assert all(svg.get("role") == "img" or svg.get("aria-hidden") == "true" or "x" in svg for svg in tags.all("svg"))
    assert all(cell.get("scope") in ("row", "col") for cell in tags.all("th"))
    named = {label["for"] for label in tags.all("label")}
    assert {control["id"] for control in tags.all("input", "select")} == named


def test_labels_lie_on_nothing_that_is_drawn(page: Path) -> None:
    """Boxes of the labels inside plots against every stroke of the same plot and against each other."""
    count = 0
    for inner in re.findall(r'<svg x="\d[^>]*>(.*?)</svg>', page.read_text(), re.DOTALL):
        strokes = [line for path in re.findall(r'<path d="([^"]+)"', inner) for line in polylines(path)]
        labels = re.findall(r'<text class="mark" x="([\d.]+)" y="([\d.]+)" text-anchor="(\w+)">([^<]*)', inner)
        boxes = [box_of(float(x), float(y), anchor, text) for x, y, anchor, text in labels]
        assert not any(crossed(line, box) for line in strokes for box in boxes), labels
        for one, other in itertools.combinations(boxes, 2):
            assert one[2] <= other[0] or other[2] <= one[0] or one[3] <= other[1] or other[3] <= one[1], labels
        count += len(boxes)
    assert count > 10


def polylines(path: str) -> list[np.ndarray]:
    """The lines (point, 2) of a path; of its dots and boxes where they begin."""
    return [np.array([point.split(",") for point in line.split("L")], float) for line in re.findall(r"M([-\d.,L]+)", path)]


def box_of(x: float, y: float, anchor: str, text: str) -> tuple[float, float, float, float]:
    """About what 12 px letters cover."""
    width = 6.8 * len(text)
    left = x - {"start": 0.0, "middle": 0.5, "end": 1.0}[anchor] * width
    return left, y - 9, left + width, y + 2


def crossed(line: np.ndarray, box: tuple[float, float, float, float]) -> bool:
    """Whether a line (point, 2) enters a box."""
    shares = np.linspace(0, 1, 400)[:, None]
    x, y = np.concatenate([line, *(one + shares * (other - one) for one, other in itertools.pairwise(line))]).T
    return bool(((x > box[0]) & (x < box[2]) & (y > box[1]) & (y < box[3])).any())


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


def csv_rows(uri: str) -> list[list[str]]:
    head, _, body = uri.partition(",")
    assert head == "data:text/csv;charset=utf-8;base64"
    return list(csv.reader(base64.b64decode(body).decode().splitlines()))


def test_a_spreadsheet_computes_nothing_that_is_a_name() -> None:
    rows = csv_rows(csv_uri(Data(("name", "value"), (("=HYPERLINK(1)", -1.5), ("-2+3", 2.0), ('a,"b', 0.1 + 0.2)))))
    assert rows == [["name", "value"], [" =HYPERLINK(1)", "-1.5"], [" -2+3", "2"], ['a,"b', "0.3"]]
    assert (file_stem("Größe: ../a b"), file_stem("…")) == ("gr-e-a-b", "figure")


def test_figures_are_those_of_the_artifacts(page: Path, stages: Path, l3: Callable) -> None:
    text = Tags(page).text
    camera = load(CameraModel, stages / "camera.h5")
    assert f"{tidy(camera.gain, 5)} DN/e⁻" in text
    table = load(TransformTable, stages / "table.h5")
    assert f"{len(table.first.samples)} classes of 5 × 5 patches; {(table.first.samples > 0).sum()} are trained" in text
    _, out, _ = l3("evaluate", stages / "table.h5", stages / "unseen.h5", "--json")
    mean = float(re.search(r'"ours": {\s*"mean_delta_e": ([0-9.]+)', out[out.index('"mean"') :])[1])  # type: ignore[index]
    assert f"Mean ΔE00 over 4 frames: ours {mean:.2f} (" in text
    for stage in table.history:
        assert f"l3 {stage.command}" in text
    assert CLASSES.strip() in text


def test_the_same_artifacts_give_the_same_bytes(page: Path, stages: Path, tmp_path: Path, l3: Callable) -> None:
    code, out, err = l3("report", *artifacts(stages), "-o", tmp_path / "deep/again.html")
    assert (code, out) == (0, "")
    assert "again.html: " in err
    assert (tmp_path / "deep/again.html").read_bytes() == page.read_bytes()
    assert str(stages) not in page.read_text()


# ------------------------------------------------------------------------------------------------------ any artifacts


@pytest.mark.parametrize(
    ("names", "sections", "lead"),
    [
        (["camera"], ["Camera", "History"], "nothing is evaluated"),
        (["table"], ["Table", "History"], "Add a training set that the table was not trained on"),
        (["training"], ["Camera", "Training set", "History"], "without a transform table"),
        (["training", "table"], ["Camera", "Training set", "Table", "History"], "add frames that it has not seen"),
        (
            ["table", "unseen"],
            ["Pictures", "Camera", "Training set", "Table", "Evaluation", "History"],
            "Mean ΔE00 over 4 frames",
        ),
        (["camera", "camera"], ["Camera", "History"], "1 artifact,"),
    ],
)
def test_a_report_shows_what_it_is_given(
    names: list[str], sections: list[str], lead: str, stages: Path, tmp_path: Path, l3: Callable
) -> None:
    out = tmp_path / "report.html"
    assert l3("report", *(stages / f"{name}.h5" for name in names), "-o", out)[0] == 0
    text = out.read_text()
    assert [re.split("[:<]", heading)[0] for heading in re.findall(r'<h2 id="section-\d+">([^\n]*)', text)] == sections
    assert lead in text


def test_a_described_camera_and_odd_outputs_are_shown(bayer: CameraModel, tmp_path: Path, l3: Callable) -> None:
    save(bayer, tmp_path / "camera.h5")
    bands = 'exposure_share = [0.5]\n[target]\noutputs = "camera"\n[[scene]]\nsource = "dead leaves"\nsize = [96, 96]\n'
    (tmp_path / "bands.toml").write_text(bands)
    simulate = ("simulate", tmp_path / "bands.toml", "--camera", tmp_path / "camera.h5", "-o", tmp_path / "bands.h5")
    assert l3(*simulate)[0] == 0
    assert l3("report", tmp_path / "camera.h5", tmp_path / "bands.h5", "-o", tmp_path / "report.html")[0] == 0
    text = (tmp_path / "report.html").read_text()
    assert "Described by a recipe, not measured" in text
    assert "there are no pictures to show" in text


def test_a_table_of_bands_is_judged_by_angles(stages: Path, tmp_path: Path, l3: Callable) -> None:
    scenes = '[target]\noutputs = "camera"\n[[scene]]\nsource = "dead leaves"\nsize = [96, 96]\ncount = 2\nseed = {}\n'
    for name in ("training", "unseen"):
        (tmp_path / "scenes.toml").write_text("exposure_share = [0.5]\n" + scenes.format(len(name)))
        simulate = ("simulate", tmp_path / "scenes.toml", "--camera", stages / "camera.h5", "-o", tmp_path / f"{name}.h5")
        assert l3(*simulate)[0] == 0
    train = ("train", tmp_path / "training.h5", "--classes", stages / "classes.toml", "-o", tmp_path / "table.h5")
    assert l3(*train)[0] == 0
    assert l3("report", tmp_path / "table.h5", tmp_path / "unseen.h5", "-o", tmp_path / "report.html")[0] == 0
    assert "Mean spectral angle (°) over 2 frames: ours " in (tmp_path / "report.html").read_text()


def test_a_camera_that_was_accepted_although_it_falls_short_says_so(stages: Path, tmp_path: Path, l3: Callable) -> None:
    camera = load(CameraModel, stages / "camera.h5")
    assert camera.fit is not None
    assert camera.fit.chart is not None
    assert camera.fit.noise is not None
    chart = replace(camera.fit.chart, relative_rmse=np.array([0.01, 0.05, 0.01]))
    noise = replace(camera.fit.noise, white_level_reached=False)
    save(replace(camera, fit=replace(camera.fit, chart=chart, noise=noise)), tmp_path / "camera.h5")
    assert l3("report", tmp_path / "camera.h5", "-o", tmp_path / "report.html")[0] == 0
    text = (tmp_path / "report.html").read_text()
    assert "It falls short: channel g is predicted with" in text
    assert "No white frame saturates" in text
    assert l3("report", stages / "camera.h5", "-o", tmp_path / "sound.html")[0] == 0
    assert "falls short" not in (tmp_path / "sound.html").read_text()


@pytest.fixture(scope="module")
def hostile(stages: Path) -> list[Path]:
    """The same artifacts with markup in every name that somebody else may choose."""
    folder = stages / "hostile"
    folder.mkdir()
    history = (Stage("<b>calibrate", {"<i>": EVIL}, EVIL, {"<u>frames": ["<s>" * 8]}, "<em>"),)
    channels = ("<b>", "</text><i>", '"><u>&amp;')  # short enough to stand in the drawings
    camera = replace(load(CameraModel, stages / "camera.h5"), name=EVIL, channels=channels, history=history)
    table = replace(
        load(TransformTable, stages / "table.h5"),
        camera_name=EVIL,
        channels=channels,
        history=history,
        camera=replace(camera, fit=None),
    )
    save(camera, folder / "camera.h5")
    save(replace(table, target_description=EVIL), folder / "table.h5")
    with open_training_set(stages / "unseen.h5") as reader:
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


# ------------------------------------------------------------------------------------------------------- refusals


def test_what_is_no_report_is_refused(stages: Path, tmp_path: Path, refused: Callable, l3: Callable) -> None:
    out, camera = tmp_path / "report.html", stages / "camera.h5"
    assert "ARTIFACT.h5" in refused(2, "report", "-o", out)
    assert "ends in .html" in refused(2, "report", camera, "-o", tmp_path / "report.pdf")
    assert "does not exist" in refused(3, "report", tmp_path / "none.h5", "-o", out)
    (tmp_path / "text.h5").write_text("no artifact")
    assert "is not an HDF5 file" in refused(3, "report", camera, tmp_path / "text.h5", "-o", out)
    shard = ("train", stages / "training.h5", "--classes", stages / "classes.toml", "--shard", "1/2")
    assert l3(*shard, "-o", tmp_path / "sums.h5")[0] == 0
    assert "give camera models, training sets or transform tables" in refused(3, "report", tmp_path / "sums.h5", "-o", out)
    out.write_text("mine")
    assert "--force" in refused(1, "report", camera, "-o", out)
    assert out.read_text() == "mine"
    assert l3("report", camera, "-o", out, "--force")[0] == 0


def test_a_table_and_frames_of_different_outputs_are_refused(stages: Path, tmp_path: Path, refused: Callable) -> None:
    with open_training_set(stages / "unseen.h5") as reader:
        head, frame = replace(reader.head, outputs=("a", "b", "c")), reader.frame(0)
    with write_training_set(tmp_path / "bands.h5", head) as writer:
        writer.append(frame)
    line = refused(3, "report", stages / "table.h5", tmp_path / "bands.h5", "-o", tmp_path / "report.html")
    assert "have different outputs" in line


# ------------------------------------------------------------------------------------------------------- its parts


def test_ticks_are_round_and_enough() -> None:
    for axis in (
        Axis("", 0, 0.27),
        Axis("", -3.2, 3.4),
        Axis("", 1e-7, 10, True),
        Axis("", 0.21, 0.29, True),
        Axis("", 0.2, 1.3, True),
    ):
        ticks = axis.ticks()
        assert 3 <= len(ticks) <= 10, ticks
        assert all(axis.low * 0.99 <= tick <= axis.high * 1.01 or abs(tick) < 1e-9 for tick in ticks)
        assert len({tick_text(tick) for tick in ticks}) == len(ticks)
    assert (tick_text(1e-7), tick_text(0.01), tick_text(-2), tick_text(2e5)) == ("10⁻⁷", "0.01", "−2", "2×10⁵")
    assert spanning("", np.full(3, 2.0)).high > spanning("", np.full(3, 2.0)).low


def test_numbers_read_without_exponents_where_they_can() -> None:
    shown = [tidy(value) for value in (0, 0.25, -0.0979, 24000, 12.3456, 1.1843e7, 3.2e-6)]
    assert shown == ["0", "0.25", "−0.0979", "24000", "12.3", "1.18×10⁷", "3.20×10⁻⁶"]


def test_a_label_goes_where_there_is_room_or_nowhere() -> None:
    free = Places(200, 100)
    assert free.place(100, 50, "here") == (100, 45 - 13.5 + 10, "middle")
    crossed_by = Places(200, 100)
    crossed_by.take([(100, 0), (100, 100)], joined=True)
    place = crossed_by.place(100, 50, "aside")
    assert place is not None
    assert place[2] == "start"
    full = Places(200, 100)
    full.take([(x, y) for y in range(0, 100, 4) for x in range(0, 200, 4)], joined=False)
    assert full.place(100, 50, "nowhere") is None


def test_pictures_are_made_smaller_until_they_fit() -> None:
    def jpeg(pixels: np.ndarray, quality: int) -> bytes:
        return b"x" * (pixels.size * quality // 100)

    picture = np.zeros((64, 96, 3), np.uint8)
    assert fitted(picture, 10**6, jpeg)[1] == (64, 96)
    uri, size = fitted(picture, 3000, jpeg)
    assert size == (16, 24)
    assert len(uri) < 3100
    assert np.allclose(reduced(np.arange(16.0).reshape(4, 4, 1), 2)[..., 0], [[2.5, 4.5], [10.5, 12.5]])


# ------------------------------------------------------------------------------------------------------- in a browser

LIGHT_AND_DARK = ((1200, False), (1200, True), (400, False), (400, True))
AREAS = """[...document.querySelectorAll('figure img, svg[role=img]')].filter(e => e.checkVisibility()).map(e => {
  const r = e.getBoundingClientRect();
  return {x: r.x + scrollX, y: r.y + scrollY, width: r.width, height: r.height, natural: e.naturalWidth ?? 1,
          name: e.alt || e.getAttribute('aria-label')};
})"""
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


UNPACKED = """new Promise((done) => {
  const waiting = () => [...document.querySelectorAll('.pixels .reading')].some((each) => each.hidden);
  const wait = () => waiting() ? setTimeout(wait, 20) : done();
  wait();
})"""


@pytest.fixture(scope="module")
def tab() -> Iterator[Browser]:
    if CHROMIUM is None:
        pytest.skip("no Chromium here; .ci/run installs it")
    with Browser() as browser:
        yield browser


def painted(tab: Browser, path: Path) -> dict[str, np.ndarray]:
    """Pixels of every figure and picture on the page by what it says."""
    tab.run(UNPACKED)
    areas = tab.run(AREAS)
    assert areas
    whole, _ = read_image(tab.screenshot(path))
    pixels = {}
    for area in areas:
        assert area["natural"] > 0, area
        assert min(area["width"], area["height"]) >= 20, area
        rows = slice(round(area["y"]), round(area["y"] + area["height"]))
        pixels[area["name"]] = whole[rows, round(area["x"]) : round(area["x"] + area["width"])]
    return pixels


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


def test_a_hostile_page_is_painted_like_any_other(tab: Browser, hostile_page: Path, tmp_path: Path) -> None:
    tab.open(hostile_page, 400)
    assert tab.complaints() == []
    assert tab.run("window.hurt") is None
    assert tab.run("document.documentElement.scrollWidth") <= 400
    painted(tab, tmp_path / "page.png")


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
    assert shown == tab.run("document.querySelectorAll('.panes img').length") > 8
    tab.open(page)
    tab.call("Emulation.setEmulatedMedia", media="print")
    assert tab.run("[...document.querySelectorAll('.panes img')].every(e => e.checkVisibility())")
    assert not tab.run("document.querySelector('.controls').checkVisibility()")
    assert tab.pdf(tmp_path / "page.pdf").read_bytes().startswith(b"%PDF")
    tab.call("Emulation.setEmulatedMedia", media="")


def test_what_is_no_number_is_named_as_such() -> None:
    assert [tidy(value) for value in (float("nan"), float("inf"), float("-inf"))] == ["–", "∞", "−∞"]
