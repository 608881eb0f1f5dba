"""Tables with several layers: storage, validation and description of each layer."""

import dataclasses
import json
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from l3cli.artifacts.container import seal
from l3cli.artifacts.layers import PlaneLayer
from l3cli.artifacts.plane_rules import StructureRule
from l3cli.artifacts.schema import equal
from l3cli.artifacts.store import load, save
from l3cli.artifacts.table import LeadingComponents, TransformTable
from l3cli.errors import InputFileError, RecipeError
from l3cli.rendering.renderer import BACKENDS, make_renderer
from l3cli.training.summary import insight
from tests.helpers.calls import L3
from tests.helpers.cameras import BAYER
from tests.helpers.tables import random_table, with_components, with_refinement, with_tree

TABLE = with_refinement(random_table(BAYER, bits=12, black_level=64.0), 3, 5)


@pytest.fixture
def path(tmp_path: Path) -> Path:
    save(TABLE, tmp_path / "table.h5")
    return tmp_path / "table.h5"


def test_layers_come_back_in_their_order(path: Path) -> None:
    again = load(TransformTable, path)
    assert equal(again, TABLE)
    assert [layer.side for layer in again.later] == [3, 5]
    assert again.layers == (again.first, *again.later)
    assert not equal(again, dataclasses.replace(TABLE, later=TABLE.later[:1]))
    assert not equal(again, dataclasses.replace(TABLE, later=TABLE.later[::-1]))
    with h5py.File(path) as root:
        assert (sorted(root["later"]), root["later/1/weights"].shape[2]) == (["0", "1"], 75)


def structure_of(layer: PlaneLayer) -> StructureRule:
    assert layer.structure is not None
    return layer.structure


def test_trees_come_back_and_have_the_first_layers_levels_and_sites(tmp_path: Path) -> None:
    table = with_tree(TABLE, leaves=9)
    (layer,) = table.later
    assert layer.tree is not None
    save(table, tmp_path / "table.h5")
    assert equal(load(TransformTable, tmp_path / "table.h5"), table)
    with h5py.File(tmp_path / "table.h5", "r+") as root:
        assert {"tree", "weights"} < set(root["later/0"])
        assert "structure" not in root["later/0"]
        root["later/0/tree/branch"][0] = 2
    seal(tmp_path / "table.h5")
    with pytest.raises(InputFileError, match="branch is not a tree"):
        load(TransformTable, tmp_path / "table.h5")
    for structure, tree in ((None, None), (structure_of(TABLE.later[0]), layer.tree)):
        with pytest.raises(ValueError, match="a layer must have either a structure rule or a tree"):
            dataclasses.replace(layer, structure=structure, tree=tree)
    longer: dict[str, Any] = {"gradient_factor": np.full(8, 64, np.uint8), "gradient_shift": np.full(8, 6, np.uint8)}
    for fields, why in ((longer, "has 8 levels"), ({"turns": np.zeros(3, np.uint8)}, "weights holds|turns has 3 sites")):
        with pytest.raises(ValueError, match=why):
            dataclasses.replace(table, later=(dataclasses.replace(layer, tree=dataclasses.replace(layer.tree, **fields)),))


def test_layers_agree_in_what_they_share() -> None:
    one, two = TABLE.later
    with pytest.raises(ValueError, match=r"output has length 2 in later/1/weights"):
        dataclasses.replace(
            TABLE, later=(one, dataclasses.replace(two, weights=two.weights[:, :2], intercept=two.intercept[:, :2]))
        )
    with pytest.raises(ValueError, match="taps"):
        dataclasses.replace(TABLE, later=(dataclasses.replace(one, side=5), two))
    longer: dict[str, Any] = {"gradient_factor": np.full(8, 64, np.uint8), "gradient_shift": np.full(8, 6, np.uint8)}
    with pytest.raises(ValueError, match="has 8 levels"):
        dataclasses.replace(
            TABLE, later=(dataclasses.replace(two, structure=dataclasses.replace(structure_of(two), **longer)),)
        )


def test_only_the_last_layer_has_colour_ratios(tmp_path: Path) -> None:
    assert with_refinement(TABLE, 5, ratios=2).later[0].ratio_taps == 4  # those of bilateral chroma, too
    one, two = with_refinement(TABLE, 3, 5, ratios=1).later
    table = dataclasses.replace(TABLE, later=(one, two))
    assert (one.ratio_taps, two.ratio_taps, two.window_taps) == (0, 2, 75)
    save(table, tmp_path / "table.h5")
    assert equal(load(TransformTable, tmp_path / "table.h5"), table)
    with pytest.raises(ValueError, match="only the last layer may have taps for colour ratios"):
        dataclasses.replace(TABLE, later=(two, one))
    with pytest.raises(ValueError, match="76 taps"):
        dataclasses.replace(TABLE, later=(dataclasses.replace(two, weights=two.weights[..., :76]),))


@pytest.mark.parametrize("lost", ["first", "later/0"])
def test_a_layer_that_is_missing_is_named(path: Path, lost: str) -> None:
    with h5py.File(path, "r+") as root:
        del root[lost]
    seal(path)
    with pytest.raises(InputFileError, match=f"the (group|dataset) {lost} is missing"):
        load(TransformTable, path)


def test_more_layers_than_can_be_are_refused(path: Path) -> None:
    with h5py.File(path, "r+") as root:
        for index in range(2, 100):
            root[f"later/{index}"] = root["later/0"]
    seal(path)
    with pytest.raises(InputFileError, match="more than 64"):
        load(TransformTable, path)


def test_info_describes_every_layer(l3: L3, path: Path) -> None:
    code, out, _ = l3("info", path)
    assert code == 0
    assert "layer 2: " in out
    assert "3 × 3 pixels in 3 planes" in out
    assert "5 × 5 pixels in 3 planes" in out
    assert "28 structures: flat, and 3 strengths with 8 directions or none" in out
    assert "later/1/structure/strength_edges" in out
    later = json.loads(l3("info", path, "--json")[1])["insight"]["later"]
    assert later == insight(TABLE)["later"]
    samples = TABLE.later[0].samples
    assert later[0]["classes"] == {"all": len(samples), "trained": len(samples) // 2, "filled": len(samples) // 2}


@pytest.mark.parametrize("backend", list(BACKENDS))
def test_renderers_refuse_more_layers_than_four(backend: str) -> None:
    with pytest.raises(RecipeError, match="5 layers"):
        make_renderer(backend, with_refinement(random_table(BAYER, patch=3), 3, 3, 3, 3))


def test_bands_have_one_layer_of_three_components(tmp_path: Path) -> None:
    table = with_components(random_table(BAYER, outputs=tuple("abcd"), patch=3), 3)
    save(table, tmp_path / "table.h5")
    assert equal(load(TransformTable, tmp_path / "table.h5"), table)
    (layer,) = table.later
    plain = dataclasses.replace(layer, weights=layer.weights[..., : layer.window_taps])
    for fields in ({"later": (plain, plain)}, {"components": None}):
        with pytest.raises(ValueError, match="refinement layers require three outputs"):
            dataclasses.replace(table, **fields)
    with pytest.raises(ValueError, match="basis has 4 planes, but must have 3"):
        LeadingComponents(np.eye(4))
    with pytest.raises(ValueError, match=r"axis output has length 5 in components/basis"):
        dataclasses.replace(table, components=LeadingComponents(np.eye(5)[:, :3]))
