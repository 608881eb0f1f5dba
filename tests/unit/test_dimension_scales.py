"""Axes and units of artifacts in xarray. Dimension scales do not change values and cannot mislead a reader."""

import dataclasses
import hashlib
import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
import xarray

from l3cli.artifacts import container
from l3cli.artifacts.camera import CameraModel
from l3cli.artifacts.camera_recipe import load_camera
from l3cli.artifacts.inspection import describe
from l3cli.artifacts.partial_sums import (
    ClassSums,
    LayerSums,
    PartialLayerSums,
    PartialSums,
    open_partial_sums,
    write_partial_sums,
)
from l3cli.artifacts.schema import Artifact, Spec, declared, equal, instances, is_stored
from l3cli.artifacts.store import load, save
from l3cli.artifacts.table import TransformTable
from l3cli.artifacts.training_set import (
    LightSpectrum,
    TrainingFrame,
    TrainingPair,
    TrainingSet,
    open_training_set,
    write_part,
    write_training_set,
)
from l3cli.errors import InputFileError
from tests.helpers.artifacts import a_camera, a_frame, a_table, some_layer_sums, some_sums
from tests.helpers.calls import L3
from tests.helpers.paths import CONFIGS, ROOT
from tests.helpers.readme import PAGES

KINDS = ("camera", "training", "table", "sums", "layer_sums")
STORED = (
    CameraModel,
    TrainingSet,
    TransformTable,
    PartialSums,
    PartialLayerSums,
    TrainingFrame,
    TrainingPair,
    ClassSums,
    LayerSums,
)


def write_each(folder: Path) -> None:
    """One artifact of each kind, every group of it there."""
    camera = a_camera(load_camera(CONFIGS / "cameras/fiveband.toml"))
    bayer = load_camera(CONFIGS / "cameras/bayer.toml")
    light = LightSpectrum(np.linspace(300.0, 900.0, 9), np.linspace(1, 2, 9, dtype=np.float32))
    frame = dataclasses.replace(a_frame(), light=light)
    save(camera, folder / "camera.h5")
    save(dataclasses.replace(a_table(bayer), camera=bayer), folder / "table.h5")
    head = TrainingSet(camera=camera, outputs=("X", "Y", "Z"), target_description="XYZ", target_light=light)
    write_part(folder / "part.h5", frame, 0.25)
    with write_training_set(folder / "training.h5", head) as writer:
        writer.append(frame)
        writer.append_part(folder / "part.h5")
        pair = {field.name: getattr(frame, field.name) for field in dataclasses.fields(TrainingPair)}
        writer.append(TrainingPair(**pair))
    sums_head, sums = some_sums(bayer)
    write_partial_sums(folder / "sums.h5", sums_head, iter([sums]))
    layer_head, layer_sums = some_layer_sums(bayer)
    write_partial_sums(folder / "layer_sums.h5", layer_head, [layer_sums])


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("each")
    write_each(folder)
    return folder


def loaded(path: Path) -> dict[str, Any]:
    """Group of a file → what l3cli reads there."""
    if path.stem == "training":
        with open_training_set(path) as reader:
            return {"/": reader.head, **dict(zip(("frames/00000", "frames/00001", "pairs/00000"), reader, strict=True))}
    if path.stem in ("sums", "layer_sums"):
        with open_partial_sums(path) as reader:
            return {"/": reader.head, "sums/00000": reader.site(0)}
    kind: type[Artifact] = CameraModel if path.stem == "camera" else TransformTable
    return {"/": load(kind, path)}


def groups(instance: Any, where: str) -> Iterator[tuple[str, Any]]:
    """(path, instance) of a group and those below it."""
    yield where, instance
    for name, member in declared(type(instance)):
        if not isinstance(member, Spec):
            for place, each in instances(name, getattr(instance, name)).items():
                yield from groups(each, f"{where.rstrip('/')}/{place}")


@pytest.mark.parametrize("kind", KINDS)
def test_xarray_shows_every_dataset_with_its_axes_unit_and_values(kind: str, folder: Path) -> None:
    path = folder / f"{kind}.h5"
    seen = 0
    for top, content in loaded(path).items():
        for where, instance in groups(content, top):
            with xarray.open_dataset(path, group=where, engine="h5netcdf") as group:
                fields = {name: spec for name, spec in declared(type(instance)) if isinstance(spec, Spec)}
                axes = {axis for spec in fields.values() for axis in spec.axes}
                assert set(group.sizes) == axes
                assert set(group.variables) - {"history"} <= set(fields) | axes
                for name, spec in fields.items():
                    if not is_stored(instance, name, spec):
                        assert name not in group.variables
                        continue
                    shown, value = group[name], np.asarray(getattr(instance, name))
                    assert shown.dims == spec.axes
                    assert shown.attrs["units"] == spec.unit
                    assert shown.dtype.kind == ("O" if spec.dtype == "str" else np.dtype(spec.dtype).kind)
                    np.testing.assert_array_equal(shown.values, value)
                    seen += 1
    assert seen == len(describe(path)["datasets"])


def test_axes_have_coordinates_where_a_dataset_gives_them(folder: Path) -> None:
    def opened(name: str, group: str = "/") -> xarray.Dataset:
        with xarray.open_dataset(folder / name, group=group, engine="h5netcdf") as content:
            return content.load()

    camera = opened("camera.h5")
    green = camera.responsivity.sel(channel="g", wavelength=550)
    assert green == camera.responsivity.values[1, list(camera.wavelength).index(550)]
    assert camera.wavelength.attrs["units"] == "nm"
    noise = opened("camera.h5", "fit/noise")
    assert list(noise.channel) == list(camera.channel) == ["r", "g", "b", "o", "c"]
    assert list(noise.photon_transfer_mean.white_exposure) == list(noise.exposure)
    assert noise.white_exposure.attrs["units"] == "s"
    assert list(opened("camera.h5", "fit/series").response.band) == ["lights 0", "lights 1"]
    for frame in ("frames/00000", "frames/00001", "pairs/00000"):
        assert list(opened("training.h5", frame).target.output) == ["X", "Y", "Z"]
        light = opened("training.h5", f"{frame}/light").radiance
        assert light.sel(wavelength=900) == 2
    assert list(opened("training.h5", "frames/00001").electrons.channel) == ["r", "g", "b", "o", "c"]
    assert opened("table.h5", "first").weights.sel(output="Y").dims == ("class", "tap")
    assert opened("table.h5", "first/rule").chroma_weights.sel(channel="r").dims == ("chroma",)


def test_the_example_of_the_docs_runs(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    lines = PAGES["artifacts.md"].partition("    import xarray\n")[2].partition("\n\n")[0].splitlines()
    monkeypatch.chdir(folder)
    names: dict[str, Any] = {"xarray": xarray}
    shown = []
    for line in map(str.strip, lines):
        if " = " in line:
            exec(line, names)
        else:
            shown.append(eval(line, names))
    assert [value if isinstance(value, str) else value.dims for value in shown] == [
        ("class", "tap"), "1", ("wavelength",), ("row", "col"),
    ]  # fmt: skip


def test_h5py_follows_dims_in_both_directions(folder: Path) -> None:
    with h5py.File(folder / "camera.h5") as root:
        responsivity = root["responsivity"]
        assert [dim.keys() for dim in responsivity.dims] == [["channel"], ["wavelength"]]
        assert responsivity.dims[1][0] == root["wavelength"]
        for axis, index in (("channel", 0), ("wavelength", 1)):
            assert h5py.h5ds.is_attached(responsivity.id, root[axis].id, index)
            assert h5py.h5ds.get_num_scales(responsivity.id, index) == 1


def test_another_process_writes_the_same_bytes(folder: Path, tmp_path: Path) -> None:
    program = f"from pathlib import Path; from {__name__} import write_each; write_each(Path({str(tmp_path)!r}))"
    environment = {**os.environ, "PYTHONHASHSEED": "7"}
    subprocess.run([sys.executable, "-c", program], check=True, cwd=ROOT, env=environment)
    for name in (*KINDS, "part"):
        digests = {hashlib.sha256((where / f"{name}.h5").read_bytes()).digest() for where in (folder, tmp_path)}
        assert len(digests) == 1, name


def test_no_scale_takes_the_name_of_another_dataset() -> None:
    def all_below(kind: type) -> Iterator[type]:
        yield kind
        for _, member in declared(kind):
            if not isinstance(member, Spec):
                yield from all_below(member.kind)

    for kind in {below for top in STORED for below in all_below(top)}:
        members = dict(declared(kind))
        for name, member in members.items():
            axes = member.axes if isinstance(member, Spec) else ()
            assert len(set(axes)) == len(axes), f"{kind.__name__}.{name}"
            for axis in set(axes) & set(members):
                assert getattr(members[axis], "axes", None) == (axis,), f"{kind.__name__}: axis {axis}"


# ---------------------------------------------------------------------------------------------------------- damage


def remove(root: h5py.File) -> None:
    del root["channel"], root["cfa_row"]


def lead_away(root: h5py.File) -> None:
    del root["channel"], root["cfa_row"]
    root["channel"], root["cfa_row"] = h5py.ExternalLink("/etc/passwd", "/"), h5py.SoftLink("/noise")


def claim_much(root: h5py.File) -> None:
    del root["channel"]
    root.create_dataset("channel", (2**60,), ">f4").make_scale("This is a netCDF dimension but not a netCDF variable.")


def refer_to_itself(root: h5py.File) -> None:
    for name in ("channel", "wavelength", "responsivity"):
        lists = np.empty(1, object)
        lists[0] = np.array([root.ref, root[name].ref], h5py.ref_dtype)
        root[name].attrs.create("DIMENSION_LIST", lists, dtype=h5py.vlen_dtype(h5py.ref_dtype))


def refer_to_nothing(root: h5py.File) -> None:
    gone = root.create_dataset("gone", data=1.0)
    root["channel"].attrs.create("REFERENCE_LIST", gone.ref, dtype=h5py.ref_dtype)
    root["responsivity"].attrs.create("DIMENSION_LIST", np.array([gone.ref] * 9, h5py.ref_dtype), dtype=h5py.ref_dtype)
    del root["gone"]


def misname(root: h5py.File) -> None:
    root["channel"].attrs["CLASS"] = np.arange(100)
    root["responsivity"].attrs["CLASS"] = h5py.Empty("f")
    root["responsivity"].attrs["units"] = root.ref


@pytest.mark.parametrize("damage", [remove, lead_away, claim_much, refer_to_itself, refer_to_nothing, misname])
def test_reading_ignores_scales_whatever_became_of_them(
    damage: Callable[[h5py.File], None], folder: Path, tmp_path: Path, l3: L3
) -> None:
    path = tmp_path / "camera.h5"
    path.write_bytes((folder / "camera.h5").read_bytes())
    with h5py.File(path, "r+") as root:
        damage(root)
    container.seal(path)
    assert equal(load(CameraModel, path), load(CameraModel, folder / "camera.h5"))
    for command in (("info", path), ("info", "--verify", path)):
        code, _, err = l3(*command)
        assert (code, err.count("\n")) in ((0, 0), (3, 1)), err


def test_a_dataset_cannot_pass_for_an_empty_scale(folder: Path, tmp_path: Path) -> None:
    path = tmp_path / "camera.h5"
    path.write_bytes((folder / "camera.h5").read_bytes())
    with h5py.File(path, "r+") as root:
        del root["responsivity"]
        root.create_dataset("responsivity", (5, 2**40), "f8").make_scale("responsivity")
    container.seal(path)
    with pytest.raises(InputFileError, match="declares more values than the file contains"):
        load(CameraModel, path)
