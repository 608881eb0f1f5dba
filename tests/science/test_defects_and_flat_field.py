"""Defects and flat field of a camera are what its darks and whites show, by the whole calibration or by those alone."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from l3cli.artifacts.camera import CameraModel, DefectMap, FlatField
from l3cli.artifacts.schema import equal
from l3cli.artifacts.store import load, save
from l3cli.calibration.corrections import corner_falloff, flat_field
from l3cli.calibration.defects import as_map, counts, join, outliers
from l3cli.errors import InputFileError
from l3cli.frames.measurement import Body
from tests.helpers.calls import L3, Refused
from tests.helpers.flaws import Flaws, flaws, seen, shading

CORNERS = (0.45, 0.5, 0.6)
CAPTURES = """
base = "{}"
[[dark]]
frames = [{}]
exposure_s = 0.01
[[white]]
frames = [{}]
exposure_ms = 10
"""


def body_of(camera: CameraModel) -> Body:
    return Body(
        camera.name, camera.rows, camera.cols, camera.pixel_pitch, camera.bits, camera.channels, camera.cfa, camera.optics
    )


@pytest.fixture(scope="module")
def wrong(bayer: CameraModel) -> Flaws:
    return flaws(bayer, CORNERS)


@pytest.fixture(scope="module")
def captures(bayer: CameraModel, wrong: Flaws, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Four darks and eight whites as .npy, the camera's model, and the measurement file."""
    folder, rng = tmp_path_factory.mktemp("captures"), np.random.default_rng(5)
    names: dict[str, list[str]] = {"dark": [], "white": []}
    for kind, count, share in (("dark", 4, 0.0), ("white", 8, 0.8)):
        for number in range(count):
            electrons = np.full((bayer.rows, bayer.cols), share * bayer.full_scale)
            np.save(folder / f"{kind}{number}.npy", seen(bayer, wrong, electrons, rng))
            names[kind].append(f'"{kind}{number}.npy"')
    save(bayer, folder / "camera.h5")
    (folder / "M.toml").write_text(CAPTURES.format("camera.h5", *(", ".join(each) for each in names.values())))
    return folder


def test_darks_and_whites_alone_give_defects_and_flat_field(
    captures: Path, bayer: CameraModel, wrong: Flaws, tmp_path: Path, l3: L3
) -> None:
    code, out, err = l3("calibrate", captures / "M.toml", "-o", tmp_path / "camera.h5", "--json")
    assert code == 0, err
    camera, result = load(CameraModel, tmp_path / "camera.h5"), json.loads(out)
    assert camera.defects
    assert camera.flat_field
    bad = np.zeros(wrong.kind.shape, bool)
    bad[tuple(camera.defects.position.T)] = True
    missed = (wrong.kind > 0) & ~bad
    assert not missed.any()
    assert (bad & (wrong.kind == 0)).sum() <= 2
    assert (result["defect map"]["rows"], result["defect map"]["columns"]) == (1, 1)
    assert result["defect map"]["clusters"] >= 3
    assert set(camera.defects.pixel_kind) == {"hot", "dead", "row", "column"}
    assert list(result["corner fall-off %"].values()) == pytest.approx([100 * (1 - each) for each in CORNERS], abs=1.0)
    assert equal(replace(camera, defects=None, flat_field=None, fit=None), bayer)
    assert [stage.command for stage in camera.history] == ["calibrate"]
    assert set(camera.history[0].inputs) == {"measurements", "frames", "camera"}
    code, out, _ = l3("calibrate", captures / "M.toml", "-o", tmp_path / "again.h5")
    assert "rows 1, columns 1, clusters" in out
    assert "light lost in the darkest corner: r 5" in out
    assert (tmp_path / "camera.h5").read_bytes() == (tmp_path / "again.h5").read_bytes()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ('[[white]]\nframes = ["white0.npy"]\nexposure_ms = 0', "above 0"),
        ('[[white]]\nframes = ["dark1.npy"]\nexposure_ms = 10', "dark1.npy: channel r is dark; expose"),
        ('[[white]]\nframes = ["clipped.npy"]\nexposure_ms = 10', "clipped.npy: channel r is clipped; expose"),
        ('[[white]]\nframes = ["scene.npy"]\nexposure_ms = 10', "give an even white"),
        ('[[white]]\nframes = ["deep.npy"]\nexposure_ms = 10', "deep.npy holds 4096 DN, more than 12 bits"),
        ('[[white]]\nframes = ["small.npy"]\nexposure_ms = 10', "whole raw frames"),
        ('[[white]]\nframes = ["nowhere.npy"]\nexposure_ms = 10', "nowhere.npy"),
        ('[[grey]]\nframes = ["white0.npy"]\nexposure_ms = 10', "`grey`"),
    ],
)
def test_captures_that_cannot_serve_are_refused(
    captures: Path, bayer: CameraModel, change: str, message: str, tmp_path: Path, refused: Refused
) -> None:
    rng, shape = np.random.default_rng(3), (bayer.rows, bayer.cols)
    np.save(captures / "clipped.npy", np.full(shape, 4095, np.uint16))
    np.save(captures / "deep.npy", np.full(shape, 4096, np.uint16))
    np.save(captures / "scene.npy", rng.integers(500, 2000, (24, 32)).repeat(8, 0).repeat(8, 1).astype(np.uint16))
    np.save(captures / "small.npy", np.full((96, 128), 2000, np.uint16))
    text = (captures / "M.toml").read_text().partition("[[white]]")[0] + change
    (captures / "BAD.toml").write_text(text)
    assert message in refused(3 if "`" not in message and "above" not in message else 2, "calibrate", captures / "BAD.toml",
                              "-o", tmp_path / "c.h5")  # fmt: skip


def test_lines_that_are_off_by_less_than_a_pixel_may_be(bayer: CameraModel) -> None:
    """Twice what pixels differ by: one alone is no defect, a whole row is. Column noise is none either."""
    rng, shape = np.random.default_rng(4), (96, 128)
    dark = 64 + rng.normal(size=shape) + rng.normal(size=shape[1])
    assert not len(outliers(dark, bayer.cfa))
    dark[30] += 4
    found = outliers(dark, bayer.cfa)
    assert len(found) == 128
    assert set(found[:, 0]) == {30}


def test_lines_clusters_and_kinds() -> None:
    shape = (20, 30)
    column = np.array([(row, 7) for row in range(20) if row != 3])
    single, cluster = np.array([(5, 20)]), np.array([(10, 10), (11, 11), (12, 10)])
    found = as_map(join(column, single, cluster), single, shape)
    assert counts(found, shape) == {"hot": 1, "dead": 3, "rows": 0, "columns": 1, "clusters": 1}
    assert found.pixel_kind.count("column") == 20  # the one that had seemed sound, too


def test_the_surface_is_that_of_cos4_whatever_its_width(bayer: CameraModel) -> None:
    for share in (0.9, 0.3):
        field = flat_field(1000 * shading(bayer, (share,) * 3), body_of(bayer))
        np.testing.assert_allclose(corner_falloff(field), 1 - share, rtol=1e-3)
        assert field.shading_gain[:, 16, 24] == pytest.approx(1.0, abs=1e-6)


def test_a_map_beyond_the_sensor_or_a_field_of_nonsense_is_refused(bayer: CameraModel) -> None:
    with pytest.raises(ValueError, match="beyond the 192×256"):
        replace(bayer, defects=DefectMap(np.array([[192, 0]]), ("hot",)))
    with pytest.raises(ValueError, match="grid of the flat field"):
        replace(bayer, flat_field=FlatField(np.array([0.0, 95.0]), np.array([0.0, 255.0]), np.ones((3, 2, 2))))
    with pytest.raises(ValueError, match="twice"):
        DefectMap(np.array([[1, 0], [1, 0]]), ("hot", "hot"))
    with pytest.raises(ValueError, match="no kind"):
        DefectMap(np.array([[1, 0]]), ("warm",))
    lines = np.array([0.0, 100.0])
    for gain in (0.0, 20.0, np.array([1.0, 1.0, 4.0])[:, None, None]):
        with pytest.raises(ValueError, match="flat field"):
            FlatField(lines, lines, np.ones((3, 2, 2)) * gain)
    with pytest.raises(InputFileError, match="dark"):
        flat_field(np.zeros((bayer.rows, bayer.cols)), body_of(bayer))


def test_old_cameras_have_neither(bayer: CameraModel, tmp_path: Path) -> None:
    save(bayer, tmp_path / "camera.h5")
    again = load(CameraModel, tmp_path / "camera.h5")
    assert again.defects is None
    assert again.flat_field is None
