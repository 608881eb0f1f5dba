"""Every changed byte of an artifact is detected, and the history of an artifact is compared with its inputs."""

import dataclasses
import json
import random
import shutil
from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from l3cli.artifacts import container
from l3cli.artifacts.camera import CameraModel
from l3cli.artifacts.partial_sums import write_partial_sums
from l3cli.artifacts.store import save
from l3cli.artifacts.training_set import TrainingSet, write_training_set
from l3cli.cli import run
from tests.helpers.artifacts import a_camera, a_frame, a_table, some_layer_sums, some_sums
from tests.helpers.calls import L3, Refused
from tests.helpers.paths import CONFIGS

SCENES = 'exposure_share = [0.9]\n[[scene]]\nsource = "dead leaves"\nsize = [32, 32]\n'
# A command that reads each kind of artifact, as first, second, … of its files.
READERS = {
    "camera": ("simulate", CONFIGS / "scenes/small.toml", "--camera", "FILE", "-o", "OUT.h5"),
    "training": ("train", "FILE", "-o", "OUT.h5"),
    "table": ("render", "FILE", "frame.tif", "-o", "OUT.png"),
    "sums": ("train", "--merge", "FILE", "-o", "OUT.h5"),
    "layer_sums": ("train", "--merge", "FILE", "-o", "OUT.h5"),
}


@pytest.fixture(scope="module")
def artifacts(bayer: CameraModel, fiveband: CameraModel, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """One small artifact of each kind."""
    folder = tmp_path_factory.mktemp("artifacts")
    paths = {kind: folder / f"{kind}.h5" for kind in READERS}
    save(a_camera(bayer), paths["camera"])
    save(a_table(bayer), paths["table"])
    with write_training_set(
        paths["training"], TrainingSet(camera=fiveband, outputs=("X",), target_description="")
    ) as writer:
        writer.append(dataclasses.replace(a_frame(), target=a_frame().target[:1], white=np.ones(1)))
    head, sums = some_sums(bayer)
    write_partial_sums(paths["sums"], head, iter([sums]))
    layer_head, layer_sums = some_layer_sums(bayer)
    write_partial_sums(paths["layer_sums"], layer_head, [layer_sums])
    return paths


@settings(max_examples=100, deadline=None)
@given(data=st.data(), kind=st.sampled_from(list(READERS)), bit=st.integers(0, 7), how=st.sampled_from(["--verify", "read"]))
def test_a_flipped_bit_anywhere_is_detected(
    data: st.DataObject, kind: str, bit: int, how: str, artifacts: dict[str, Path], tmp_path_factory: pytest.TempPathFactory
) -> None:
    content = bytearray(artifacts[kind].read_bytes())
    content[data.draw(st.integers(0, len(content) - 1))] ^= 1 << bit
    path = tmp_path_factory.getbasetemp() / "flipped.h5"
    path.write_bytes(content)
    command = ("info", "--verify", path) if how == "--verify" else READERS[kind]
    named = {"FILE": path, "OUT.h5": path.with_name("out.h5"), "OUT.png": path.with_name("out.png")}
    assert run([str(named.get(str(each), each)) for each in command]) == 3


@pytest.mark.parametrize("kind", list(READERS))
def test_every_command_reports_a_changed_byte_in_one_line(
    kind: str, artifacts: dict[str, Path], refused: Refused, tmp_path: Path
) -> None:
    content = bytearray(artifacts[kind].read_bytes())
    content[random.Random(kind).randrange(600, len(content))] ^= 16
    path = tmp_path / "changed.h5"
    path.write_bytes(content)
    named = {"FILE": path, "OUT.h5": tmp_path / "out.h5", "OUT.png": tmp_path / "out.png"}
    for command in (READERS[kind], ("info", path), ("info", "--verify", path), ("report", path, "-o", tmp_path / "r.html")):
        assert "changed.h5" in refused(3, *(named.get(str(each), each) for each in command))


def test_whole_artifacts_are_right_and_read_by_any_hdf5(artifacts: dict[str, Path], l3: L3) -> None:
    for path in artifacts.values():
        code, out, err = l3("info", "--verify", path)
        assert (code, err) == (0, "")
        assert "the contents match the digest" in out
        with h5py.File(path) as root:
            assert root.userblock_size == container.BLOCK
            names: list[str] = []
            root.visit(names.append)
            count = sum("axes" in root[name].attrs for name in names)  # without scales
        assert json.loads(l3("info", "--verify", path, "--json")[1])["datasets"] == count
        assert path.read_bytes().startswith(container.TITLE)


def test_a_changed_value_that_is_sealed_again_fails_its_checksum(
    artifacts: dict[str, Path], tmp_path: Path, refused: Refused
) -> None:
    path = tmp_path / "table.h5"
    content = bytearray(artifacts["table"].read_bytes())
    with h5py.File(artifacts["table"]) as root:
        content[container.BLOCK + root["first/weights"].id.get_chunk_info(0).byte_offset + 9] ^= 1
    path.write_bytes(content)
    container.seal(path)
    assert "first/weights" in refused(3, "info", "--verify", path)


LARGE = {  # a dataset of floating point that each kind cannot do without
    "camera": "responsivity",
    "training": "frames/00000/electrons",
    "table": "first/weights",
    "sums": "sums/00000/moments",
    "layer_sums": "sums/00000/noise",
}


def _nothing(root: h5py.File, name: str) -> None:
    attributes = dict(root[name].attrs)
    del root[name]
    root.create_dataset(name, dtype="f8", shape=None)
    root[name].attrs["axes"] = attributes["axes"]


def _missing(root: h5py.File, name: str) -> None:
    del root[name]


def _elsewhere(root: h5py.File, name: str) -> None:
    del root[name]
    root[name] = h5py.ExternalLink("other.h5", f"/{name}")


def _soft(root: h5py.File, name: str) -> None:
    root.move(name, "moved")
    root[name] = h5py.SoftLink("/moved")


def _not_a_number(root: h5py.File, name: str) -> None:
    values = root[name][()]
    values.flat[1] = np.nan
    root[name][...] = values


@pytest.mark.parametrize("spoil", [_nothing, _missing, _elsewhere, _soft, _not_a_number])
@pytest.mark.parametrize("kind", list(READERS))
def test_verification_finds_what_cannot_be_read_though_every_byte_is_as_written(
    kind: str, spoil: Callable[[h5py.File, str], None], artifacts: dict[str, Path], tmp_path: Path, refused: Refused
) -> None:
    path = Path(shutil.copy(artifacts[kind], tmp_path / "spoilt.h5"))
    shutil.copy(artifacts[kind], tmp_path / "other.h5")
    with h5py.File(path, "r+") as root:
        spoil(root, LARGE[kind])
    container.seal(path)
    assert LARGE[kind].rsplit("/", 1)[-1] in refused(3, "info", "--verify", path)


def test_a_dataset_of_nothing_that_nobody_reads_is_no_traceback(
    artifacts: dict[str, Path], tmp_path: Path, refused: Refused
) -> None:
    path = Path(shutil.copy(artifacts["camera"], tmp_path / "more.h5"))
    with h5py.File(path, "r+") as root:
        root.create_dataset("more", dtype="f8", shape=None)
    container.seal(path)
    for call in (("info", "--verify", path), ("info", path)):
        assert "dataset more" in refused(3, *call)


def test_a_file_without_its_digest_or_before_its_first_byte_is_refused(
    artifacts: dict[str, Path], tmp_path: Path, refused: Refused
) -> None:
    content = artifacts["camera"].read_bytes()
    path = tmp_path / "camera.h5"
    for bad, words in (
        (content[container.BLOCK :], "not an l3 artifact, or is damaged"),
        (bytes(container.BLOCK) + content[container.BLOCK :], "not an l3 artifact, or is damaged"),
        (content[:-1], "truncated or damaged"),
        (content + b"\0", "truncated or damaged"),
        (content[: container.BLOCK], "truncated or damaged"),
        (b"", "not an HDF5 file"),
    ):
        path.write_bytes(bad)
        assert words in refused(3, "info", path)


# ---------------------------------------------------------------------------------------------------------- history


def test_the_history_is_compared_with_its_inputs(bayer_recipe: Path, tmp_path: Path, l3: L3) -> None:
    scenes = tmp_path / "scenes.toml"
    classes = tmp_path / "classes.toml"
    scenes.write_text(SCENES)
    classes.write_text("[classes]\npatch = 3\nlevels = 2\n[learning]\npatches = 500\n")
    sets = [tmp_path / "a.h5", tmp_path / "b.h5"]
    for seed, path in enumerate(sets):
        assert l3("simulate", scenes, "--camera", bayer_recipe, "-o", path, "--seed", seed, "--quiet")[0] == 0
    table = tmp_path / "table.h5"
    assert l3("train", *sets, "--classes", classes, "-o", table, "--quiet")[0] == 0
    code, out, err = l3("info", "--verify", table, *sets, scenes, classes, bayer_recipe, "--json")
    assert (code, err) == (0, "")
    document = json.loads(out)
    links = {(link["stage"], link["role"]): link for link in document["history"] if link["given"]}
    assert links["train", "training set"]["given"] == [str(path) for path in sets]
    assert links["train", "recipe"]["given"] == [str(classes)]
    assert links["simulate", "camera"]["given"] == [str(bayer_recipe)]
    assert set(links["simulate", "recipe"]["given"]) == {str(scenes), str(bayer_recipe)}
    assert document["different"] == []
    code, out, _ = l3("info", "--verify", table, sets[0])
    assert code == 0
    assert f"train training set: 1 verified ({sets[0]}), 1 not listed" in out
    classes.write_text(classes.read_text().replace("500", "501"))
    sets[0].write_bytes(sets[0].read_bytes()[:-1])
    code, out, err = l3("info", "--verify", table, *sets, classes)
    assert (code, err.count("\n")) == (3, 1)
    assert f"the history of {table} does not contain {sets[0]}, {classes}" in err
    assert "train training set: 1 verified" in out
    assert "--verify" in l3("info", table, sets[1])[2]
