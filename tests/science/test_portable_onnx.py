"""Tables as ONNX graphs, run by onnxruntime: the same classes and outputs as the reference renderer."""

import dataclasses
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import onnxruntime
import pytest

from l3cli.artifacts.structure_rule import StructureRule
from l3cli.artifacts.table import TransformTable
from l3cli.classes import direction
from l3cli.rendering.portable.onnx_graph import OPSET, Graph
from l3cli.rendering.portable.onnx_model import onnx_files
from l3cli.rendering.reference import ReferenceRenderer
from tests.helpers.tables import frame_of_all_levels, random_table, with_first, with_later, with_spectra, with_tree


def unsaturated_first(table: TransformTable) -> TransformTable:
    """The table with case 0 where nothing is saturated: there chromas, structures and leaves decide."""
    cases = table.first.rule.case_of_code.copy()
    cases[0], cases[-1] = 0, cases.max()
    return with_first(table, rule=dataclasses.replace(table.first.rule, case_of_code=cases))


def three_layers() -> TransformTable:
    table = with_later(
        unsaturated_first(random_table([[0, 1, 2, 1], [2, 1, 0, 1]], 16, 64.0, patch=7, contrasts=())), 3, 5, ratios=True
    )
    later = []
    for layer in table.later:
        assert isinstance(layer.rule, StructureRule)
        edges = np.array([5_000_000, 100_000_000, 700_000_000, 1_500_000_000][: layer.rule.strengths], np.uint32)
        later.append(dataclasses.replace(layer, structure=dataclasses.replace(layer.rule, strength_edges=edges)))
    return dataclasses.replace(table, later=tuple(later))


TABLES: dict[str, Callable[[], TransformTable]] = {
    "one layer": lambda: unsaturated_first(random_table([[0, 1, 2], [2, 0, 1]], 12, 60.25, contrasts=(0.5, 3.0))),
    "directions": lambda: unsaturated_first(
        random_table(
            [[0, 1], [1, 2]], 10, 40.0, outputs=("a", "b"), contrasts=(),
            direction=direction.Keys(orientations=8, strengths=(4.0,), coherence=0.5),
        )
    ),
    "smoothed spectra": lambda: with_spectra(random_table([[0, 1], [2, 3]], 12, 64.0, outputs=tuple("abcd")), 3, 0.4),
    "three layers": three_layers,
    "a tree": lambda: with_tree(unsaturated_first(random_table([[0, 1], [1, 2]], 12, 64.0, contrasts=()))),
}  # fmt: skip


@pytest.mark.parametrize("name", TABLES)
def test_a_graph_gives_the_classes_and_outputs_of_the_reference(name: str) -> None:
    table = TABLES[name]()
    content = onnx_files(table)["table.onnx"]
    model = onnx.load_from_string(content)
    onnx.checker.check_model(model, full_check=True)
    assert [(each.domain, each.version) for each in model.opset_import] == [("", OPSET)]
    assert not model.functions
    session: Any = onnxruntime.InferenceSession(content)
    reference, rng = ReferenceRenderer(table), np.random.default_rng(5)
    for shape, phase in (((23, 64), (1, 1)), ((1, 2), (0, 1)), ((3, 1), (1, 0))):
        frame = frame_of_all_levels(table, rng, shape, phase)
        labels, outputs = session.run(None, {"raw": frame.values, "phase": np.array(phase)})
        for layer in range(len(table.layers)):
            np.testing.assert_array_equal(labels[layer], reference.labels(frame, layer))
        exact = reference.exact_outputs(frame)
        assert np.abs(outputs - exact).max() <= 1e-6 * max(1.0, np.abs(exact).max())


def test_the_program_of_its_readme_agrees(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    files = onnx_files(TABLES["one layer"]())
    for name, content in files.items():
        (tmp_path / name).write_bytes(content)
    monkeypatch.chdir(tmp_path)
    (program,) = re.findall(r"```python\n(.*?)```", files["README.md"].decode(), re.DOTALL)
    exec(program, {})
    (tmp_path / "test_labels.bin").write_bytes(bytes(len(files["test_labels.bin"])))
    with pytest.raises(AssertionError):
        exec(program, {})


def test_equal_formulas_become_one_node() -> None:
    graph = Graph()
    value = graph.input("value", np.float64)
    assert (value * 2 + 1).floor() == (value * 2 + 1).floor()
    assert [node[0] for node in graph.nodes] == ["Mul", "Add", "Floor"]
    assert len(graph.constants) == 2
