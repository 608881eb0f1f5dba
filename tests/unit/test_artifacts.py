"""Artifacts: written values are read back, and broken files are rejected in one line with the culprit and the fix."""

import dataclasses
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from l3cli.artifacts.camera import CameraModel
from l3cli.artifacts.container import seal
from l3cli.artifacts.partial_sums import PartialSums
from l3cli.artifacts.schema import equal
from l3cli.artifacts.store import load, save
from l3cli.artifacts.training_set import TrainingSet, open_training_set, write_training_set
from l3cli.errors import InputFileError
from tests.helpers.artifacts import a_camera, a_frame, a_table
from tests.helpers.calls import L3, Refused


def test_camera_and_table_come_back_as_they_went(fiveband: CameraModel, bayer: CameraModel, tmp_path: Path) -> None:
    for artifact in (fiveband, a_camera(fiveband), a_table(bayer)):
        path = tmp_path / "sub" / "artifact.h5"
        save(artifact, path)
        again = load(type(artifact), path)
        assert equal(artifact, again)
        assert again.history == artifact.history


def test_partial_sums_take_a_calibrated_camera_next_to_any_class_rule(bayer: CameraModel) -> None:
    training = TrainingSet(camera=a_camera(bayer), outputs=("X", "Y", "Z"), target_description="XYZ")
    rule = a_table(bayer).first.rule
    fit = training.camera.fit
    assert fit is not None
    assert fit.noise is not None
    assert rule.contrast_edges.shape[1] != len(fit.noise.exposure)
    sums = PartialSums(
        shard=1, shards=2, pass_number=2, patches=np.array([9]), training=training, rule=rule,
        white_point=np.array([0.95, 1.0, 1.09]), sites=np.array([0]),
    )  # fmt: skip
    assert sums.rule is rule


def test_training_set_comes_back_frame_by_frame(fiveband: CameraModel, tmp_path: Path) -> None:
    head = TrainingSet(camera=fiveband, outputs=("X", "Y", "Z"), target_description="XYZ")
    path = tmp_path / "training.h5"
    with write_training_set(path, head) as writer:
        for seed in range(3):
            writer.append(a_frame(seed))
    with open_training_set(path) as reader:
        assert len(reader) == 3
        assert equal(reader.head, head)
        for seed, frame in enumerate(reader):
            assert equal(frame, a_frame(seed))


def test_same_content_same_bytes(fiveband: CameraModel, tmp_path: Path) -> None:
    save(a_camera(fiveband), tmp_path / "one.h5")
    save(a_camera(fiveband), tmp_path / "two.h5")
    assert (tmp_path / "one.h5").read_bytes() == (tmp_path / "two.h5").read_bytes()


def test_a_failed_writer_leaves_nothing(fiveband: CameraModel, tmp_path: Path) -> None:
    head = TrainingSet(camera=fiveband, outputs=("X", "Y", "Z"), target_description="XYZ")

    def write_and_fail() -> None:
        with write_training_set(tmp_path / "training.h5", head) as writer:
            writer.append(a_frame())
            raise RuntimeError

    with pytest.raises(RuntimeError):
        write_and_fail()
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"responsivity": np.zeros((5, 3))}, "responsivity"),
        ({"responsivity": np.full((5, 65), np.nan)}, "not finite"),
        ({"channels": ("r", "g")}, "channel"),
        ({"cfa": np.array([[9]], np.uint8)}, "cfa contains the channel index 9"),
        ({"gain": "high"}, "gain"),
        ({"black_level": 5000.0}, "black level is 5000"),
    ],
)
def test_a_constructor_refuses_what_cannot_be(fiveband: CameraModel, changes: dict, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        dataclasses.replace(fiveband, **changes)


def with_gain(value: Any) -> Callable[[h5py.File], None]:
    def change(root: h5py.File) -> None:
        del root["gain"]
        root["gain"] = value

    return change


def of_size(root: h5py.File) -> None:
    del root["responsivity"]
    root.create_dataset("responsivity", (100_000, 100_000), "f8", chunks=(100, 100), compression="gzip")


def of_shape(root: h5py.File) -> None:
    del root["wavelength"]
    root["wavelength"] = np.arange(3.0)


def of_history(root: h5py.File) -> None:
    del root["history"]
    root.create_dataset("history", data=np.bytes_(b"{"))


def truncate(path: Path) -> None:
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])


def garbage(path: Path) -> None:
    path.write_text("not an artifact")


def plain_hdf5(path: Path) -> None:
    path.unlink()
    with h5py.File(path, "w") as root:
        root["gain"] = 1.0


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda root: root.attrs.modify("kind", "transform table"), "contains a transform table; use a file written by"),
        (
            lambda root: root.attrs.modify("version", 5),
            "has format version 5, but this version of l3 reads only version 1; create the file again with",
        ),
        (lambda root: root.pop("gain"), "the dataset gain is missing"),
        (lambda root: root.pop("noise"), "the group noise is missing"),
        (with_gain("much"), "dataset gain has the type"),
        (with_gain(h5py.ExternalLink("/etc/passwd", "/")), "the dataset gain is a link"),
        (of_size, "declares more values than the file contains"),
        (of_shape, "responsivity"),
        (of_history, "history"),
    ],
)
def test_a_member_that_is_wrong_is_one_line(
    fiveband: CameraModel, tmp_path: Path, change: Callable[[h5py.File], None], message: str
) -> None:
    path = tmp_path / "camera.h5"
    save(fiveband, path)
    with h5py.File(path, "r+") as root:
        change(root)
    require_refused(path, "damaged")
    seal(path)  # as who makes such a file on purpose
    require_refused(path, message)


def require_refused(path: Path, message: str) -> None:
    with pytest.raises(InputFileError) as caught:
        load(CameraModel, path)
    assert message in str(caught.value)
    assert str(path) in str(caught.value)


@pytest.mark.parametrize(
    ("damage", "message"),
    [(truncate, "truncated or damaged"), (garbage, "is not an HDF5 file"), (plain_hdf5, "not an l3 artifact")],
)
def test_a_broken_artifact_is_one_line(
    fiveband: CameraModel, tmp_path: Path, damage: Callable[[Path], None], message: str
) -> None:
    path = tmp_path / "camera.h5"
    save(fiveband, path)
    damage(path)
    require_refused(path, message)


def test_info_lists_every_dataset_with_unit(fiveband: CameraModel, tmp_path: Path, l3: L3, refused: Refused) -> None:
    path = tmp_path / "camera.h5"
    save(a_camera(fiveband), path)
    code, out, err = l3("info", path)
    assert (code, err) == (0, "")
    assert "camera model, format version 1" in out
    for word in ("responsivity (channel, wavelength) 5×65 float64 e-/photon", "gain", "DN/e-", "made by l3 calibrate"):
        assert word in out
    shutil.copy(path, tmp_path / "cut.h5")
    truncate(tmp_path / "cut.h5")
    assert "truncated" in refused(3, "info", tmp_path / "cut.h5")
    assert "does not exist" in refused(3, "info", tmp_path / "nothing.h5")
    assert "is a folder" in refused(3, "info", tmp_path)
