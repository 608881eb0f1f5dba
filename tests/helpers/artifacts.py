"""Example artifacts with a value in every field, for tests that write and read them."""

import dataclasses
from typing import Any

import numpy as np

from l3cli.artifacts.camera import CameraModel
from l3cli.artifacts.class_rule import ClassRule
from l3cli.artifacts.design import GROUPS, SIDE, SOFT, Design, LightMoments, SceneMoments, Truth, Tuned
from l3cli.artifacts.fit import ChartFit, Fit, NoiseFit, SeriesFit, SweepFit
from l3cli.artifacts.layers import MosaicLayer
from l3cli.artifacts.partial_sums import ClassSums, LayerSums, PartialLayerSums, PartialSums
from l3cli.artifacts.plane_rules import StructureRule
from l3cli.artifacts.schema import Spec, Stage, declared
from l3cli.artifacts.table import TransformTable
from l3cli.artifacts.training_set import TrainingFrame, TrainingSet


def a_fit(channels: int) -> Fit:
    """Return a fit with a number in every field."""
    lengths = {"channel": channels, "patch": 24, "trial": 4, "white_exposure": 3, "defect": 0, "left_out": 1, "odd": 1}
    return Fit(*(filled(part, lengths) for part in (NoiseFit, SweepFit, ChartFit, SeriesFit)))


def filled(kind: type, lengths: dict[str, int], **given: Any) -> Any:
    """Return an instance with consecutive numbers in every declared dataset; axes without a length are 2 long."""
    for name, spec in declared(kind):
        if name in given or not isinstance(spec, Spec):
            continue
        shape = tuple(lengths.get(axis, 2) for axis in spec.axes)
        if spec.dtype == "str":
            given[name] = tuple(f"{name} {index}" for index in range(*shape)) if shape else name
        else:
            given[name] = (np.arange(np.prod(shape, dtype=int)).reshape(shape) + 0.5).astype(spec.dtype)[()]
    return kind(**given)


def some_moments() -> SceneMoments:
    """Return scene moments of one light, with a number in every field."""
    lengths = {"group": len(GROUPS), "coefficient": 2 * SIDE**2, "entry": 2 * SIDE**2 + SOFT.stop + 2}
    return filled(SceneMoments, {}, light=(filled(LightMoments, lengths),))


def a_design(camera: CameraModel) -> Design:
    """Return a design with a number in every field."""
    return filled(Design, {}, pixel=camera, tuned=filled(Tuned, {}), truth=filled(Truth, {}))


def a_camera(camera: CameraModel) -> CameraModel:
    """Return the camera with a complete fit and a history."""
    history = (Stage("calibrate", {"accept": True}, 'name = "µ"', {"frames": ["ab", "cd"]}),)
    return dataclasses.replace(camera, fit=a_fit(len(camera.channels)), history=history)


def a_frame(seed: int = 0, channels: int = 5) -> TrainingFrame:
    """Return a small training frame of random values."""
    rng = np.random.default_rng(seed)
    return TrainingFrame(
        electrons=rng.random((channels, 20, 24), dtype=np.float32),
        raw=rng.integers(0, 4096, (20, 24)).astype(np.uint16),
        target=rng.random((3, 20, 24), dtype=np.float32),
        white=np.array([95.0, 100.0, 108.0]),
        scene="leaves",
        illuminant="D65",
        luminance=100.0,
        exposure=0.01,
        seed=(7, seed),
    )


def a_table(camera: CameraModel) -> TransformTable:
    """Return a small table of random weights for the camera."""
    rule = ClassRule(
        patch=3,
        shift=0,
        level_edges=np.array([900], np.uint32),
        contrast_edges=np.array([[5, 6]], np.uint32),
        saturation=4000,
        saturation_radius=1,
        case_of_code=np.arange(8, dtype=np.uint16),
        chroma_black_level=64 * 16,
        chroma_weights=np.array([[1, 2, 3], [-4, 5, 6]], np.int32),
    )
    classes = camera.cfa.size * rule.classes_per_site
    rng = np.random.default_rng(1)
    return TransformTable(
        camera_name=camera.name,
        rows=camera.rows,
        cols=camera.cols,
        channels=camera.channels,
        cfa=camera.cfa,
        bits=camera.bits,
        black_level=camera.black_level,
        white_level=camera.white_level,
        outputs=("X", "Y", "Z"),
        target_description="",
        output_unit=0.5,
        white_point=np.array([0.95, 1.0, 1.09]),
        first=MosaicLayer(
            rule=rule,
            weights=rng.standard_normal((classes, 3, 9)).astype(np.float32),
            intercept=np.zeros((classes, 3), np.float32),
            samples=np.ones(classes),
            condition=np.ones(classes, np.float32),
        ),
        history=(Stage("train", {"seed": 0}),),
    )


def some_layer_sums(camera: CameraModel) -> tuple[PartialLayerSums, LayerSums]:
    """Return sums of a refinement layer from a training shard, with their metadata."""
    table = dataclasses.replace(a_table(camera), camera=camera)
    rule = StructureRule(
        level_step=1,
        gradient_factor=np.full(table.first.rule.levels, 64, np.uint8),
        gradient_shift=np.full(table.first.rule.levels, 6, np.uint8),
        strength_edges=np.array([1000, 5000], np.uint32),
        coherence=31,
        turns=np.ones((camera.cfa.size, 2), np.int8),
        cases=table.first.rule.cases,
    )
    head = PartialLayerSums(
        shard=1,
        shards=1,
        mosaics=np.array([5]),
        side=1,
        structure=rule,
        table=table,
        sites=np.array([0]),
        history=table.history,
    )
    moments, noise, count = (np.ones(shape) for shape in head.shapes)
    return head, LayerSums(moments, noise, count)


def some_sums(camera: CameraModel) -> tuple[PartialSums, ClassSums]:
    """Return sums of the first layer from a training shard, with their metadata."""
    rule = a_table(camera).first.rule
    head = PartialSums(
        shard=1,
        shards=1,
        pass_number=1,
        patches=np.array([5]),
        training=TrainingSet(camera=camera, outputs=("X", "Y", "Z"), target_description=""),
        rule=rule,
        white_point=np.ones(3),
        sites=np.array([0]),
        history=(Stage("train", {"seed": 0}),),
    )
    moments, noise, count = (np.ones(shape) for shape in head.shapes)
    return head, ClassSums(moments, noise, count)
