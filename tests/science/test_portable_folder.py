"""A table as plain arrays: what table.json says is enough to compute by, and both sets of transforms are there."""

import dataclasses
import itertools
import json
from typing import Any

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.table import TransformTable
from l3cli.export.folder import folder_files
from tests.helpers.tables import random_table, with_later, with_low_noise


def read_folder(table: TransformTable) -> tuple[dict[str, Any], dict[str, NDArray]]:
    """table.json and the arrays that it names, read as it says and as nothing else does."""
    files = folder_files(table)
    document = json.loads(files.pop("table.json"))
    arrays = {}
    for entry in document["arrays"]:
        content = files.pop(entry["file"])
        values = np.frombuffer(content, np.dtype(entry["dtype"]).newbyteorder("<")).reshape(entry["shape"])
        assert len(entry["axes"]) == values.ndim
        assert entry["unit"]
        arrays[entry["name"]] = values
    assert not files, "files that table.json does not name"
    return document, arrays


def test_arrays_of_one_layer_make_the_outputs_of_the_test_mosaic() -> None:
    document, arrays = read_folder(random_table([[0, 1], [1, 2]], 12, 64.0))
    black, white = (document["table"][key]["value"] for key in ("black_level", "white_level"))
    radius, sizes = document["layers"][0]["patch"]["value"] // 2, document["layers"][0]["sizes"]
    raw, (labels,), outputs = arrays["test_raw"], arrays["test_labels"], arrays["test_outputs"]
    assert sizes["classes"] == len(arrays["layer0/weights"]) > labels.max()
    words = arrays["layer0/word_weights"] * 2.0 ** -arrays["layer0/word_fraction"].astype(float)[:, None, None]
    coarse = 8 * 10 ** (-document["word_lengths"]["chosen"]["least_psnr_db"] / 20)
    for weights, most in ((arrays["layer0/weights"], 1e-6), (words, coarse)):
        for row, col in itertools.product(range(5, 35, 7), range(5, 140, 3)):
            patch = (raw[row - radius : row + radius + 1, col - radius : col + radius + 1].ravel() - black) / (white - black)
            made = weights[labels[row, col]].astype(float) @ patch + arrays["layer0/intercept"][labels[row, col]]
            np.testing.assert_allclose(made, outputs[:, row, col], atol=most)


def test_arrays_of_the_second_set_stand_beside_the_usual_ones() -> None:
    """As another table's would; what both sets share stands once, and a table of one set is written as ever."""
    table = with_low_noise(with_later(random_table([[0, 1], [1, 2]], 12, 64.0), 3), 0.25)
    document, arrays = read_folder(table)
    usual, usual_arrays = read_folder(dataclasses.replace(table, conditions=()))
    other, other_arrays = read_folder(table.under(table.conditions[0]))
    (low,) = document.pop("conditions")["sets"]
    assert low["noise"] == {"shot": 0.25, "read": 0.25, "limit": 0.25**0.75}
    assert (low["layers"], low["word_lengths"]) == (other["layers"], other["word_lengths"])
    behind = {name: values for name, values in arrays.items() if not name.startswith("conditions/0/")}
    assert set(behind) == set(usual_arrays)
    assert document | {"arrays": []} == usual | {"arrays": []}
    for name, values in other_arrays.items():
        np.testing.assert_array_equal(arrays.get(f"conditions/0/{name}", arrays[name]), values)
    assert {"conditions/0/layer0/weights", "conditions/0/layer0/contrast_edges", "conditions/0/test_outputs"} < set(arrays)
    assert not {"conditions/0/test_raw", "conditions/0/layer0/level_edges", "conditions/0/layer0/count"} & set(arrays)


def test_two_bits_more_cost_twelve_decibels_less() -> None:
    document, arrays = read_folder(with_later(random_table([[0, 1], [1, 2]], 12, 64.0, contrasts=()), 3))
    costs = {(each["binary_point_of"], each["bits"]): each["psnr_db"] for each in document["word_lengths"]["costs"]}
    for scale in ("class", "table"):
        steps = np.diff([costs[scale, bits] for bits in (8, 10, 12, 14, 16)])
        assert ((steps > 9) & (steps < 15)).all(), steps
    assert all(costs["class", bits] >= costs["table", bits] - 0.5 for bits in (8, 10, 12, 14, 16))
    chosen = document["word_lengths"]["chosen"]["bits"]
    assert costs["class", chosen] >= 60 > costs["class", chosen - 2]
    assert np.abs(arrays["layer1/word_weights"].astype(int)).max() < 2 ** (chosen - 1)
    assert arrays["layer0/fixed_weights"].dtype == np.int16
