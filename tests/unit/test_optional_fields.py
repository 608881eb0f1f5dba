"""Optional fields of artifacts: files without the field keep their bytes, and a stored field is read back."""

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from l3cli.artifacts.camera import CameraModel
from l3cli.artifacts.inspection import describe
from l3cli.artifacts.notebook import html
from l3cli.artifacts.partial_sums import write_partial_sums
from l3cli.artifacts.schema import Artifact, Spec, data, declared, equal, group
from l3cli.artifacts.store import load, save
from l3cli.artifacts.training_set import TrainingSet, write_training_set
from tests.helpers.artifacts import a_camera, a_design, a_frame, a_table, some_layer_sums, some_moments, some_sums


@dataclasses.dataclass(frozen=True)
class Part:
    """A group that is added."""

    value: float = data("float64", doc="a number")


ADDED: dict[str, tuple[Any, Any, Any]] = {  # name → type, declaration, a value that is not the default
    "added_number": (float, data("float64", unit="e-", doc="a number", optional=1.5), 2.5),
    "added_text": (str, data("str", doc="a text", optional=""), "text"),
    "added_words": (tuple[str, ...], data("str", "word", doc="words", optional=()), ("one", "two")),
    "added_array": (NDArray[np.float64] | None, data("float64", "added", doc="an array", optional=None), np.arange(3.0)),
    "added_group": (Part | None, group(default=None), Part(1.0)),
}


def with_additions(instance: Any, **values: Any) -> Any:
    """Return an instance, and all that it holds, of types that declare the further fields; `values` go to the top."""
    kind = type(instance)
    fields = {field.name: getattr(instance, field.name) for field in dataclasses.fields(kind)}
    for name, spec in declared(kind):
        if isinstance(spec, Spec) or fields[name] is None:
            continue
        several = isinstance(fields[name], tuple)
        fields[name] = tuple(map(with_additions, fields[name])) if several else with_additions(fields[name])
    return larger(kind)(**fields, **values)


def larger(kind: type) -> type:
    """Return a dataclass with the further fields: all of them for an artifact, a number for what it holds."""
    further = []
    for name, (hint, declaration, _) in ADDED.items():
        if name != "added_number" and not issubclass(kind, Artifact):
            continue
        added = dataclasses.field(metadata=declaration.metadata, default=declaration.default, kw_only=True)
        further.append((name, hint, added))
    return dataclasses.make_dataclass(kind.__name__, further, bases=(kind,), frozen=True, repr=False)


def written(content: tuple[Any, ...], path: Path) -> bytes:
    """Return the bytes of an artifact, and of a frame or sums that it holds."""
    head, *rest = content
    if isinstance(head, TrainingSet):
        with write_training_set(path, head) as writer:
            for frame in rest:
                writer.append(frame)
    elif rest:
        write_partial_sums(path, head, rest)
    else:
        save(head, path)
    return path.read_bytes()


@pytest.fixture
def artifacts(fiveband: CameraModel, bayer: CameraModel) -> dict[str, tuple[Any, ...]]:
    head = TrainingSet(camera=fiveband, outputs=("X", "Y", "Z"), target_description="XYZ")
    return {
        "camera model": (a_camera(fiveband),),
        "training set": (head, a_frame()),
        "table": (dataclasses.replace(a_table(bayer), camera=bayer),),
        "partial sums": some_sums(bayer),
        "partial sums of a layer": some_layer_sums(bayer),
        "scene moments": (some_moments(),),
        "design": (a_design(bayer),),
    }


def test_bytes_stay_where_a_new_field_is_not_set(artifacts: dict[str, tuple[Any, ...]], tmp_path: Path) -> None:
    for kind, content in artifacts.items():
        before = written(content, tmp_path / "before.h5")
        assert written(tuple(map(with_additions, content)), tmp_path / "after.h5") == before, kind


def test_a_new_field_comes_back(artifacts: dict[str, tuple[Any, ...]], tmp_path: Path) -> None:
    for head, *_ in artifacts.values():
        values = {name: value for name, (_, _, value) in ADDED.items()}
        changed, plain = with_additions(head, **values), with_additions(head)
        save(changed, tmp_path / "set.h5")
        again = load(type(changed), tmp_path / "set.h5")
        assert equal(again, changed)
        assert not equal(again, plain)
        held = {item["name"] for item in describe(tmp_path / "set.h5")["datasets"]}
        assert {*ADDED} - {"added_group"} | {"added_group/value"} <= held
        assert "added_number" in html("", changed)
        assert "added_number" not in html("", plain)
        save(plain, tmp_path / "plain.h5")
        unset = load(type(changed), tmp_path / "plain.h5")
        assert (unset.added_number, unset.added_text, unset.added_words) == (1.5, "", ())
        assert (unset.added_array, unset.added_group) == (None, None)
