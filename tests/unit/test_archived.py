"""Artifacts of older format versions, made by the code of their time (tests/data/README.md), open and render as they did."""

import hashlib
import json
import zipfile
from dataclasses import dataclass, replace
from pathlib import Path

import h5py
import numpy as np
import pytest

from l3cli.artifacts.camera import CameraModel, NoiseScale
from l3cli.artifacts.partial_sums import open_partial_sums
from l3cli.artifacts.schema import equal
from l3cli.artifacts.store import load, save
from l3cli.artifacts.table import TransformTable
from l3cli.artifacts.training_set import TrainingFrame, open_training_set
from l3cli.frames.frame import NoiseLeft
from l3cli.io.images import read_image
from l3cli.io.raw.files import read_raw
from l3cli.physics import spectra
from l3cli.rendering.conditions import mixed, nearest_for
from l3cli.rendering.reference import ReferenceRenderer
from l3cli.rendering.white.source import given_white
from tests.helpers.calls import L3
from tests.helpers.paths import ROOT


@dataclass(frozen=True)
class Archived:
    """What was in the files of a version when they were made."""

    version: int
    weights: str  # SHA-256
    output_unit: float
    exposure: float  # s, of the table; 0: of before it was stored
    electrons: float  # mean of the frame
    raw: int  # sum of the frame
    moments: float  # sum of those of the first site
    has_camera: bool


ARCHIVED = (
    Archived(
        version=1,
        weights="ee35f7dcfe46d23f888cfe9e3933aea08cb35a60e4ead81b6fe5022300c3d7f1",
        output_unit=6.213207085311467,
        exposure=0.0,
        electrons=2496.4055,
        raw=290406,
        moments=20098997.809020996,
        has_camera=False,
    ),
    Archived(
        version=2,
        weights="77d46a6bc4b0a50cec0280d898b569266b5259bb4a9bead5bcaf647e1a09a88b",
        output_unit=6.213834788714508,
        exposure=0.055948414359684034,
        electrons=2496.0332,
        raw=290342,
        moments=20098961.427612305,
        has_camera=True,
    ),
)


@pytest.fixture(params=ARCHIVED, ids=lambda archived: f"version {archived.version}")
def archived(request: pytest.FixtureRequest) -> Archived:
    value: Archived = request.param
    return value


@pytest.fixture
def folder(archived: Archived, tmp_path: Path) -> Path:
    """The files of a version."""
    with zipfile.ZipFile(ROOT / f"tests/data/version{archived.version}.zip") as packed:
        packed.extractall(tmp_path)
    return tmp_path


def test_every_file_is_of_its_version_and_intact(l3: L3, archived: Archived, folder: Path) -> None:
    for name in ("camera.h5", "training.h5", "sums.h5", "table.h5"):
        code, out, _ = l3("info", folder / name, "--json")
        assert (code, json.loads(out)["version"]) == (0, archived.version)
        assert l3("info", "--verify", folder / name)[0] == 0


def test_cameras_and_frames_hold_what_they_held(archived: Archived, folder: Path) -> None:
    camera = load(CameraModel, folder / "camera.h5")
    assert camera.responsivity.sum() == pytest.approx(9.555008661696863, rel=1e-12)
    assert (camera.name, camera.noise.well_capacity, camera.black_level, camera.fit) == ("archived", 15000.0, 64.0, None)
    with open_training_set(folder / "training.h5") as training:
        frame = training.frame(0)
        assert (len(training), training.head.outputs, training.head.camera.name) == (1, ("X", "Y", "Z"), "archived")
        assert isinstance(frame, TrainingFrame)
        assert frame.electrons.mean(dtype=np.float64) == pytest.approx(archived.electrons, rel=1e-6)
        assert int(frame.raw.sum()) == archived.raw
    with open_partial_sums(folder / "sums.h5") as sums:
        assert (sums.head.shard, sums.head.shards, sums.head.sites.tolist()) == (1, 2, [0, 1, 3])
        assert sums.site(0).count.tolist() == [0, 0, 2794, 1206]
        assert sums.site(0).moments.sum() == pytest.approx(archived.moments, rel=1e-12)
        assert sums.head.exposure == archived.exposure


def test_a_table_without_layers_opens_as_one_of_one_layer(archived: Archived, folder: Path) -> None:
    table = load(TransformTable, folder / "table.h5")
    assert hashlib.sha256(table.first.weights.tobytes()).hexdigest() == archived.weights
    assert (table.first.rule.patch, table.first.rule.shape, table.first.samples.sum()) == (3, (2, 1, 1, 2), 16000)
    assert (table.output_unit, table.exposure, table.camera is not None) == (
        archived.output_unit, archived.exposure, archived.has_camera
    )  # fmt: skip
    assert table.later == ()
    with h5py.File(folder / "table.h5") as root:
        assert "first" not in root
    save(table, folder / "again.h5")
    with h5py.File(folder / "again.h5") as root:
        assert (int(root.attrs["version"]), "weights" in root, "first/weights" in root) == (5, False, True)
        assert (root["black_level"][()], root["white_level"][()]) == (64.0, 3814.0)
        assert not {"black", "white"} & set(root)
    assert equal(load(TransformTable, folder / "again.h5"), table)


def test_a_table_renders_what_it_rendered(l3: L3, folder: Path) -> None:
    table = load(TransformTable, folder / "table.h5")
    outputs = ReferenceRenderer(table).outputs(read_raw(folder / "raw.tif", table))
    np.testing.assert_allclose(outputs, np.load(folder / "outputs.npy"), rtol=1e-6, atol=1e-9)  # float32
    # D65 by its chromaticity: by its name, channels are balanced before the table now.
    shown = ("--backend", "reference", "--exposure", "1", "--white", "0.31272050,0.32903063", "--quiet")
    assert l3("render", folder / "table.h5", folder / "raw.tif", "-o", folder / "again.png", *shown)[0] == 0
    np.testing.assert_array_equal(read_image(folder / "again.png")[0], read_image(folder / "picture.png")[0])


def test_evaluations_and_training_take_old_files(l3: L3, folder: Path) -> None:
    call = ("evaluate", folder / "table.h5", folder / "training.h5", "--backend", "reference", "--json", "--quiet")
    code, out, _ = l3(*call)
    assert code == 0
    assert 0 < json.loads(out)["mean"]["ours"]["mean_delta_e"] < 20
    again = ("train", folder / "training.h5", "--classes", folder / "classes.toml", "-o", folder / "new.h5", "--quiet")
    assert l3(*again)[0] == 0
    assert load(TransformTable, folder / "new.h5").first.weights.shape == (16, 3, 9)


def test_tables_of_version_4_open_with_their_conditions(l3: L3, tmp_path: Path) -> None:
    """Low-noise transforms, those of lights, and sums for both noises, as they were learned and rendered."""
    with zipfile.ZipFile(ROOT / "tests/data/version4.zip") as packed:
        packed.extractall(tmp_path)
    low, lights = (load(TransformTable, tmp_path / f"{name}.h5") for name in ("low_noise", "lights"))
    assert [(each.light, each.noise) for each in low.conditions] == [(None, NoiseScale(noise_left=0.25))]
    assert [(each.name, each.spectrum is not None) for each in lights.lights] == [("A", True), ("D65", True)]
    assert [each.noise for each in lights.conditions] == [None, None]
    shares = np.where(np.arange(8 * 10).reshape(8, 10) % 2, 256, 1024).astype(np.uint16)
    frame = replace(read_raw(tmp_path / "raw.tif", low), noise_left=NoiseLeft(shares, 1024, (4, 4)))
    outputs = ReferenceRenderer(low, by_noise=True).outputs(frame)
    np.testing.assert_array_equal(outputs, np.load(tmp_path / "low_noise.npy"))
    under_a = mixed(lights, nearest_for(lights, spectra.white_point("A")))
    outputs = ReferenceRenderer(under_a).outputs(read_raw(tmp_path / "raw.tif", lights))
    np.testing.assert_array_equal(outputs, np.load(tmp_path / "lights.npy"))
    # It shows surfaces in hardly more than greys: a correction of their colours would be of what processors round.
    white = given_white("A", under_a)
    assert white is not None
    assert np.abs(white.balance.adaptation).max() < 50
    assert l3("train", "--merge", tmp_path / "layer_sums.h5", "-o", tmp_path / "merged.h5", "--quiet")[0] == 0
    assert equal(load(TransformTable, tmp_path / "merged.h5"), low)
    for table in (low, lights):
        save(table, tmp_path / "again.h5")
        assert equal(load(TransformTable, tmp_path / "again.h5"), table)
