"""The Python API does the same as the commands, writes the same bytes, and returns artifacts and arrays."""

import doctest
import inspect
import re
import shutil
import subprocess
import sys
import threading
from collections.abc import Callable
from dataclasses import fields, replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import OpenImageIO as oiio
import pytest

import l3cli as l3
from l3cli.artifacts.camera import CameraModel
from l3cli.artifacts.table import TransformTable
from l3cli.artifacts.training_set import TrainingSet
from l3cli.errors import InputFileError, L3Error, RecipeError
from l3cli.evaluation.quality import quality
from l3cli.io.images import read_image
from l3cli.options.commands import EvaluateOptions, TrainOptions
from l3cli.options.render import Exposure, RenderOptions
from l3cli.physics.display import codes, daylight, displayed, srgb_curve, white_luminance
from l3cli.rendering.temporal import chunks
from tests.helpers.calls import Refused
from tests.helpers.cameras import BAYER, random_camera
from tests.helpers.sequences import RGGB, frames
from tests.helpers.tables import colorimetric_table, random_table


def same(one: Path, other: Path) -> bool:
    return one.read_bytes() == other.read_bytes()


def test_stages_give_the_bytes_of_the_commands(pipeline: Path, tmp_path: Path) -> None:
    camera = l3.calibrate(pipeline / "lab/MEASUREMENTS.toml", tmp_path / "camera.h5")
    assert isinstance(camera, CameraModel)
    assert same(tmp_path / "camera.h5", pipeline / "camera.h5")
    head = l3.simulate(str(pipeline / "scenes.toml"), camera, tmp_path / "training.h5")
    assert isinstance(head, TrainingSet)
    assert same(tmp_path / "training.h5", pipeline / "training.h5")
    table = l3.train(tmp_path / "training.h5", tmp_path / "table.h5", classes=pipeline / "classes.toml")
    assert isinstance(table, TransformTable)
    assert same(tmp_path / "table.h5", pipeline / "table.h5")
    raw = next((pipeline / "unseen").glob("*_raw.tif"))
    assert l3.render(table, raw, tmp_path / "picture.png") == 0
    assert same(tmp_path / "picture.png", pipeline / "picture.png")
    figures = l3.evaluate(table, pipeline / "unseen.h5")["mean"]
    ours, basic = figures["ours"], figures["basic"]  # of the same frames
    assert ours["mean_delta_e"] < 0.85 * basic["mean_delta_e"]  # in fact 0.76
    assert ours["scielab"] < 0.95 * basic["scielab"]  # in fact 0.87
    assert ours["psnr"] > basic["psnr"] + 3  # in fact 4.5 dB


def test_a_renderer_gives_the_picture_of_the_command(pipeline: Path) -> None:
    table = l3.load(pipeline / "table.h5")
    assert isinstance(table, TransformTable)
    raw = next((pipeline / "unseen").glob("*_raw.tif"))
    frame = l3.read_raw(raw, table)
    expected, _ = read_image(pipeline / "picture.png")
    for renderer in (l3.Renderer(table), l3.Renderer(pipeline / "table.h5")):
        np.testing.assert_array_equal(renderer.picture(frame), expected)
    assert renderer.outputs(frame).shape == (*frame.values.shape, 3)
    assert renderer.labels(frame).shape == frame.values.shape
    assert renderer.picture(frame, exposure=0.5, white="A", bits=16).dtype == np.uint16


def test_uncertainty_is_that_of_the_command(pipeline: Path, tmp_path: Path, refused: Refused) -> None:
    raw = next((pipeline / "unseen").glob("*_raw.tif"))
    table = l3.Renderer(pipeline / "table.h5").table
    command = ("render", pipeline / "table.h5", raw, "-o", tmp_path / "p.png", "--uncertainty")
    assert "u.tif" in refused(2, *command, tmp_path / "u.tif")
    assert "--uncertainty" in refused(2, *command[:3], raw, "-o", tmp_path / "all", "--uncertainty", tmp_path / "u.exr")
    into, clips = tmp_path / "into" / f"{raw.stem}.exr", (raw.parent, "-o", tmp_path / "clips", "--format", "mp4")
    assert "--uncertainty" in refused(2, *command[:2], *clips, "--uncertainty", into)
    for output in (into, into.parent):
        assert into.name in refused(2, *command[:3], "-o", output, "--format", "exr", "--uncertainty", into)
    np.save(tmp_path / "small.npy", l3.read_raw(raw, table).values[:30])
    assert "30×240" in refused(2, *command[:2], tmp_path / "small.npy", *command[3:], tmp_path / "u.exr")
    assert not list(tmp_path.glob("p.png"))
    assert l3.render(table, raw, tmp_path / "p.png", uncertainty=tmp_path / "u.exr") == 0
    written = oiio.ImageBuf(str(tmp_path / "u.exr"))
    assert written.spec().channelnames == ("mask", "sigma.X", "sigma.Y", "sigma.Z")
    renderer = l3.Renderer(table)
    frame = l3.read_raw(raw, table)
    found, outputs = renderer.uncertainty(frame), renderer.outputs(frame)
    np.testing.assert_array_equal(written.get_pixels(oiio.FLOAT), np.dstack([found.mask.astype(np.float32), found.sigma]))
    assert (found.sigma > 0).all()
    corners = [(4, 4), (4, 40), (30, 40), (30, 4)]
    patch = l3.region(outputs, found, corners)
    assert patch.mean == pytest.approx(outputs[4:30, 4:40].mean(axis=(0, 1)), rel=1e-5)
    independent = np.sqrt((found.sigma[4:30, 4:40] ** 2).sum(axis=(0, 1))) / patch.pixels
    assert (patch.sigma > independent).all()


def test_pictures_of_luminance_are_grey_whatever_white_is_named(bayer: CameraModel) -> None:
    table = colorimetric_table(bayer)
    first = replace(table.first, weights=table.first.weights[:, 1:2], intercept=table.first.intercept[:, 1:2])
    renderer = l3.Renderer(replace(table, outputs=("Y",), white_point=np.ones(1), first=first))
    share = np.linspace(0.1, 0.5, 48) * np.ones((40, 1))
    values = np.rint(bayer.black_level + share * (bayer.white_level - bayer.black_level)).astype(np.uint16)
    assert renderer.outputs(values).shape == (40, 48, 1)
    for white in (None, "table", "A", "0.31,0.33"):
        picture = renderer.picture(values, exposure=1.0, white=white).astype(int)
        assert np.ptp(picture, axis=2).max() == 0
        assert np.ptp(picture) > 50
    for white in ("auto", "camera", "20,20"):
        with pytest.raises(RecipeError):
            renderer.picture(values, white=white)


def test_arrays_generators_and_threads_share_a_renderer() -> None:
    table, rng = random_table(BAYER, patch=3), np.random.default_rng(1)
    frames = [rng.integers(0, 4096, (20, 24)).astype(np.uint16) for _ in range(6)]
    renderer = l3.Renderer(table)
    expected = [renderer.picture(frame, exposure=1.0) for frame in frames]
    assert all(map(np.array_equal, renderer.pictures((frame for frame in frames), exposure=1.0), expected))
    made: dict[int, np.ndarray] = {}

    def work(index: int) -> None:
        made[index] = renderer.picture(frames[index], exposure=1.0)

    threads = [threading.Thread(target=work, args=(index,)) for index in range(6)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert all(np.array_equal(made[index], expected[index]) for index in range(6))


def test_a_sequence_is_shown_as_the_command_shows_it(tmp_path: Path) -> None:
    """Exposure and white follow; without a rate those of the first frame hold, in any order."""
    clip = (1000 + (frames() - 64.0) / 8).astype(np.uint16)  # near to a grey
    l3.save(RGGB, tmp_path / "table.h5")
    np.save(tmp_path / "clip.npy", clip)
    l3.render(tmp_path / "table.h5", tmp_path / "clip.npy", tmp_path / "out", white="8,8,8", backend="reference")
    expected = [read_image(path)[0] for path in sorted((tmp_path / "out").glob("*.png"))]
    renderer = l3.Renderer(RGGB, backend="reference")
    show = renderer.sequence(Fraction(30), white="8,8,8")
    assert all(np.array_equal(show(frame), picture) for frame, picture in zip(clip, expected, strict=True))
    stored = renderer.sequence(None, white="8,8,8")
    first, last = stored(clip[0]), stored(clip[-1])
    np.testing.assert_array_equal(first, expected[0])
    assert (last != expected[-1]).any()
    np.testing.assert_array_equal(stored(clip[0]), first)
    fixed = renderer.sequence(Fraction(30), exposure=0.7)(clip[1])
    np.testing.assert_array_equal(fixed, renderer.picture(clip[1], exposure=0.7))


def test_a_sequence_is_filtered_in_time_as_the_command_filters_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Across a chunk, by both backends; a table that does not know its noise is refused before any frame."""
    monkeypatch.setattr(chunks, "CHUNK", 4)
    monkeypatch.setattr(chunks, "LEAD", 1)
    still = (1000 + (frames() - 64.0) / 8).astype(np.uint16)[0]
    clip = np.stack([still + np.random.default_rng(number).integers(0, 9, still.shape, np.uint16) for number in range(7)])
    quiet = replace(RGGB, camera=random_camera(BAYER, 3, 12, RGGB.black_level))
    l3.save(quiet, tmp_path / "table.h5")
    np.save(tmp_path / "clip.npy", clip)
    l3.render(tmp_path / "table.h5", tmp_path / "clip.npy", tmp_path / "out", temporal=True)
    expected = [read_image(path)[0] for path in sorted((tmp_path / "out").glob("*.png"))]
    renderer = l3.Renderer(quiet)
    show, plain = renderer.sequence(Fraction(30), temporal=True), renderer.sequence(Fraction(30))
    made = [(show(frame), plain(frame)) for frame in clip]
    assert all(np.array_equal(ours, picture) for (ours, _), picture in zip(made, expected, strict=True))
    assert [np.array_equal(*both) for both in made] == [True] + [False] * 6
    assert len({picture.tobytes() for _, picture in made}) == 7  # nor does it fill one array again and again
    with pytest.raises(RecipeError, match="‹temporal›"):
        l3.Renderer(replace(RGGB, camera=None)).sequence(Fraction(30), temporal=True)


def test_what_is_loaded_and_saved_is_the_same_file(pipeline: Path, tmp_path: Path) -> None:
    for name in ("camera.h5", "table.h5"):
        artifact = l3.load(pipeline / name)
        assert not isinstance(artifact, TrainingSet)
        l3.save(artifact, tmp_path / name)
        assert same(tmp_path / name, pipeline / name)
    assert isinstance(l3.load(pipeline / "training.h5"), TrainingSet)


def test_mistakes_raise_and_state_what_is_wrong(pipeline: Path, tmp_path: Path) -> None:
    with pytest.raises(InputFileError, match=r"nothing\.h5"):
        l3.load(tmp_path / "nothing.h5")
    with pytest.raises(RecipeError, match="defalt"):
        l3.simulate("defalt", "bayer", tmp_path / "t.h5")
    with pytest.raises(RecipeError, match="‹shares›"):
        l3.train(pipeline / "training.h5", tmp_path / "t.h5", shares=[1, 2])
    with pytest.raises(L3Error, match=r"table\.h5"):
        l3.train(pipeline / "training.h5", pipeline / "table.h5")
    with pytest.raises(InputFileError, match=r"camera\.h5"):
        l3.load_table(pipeline / "camera.h5")
    with pytest.raises(AttributeError, match="colour"):
        l3.colour  # noqa: B018


def test_an_object_in_place_of_a_path_is_named(pipeline: Path, tmp_path: Path) -> None:
    table: Any = l3.load_table(pipeline / "table.h5")
    for call in (
        lambda: l3.simulate(table, "bayer", tmp_path / "a.h5"),
        lambda: l3.train(table, tmp_path / "a.h5"),
        lambda: l3.render(table, table, tmp_path / "a.png"),
        lambda: l3.evaluate(table, table),
    ):
        with pytest.raises(TypeError, match=r"object of type TransformTable; save the artifact with l3cli\.save"):
            call()
    frames: Any = [np.zeros((4, 4), np.uint16)]
    with pytest.raises(TypeError, match=r"expected a path, but got an object of type ndarray$"):
        l3.render(table, frames, tmp_path / "a.png")
    assert not any(tmp_path.iterdir())


def test_options_have_names_types_and_ranges(tmp_path: Path) -> None:
    """mypy, which reads this file, too, knows the types; help() shows the texts of the command line."""
    refused: Callable[..., int] = l3.render
    with pytest.raises(TypeError, match="wihte"):
        refused("t.h5", "a", "b", wihte="D65")
    with pytest.raises(RecipeError, match="‹crf›: 99"):
        l3.render("t.h5", "a", "b", crf=99)
    with pytest.raises(RecipeError, match="‹bits›"):
        refused("t.h5", "a", "b", bits=12)
    for function, options in ((l3.render, RenderOptions), (l3.train, TrainOptions), (l3.evaluate, EvaluateOptions)):
        named = inspect.signature(function).parameters
        assert [each.name for each in fields(options)] == [
            name for name, each in named.items() if each.kind is each.KEYWORD_ONLY
        ]
    assert inspect.signature(l3.render).parameters["fps"].annotation == Fraction | float | str | None
    text = inspect.getdoc(l3.render) or ""
    assert "\nwhite : str, optional\n    " in text
    assert "\nblack_level : float, 0…65535 DN, optional\n    " in text
    assert "\ndark : str, path or sequence of str or path, optional\n    " in text
    stages: tuple[Callable[..., Any], ...] = (l3.calibrate, l3.simulate, l3.train, l3.render, l3.evaluate)
    for stage in stages:
        documented = set(re.findall(r"^(\w+) : \S", inspect.getdoc(stage) or "", re.MULTILINE))
        assert inspect.signature(stage).parameters.keys() <= documented
    same = RenderOptions(exposure="+1EV", frames="1-5x2", fps=29.97002997, phase=(1, 0), dark=tmp_path, shard=(1, 4))
    assert same == RenderOptions(
        exposure=Exposure(None, 1.0), frames=range(1, 6, 2), fps="30000/1001", phase="1,0", dark=[tmp_path], shard="1/4"
    )


@pytest.mark.parametrize(
    ("wrong", "described"),
    [
        (np.zeros((20, 20)), r"shape \(20, 20\) and dtype float64"),
        (np.zeros((20, 20, 3), np.uint16), r"shape \(20, 20, 3\) and dtype uint16"),
        (np.zeros((0, 20), np.uint16), r"shape \(0, 20\) and dtype uint16"),
        (np.zeros((20, 20), np.int32), r"dtype int32"),
        ("frame.dng", r"dtype <U9"),
        (None, r"dtype object"),
    ],
)
def test_an_array_that_is_no_frame_is_described(wrong: Any, described: str) -> None:
    renderer = l3.Renderer(RGGB, backend="reference")
    for call in (renderer.picture, renderer.outputs, renderer.labels, renderer.sequence(None)):
        with pytest.raises(InputFileError, match=f"array with .*{described} is not a raw frame; pass raw values"):
            call(wrong)


@pytest.mark.parametrize(
    ("options", "described"),
    [
        ({"exposure": 0}, r"exposure 0 is not within 1e-09…1e\+09"),
        ({"exposure": float("nan")}, "exposure nan is not within"),
        ({"exposure": "auto"}, 'exposure "auto" is not within .*; set a factor for Y'),
        ({"bits": 12}, "pictures cannot have 12 bits; use 8, 16 or 32"),
    ],
)
def test_an_option_that_no_picture_has_is_described(options: dict[str, Any], described: str) -> None:
    renderer = l3.Renderer(RGGB, backend="reference")
    with pytest.raises(RecipeError, match=described):
        renderer.picture(np.zeros((20, 20), np.uint16), **options)
    with pytest.raises(RecipeError, match=described):
        renderer.sequence(None, **options)


METHODS = [each for name, each in vars(l3.Renderer).items() if inspect.isfunction(each) and not name.startswith("_")]
PUBLIC = [each for name in l3.__all__ if inspect.isfunction(each := getattr(l3, name)) or inspect.isclass(each)]
EXAMPLES = PUBLIC + METHODS


@pytest.mark.parametrize("documented", [each for each in EXAMPLES if each is not L3Error])
def test_examples_run_as_shown(
    documented: Any, pipeline: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """In a folder with the files of a pipeline; help() shows sections of numpydoc."""
    shutil.copytree(pipeline, tmp_path, dirs_exist_ok=True)
    monkeypatch.chdir(tmp_path)
    text = inspect.getdoc(documented) or ""
    assert [each for each in ("Parameters\n---", "Examples\n---") if each not in text] == []
    assert inspect.isclass(documented) or documented is l3.save or "Returns\n---" in text
    example = doctest.DocTestParser().get_doctest(text, {}, documented.__name__, None, None)
    assert doctest.DocTestRunner().run(example).failed == 0, capsys.readouterr().out


def test_figures_of_two_pictures_are_those_of_evaluations() -> None:
    rng = np.random.default_rng(4)
    planes = rng.uniform(0.02, 1.0, (2, 3, 40, 48))
    expected = quality(planes[0], planes[1], daylight())
    scale = white_luminance(planes[1][1])
    ours, ideal = (srgb_curve(displayed(each, daylight(), scale)) for each in planes)
    assert l3.delta_e_2000(ours, ideal).mean() == pytest.approx(expected.mean_delta_e)
    assert l3.scielab(ours, ideal).mean() == pytest.approx(expected.scielab)
    assert l3.psnr(ours, ideal) == pytest.approx(expected.psnr)
    assert l3.ssim(ours, ideal) == pytest.approx(expected.ssim)
    for bits, close in ((8, 1e-2), (16, 1e-4)):
        coded = [codes(each, bits) for each in (ours, ideal)]
        assert l3.delta_e_2000(*coded).mean() == pytest.approx(expected.mean_delta_e, rel=close)
        assert l3.psnr(coded[0], ideal) == pytest.approx(expected.psnr, rel=close)
    assert l3.ssim(ours[..., 0], ours[..., 0]) == 1.0


@pytest.mark.parametrize(
    ("one", "other", "words"),
    [
        (np.zeros((8, 9, 3)), np.zeros((9, 8, 3)), r"\(8, 9, 3\) and dtype float64 and .*\(9, 8, 3\).* different shapes"),
        (np.zeros((8, 9)), np.zeros((8, 9)), r"\(8, 9\) and dtype float64 is not a colour picture"),
        (np.zeros((8, 9, 4)), np.zeros((8, 9, 4)), r"\(8, 9, 4\) .* is not a picture; pass an sRGB"),
        (np.zeros((8, 9, 3), int), np.zeros((8, 9, 3), int), r"dtype int64 is not a picture; pass uint8"),
        (np.full((8, 9, 3), 255.0), np.zeros((8, 9, 3)), r"dtype float64 contains values outside 0…1"),
        (np.full((8, 9, 3), np.nan), np.zeros((8, 9, 3)), r"dtype float64 contains values outside 0…1"),
    ],
)
def test_arrays_that_are_no_pictures_are_described(one: np.ndarray, other: np.ndarray, words: str) -> None:
    for figure in (l3.delta_e_2000, l3.scielab):
        with pytest.raises(InputFileError, match=words):
            figure(one, other)


@pytest.mark.parametrize("viewing", [0, -1, float("nan"), 1e9])
def test_a_distance_that_no_eye_is_at_is_described(viewing: float) -> None:
    with pytest.raises(RecipeError, match="‹viewing›"):
        l3.scielab(np.zeros((8, 9, 3)), np.zeros((8, 9, 3)), viewing)


def test_the_interface_is_imported_when_it_is_used() -> None:
    code = "import sys, l3cli; print([name for name in sys.modules if name.startswith(('l3cli.', 'numpy', 'h5py'))])"
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout == "[]\n"
    assert set(l3.__all__) <= set(dir(l3))
    assert (Path(l3.__file__).parent / "py.typed").is_file()
