"""Polarisation cameras, from scenes to pictures, files and metrics."""

import json
import re
import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from l3cli.artifacts.camera_recipe import load_camera
from l3cli.artifacts.store import load
from l3cli.artifacts.table import TransformTable
from l3cli.artifacts.training_set import open_training_set, stokes_signals, white_signal
from l3cli.classes.planes import planes_basis
from l3cli.cli import run
from l3cli.evaluation.camera_match import camera_differences, colour_difference
from l3cli.frames.frame import RawFrame
from l3cli.io.images import read_image
from l3cli.physics.stokes import STOKES, dolp, luminance_name, stokes_of
from l3cli.recipes.builtin import known_recipes
from l3cli.rendering.reference import ReferenceRenderer
from l3cli.rendering.renderer import BACKENDS
from tests.helpers.calls import L3, Refused
from tests.helpers.paths import CONFIGS
from tests.helpers.recipes import small_classes

SCENES = """
exposure_share = [0.9]
[target]
outputs = "{outputs}"
[[scene]]
source = "dead leaves"
size = [48, 56]
count = 3
"""
KINDS = {"polarised": "Stokes", "polarised_colour": "CIE 1931 + Stokes"}


@pytest.fixture(scope="module", params=KINDS)
def trained(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with frames for training, unseen frames, a table and a raw frame of one of the two cameras."""
    folder = tmp_path_factory.mktemp(request.param)
    (folder / "scenes.toml").write_text(SCENES.format(outputs=KINDS[request.param]))
    (folder / "classes.toml").write_text(small_classes("polarised"))
    for call in (
        ("simulate", folder / "scenes.toml", "--camera", request.param, "-o", folder / "frames.h5"),
        ("simulate", folder / "scenes.toml", "--camera", request.param, "-o", folder / "unseen.h5", "--seed", 1),
        ("train", folder / "frames.h5", "--classes", folder / "classes.toml", "-o", folder / "table.h5"),
    ):
        assert run([*map(str, call), "--quiet"]) == 0
    with open_training_set(folder / "frames.h5") as reader:
        np.save(folder / "raw.npy", reader.frame(0).raw)
    return folder


@pytest.mark.parametrize("name", KINDS)
def test_a_new_folder_trains_for_the_illuminant_of_its_scenes(name: str, tmp_path: Path, l3: L3) -> None:
    assert l3("init", name, tmp_path / "demo")[0] == 0
    assert tomllib.loads((tmp_path / "demo/scenes.toml").read_text())["illuminants"] == ["D65"]
    assert tomllib.loads((tmp_path / "demo/scenes.toml").read_text())["target"]["outputs"] == KINDS[name]
    assert "lights" not in tomllib.loads((tmp_path / "demo/classes.toml").read_text())["learning"]
    assert (tmp_path / "demo/classes.toml").read_bytes() == (CONFIGS / "classes/polarised.toml").read_bytes()


@pytest.mark.parametrize("name", KINDS)
def test_two_calibrations_of_channels_with_the_same_filter_are_one_camera(name: str) -> None:
    camera = load_camera(known_recipes("cameras")[name])
    rng = np.random.default_rng(7)
    again = replace(camera, responsivity=camera.responsivity * rng.normal(1.0, 0.002, camera.responsivity.shape))
    assert colour_difference(again, camera) < 0.5
    assert camera_differences(again, camera) == ""


def test_tables_have_two_layers(trained: Path) -> None:
    """The second layer reads S0 (or Y) like luminance, and S1 and S2 like chroma."""
    table = load(TransformTable, trained / "table.h5")
    (layer,) = table.later
    assert layer.coarse_chroma is not None
    assert [table.outputs[each] for each in table.chroma_outputs] == ["S1", "S2"]
    assert planes_basis(table)[table.outputs.index(luminance_name(table.outputs))].tolist() == [0, 1, 0]
    assert table.white_point @ planes_basis(table) == pytest.approx([0, 1, 0], abs=1e-6)
    assert table.camera is not None
    assert table.camera.polarisers is not None


def test_unpolarised_greys_are_unpolarised_at_every_site(trained: Path) -> None:
    table = load(TransformTable, trained / "table.h5")
    white, span = table.white_signals, table.white_level - table.black_level
    assert white is not None
    for level in (0.02, 0.1, 0.4):
        signals = level * white / white.max()
        values = table.black_level + span * signals[np.tile(table.cfa, (24 // len(table.cfa), 24 // len(table.cfa)))]
        rounding = RawFrame("grey", np.rint(values).astype(np.uint16), table.black_level, table.white_level)
        stokes = stokes_of(ReferenceRenderer(table).exact_outputs(rounding), table.outputs)
        assert np.abs(stokes[1:]).max() < 0.02 * level + 2 / span
        assert stokes[0] == pytest.approx(level / white.max(), rel=0.03)


@pytest.mark.parametrize("angle", [20.0, 65.0, 110.0])
@pytest.mark.parametrize("level", [0.05, 0.2, 0.6])
def test_polarised_greys_keep_their_degree_and_angle(trained: Path, level: float, angle: float) -> None:
    """Uniform light that is polarised equally at all wavelengths is exact at every site, up to rounded raw values."""
    table = load(TransformTable, trained / "table.h5")
    assert table.camera is not None
    assert table.light is not None
    twice, degree = 2 * np.radians(angle), 0.2
    first, second = stokes_signals(table.light, table.camera)
    signal = white_signal(table.light, table.camera) + degree * (np.cos(twice) * first + np.sin(twice) * second)
    values = table.black_level + (table.white_level - table.black_level) * level * signal / signal.max()
    sites = np.rint(values).astype(np.uint16)[table.camera.channel_map((24, 24))]
    frame = RawFrame("grey", sites, table.black_level, table.white_level)
    # With such a small training set, the second layer changes the degree by up to 5 %.
    for layers, allowed in ((replace(table, later=()), 0.0006 / level), (table, 0.01)):
        s0, s1, s2 = stokes_of(ReferenceRenderer(layers).exact_outputs(frame), table.outputs)
        np.testing.assert_allclose(s1 / s0, degree * np.cos(twice), atol=allowed)
        np.testing.assert_allclose(s2 / s0, degree * np.sin(twice), atol=allowed)


def test_linear_files_contain_stokes_parameters_in_order(trained: Path, l3: L3) -> None:
    outputs = load(TransformTable, trained / "table.h5").outputs
    wanted = ("S0", "S1", "S2") if outputs == STOKES else outputs
    for name, bits in (("picture.exr", ()), ("picture.tif", ("--bits", 32))):
        assert l3("render", trained / "table.h5", trained / "raw.npy", "-o", trained / name, *bits)[0] == 0
        pixels, names = read_image(trained / name)
        assert pixels.shape == (48, 56, len(wanted) + 2)
        if name.endswith(".exr"):
            assert set(names) == {*wanted, "DoLP", "AoLP"}
            planes = {each: pixels[..., place] for place, each in enumerate(names)}
        else:
            assert all(np.array_equal(pixels[..., place], planes[each]) for place, each in enumerate(wanted))
    stokes = np.stack([planes["S0" if "S0" in planes else "Y"], planes["S1"], planes["S2"]])
    np.testing.assert_allclose(planes["DoLP"], dolp(stokes), atol=1e-6)
    assert planes["AoLP"].min() >= 0
    assert planes["AoLP"].max() < 180


def test_pictures_of_intensity_and_polarisation(trained: Path, l3: L3) -> None:
    table, raw = trained / "table.h5", trained / "raw.npy"
    assert l3("render", table, raw, "-o", trained / "intensity.png")[0] == 0
    intensity = read_image(trained / "intensity.png")[0]
    assert intensity.shape == (48, 56, 3)
    assert (np.ptp(intensity.astype(int), axis=2).max() == 0) == (load(TransformTable, table).outputs == STOKES)
    for shown in ("dolp", "aolp", "stokes"):
        assert l3("render", table, raw, "-o", trained / f"{shown}.png", "--show", shown)[0] == 0
        picture = read_image(trained / f"{shown}.png")[0]
        assert picture.shape[1] > 56
        assert np.ptp(picture.astype(int), axis=2).max() > 20


def test_uncertainty_of_degree_and_angle(trained: Path, l3: L3) -> None:
    sigma, outputs = trained / "sigma.exr", load(TransformTable, trained / "table.h5").outputs
    arguments = ("render", trained / "table.h5", trained / "raw.npy", "-o", trained / "picture.exr", "--force")
    code, _, err = l3(*arguments, "--uncertainty", sigma)
    assert code == 0, err
    pixels, names = read_image(sigma)
    assert set(names) == {*(f"sigma.{name}" for name in (*outputs, "DoLP", "AoLP")), "mask"}
    degree, angle = (pixels[..., names.index(f"sigma.{name}")] for name in ("DoLP", "AoLP"))
    assert 0 < degree.min() < degree.max() <= 0.5
    assert 0 < angle.min() < angle.max() <= 52


def test_show_is_refused_where_it_has_no_effect(trained: Path, refused: Refused) -> None:
    table, raw = trained / "table.h5", trained / "raw.npy"
    for options in (("new.exr",), ("new.png", "--exposure", 2), ("new.png", "--tone", "aces"), ("new.dng",)):
        assert "--show" in refused(2, "render", table, raw, "-o", trained / options[0], "--show", "dolp", *options[1:])


def test_figures_and_reports(trained: Path, l3: L3) -> None:
    """Monochrome tables have bilinear interpolation beside them."""
    table, frames, page = trained / "table.h5", trained / "unseen.h5", trained / "report.html"
    code, out, _ = l3("evaluate", table, frames, "--json", "--backend", "reference")
    assert code == 0
    document = json.loads(out)
    mono = load(TransformTable, table).outputs == STOKES
    assert document["pipelines"] == (["ours", "bilinear"] if mono else ["ours"])
    for quality in document["mean"].values():
        assert quality["psnr_s0"] > 20
        assert 0 < quality["mean_dolp_error"] < 0.3
        assert 0 < quality["aolp_rmse"] < 52
    assert "S0" in l3("evaluate", table, frames, "--backend", "reference")[1]
    assert l3("report", table, frames, "-o", page, "--backend", "reference")[0] == 0
    text = page.read_text()
    captions = re.findall(r'alt="[^"]*?, (\w+) of (\w+):', text)
    shown = document["pipelines"] + ["ideal"]
    assert {name for kind, name in captions if kind == "DoLP"} == set(shown)
    assert [kind for kind, name in captions if name == "ideal"] == ["DoLP", "AoLP", "S0", "DoLP", "DoLP"]  # of three frames
    assert len(captions) == 5 * len(shown)


@pytest.mark.parametrize("options", ["--white A", "--white auto", "--white 20,20,9", "--exposure 2"])
def test_pictures_of_colour_tables_on_every_backend(trained: Path, options: str, l3: L3) -> None:
    table = load(TransformTable, trained / "table.h5")
    if table.outputs == STOKES:
        return
    assert table.white_signals is not None
    raw, pictures = np.load(trained / "raw.npy"), []
    grey = 0.4 * table.white_signals / table.white_signals.max() * (table.white_level - table.black_level)
    raw[16:40, 16:40] = np.rint(table.black_level + grey)[np.tile(table.cfa, (6, 6))]
    np.save(trained / "grey.npy", raw)
    for backend in BACKENDS:
        name = trained / f"{backend}.png"
        arguments = ("render", trained / "table.h5", trained / "grey.npy", "-o", name, "--backend", backend, "--force")
        code, _, err = l3(*arguments, *options.split())
        assert code == 0, err
        pictures.append(read_image(name)[0].astype(int))
    assert np.ptp(pictures[0], axis=2).max() > 10
    assert all(np.abs(each - pictures[0]).max() <= 1 for each in pictures)
    if options.startswith("--white 2"):  # the square is almost neutral
        assert np.ptp(pictures[0][24:32, 24:32].mean(axis=(0, 1))) < 8


def test_a_white_does_not_change_grey_pictures(trained: Path, l3: L3) -> None:
    if load(TransformTable, trained / "table.h5").outputs != STOKES:
        return
    for name, options in (("one.png", ()), ("two.png", ("--white", "A"))):
        assert l3("render", trained / "table.h5", trained / "raw.npy", "-o", trained / name, *options)[0] == 0
    np.testing.assert_array_equal(read_image(trained / "one.png")[0], read_image(trained / "two.png")[0])


def test_stokes_outputs_need_polarisers(refused: Refused, tmp_path: Path) -> None:
    assert "Stokes" in refused(2, "simulate", "polarised", "--camera", "bayer", "-o", tmp_path / "new.h5")
