"""`l3 evaluate --sequence`: accepted inputs, output, and rejected calls."""

import json
import re
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

from l3cli.artifacts import store
from l3cli.artifacts.camera import CameraModel
from l3cli.io.pictures.registry import write_picture
from l3cli.io.sequences import find_pictures
from l3cli.io.video import VideoChoice, new_video, new_y4m
from l3cli.physics.display import srgb_curve
from l3cli.report.sequence import sequence_section
from tests.helpers.calls import L3, Refused

SHAPE = (24, 32)


def pictures(count: int = 4, sigma: float = 0.0) -> list[np.ndarray]:
    rng = np.random.default_rng(0)
    plain = rng.integers(60, 200, (3, 4, 3)).repeat(8, 0).repeat(8, 1)
    noise = sigma * rng.standard_normal((count, *SHAPE, 1))
    return [np.clip(np.rint(plain + each), 0, 255).astype(np.uint8) for each in noise]


def folder_of(path: Path, made: list[np.ndarray], name: str = "{:04d}.png") -> Path:
    path.mkdir()
    for number, picture in enumerate(made):
        write_picture(path / name.format(number), picture)
    return path


@pytest.fixture
def ideal(tmp_path: Path) -> Path:
    """What a simulation writes: raw frames, ideal pictures, motion."""
    folder = folder_of(tmp_path / "clip", pictures(), "{:05d}_x_ideal.png")
    still = np.zeros((*SHAPE, 3), np.float32)
    for number in range(4):
        write_picture(folder / f"{number:05d}_x_motion.exr", still + (0, 0, number > 0), ("down", "right", "seen"))
        (folder / f"{number:05d}_x_raw.tif").write_bytes(b"not looked at")
    return folder


@pytest.mark.parametrize("given", ["noisy", "noisy/%04d.png", "noisy/*.png", "noisy/####.png"])
def test_a_sequence_has_many_names(given: str, tmp_path: Path, ideal: Path, l3: L3) -> None:
    folder_of(tmp_path / "noisy", pictures(sigma=4.0))
    code, out, err = l3("evaluate", "--sequence", tmp_path / given, "--ideal", ideal, "--json")
    assert (code, err) == (0, "")
    document = json.loads(out)
    assert document["kind"] == "sequence"
    assert [frame["frame"] for frame in document["frames"]] == [0, 1, 2, 3]
    assert document["frames"][0]["jump"] is None
    assert document["still_share"] == 1
    assert 1 < document["temporal_sigma"] < 2.5
    assert document["warped_error"] == pytest.approx(np.sqrt(2) * document["temporal_sigma"], rel=0.1)


def test_figures_are_printed_for_every_frame_and_the_whole(ideal: Path, tmp_path: Path, l3: L3) -> None:
    folder_of(tmp_path / "noisy", pictures(sigma=4.0))
    code, out, err = l3("evaluate", "--sequence", tmp_path / "noisy", "--ideal", ideal, "--border", 4)
    assert (code, err) == (0, "")
    for part in ("mean L*", "step σ", "temporal σ of L*, still patches", "100.0%", "ΔE00 mean", "largest jump"):
        assert part in out
    code, out, err = l3("evaluate", "--sequence", tmp_path / "noisy")
    assert (code, err) == (0, "")
    assert out.splitlines()[-2].split() == ["PSNR", "dB", "–"]


@pytest.mark.parametrize("name", ["a.mkv", "a.mp4", "a.mov", "a.y4m"])
@pytest.mark.parametrize("bits", [8, 16])
def test_videos_are_judged_as_their_pictures(name: str, bits: int, ideal: Path, tmp_path: Path, l3: L3) -> None:
    """Chroma is stored more coarsely than luma, and blocks of 8 pixels are what codecs keep best."""
    codec = "h265" if name == "a.mp4" and bits == 16 else None
    choice = VideoChoice(Fraction(24), bits, codec, crf=4 if name == "a.mp4" else None)
    made = [picture if bits == 8 else picture.astype(np.uint16) * 257 for picture in pictures()]
    with (new_y4m if name == "a.y4m" else new_video)(tmp_path / name, choice) as video:
        for picture in made:
            video.write(picture)
    code, out, err = l3("evaluate", "--sequence", tmp_path / name, "--ideal", ideal, "--json")
    assert code == 0, err
    document = json.loads(out)
    assert len(document["frames"]) == 4
    assert document["psnr"] > (60 if name == "a.mkv" else 22)
    assert document["temporal_sigma"] < (0.001 if name in ("a.mkv", "a.y4m") else 0.5)
    light = [frame["mean_lightness"] for frame in document["frames"]]
    _, plain, _ = l3("evaluate", "--sequence", ideal, "--json")
    assert light == pytest.approx([frame["mean_lightness"] for frame in json.loads(plain)["frames"]], abs=0.6)


@pytest.mark.parametrize("name", ["a.mp4", "a.mov", "a.y4m"])
def test_colours_of_videos_are_those_that_were_written(name: str, tmp_path: Path) -> None:
    colour = np.broadcast_to(np.array([20, 200, 40], np.uint8), (32, 32, 3))
    with (new_y4m if name == "a.y4m" else new_video)(tmp_path / name, VideoChoice(Fraction(24), 8)) as video:
        video.write(colour)
        video.write(colour)
    for picture in find_pictures(tmp_path / name).pictures():
        assert np.allclose(srgb_curve(picture) * 255, colour, atol=3)


def test_two_videos_are_read_next_to_each_other(tmp_path: Path, l3: L3) -> None:
    for name, sigma in {"a": 0.0, "b": 3.0}.items():
        with new_video(tmp_path / f"{name}.mkv", VideoChoice(Fraction(24), 8)) as video:
            for picture in pictures(sigma=sigma):
                video.write(picture)
    code, out, _ = l3("evaluate", "--sequence", tmp_path / "b.mkv", "--ideal", tmp_path / "a.mkv", "--json")
    assert code == 0
    assert 30 < json.loads(out)["psnr"] < 45
    assert len(json.loads(out)["frames"]) == 4


def test_another_exposure_is_reported(ideal: Path, tmp_path: Path, l3: L3) -> None:
    folder_of(tmp_path / "dark", [picture // 2 for picture in pictures()])
    code, _, err = l3("evaluate", "--sequence", tmp_path / "dark", "--ideal", ideal, "--json")
    assert code == 0
    assert "times as bright" in err
    assert "--exposure" in err


def test_what_does_not_belong_jointly_is_refused(ideal: Path, tmp_path: Path, refused: Refused) -> None:
    call = ("evaluate", "--ideal", ideal, "--sequence")
    few = folder_of(tmp_path / "few", pictures(3))
    assert "few" in refused(3, *call, few)
    other = folder_of(tmp_path / "other", [picture[:16] for picture in pictures()])
    assert "other" in refused(3, *call, other)
    write_picture(few / "0003.png", pictures()[0][:16])
    assert "0003.png" in refused(3, *call, few)
    (few / "0003.png").unlink()
    (few / "0001.png").unlink()
    assert "%04d.png" in refused(3, *call, few / "%04d.png")
    with new_video(tmp_path / "short.mkv", VideoChoice(Fraction(24), 8)) as video:
        for picture in pictures(3):
            video.write(picture)
    assert "short.mkv" in refused(3, *call, tmp_path / "short.mkv")
    for option in (("--viewing", 60), ("--backend", "reference"), ("--force",)):
        assert option[0] in refused(2, *call, ideal, *option)
    assert "short.mkv" in refused(3, "evaluate", "--sequence", ideal, "--ideal", tmp_path / "short.mkv")
    write_picture(ideal / "00002_x_motion.exr", np.zeros((8, 8, 3), np.float32), ("down", "right", "seen"))
    assert "00002_x_motion.exr" in refused(3, *call, folder_of(tmp_path / "four", pictures()))


@pytest.mark.parametrize("given", ["none", "empty", "one.png", "*.png", "*.txt", "?.nothing", "broken.mkv", "grey.mkv"])
def test_what_is_no_sequence_is_refused(given: str, tmp_path: Path, refused: Refused) -> None:
    from tests.helpers.sequences import write_raw_video

    (tmp_path / "empty").mkdir()
    write_picture(tmp_path / "one.png", pictures()[0])
    (tmp_path / "a.txt").write_text("x")
    (tmp_path / "broken.mkv").write_bytes(b"x" * 100)
    if given == "grey.mkv":
        write_raw_video(tmp_path / given, "gray")
    assert given.replace("*.txt", "a.txt") in refused(3, "evaluate", "--sequence", tmp_path / given)


def test_a_call_is_of_one_kind(ideal: Path, refused: Refused) -> None:
    assert "--sequence" in refused(2, "evaluate", "table.h5", "frames.h5", "--ideal", ideal)
    assert "--border" in refused(2, "evaluate", "--sequence", ideal, "--border", 10)


# ----------------------------------------------------------------------------------------------------------- report


@pytest.fixture
def evaluations(ideal: Path, tmp_path: Path, l3: L3) -> tuple[Path, Path]:
    """Of a sequence beside its ideal and of one without."""
    noisy = folder_of(tmp_path / "noisy", pictures(sigma=4.0))
    for name, more in {"with.json": ("--ideal", ideal), "without.json": ()}.items():
        code, out, _ = l3("evaluate", "--sequence", noisy, *more, "--json", "--quiet")
        assert code == 0
        (tmp_path / name).write_text(out)
    return tmp_path / "with.json", tmp_path / "without.json"


def test_a_report_plots_sequences_over_their_frames(
    evaluations: tuple[Path, Path], fiveband: CameraModel, tmp_path: Path, l3: L3
) -> None:
    store.save(fiveband, tmp_path / "camera.h5")
    assert l3("report", *evaluations, tmp_path / "camera.h5", "-o", tmp_path / "both.html", "--quiet") == (0, "", "")
    assert l3("report", *evaluations, "-o", tmp_path / "alone.html", "--quiet") == (0, "", "")
    for page in (tmp_path / "both.html", tmp_path / "alone.html"):
        section = page.read_text().partition(">Sequences</h2>")[2].partition("</section>")[0]
        plots = re.findall(r"<svg viewBox.*?</svg></svg>", section)
        assert len(plots) == 6
        lines = [plot.count('stroke-linejoin="round"') for plot in plots]
        assert lines == [2, 2, 1, 1, 1, 2]  # what has no ideal has no error
        assert all('class="mark"' not in plot for plot in plots)  # names stand in the legend, not on the curves
        assert "with.json" in section
        assert "temporal σ" in section


def test_a_line_keeps_its_colour_where_another_is_missing(evaluations: tuple[Path, Path]) -> None:
    documents = {path.name: json.loads(path.read_text()) for path in reversed(evaluations)}
    section = sequence_section(documents)
    figures = {figure.title: figure for figure in section.parts[1].blocks[0].figures}  # type: ignore[union-attr]
    keys = {title: {key.label: key.colour for key in figure.legend} for title, figure in figures.items()}
    assert keys["Error along the motion"]["with.json"] == keys["Noise over time"]["with.json"]
    assert keys["Noise over time"]["with.json"] != keys["Noise over time"]["without.json"]


@pytest.mark.parametrize(
    "content",
    [
        "",
        "{}",
        "[]",
        '{"kind": "sequence"}',
        '{"kind": "other"}',
        "[" * 100000,
        '{"kind": "sequence", "frames": []}',
        "\x00",
    ],
)
def test_what_is_no_evaluation_is_not_reported(content: str, tmp_path: Path, refused: Refused) -> None:
    (tmp_path / "a.json").write_text(content)
    assert "a.json" in refused(3, "report", tmp_path / "a.json", "-o", tmp_path / "a.html")


def test_an_evaluation_of_a_single_frame_is_none(evaluations: tuple[Path, Path], tmp_path: Path, refused: Refused) -> None:
    document = json.loads(evaluations[0].read_text())
    document["frames"] = document["frames"][:1]
    (tmp_path / "a.json").write_text(json.dumps(document))
    assert "a.json" in refused(3, "report", tmp_path / "a.json", "-o", tmp_path / "a.html")
