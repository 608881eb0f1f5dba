"""`l3 render --white`: white from the file, a grey area, an estimate or a name, in stills, sequences and resumed runs."""

import contextlib
import dataclasses
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import l3cli
from l3cli.artifacts.camera import CameraModel
from l3cli.artifacts.conditions import Condition, SceneLight
from l3cli.artifacts.store import load, save
from l3cli.artifacts.table import TransformTable
from l3cli.frames.chart import Located
from l3cli.io.images import read_image
from l3cli.io.pictures.dng import LIGHT_CODES, write_dng
from l3cli.physics import spectra
from l3cli.physics.display import daylight, displayed_xyz, lab, srgb_decoded
from l3cli.rendering.conditions import Mix, mixed
from l3cli.rendering.white import source
from l3cli.rendering.white.source import CAMERA
from tests.helpers.calls import L3, Refused
from tests.helpers.photos import FIRST, PITCH, chart_mosaic
from tests.helpers.tables import colorimetric_table

FAST = ("--backend", "reference")
ROUNDING = (
    3  # codes of 8 bits between the channels of a grey that is neutral: a DN of 12 bits, the gains on it, the sRGB curve
)


def mosaic(camera: CameraModel, light: str, share: float = 0.5) -> np.ndarray:
    """Grey on the left, coloured squares and white on the right, under a light."""
    surfaces = spectra.reflectance_library(camera.wavelength)[5:300:20]
    surfaces = np.vstack([np.full(camera.wavelength.size, 0.5), np.full(camera.wavelength.size, 0.9), surfaces])
    radiance = spectra.illuminant(light, camera.wavelength)
    signals = (surfaces * radiance) @ camera.electron_weights.T / (camera.electron_weights @ radiance).max()
    chosen = np.zeros((60, 160), int)
    chosen[:, 80:] = np.arange(6 * 8).reshape(6, 8).repeat(10, 0).repeat(10, 1) % (len(surfaces) - 1) + 1
    values = np.take_along_axis(signals[chosen], np.tile(camera.cfa, (30, 80))[..., None], axis=2)[..., 0]
    return np.rint(camera.black_level + share * values * (camera.white_level - camera.black_level)).astype(np.uint16)


def dng(path: Path, camera: CameraModel, light: str, values: np.ndarray, stated: str | None = "") -> Path:
    """A frame as DNG that states the neutral of its light, or of another one."""
    neutral = camera.electron_weights @ spectra.illuminant(stated or light, camera.wavelength)
    colour = dict.fromkeys(LIGHT_CODES, np.eye(3))
    write_dng(path, values, camera, colour, None if stated is None else neutral / neutral.max(), 0.01)
    return path


@pytest.fixture(scope="module")
def table(bayer: CameraModel, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("white") / "table.h5"
    save(colorimetric_table(dataclasses.replace(bayer, noise=dataclasses.replace(bayer.noise, dark_current=0.0))), path)
    return path


@pytest.fixture(scope="module")
def warm(bayer: CameraModel, table: Path) -> Path:
    return dng(table.parent / "warm.dng", bayer, "3200K", mosaic(bayer, "3200K"))


def grey(picture: Path) -> np.ndarray:
    return read_image(picture)[0][10:50, 10:70].astype(int)


def cast(picture: Path) -> int:
    """The largest difference between the channels of the grey half."""
    return int(np.ptp(grey(picture), axis=2).max())


def test_the_white_that_the_file_states(l3: L3, table: Path, warm: Path, tmp_path: Path) -> None:
    code, _, err = l3("render", table, warm, "--white", CAMERA, "-o", tmp_path / "a.png", *FAST)
    assert code == 0
    line, *warnings = err.splitlines()
    assert line.startswith(f"{warm}: white from the file: x,y = 0.42")
    assert 3150 < float(line.split(" K,")[0].split()[-1]) < 3250
    assert not [each for each in warnings if "camera" in each or "array" in each]
    assert cast(tmp_path / "a.png") <= ROUNDING
    assert l3("render", table, warm, "-o", tmp_path / "usual.png", *FAST)[2] == err
    assert (tmp_path / "usual.png").read_bytes() == (tmp_path / "a.png").read_bytes()
    assert l3("render", table, warm, "--white", "table", "-o", tmp_path / "b.png", *FAST)[2] == ""
    assert cast(tmp_path / "b.png") > 40


@pytest.mark.parametrize("white", ["30,40", "30,40,24", "3200K"])
def test_a_grey_of_the_picture_or_a_name_shows_it_neutral(
    l3: L3, table: Path, warm: Path, tmp_path: Path, white: str
) -> None:
    """Exposure means the same whatever the white: the grey has half of white's luminance, white half of full scale."""
    code, _, err = l3("render", table, warm, "--white", white, "--exposure", 1, "-o", tmp_path / "a.png", *FAST)
    assert code == 0
    assert ("around row 30, column 40" in err) == ("," in white)
    assert cast(tmp_path / "a.png") <= ROUNDING
    assert l3("render", table, warm, "--white", "0.42,0.4", "--exposure", 1, "-o", tmp_path / "b.png", *FAST)[0] == 0
    assert abs(grey(tmp_path / "a.png")[..., 1].mean() - grey(tmp_path / "b.png")[..., 1].mean()) < 4


def test_multipliers_of_the_channels_are_a_white(
    l3: L3, table: Path, warm: Path, bayer: CameraModel, tmp_path: Path
) -> None:
    """As raw developers show them, of any scale; what the file states gives the same picture."""
    signals = bayer.electron_weights @ spectra.illuminant("3200K", bayer.wavelength)
    of_file = ("render", table, warm, "-o", tmp_path / "a.png", "--exposure", "1", *FAST)
    assert l3(*of_file, "--quiet")[0] == 0
    for scale in (1.0, 1.7):
        multipliers = ",".join(f"{scale * signals[1] / each:.4f}" for each in signals)
        assert l3(*of_file, "--white", multipliers, "--quiet", "--force")[0] == 0
        assert cast(tmp_path / "a.png") <= ROUNDING
        renderer = l3cli.Renderer(table, backend="reference")
        frame = l3cli.read_raw(warm, renderer.table)
        python = renderer.picture(frame, white=multipliers, exposure=1.0)
        np.testing.assert_array_equal(python, read_image(tmp_path / "a.png")[0])


def test_stated_multipliers_of_1_are_a_white(l3: L3, table: Path, bayer: CameraModel, tmp_path: Path) -> None:
    """Values that are balanced already: a grey has equal signals, which the table shows in colour without gains."""
    values = np.full((60, 160), bayer.black_level + 1000, np.uint16)
    write_dng(tmp_path / "even.dng", values, bayer, dict.fromkeys(LIGHT_CODES, np.eye(3)), np.ones(3), 0.01)
    for number, options in enumerate([(), ("--white", CAMERA), ("--white", "1,1,1"), ("--white", "1.0,1,1")]):
        picture = tmp_path / f"{number}.png"
        assert l3("render", table, tmp_path / "even.dng", *options, "-o", picture, "--quiet", *FAST)[0] == 0
        assert cast(picture) <= ROUNDING


def test_automatic_white_is_reported_and_takes_most_of_a_cast_away(l3: L3, table: Path, warm: Path, tmp_path: Path) -> None:
    code, _, err = l3("render", table, warm, "--white", "auto", "-o", tmp_path / "a.png", *FAST)
    assert code == 0
    assert "white estimated from the frame: x,y = 0." in err
    assert cast(tmp_path / "a.png") < 25


@pytest.mark.parametrize(
    ("code", "white"),
    [
        *((2, white) for white in ("30,40,0", "30,40,2.5", "-3,40", "30,40,3,5", "2,1,1,1.5", "2.1,0,1.4", "2.1,-1,1.4")),
        *((2, white) for white in ("2.1,nan,1.4", "2.1,1,", "30,40,1", "cameras", "AUTO")),
        *((3, white) for white in ("58,40", "5000,5000", "30,120,1000")),
    ],
)
def test_whites_that_cannot_be(refused: Refused, table: Path, warm: Path, tmp_path: Path, code: int, white: str) -> None:
    line = refused(code, "render", table, warm, "--white", white, "-o", tmp_path / "a.png", *FAST)
    assert "white" in line or white in line


def test_frames_whose_white_cannot_be_taken(
    refused: Refused, table: Path, bayer: CameraModel, tmp_path: Path, l3: L3
) -> None:
    raw, picture = mosaic(bayer, "A"), tmp_path / "a.png"
    np.save(tmp_path / "plain.npy", raw)
    dng(tmp_path / "none.dng", bayer, "A", raw, stated=None)
    for name in ("plain.npy", "none.dng"):
        assert name in refused(3, "render", table, tmp_path / name, "--white", "camera", "-o", picture, *FAST)
    raw[20:40, 20:60] = int(bayer.white_level)
    np.save(tmp_path / "clipped.npy", raw)
    patch = ("--white", "30,40,20", "-o", picture, *FAST)
    assert "clipped.npy" in refused(3, "render", table, tmp_path / "clipped.npy", *patch)
    raw[20:40, 20:60] = int(bayer.black_level) + np.arange(40) % 3
    np.save(tmp_path / "dark.npy", raw)
    assert "dark.npy" in refused(3, "render", table, tmp_path / "dark.npy", *patch)
    np.save(tmp_path / "black.npy", np.full_like(raw, int(bayer.black_level)))
    code, _, err = l3("render", table, tmp_path / "black.npy", "--white", "auto", "-o", picture, *FAST)
    assert code == 0
    assert "the white cannot be determined" in err
    exr = refused(2, "render", table, tmp_path / "plain.npy", "--white", "auto", "-o", tmp_path / "a.exr", *FAST)
    assert "--white" in exr


def test_a_neutral_that_no_light_gives_and_another_camera_are_warned_of(
    l3: L3, table: Path, bayer: CameraModel, tmp_path: Path
) -> None:
    other = dataclasses.replace(bayer, name="Canon EOS 550D")
    colour = dict.fromkeys(LIGHT_CODES, np.eye(3))
    write_dng(tmp_path / "odd.dng", mosaic(bayer, "A"), other, colour, np.array([1.0, 0.2, 1.0]), 0.01)
    code, _, err = l3("render", table, tmp_path / "odd.dng", "--white", "camera", "-o", tmp_path / "a.png", *FAST)
    assert code == 0
    (line,) = [each for each in err.splitlines() if "does not match any daylight, lamp or black body" in each]
    assert "l3 makes greys neutral but does not correct other colours" in line
    assert "the file comes from the camera Canon EOS 550D, but the table is for small Bayer" in err


def test_an_array_that_a_file_misstates_is_warned_of_with_the_phase(
    l3: L3, table: Path, bayer: CameraModel, tmp_path: Path
) -> None:
    raw = dng(tmp_path / "shifted.dng", bayer, "D65", mosaic(bayer, "D65")[:, 1:].copy())
    err = l3("render", table, raw, "-o", tmp_path / "a.png", *FAST)[2]
    assert "the phase of the colour filter array seems wrong" in err
    assert "--phase 0,1 or 1,0" in err
    assert "sites" not in l3("render", table, raw, "-o", tmp_path / "b.png", "--phase", "0,1", *FAST)[2]


def clip(folder: Path, camera: CameraModel, lights: tuple[str, ...]) -> Path:
    folder.mkdir()
    for number, light in enumerate(lights):
        dng(folder / f"{number}.dng", camera, light, mosaic(camera, light))
    return folder


@pytest.mark.parametrize("white", ["auto", "camera"])
def test_white_is_followed_in_sequences_and_the_same_when_resumed(
    l3: L3, table: Path, bayer: CameraModel, tmp_path: Path, white: str
) -> None:
    """At 30 frames a second a step of light is followed by 3 % a frame; what is resumed is what it would have been."""
    folder = clip(tmp_path / "clip", bayer, ("3200K", "3200K", "D65", "D65", "D65"))
    call = ("render", table, folder, "--white", white, "--exposure", 1, *FAST)
    code, _, err = l3(*call, "-o", tmp_path / "out")
    assert code == 0
    assert err.count("white ") == 2  # of the first and of the last frame
    pictures = {path.name: path.read_bytes() for path in sorted((tmp_path / "out").glob("[!.]*"))}
    shown = [grey(tmp_path / "out" / f"{number}.png") for number in range(5)]
    step = [each[..., 2].mean() - each[..., 0].mean() for each in shown]
    assert step[2] > step[3] > step[4] > step[2] - 40  # bluish after the step, ever less so
    (folder / "4.dng").rename(tmp_path / "4.dng")
    (folder / "4.dng").write_bytes(b"broken")
    assert l3(*call, "-o", tmp_path / "again", "--quiet")[0] == 3
    (tmp_path / "4.dng").replace(folder / "4.dng")
    (tmp_path / "again/1.png").unlink()
    assert l3(*call, "-o", tmp_path / "again", "--resume", "--quiet") == (0, "", "")
    assert {path.name: path.read_bytes() for path in sorted((tmp_path / "again").glob("[!.]*"))} == pictures
    dng(folder / "1.dng", bayer, "D65", mosaic(bayer, "D65"))  # changes the white of all later pictures
    assert l3(*call, "-o", tmp_path / "again", "--resume", "--quiet") == (0, "", "")
    assert (tmp_path / "again/0.png").read_bytes() == pictures["0.png"]
    assert (tmp_path / "again/2.png").read_bytes() != pictures["2.png"]


def test_a_grey_is_measured_on_the_first_frame_of_a_sequence_and_on_every_still(
    l3: L3, table: Path, bayer: CameraModel, tmp_path: Path
) -> None:
    folder = clip(tmp_path / "clip", bayer, ("3200K", "D65"))
    call = ("render", table, "--white", "30,40", "--exposure", 1, *FAST, "-o")
    assert l3(*call, tmp_path / "held", folder)[0] == 0
    assert cast(tmp_path / "held/0.png") <= ROUNDING
    assert cast(tmp_path / "held/1.png") > 40
    code, _, err = l3(*call, tmp_path / "stills", folder / "0.dng", folder / "1.dng")
    assert (code, err.count(": white measured on 32×32 pixels")) == (0, 2)
    assert max(cast(tmp_path / f"stills/{number}.png") for number in range(2)) <= ROUNDING


def test_python_gives_the_pictures_of_the_command(
    l3: L3, table: Path, warm: Path, bayer: CameraModel, tmp_path: Path
) -> None:
    renderer = l3cli.Renderer(table, backend="reference")
    frame = l3cli.read_raw(warm, renderer.table)
    assert frame.neutral is not None
    for white in ("camera", "auto", "30,40", "A"):
        assert l3("render", table, warm, "--white", white, "-o", tmp_path / "a.png", "--force", "--quiet", *FAST)[0] == 0
        np.testing.assert_array_equal(renderer.picture(frame, white=white), read_image(tmp_path / "a.png")[0])
    with pytest.raises(l3cli.errors.InputFileError, match="contains no white balance"):
        renderer.picture(mosaic(bayer, "A"), white="camera")


def test_a_table_of_an_older_file_adapts_from_what_it_shows(l3: L3, table: Path, warm: Path, tmp_path: Path) -> None:
    made = l3cli.load(table)
    assert isinstance(made, TransformTable)
    save(dataclasses.replace(made, camera=None, light=None), tmp_path / "old.h5")
    for white in ("camera", "30,40", "auto"):
        code, _, err = l3("render", tmp_path / "old.h5", warm, "--white", white, "-o", tmp_path / "a.png", "--force", *FAST)
        assert code == 0
        assert ": white " in err
        assert cast(tmp_path / "a.png") <= (25 if white == "auto" else ROUNDING)


@pytest.fixture(scope="module")
def several(table: Path, bayer: CameraModel) -> Path:
    """A table of several lights."""
    common = load(TransformTable, table)
    assert common.camera
    made = [colorimetric_table(common.camera, light) for light in ("A", "D65")]
    lights = [
        Condition.of(one.first, one.later, SceneLight(name, one.white_point, one.light), None)
        for name, one in zip(("A", "D65"), made, strict=True)
    ]
    path = table.with_name("several.h5")
    save(dataclasses.replace(common, conditions=tuple(lights)), path)
    return path


@pytest.mark.parametrize("given", ["3200K", CAMERA])
def test_transforms_of_the_nearest_of_several_lights_are_taken(
    l3: L3, several: Path, warm: Path, tmp_path: Path, given: str
) -> None:
    """As if the table had these alone, from Python too."""
    code, _, err = l3("render", several, warm, "--white", given, "-o", tmp_path / "a.png", *FAST)
    assert code == 0
    assert "transforms for A" in err
    table = load(TransformTable, several)
    save(mixed(table, Mix(0, 1, 0.0)), tmp_path / "mixed.h5")
    assert l3("render", tmp_path / "mixed.h5", warm, "--white", "3200K", "-o", tmp_path / "b.png", *FAST)[0] == 0
    ours, alone = (read_image(tmp_path / name)[0].astype(int) for name in ("a.png", "b.png"))
    assert np.abs(ours - alone).max() <= (2 if given == CAMERA else 0)
    renderer = l3cli.Renderer(several, backend="reference")
    frame = l3cli.read_raw(warm, renderer.table)
    np.testing.assert_array_equal(renderer.picture(frame, white=given), ours)
    exposed = renderer.picture(frame, white=given, exposure=1.0)
    np.testing.assert_array_equal(renderer.sequence(None, white=given, exposure=1.0)(frame), exposed)


def test_what_is_exported_is_not_balanced_and_mixed(l3: L3, several: Path, tmp_path: Path) -> None:
    code, _, err = l3("export", several, "-o", tmp_path, "--to", "folder", "--white", "3200K")
    assert code == 0
    assert "white 3200K: using the transforms for 81 % A, 19 % D65" in err


def test_a_sequence_is_rendered_by_the_light_of_its_first_frame(
    l3: L3, several: Path, bayer: CameraModel, tmp_path: Path
) -> None:
    """Also one of which each frame comes once."""
    frames = np.stack([mosaic(bayer, light) for light in ("3200K", "D65")])
    np.save(tmp_path / "clip.npy", frames)
    (tmp_path / "clip.bin").write_bytes(frames.astype("<u2").tobytes())
    call = ("--white", "30,40", "--exposure", "1", *FAST, "-o")
    code, _, err = l3("render", several, tmp_path / "clip.npy", *call, tmp_path / "files" / "####.png")
    assert (code, "transforms for A, for all frames" in err) == (0, True)
    with stdin_of(tmp_path / "clip.bin"):
        code, _, err = l3("render", several, "-", "--size", "60x160", *call, tmp_path / "stream" / "####.png")
    assert (code, "transforms for A, for all frames" in err) == (0, True)
    for files in zip(*(sorted((tmp_path / name).glob("[!.]*")) for name in ("files", "stream")), strict=True):
        one, other = (read_image(file)[0] for file in files)
        np.testing.assert_array_equal(one, other)


@contextlib.contextmanager
def stdin_of(path: Path) -> Iterator[None]:
    before = os.dup(0)
    try:
        with path.open("rb") as file:
            os.dup2(file.fileno(), 0)
            yield
    finally:
        os.dup2(before, 0)
        os.close(before)


def test_by_the_table_s_white_all_lights_are_taken_in_common(
    l3: L3, table: Path, several: Path, warm: Path, tmp_path: Path
) -> None:
    code, _, err = l3("render", several, warm, "--white", "table", "-o", tmp_path / "a.png", *FAST)
    assert code == 0
    assert "transforms trained on all illuminants of the table (A, D65); to use the transforms for one" in err
    assert l3("render", table, warm, "--white", "table", "-o", tmp_path / "b.png", *FAST)[0] == 0
    one, other = (read_image(tmp_path / name)[0] for name in ("a.png", "b.png"))
    np.testing.assert_array_equal(one, other)


def chroma(picture: Path) -> np.ndarray:
    """C*ab of the neutral patches, from white to black, of a picture in which the chart lies upright."""
    values = srgb_decoded(read_image(picture)[0] / 65535)
    places = [(FIRST[0] + 3 * PITCH, FIRST[1] + PITCH * each) for each in range(6)]
    means = np.array([values[row + 4 : row + 20, col + 4 : col + 20].mean(axis=(0, 1)) for row, col in places])
    return np.asarray(np.hypot(*lab(displayed_xyz(means), daylight())[:, 1:].T))


def test_its_greys_are_neutral_also_where_the_file_states_another_white(
    l3: L3, table: Path, bayer: CameraModel, tmp_path: Path
) -> None:
    raw, picture = tmp_path / "photo.dng", tmp_path / "a.tif"
    daylight_neutral = bayer.electron_weights @ spectra.illuminant("D55", bayer.wavelength)
    colour = dict.fromkeys(LIGHT_CODES, np.eye(3))
    write_dng(raw, chart_mosaic(bayer, "A"), bayer, colour, daylight_neutral / daylight_neutral.max(), 0.01)
    call = ("render", table, raw, "--bits", 16, "--backend", "reference", "-o", picture, "--force", "--white")
    code, _, err = l3(*call, "chart")
    assert code == 0
    line = next(each for each in err.splitlines() if ": white measured on a ColorChecker: x,y = 0.4" in each)
    assert 2700 < float(line.split(" K,")[0].split()[-1]) < 3000
    rows, cols = ([int(n) for n in each.split()[-1].split("–")] for each in line.split("; rows ")[1].split(", "))
    np.testing.assert_allclose([*rows, *cols], [39, 39 + 4 * PITCH, 31, 31 + 6 * PITCH], atol=6)
    assert "the white balance in the file is 5" in err
    assert chroma(picture).max() < 3
    assert l3(*call, "camera")[0] == 0
    assert chroma(picture).max() > 20


def test_clipped_patches_are_left_out_and_pictures_without_a_chart_are_refused(
    l3: L3, refused: Refused, table: Path, bayer: CameraModel, tmp_path: Path
) -> None:
    values = chart_mosaic(bayer, "A", share=1.3)  # white and the next grey clip
    np.save(tmp_path / "bright.npy", values)
    options = ("--bits", 16, "--backend", "reference", "--exposure", 0.5, "--white", "chart")
    assert l3("render", table, tmp_path / "bright.npy", *options, "-o", tmp_path / "a.tif")[0] == 0
    assert chroma(tmp_path / "a.tif")[2:].max() < 3
    np.save(tmp_path / "none.npy", values[:80, :120])  # six of its patches
    error = refused(3, "render", table, tmp_path / "none.npy", *options, "-o", tmp_path / "b.tif")
    assert "none.npy" in error


def test_a_find_that_is_not_certain_is_none(
    refused: Refused, table: Path, bayer: CameraModel, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    np.save(tmp_path / "chart.npy", chart_mosaic(bayer, "A"))
    found = source.locate

    def doubtful(*of: Any) -> Located:
        located = found(*of)
        assert located is not None
        return dataclasses.replace(located, fit=0.94)

    monkeypatch.setattr(source, "locate", doubtful)
    error = refused(3, "render", table, tmp_path / "chart.npy", "--white", "chart", "-o", tmp_path / "a.png")
    assert "chart.npy" in error
