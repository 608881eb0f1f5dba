"""Artifacts are displayed as one line, and as a table of fields in notebooks."""

import dataclasses
from pathlib import Path

from l3cli.artifacts.camera import CameraModel
from l3cli.artifacts.training_set import TrainingSet, open_training_set, write_training_set
from tests.helpers.artifacts import a_camera, a_frame, a_table


def test_an_artifact_is_a_line_that_says_what_it_holds(bayer: CameraModel, tmp_path: Path) -> None:
    table, camera = a_table(bayer), a_camera(bayer)
    training = TrainingSet(camera=camera, outputs=("X", "Y", "Z"), target_description="XYZ")
    for artifact, shown in (
        (camera, (camera.name, f"{camera.rows}×{camera.cols}", "2×2 CFA of r, g, b")),
        (table, (table.camera_name, "2×2 CFA of r, g, b → X, Y, Z", f"{len(table.first.weights)} classes")),
        (training, (camera.name, "X, Y, Z")),
    ):
        line = repr(artifact)
        assert line.startswith(f"<{type(artifact).__name__}: ")
        assert "\n" not in line
        assert len(line) < 200
        assert all(each in line for each in shown)
    path = tmp_path / "training.h5"
    with write_training_set(path, training) as writer:
        writer.append(a_frame())
    with open_training_set(path) as reader:
        assert repr(reader).startswith("<TrainingSetReader: 1 frames of")
        assert "<table>" in reader._repr_html_()


def test_parts_of_artifacts_are_shown_without_their_arrays(bayer: CameraModel) -> None:
    assert len(repr(a_table(bayer).first)) < 500


def test_notebooks_show_fields_with_axes_units_and_values(bayer: CameraModel) -> None:
    table = dataclasses.replace(a_table(bayer), camera_name="<script>")
    page = table._repr_html_()
    taps = table.first.rule.patch**2
    assert f"float32 (class: {len(table.first.weights)}, output: 3, tap: {taps})" in page
    assert "<summary>first <em>MosaicLayer</em></summary>" in page
    assert "cd s/m^2" in page
    assert "<script>" not in page
    assert page.count("<table>") == page.count("</table>")
    assert len(page) < 40_000
