"""Generate the list of datasets of every type of artifact, from the declarations for saving and loading."""

import inspect
from collections.abc import Iterator

from markup import code, page, plain, table

from l3cli.artifacts.camera import CameraModel
from l3cli.artifacts.design import Design, SceneMoments
from l3cli.artifacts.partial_sums import PartialLayerSums, PartialSums
from l3cli.artifacts.schema import Artifact, Spec, declared
from l3cli.artifacts.table import TransformTable
from l3cli.artifacts.training_set import GROUPS, TrainingSet

KINDS: tuple[type[Artifact], ...] = (
    CameraModel, TrainingSet, TransformTable, PartialSums, PartialLayerSums, SceneMoments, Design,
)  # fmt: skip
INTRO = (
    "This page is for looking up the datasets of artifacts. It is generated from the declarations with which l3 saves and "
    "loads files. [File formats](../artifacts.md) describes the files. Datasets in brackets are optional."
)


def artifact_pages() -> dict[str, str]:
    return {"artifacts.md": page("# Datasets of artifacts", INTRO, *map(section, KINDS))}


def section(kind: type[Artifact]) -> str:
    made = f"Written by {code(kind.made_by.strip(chr(34)))}. {plain(first(kind))}"
    found = list(rows(kind))
    if kind is TrainingSet:
        found += [each for name, group in GROUPS.items() for each in rows(group, f"{name}/00000/")]
    heading = f"## {kind.kind[:1].upper()}{kind.kind[1:]}"
    return page(heading, made, table(["dataset", "type", "axes", "unit", "meaning"], found)).rstrip()


def first(kind: type) -> str:
    """Return the first paragraph of the docstring of a class."""
    return (inspect.getdoc(kind) or "").partition("\n\n")[0]


def rows(kind: type, prefix: str = "", absent: bool = False) -> Iterator[tuple[str, ...]]:
    for name, spec in declared(kind):
        if isinstance(spec, Spec):
            place = code(prefix + name)
            axes = ", ".join(map(plain, spec.axes)) or "—"
            yield f"({place})" if spec.optional or absent else place, spec.dtype, axes, plain(spec.unit), plain(spec.doc)
        else:
            yield from rows(spec.kind, f"{prefix}{name}/{'0/' if spec.several else ''}", spec.optional or absent)
