"""The page that `l3 report` makes: its sections, figures, drawings and downloads."""

import itertools
import os
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from l3cli.artifacts.camera import CameraModel
from l3cli.artifacts.store import load
from l3cli.artifacts.table import TransformTable
from l3cli.cli import run
from l3cli.system.text import tidy
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
