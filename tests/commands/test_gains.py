"""Frames with different analog gains: sources of the gain, and commands that use the transforms for a gain."""

import dataclasses
import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from l3cli.artifacts.camera import AnalogGains
from l3cli.artifacts.store import load, save
from l3cli.artifacts.table import TransformTable
from l3cli.io.images import read_image
from l3cli.io.pictures.openimageio import write_mosaic
from l3cli.io.raw.files import RawOverrides, frame_of
from tests.helpers.calls import L3, Refused
from tests.helpers.dng_files import SHORT, SRATIONAL, write_dng
from tests.helpers.plain_scenes import SHAPE, cells, taken

REFERENCE = ("--backend", "reference")  # saves the compilation of kernels that no other test uses


@pytest.fixture(scope="module")
def several(gain_tables: Path) -> TransformTable:
    return load(TransformTable, gain_tables / "several.h5")


def test_a_file_tells_its_gain_by_its_iso_speed(several: TransformTable) -> None:
    """If the table's camera has one, and nobody knows better; dark current is amplified, too."""
    values = np.full((8, 8), 300, np.uint16)
    camera = several.camera
    assert camera is not None
    noise = dataclasses.replace(camera.noise, dark_current=100.0)
    known = AnalogGains(np.array([16.0]), np.array([1.0]), 100.0)
    table = dataclasses.replace(several, camera=dataclasses.replace(camera, noise=noise, gains=known))
    content: Any = {"values": values, "shot": {"iso": 1600.0}, "exposure": 0.01, "baseline_exposure": 1.0}  # of pictures
    frames = [
        frame_of("a.dng", content, each, over)
        for each, over in ((table, RawOverrides()), (table, RawOverrides(gain=4.0)), (several, RawOverrides()))
    ]
    assert [frame.gain for frame in frames] == [16, 4, 1]
    assert frames[0].dark == pytest.approx(4 * frames[1].dark)
    assert frames[1].dark > 0
    unknown = [frame_of("a.dng", content | {"exposure": None}, table, RawOverrides(gain=gain)).dark for gain in (1.0, 4.0)]
    assert unknown[0] == unknown[1] > 0  # that of training, whose frames at a higher gain are exposed as much shorter


def test_the_gain_of_frames_without_iso_speed_is_estimated(
    gain_tables: Path, several: TransformTable, l3: L3, tmp_path: Path
) -> None:
    """Once a run, of the first frame, and said; of one without plain areas nothing is known."""
    assert several.camera is not None
    camera, rng = dataclasses.replace(several.camera, rows=SHAPE[0], cols=SHAPE[1]), np.random.default_rng(1)
    plain, textured = cells(camera, rng, 0.0), cells(camera, rng, 1.0)
    for name, share in (("in_0", plain), ("in_1", plain), ("textured", textured)):
        write_mosaic(tmp_path / f"{name}.tif", taken(camera, share, 8.0))
    call = ("render", gain_tables / "several.h5", tmp_path / "in_%d.tif", "-o")
    code, _, words = l3(*call, tmp_path / "out")
    assert code == 0
    found = re.search(r"in_0.tif: the gain is estimated from the noise as ([\d.]+) \(([\d.]+) to ([\d.]+)\) and", words)
    assert found, words
    gain, low, high = map(float, found.groups())
    assert low < 8 < high
    assert gain == pytest.approx(8, rel=0.1)
    assert "estimated" not in l3(*call, tmp_path / "given", "--gain", gain)[2]
    for picture in ("in_0.png", "in_1.png"):
        assert (tmp_path / "out" / picture).read_bytes() == (tmp_path / "given" / picture).read_bytes()

    one = ("render", gain_tables / "several.h5", tmp_path / "textured.tif", "-o", tmp_path / "x.png")
    warning = "textured.tif: the gain is unknown (no uniform area was found), so l3 assumes a gain of 1; set --gain"
    assert warning in l3(*one)[2]


def test_transforms_for_a_gain_are_exported(gain_tables: Path, several: TransformTable, l3: L3, tmp_path: Path) -> None:
    code, _, words = l3("export", gain_tables / "several.h5", "-o", tmp_path / "usual")
    assert (code, "to export the transforms for a different gain, set --gain" in words) == (0, True)
    assert l3("export", gain_tables / "several.h5", "-o", tmp_path / "high", "--gain", "16", "--quiet")[0] == 0
    assert l3("export", gain_tables / "one.h5", "-o", tmp_path / "one", "--quiet")[0] == 0
    source = {name: (tmp_path / name / "l3_table.c") for name in ("usual", "high", "one")}
    found = {name: path.read_bytes() for name, path in source.items()}
    assert found["usual"] == found["one"] != found["high"]
    assert "transforms for other noise: 0.1 of the temporal noise" in l3("info", gain_tables / "several.h5")[1]


def test_frames_of_another_gain_are_judged_by_its_transforms(gain_tables: Path, l3: L3, tmp_path: Path) -> None:
    """No word of another camera: its noise at that gain is known. Two of four frames are exposed again at other gains; near
    their own they are nearly what they were."""
    code, out, words = l3("evaluate", gain_tables / "several.h5", gain_tables / "set16.h5", "--json", *REFERENCE)
    assert (code, "was trained for camera" in words) == (0, False)
    document = json.loads(out)
    groups = document["by_gain"]
    assert [(each["gain"], each["illuminant"], each["frames"]) for each in groups] == [(g, "D65", 2) for g in (1, 4, 16)]
    error = [each["ours"]["mean_delta_e"] for each in groups]
    own = np.mean([document["frames"][index]["ours"]["mean_delta_e"] for index in (0, 2)])
    assert error[2] == pytest.approx(own, rel=0.03)
    assert error[0] < error[1] < error[2] < 0.9 * groups[2]["basic"]["mean_delta_e"]
    assert (
        l3("report", gain_tables / "several.h5", gain_tables / "set16.h5", "-o", tmp_path / "page.html", *REFERENCE)[0] == 0
    )
    page = (tmp_path / "page.html").read_text()
    assert f"mean ΔE00: ours {error[0]:.2f} at gain 1, {error[2]:.2f} at 16; basic " in page
    assert f"mean ΔE00 over 4 frames: ours {document['mean']['ours']['mean_delta_e']:.2f} (" in page.replace("Mean", "mean")
    several = load(TransformTable, gain_tables / "several.h5")
    assert several.camera is not None
    save(dataclasses.replace(several, camera=dataclasses.replace(several.camera, gains=None)), tmp_path / "one.h5")
    call = ("evaluate", tmp_path / "one.h5", gain_tables / "set8.h5", "--backend", "reference")
    assert "was trained for camera" not in l3(*call)[2]


def test_render_takes_the_gain_that_is_given(
    gain_tables: Path, several: TransformTable, l3: L3, refused: Refused, tmp_path: Path
) -> None:
    raw = tmp_path / "frame.raw"
    raw.write_bytes(np.random.default_rng(1).integers(300, 3000, (96, 96)).astype("<u2").tobytes())
    how = ("--size", "96x96", "--backend", "reference")
    for name, gain in (("a.exr", ()), ("b.exr", ("--gain", "16")), ("c.exr", ("--gain", "64"))):
        code, _, words = l3("render", gain_tables / "several.h5", raw, "-o", tmp_path / name, *how, *gain)
        assert (code, "the read noise only for 1 to 16 times" in words) == (0, name == "c.exr")
    assert (tmp_path / "a.exr").read_bytes() != (tmp_path / "b.exr").read_bytes()
    assert "--gain" in refused(2, "render", gain_tables / "several.h5", raw, "-o", tmp_path / "d.exr", "--gain", "0")


def test_each_frame_of_a_sequence_has_its_gain(gain_tables: Path, l3: L3, refused: Refused, tmp_path: Path) -> None:
    """Whatever holds the frames, and whichever of them are rendered."""
    frames, folder = np.random.default_rng(1).integers(300, 3000, (4, 32, 40)).astype("<u2"), tmp_path / "frames"
    (tmp_path / "clip.raw").write_bytes(frames.tobytes())
    folder.mkdir()
    for number, values in enumerate(frames):
        np.save(folder / f"frame_{number + 7}.npy", values)
    listed, how = tmp_path / "gains.txt", ("--size", "32x40", "--backend", "reference", "--quiet")
    listed.write_text("1\n4.0\n16\n2\n")
    for number, gain in enumerate((1, 4, 16, 2)):
        one = (folder / f"frame_{number + 7}.npy", "-o", tmp_path / f"one{number}.exr", *how, "--gain", str(gain))
        assert l3("render", gain_tables / "several.h5", *one)[0] == 0
    wanted = [read_image(tmp_path / f"one{number}.exr")[0] for number in range(4)]
    assert not np.array_equal(wanted[0], wanted[1])

    def check(out: str, source: Path, first: int, count: int, *more: str) -> None:
        call = ("render", gain_tables / "several.h5", source, "-o", tmp_path / out, *how, "--gains", listed, *more)
        assert l3(*call)[0] == 0
        made = sorted(tmp_path.glob(out.replace("%d", "*")))
        assert len(made) == count
        for path in made:
            np.testing.assert_array_equal(read_image(path)[0], wanted[int(re.findall(r"\d+", path.name)[-1]) - first])

    check("clip-%d.exr", tmp_path / "clip.raw", 0, 4)
    check("shard-%d.exr", tmp_path / "clip.raw", 0, 2, "--shard", "2/2")
    check("folder-%d.exr", folder, 7, 4)
    check("pattern-%d.exr", folder / "frame_%d.npy", 7, 2, "--frames", "8-9")
    call = ("render", gain_tables / "several.h5", folder, "-o", tmp_path / "no-%d.exr", *how, "--gains", listed)
    assert "--gain" in refused(2, *call, "--gain", "2")
    for text, culprit in (("1\n4\n", "--gains"), ("1\nx\n2\n2\n", "gains.txt"), ("", "gains.txt")):
        listed.write_text(text)
        assert culprit in refused(3, *call)


def test_a_baseline_exposure_brightens_pictures_and_is_no_gain(gain_tables: Path, l3: L3, tmp_path: Path) -> None:
    """As the file states it where that is asked for; automatic exposure measures instead. Noise goes by the ISO speed."""
    values = np.random.default_rng(1).integers(300, 900, (32, 40)).astype(np.uint16)
    for name, stops in (("plain", 0), ("bright", 1), ("broken", 1000)):
        tags = {50730: (SRATIONAL, [stops, 1]), 50714: (SHORT, [240]), 34855: (SHORT, [400])}
        write_dng(tmp_path / f"{name}.dng", values, np.array([[0, 1], [1, 2]]), tags=tags)

    how = ("--bits", "32", "--space", "srgb", "--white", "table", "--backend", "reference", "--quiet")

    def shown(name: str, exposure: str) -> np.ndarray:
        picture = tmp_path / f"{name}{exposure}.tif"
        call = ("render", gain_tables / "several.h5", tmp_path / f"{name}.dng", "-o", picture, "--exposure", exposure)
        code, _, words = l3(*call, *how)
        assert code == 0, words
        return read_image(picture)[0]

    factor = shown("plain", "1")
    for name, exposure, times in (
        ("plain", "camera", 1), ("bright", "camera", 2), ("bright", "1", 1), ("broken", "camera", 1)
    ):  # fmt: skip
        np.testing.assert_allclose(shown(name, exposure), times * factor, rtol=1e-5, atol=1e-6)
    np.testing.assert_array_equal(shown("bright", "auto"), shown("plain", "auto"))
