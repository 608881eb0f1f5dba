"""`l3 report` of tables for several colour filter arrays: side by side for equal frames, otherwise in separate sections."""

import dataclasses
import html
import json
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from l3cli.artifacts.camera import CameraModel
from l3cli.artifacts.camera_recipe import load_camera
from l3cli.artifacts.store import save
from l3cli.artifacts.training_set import Shown, TrainingSet, write_training_set
from l3cli.cli import run
from tests.helpers.browser import Browser
from tests.helpers.calls import L3
from tests.helpers.cameras import bayer_camera
from tests.helpers.tables import colorimetric_table, frame_of_all_levels
from tests.helpers.training_sets import a_frame

SIZE = (36, 56)


@pytest.fixture(scope="module")
def quad(tmp_path_factory: pytest.TempPathFactory) -> CameraModel:
    """The small camera with each filter on a square of four pixels."""
    path = tmp_path_factory.mktemp("camera") / "quad.toml"
    rows = ("r r g g", "r r g g", "g g b b", "g g b b")
    path.write_text(bayer_camera(pattern=rows).replace("small Bayer", "small quad"))
    return load_camera(path)


def write(
    folder: Path,
    name: str,
    camera: CameraModel,
    seeds: tuple[int, ...],
    size: tuple[int, int] = SIZE,
    light: str | None = "",
) -> list[Path]:
    """A table of a camera and frames that it has not seen, one a seed, which say what they show, unless `light` is None."""
    table = colorimetric_table(camera)
    files = [folder / f"{name}.h5", folder / f"{name} unseen.h5"]
    save(table, files[0])
    head = TrainingSet(camera=camera, outputs=table.outputs, target_description="")
    with write_training_set(files[1], head) as writer:
        for seed in seeds:
            raw = frame_of_all_levels(table, np.random.default_rng(seed), size)
            frame = a_frame(camera, seed, smooth=False, size=size)
            writer.append(
                dataclasses.replace(frame, raw=raw.values, shown=None if light is None else Shown(np.ones(8) * seed, light))
            )
    return files


@pytest.fixture(scope="module")
def files(bayer: CameraModel, quad: CameraModel, tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    folder = tmp_path_factory.mktemp("arrays")
    return [*write(folder, "<i>bayer", bayer, (1, 2, 3)), *write(folder, "quad", quad, (3, 2, 7))]


@pytest.fixture(scope="module")
def one(bayer: CameraModel, tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """The first table and one of its frames."""
    return write(tmp_path_factory.mktemp("one"), "<i>bayer", bayer, (2,))


@pytest.fixture(scope="module")
def both(files: list[Path]) -> Path:
    """The page on all of them."""
    out = files[0].parent / "report.html"
    assert run(["report", *map(str, files), "-o", str(out), "--backend", "reference", "--quiet"]) == 0
    return out


@pytest.fixture
def page(l3: L3, tmp_path: Path) -> Callable[..., tuple[str, str]]:
    """The page on files, and what was said meanwhile."""

    def made(*files: Path) -> tuple[str, str]:
        out = ("-o", tmp_path / "report.html", "--force", "--backend", "reference")
        code, _, err = l3("report", *files, *out)
        assert code == 0, err
        return (tmp_path / "report.html").read_text(), err

    return made


def sections(text: str) -> list[str]:
    return [html.unescape(title) for title in re.findall(r'<h2 id="section-\d+">([^\n]*)</h2>', text)]


def side_by_side(text: str) -> str:
    assert text.count("<section") > 1
    return html.unescape(text[text.index("<section") : text.index("</section>")])


def test_tables_of_two_arrays_stand_side_by_side(both: Path) -> None:
    text = both.read_text()
    assert sections(text)[:3] == [
        "Comparison of tables",
        "Pictures: <i>bayer.h5 on <i>bayer unseen.h5",
        "Pictures: quad.h5 on quad unseen.h5",
    ]
    assert [title.partition(":")[0] for title in sections(text)[3:]] == [
        *("Camera", "Training set", "Table", "Evaluation") * 2,
        "History",
    ]
    first = side_by_side(text)
    assert re.search(r"(<i>bayer|quad)\.h5 is closest to the ideal on average, and in [12] of 2 frames\.", first)
    assert "over 2 frames that all training sets contain" in first
    assert "The exposure times of the cameras may differ" in first
    captions = re.findall("<figcaption>(.*?): (?:mean|the)", first)
    assert captions == ["<i>bayer.h5", "quad.h5", "ideal"]
    assert "2 × 2, 3 channels" in first
    assert "4 × 4, 3 channels" in first
    assert "Responsivities: small quad" in first
    assert "Colour filter array: small Bayer" in first
    assert "<i>" not in text


def test_figures_are_means_over_the_frames_that_both_have(both: Path, files: list[Path], l3: L3) -> None:
    means = []
    for table, frames in (files[:2], files[2:]):
        document = json.loads(l3("evaluate", table, frames, "--json", "--backend", "reference")[1])
        shared = [frame["ours"]["mean_delta_e"] for frame in document["frames"] if frame["scene"] in ("frame 2", "frame 3")]
        assert len(shared) == 2
        means.append(f"{np.mean(shared):.2f}")
    first = side_by_side(both.read_text())
    rows = re.findall(r'<th scope="row">(?:<i>bayer|quad)\.h5</th>(.*?)</tr>', first)
    assert [re.findall(r"<td[^>]*>([^<]*)", row)[2] for row in rows] == means


def test_pictures_name_the_light_on_the_scene_and_are_chosen_by_it(
    bayer: CameraModel, quad: CameraModel, tmp_path: Path, l3: L3
) -> None:
    """One scene at three luminances: the picture that stands side by side is the one at the illuminance that is wanted."""
    files = []
    for name, camera in (("bayer", bayer), ("quad", quad)):
        table = colorimetric_table(camera)
        files += [tmp_path / f"{name}.h5", tmp_path / f"{name} unseen.h5"]
        save(table, files[-2])
        head = TrainingSet(camera=camera, outputs=table.outputs, target_description="")
        with write_training_set(files[-1], head) as writer:
            for number, lux in enumerate((5.0, 50.0, 500.0)):
                raw = frame_of_all_levels(table, np.random.default_rng(number), SIZE)
                frame = a_frame(camera, number, smooth=False, size=SIZE)
                frame = dataclasses.replace(frame, raw=raw.values, scene="one", luminance=lux / np.pi)
                writer.append(dataclasses.replace(frame, shown=Shown(np.ones(8), "")))
    out = tmp_path / "report.html"
    for wanted in ("5", "500"):
        code, _, err = l3("report", *files, "--at", f"{wanted} lux", "-o", out, "--force", "--backend", "reference")
        assert code == 0, err
        shown = re.findall(r"one, [^<,]*, [^<,]* cd/m² \((\d+) lux\)", side_by_side(out.read_text()))
        assert set(shown) == {wanted}
        assert len(re.findall(rf"Frame \d: one, [^<,]*, [^<,]* cd/m² \({wanted} lux\)", out.read_text())) >= 2


def test_without_common_frames_nothing_is_compared(
    one: list[Path], quad: CameraModel, page: Callable, tmp_path: Path
) -> None:
    text, _ = page(*one, *write(tmp_path, "other", quad, (8,)))
    first = side_by_side(text)
    assert "evaluated on different frames, so their metrics cannot be compared" in first
    assert "nearest" not in first
    assert "<img" not in first


def test_frames_of_one_name_that_show_other_scenes_are_not_compared(
    one: list[Path], bayer: CameraModel, page: Callable, tmp_path: Path
) -> None:
    other = dataclasses.replace(bayer, cfa=bayer.cfa[::-1])
    first = side_by_side(page(*one, *write(tmp_path, "other", other, (2,), light="other"))[0])
    assert (
        "on different frames (frames with equal names show different scenes or illuminants; simulate all training sets with "
        "the same recipe and seed)" in first
    )
    assert "nearest" not in first
    assert "the same scenes and illuminants" not in first
    text = page(*one, *write(tmp_path, "older", other, (2,), light=None))[0]
    assert "They may still differ, because some frames, for example real frames, have no fingerprint" in side_by_side(text)
    assert "the same scenes and illuminants" not in text
    assert "Colour filter array: small Bayer (older.h5)" in side_by_side(text)
    assert {"Camera: small Bayer (<i>bayer unseen.h5)", "Camera: small Bayer (older unseen.h5)"} <= {*sections(text)}


def test_frames_of_other_sizes_stand_next_to_one_another(
    one: list[Path], quad: CameraModel, page: Callable, tmp_path: Path
) -> None:
    first = side_by_side(page(*one, *write(tmp_path, "larger", quad, (2,), (40, 64)))[0])
    assert 'class="gallery wide"' in first
    assert first.count("<img") == 3
    assert 'class="comparison"' not in first


def test_frames_of_an_array_without_a_table_are_reported_to_be_left_out(files: list[Path], page: Callable) -> None:
    text, err = page(files[0], files[3])
    assert "quad unseen.h5 has a different colour filter array from <i>bayer.h5, so it is not used for evaluation" in err
    assert "For each table, add a training set of its camera on which it was not trained" in text
    assert "Comparison of tables" not in sections(text)


def test_the_divider_names_what_it_divides(both: Path, tab: Browser) -> None:
    for width in (400, 1200):
        tab.open(both, width, dark=True)
        assert tab.complaints() == []
        assert tab.run("document.documentElement.scrollWidth") <= width
    label = "document.querySelector('.comparison label').textContent"
    assert tab.run(label) == "Compare <i>bayer.h5 with"
    cut = "document.querySelector('.comparison input').getAttribute('aria-valuetext')"
    assert tab.run(cut) == "50 % <i>bayer.h5"
    options = "[...document.querySelectorAll('.comparison option')].slice(0, 2).map((each) => each.text)"
    assert tab.run(options) == ["quad.h5", "ideal"]
