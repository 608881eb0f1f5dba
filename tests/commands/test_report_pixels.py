"""The pixel viewer of a report: packed classes and transforms, and the display in a browser."""

import base64
import dataclasses
import json
import re
import zlib
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest

from l3cli.artifacts.camera import CameraModel
from l3cli.artifacts.layers import MosaicLayer
from l3cli.artifacts.plane_rules import DIRECTIONS, StructureRule
from l3cli.artifacts.store import save
from l3cli.artifacts.table import TransformTable
from l3cli.artifacts.training_set import TrainingSet, write_training_set
from l3cli.classes.names import class_words, plane_class_words
from l3cli.classes.structure import name, structures
from l3cli.cli import run
from l3cli.frames.frame import RawFrame
from l3cli.rendering.reference import ReferenceRenderer
from l3cli.report.pixels import Crop, Layer, Sites, crop_of, packed, richest
from l3cli.stages.report import CLASS_BYTES
from tests.helpers.browser import Browser
from tests.helpers.tables import colorimetric_table, frame_of_all_levels, with_refinement, with_tree
from tests.helpers.training_sets import a_frame

SIZE = (60, 90)


class Report(NamedTuple):
    """A page on a table of two layers and a frame of all levels, and what was put into it."""

    page: Path
    table: TransformTable
    raw: RawFrame


@pytest.fixture(scope="module")
def report(bayer: CameraModel, tmp_path_factory: pytest.TempPathFactory) -> Report:
    folder = tmp_path_factory.mktemp("pixels")
    camera = dataclasses.replace(bayer, channels=("r", "<b>", "b"))
    table = with_refinement(colorimetric_table(camera), 3)
    raw = frame_of_all_levels(table, np.random.default_rng(3), SIZE)
    save(table, folder / "table.h5")
    head = TrainingSet(camera=camera, outputs=table.outputs, target_description="")
    with write_training_set(folder / "unseen.h5", head) as writer:
        writer.append(dataclasses.replace(a_frame(camera, 1, smooth=False, size=SIZE), raw=raw.values))
    files = [str(folder / name) for name in ("table.h5", "unseen.h5")]
    assert run(["report", *files, "-o", str(folder / "report.html"), "--backend", "reference", "--quiet"]) == 0
    return Report(folder / "report.html", table, raw)


class View(NamedTuple):
    head: dict[str, Any]
    layers: list[tuple[np.ndarray, np.ndarray]]  # labels (row, col), weights (class, output, tap)


def unpacked(text: str) -> View:
    """As the page's script does it."""
    whole = zlib.decompress(base64.b64decode(text))
    at = 4 + int.from_bytes(whole[:4], "little")
    head, layers = json.loads(whole[4:at]), []

    def numbers(kind: str, count: int) -> np.ndarray:
        nonlocal at
        array = np.frombuffer(whole, kind, count, at)
        at += -(-array.nbytes // 4) * 4
        return array

    for layer in head["layers"]:
        classes, outputs, taps = layer["with_weights"], len(head["outputs"]), layer["side"] ** 2 * len(layer["planes"])
        largest = numbers("<f4", classes * outputs).reshape(classes, outputs, 1)
        labels = numbers("<u2", int(np.prod(head["size"]))).reshape(head["size"])
        root = numbers("i1", classes * outputs * taps).reshape(classes, outputs, taps) / 127
        layers.append((labels, np.sign(root) * root**2 * largest))
    assert at == len(whole)
    return View(head, layers)


def packed_in(page: Path) -> str:
    found = re.search(r"<template>([^<]*)</template>", page.read_text())
    assert found is not None
    return found[1]


def test_every_pixel_has_its_classes_and_transforms(report: Report) -> None:
    view, renderer = unpacked(packed_in(report.page)), ReferenceRenderer(report.table)
    top, left = view.head["corner"]
    rows, cols = view.head["size"]
    assert (rows, cols) == SIZE
    for number, (labels, weights) in enumerate(view.layers):
        layer = report.table.layers[number]
        truth = renderer.labels(report.raw, number)[top : top + rows, left : left + cols]
        words = view.head["layers"][number]["classes"][: len(np.unique(truth))]
        assert np.array_equal(np.array([int(each["class"].split()[0]) for each in words])[labels], truth)
        wanted = layer.weights[[int(each["class"].split()[0]) for each in view.head["layers"][number]["classes"]]]
        assert np.abs(weights - wanted).max() <= 0.009 * np.abs(wanted).max()
        for index, answer in zip(np.unique(truth).tolist(), words, strict=True):
            of_class = (
                class_words(report.table, index)
                if isinstance(layer, MosaicLayer)
                else plane_class_words(report.table, layer, index)
            )
            assert of_class.items() <= answer.items()
            assert answer["training"] == ("no patches; filled from a neighbour" if layer.samples[index] == 0 else
                                        f"{layer.samples[index]:.0f} patches")  # fmt: skip
    assert view.head["channels"] == ["r", "<b>", "b"]
    assert "<b>" not in report.page.read_text()


def labels_of(report: Report) -> list[np.ndarray]:
    """The classes of the frame in both layers."""
    renderer = ReferenceRenderer(report.table)
    return [renderer.labels(report.raw, number) for number in range(2)]


def test_classes_are_reported_in_words(bayer: CameraModel) -> None:
    table = with_refinement(colorimetric_table(bayer), 3)
    rule = table.first.rule
    words = class_words(table, rule.join(2, 1, 0, site=3))
    assert words["level"].startswith("2 (0.")
    assert (words["contrast"], words["saturation"]) == ("1 of 0…1, the most textured", "none")
    assert words["chroma"].startswith("0: r 0.")
    saturated = class_words(table, rule.join(2, 0, rule.kind(0, 1)))
    assert "chroma" not in saturated
    assert saturated["saturation"].startswith("saturated ")
    later = table.later[0]
    assert plane_class_words(table, later, later.rule.join(1, 0))["structure"] == "flat"
    tree = with_tree(table).later[0]
    leaf = plane_class_words(table, tree, tree.rule.join(0, 2))
    assert leaf == {"leaf of the tree": f"2 of {tree.rule.structures}", "saturation": "none"}


@pytest.mark.parametrize(("step", "angle"), [((0, 1), 90), ((1, 0), 0), ((1, 1), 45), ((1, -1), 135)])
@pytest.mark.parametrize("site", [0, 1, 2, 3])
def test_an_edge_is_named_by_its_angle(bayer: CameraModel, step: tuple[int, int], angle: int, site: int) -> None:
    """A ramp down and across by `step`: its edges run at right angles to it, as seen with rows downwards."""
    rule = with_refinement(colorimetric_table(bayer), 3).later[0].rule
    assert isinstance(rule, StructureRule)
    rule = dataclasses.replace(rule, turns=np.array([[1, 1], [1, -1], [-1, 1], [-1, -1]], np.int8))
    row, col = np.mgrid[:7, :7]
    ramp = (step[0] * row + step[1] * col) * 3000
    structure = int(structures(ramp, np.full((5, 5), 3), np.full((1, 1), site), rule)[0, 0])
    assert 0 <= (structure - 1) % (1 + DIRECTIONS) - 1 < DIRECTIONS
    assert name(rule, structure, site).endswith(f"edge at {angle}°")
    assert name(rule, 0, site) == "flat"


def test_the_crop_is_that_of_most_classes_and_of_bounded_size(report: Report) -> None:
    labels = np.zeros((64, 96), int)
    labels[40:44, 60:64] = np.arange(16).reshape(4, 4)
    top, left = richest(labels, (16, 24))
    assert top <= 40 <= top + 12
    assert left <= 60 <= left + 20
    assert richest(labels, (192, 256)) == (0, 0)
    assert report.table.camera is not None
    given = report.table, report.table.camera, labels_of(report)
    whole, text = crop_of(*given, 10**6)
    smaller, less = crop_of(*given, len(text) - 1)
    assert whole.layers[0].labels.shape == SIZE
    assert smaller.layers[0].labels.size < np.prod(SIZE)
    assert len(less) < len(text)
    assert crop_of(*given, 10**6)[1] == text
    assert len(text) < len(packed_in(report.page)) <= len(text) + CLASS_BYTES


def test_other_classes_follow_those_of_the_crop(report: Report) -> None:
    """All of them in words, and their weights as far as there is room, those of most pixels first; if there is none, those
    of the frame alone or no other."""
    assert report.table.camera is not None
    truths = labels_of(report)
    given = report.table, report.table.camera, truths
    small = 1  # letters, which only the smallest crop is tried for
    _, alone = crop_of(*given, small)
    plain = unpacked(alone)
    for more, whole in ((CLASS_BYTES, True), (len(alone) // 2, False)):
        crop, text = crop_of(*given, small, more)
        assert len(text) <= len(alone) + more
        view, (top, left) = unpacked(text), crop.corner
        for number, (labels, weights) in enumerate(view.layers):
            layer, head = report.table.layers[number], view.head["layers"][number]
            truth = truths[number]
            classes = [int(each["class"].split()[0]) for each in head["classes"]]
            first = plain.head["layers"][number]["with_weights"]
            assert classes[:first] == np.unique(truth[top : top + labels.shape[0], left : left + labels.shape[1]]).tolist()
            assert len(set(classes)) == len(classes)
            assert head["with_weights"] == len(weights) <= len(classes)
            pixels = np.bincount(truth.ravel(), minlength=len(layer.weights))
            stored = head["pixels"] + [0] * (len(classes) - len(head["pixels"]))
            assert stored == pixels[classes].tolist()
            assert (np.diff(stored[first:]) <= 0).all()
            if whole:
                assert len(classes) == len(layer.weights)
                assert head["with_weights"] > first
                assert np.abs(weights - layer.weights[classes][: len(weights)]).max() <= 0.009 * np.abs(layer.weights).max()
            for index, answer in zip(classes, head["classes"], strict=True):
                row, col = divmod(index // layer.rule.classes_per_site, 2)
                assert answer["site"] == f"({row}, {col}) {report.table.channels[report.table.cfa[row, col]]}"
    assert unpacked(crop_of(*given, small, 0)[1]).head["layers"] == plain.head["layers"]


def test_transforms_without_weights_are_packed() -> None:
    labels = np.zeros((1, 1), int)
    layer = Layer(3, ("mosaic",), labels, ({"level": "0"},), np.zeros(1), np.ones(1, int), np.zeros((1, 1, 9)))
    view = unpacked(packed(Crop((0, 0), (1, 1), (layer,)), Sites(np.zeros((1, 1), np.uint8), ("w",), ("#fff",)), ("Y",)))
    assert not view.layers[0][1].any()


# ------------------------------------------------------------------------------------------------------- in a browser


READ = "document.querySelector('.reading').innerText"
READY = """new Promise((done) => {
  const wait = () => document.querySelector('.reading h4') ? done() : setTimeout(wait, 20);
  wait();
})"""


def press(tab: Browser, key: str, modifiers: int = 0) -> None:
    for kind in ("rawKeyDown", "keyUp"):
        tab.call("Input.dispatchKeyEvent", type=kind, key=key, code=key, modifiers=modifiers)


def click(tab: Browser, selector: str, share: tuple[float, float]) -> None:
    """Press the mouse at a share (down, across) of an element."""
    tab.run(f"document.querySelector('{selector}').scrollIntoView({{block: 'center'}})")
    place = tab.run(f"(() => {{ const r = document.querySelector('{selector}').getBoundingClientRect();"
                    "return [r.x, r.y, r.width, r.height]; })()")  # fmt: skip
    x, y = place[0] + share[1] * place[2], place[1] + share[0] * place[3]
    for kind in ("mousePressed", "mouseReleased"):
        tab.call("Input.dispatchMouseEvent", type=kind, x=x, y=y, button="left", buttons=1, clickCount=1)


def shown(tab: Browser, report: Report, row: int, col: int) -> None:
    """The reading is that of a pixel."""
    text, renderer = tab.run(READ), ReferenceRenderer(report.table)
    channel = report.table.channels[report.table.cfa[row % 2, col % 2]]
    assert f"Row {row}, column {col}: site ({row % 2}, {col % 2}) {channel}" in text
    for number, layer in enumerate(report.table.layers):
        assert f"{renderer.labels(report.raw, number)[row, col]} of {len(layer.weights)}" in text


@pytest.mark.parametrize("width", [1200, 400])
def test_a_pixel_is_chosen_by_click_and_by_keys(tab: Browser, report: Report, width: int) -> None:
    tab.open(report.page, width)
    tab.run(READY)
    shown(tab, report, SIZE[0] // 2, SIZE[1] // 2)
    click(tab, ".crops img", (10.5 / SIZE[0], 20.5 / SIZE[1]))
    shown(tab, report, 10, 20)
    tab.run("document.querySelector('.crops .view').focus()")
    press(tab, "ArrowRight")
    press(tab, "ArrowDown", modifiers=8)
    shown(tab, report, 20, 21)
    for _ in range(4):
        press(tab, "ArrowUp", modifiers=8)
    shown(tab, report, 0, 21)
    click(tab, ".under img", (50.5 / SIZE[0], 80.5 / SIZE[1]))
    shown(tab, report, 50, 80)
    taps = sum(layer.weights.shape[1] * layer.weights.shape[2] for layer in report.table.layers) + 25
    assert tab.run("document.querySelectorAll('.reading rect').length") == taps
    assert tab.run("document.querySelectorAll('.reading b').length") == 0
    assert tab.complaints() == []
    assert tab.run("document.documentElement.scrollWidth") <= width


def test_the_drawn_transform_is_that_of_the_class(tab: Browser, report: Report) -> None:
    tab.open(report.page)
    tab.run(READY)
    index = int(ReferenceRenderer(report.table).labels(report.raw)[SIZE[0] // 2, SIZE[1] // 2])
    answer = tab.run("[...document.querySelectorAll('.layer:nth-of-type(1) rect title')].map((each) => each.textContent)")
    drawn = np.array([float(text.replace("−", "-")) for text in answer[25:]]).reshape(3, 25)
    wanted = report.table.first.weights[index]
    assert np.abs(drawn - wanted).max() <= 0.06 * np.abs(wanted).max()  # two digits of a weight in 127 roots
    roles = tab.run(
        "[...document.querySelectorAll('.crops .view')].map((each) => [each.tabIndex, each.getAttribute('role')])"
    )
    assert roles == [[0, "application"]] * 3
    assert tab.run("document.querySelector('.reading').getAttribute('aria-live')") == "polite"


@pytest.mark.parametrize("width", [1200, 400])
def test_any_class_is_looked_at_without_the_picture(tab: Browser, report: Report, width: int) -> None:
    """By keys alone: the list is opened, a layer, a site and a class chosen."""
    tab.open(report.page, width)
    tab.run(READY)
    tab.run("document.querySelector('.classes summary').focus()")
    tab.call("Input.dispatchKeyEvent", type="keyDown", key="Enter", code="Enter", text="\r", windowsVirtualKeyCode=13)
    tab.run(READY.replace(".reading h4", ".classes h5"))
    layer, site, classes = (f"document.querySelectorAll('.classes select')[{number}]" for number in range(3))
    each = len(report.table.first.weights) // 4
    assert tab.run(f"{classes}.length") == each
    tab.run(f"{site}.focus()")
    press(tab, "ArrowDown")
    assert tab.run(f"{site}.selectedOptions[0].text") == "(0, 1) <b>"
    pixels = np.bincount(ReferenceRenderer(report.table).labels(report.raw).ravel(), minlength=4 * each)[each : 2 * each]
    shares = [f"{100 * count / np.prod(SIZE):.2f} %" for count in sorted(pixels.tolist(), reverse=True)]
    assert tab.run(f"[...{classes}.options].map((each) => each.text.split(' · ')[0])") == shares
    tab.run(f"{classes}.focus()")
    press(tab, "ArrowDown")
    second = int(np.argsort(-pixels, kind="stable")[1]) + each
    words = class_words(report.table, second)
    answer = tab.run("document.querySelector('.classes .reading').innerText")
    assert f"{second} of {4 * each}" in answer
    assert words["level"] in answer
    assert f"{shares[1]} of its pixels" in answer
    taps = report.table.first.weights.shape[1] * report.table.first.weights.shape[2] + 25
    assert tab.run("document.querySelectorAll('.classes .reading rect').length") == taps
    tab.run(f"{layer}.focus()")
    press(tab, "ArrowDown")
    assert "structure" in tab.run("document.querySelector('.classes .reading').innerText")
    assert tab.complaints() == []
    assert tab.run("document.documentElement.scrollWidth") <= width


def test_without_scripts_the_crops_are_pictures(tab: Browser, report: Report) -> None:
    tab.open(report.page, scripts=False)
    tab.call("Emulation.setScriptExecutionDisabled", value=False)
    assert not tab.run("document.querySelector('.reading').checkVisibility()")
    assert not tab.run("document.querySelector('.hint span').checkVisibility()")
    assert not tab.run("document.querySelector('.classes').checkVisibility()")
    assert tab.run("[...document.querySelectorAll('.crops img')].every((each) => each.checkVisibility())")
