"""Tables exported as C99 source and as arrays yield the same classes and outputs as the reference renderer."""

import ctypes
import dataclasses
import itertools
import json
import os
import re
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import ArrayLike, NDArray

from l3cli.artifacts.plane_rules import StructureRule, TreeRule
from l3cli.artifacts.table import TransformTable
from l3cli.classes import direction
from l3cli.errors import InputFileError
from l3cli.export.folder import folder_files
from l3cli.export.source import Words, c_files
from l3cli.export.wordlengths import OUTPUT_TOP, SEED, SHAPE, drawn_mosaic, output_fraction, short_cost, short_words
from l3cli.frames.frame import RawFrame
from l3cli.physics.stokes import COLOUR_STOKES
from l3cli.rendering.reference import ReferenceRenderer
from tests.helpers.tables import (
    random_table,
    with_clipped_white,
    with_clipping,
    with_coarse_chroma,
    with_components,
    with_first,
    with_low_noise,
    with_refinement,
    with_smoothed_chroma,
    with_spectra,
    with_stokes_layer,
    with_tree,
)

CC = os.environ.get("CC") or shutil.which("cc") or shutil.which("gcc")
ARM, QEMU = shutil.which("arm-linux-gnueabihf-gcc"), shutil.which("qemu-arm")
WARNINGS = ["-std=c99", "-Wall", "-Wextra", "-Wconversion", "-Wpedantic", "-Werror"]
XTRANS = ["gbggrg", "rgrbgb", "gbggrg", "grggbg", "brbgrg", "grggbg"]
SIX = [["rgb".index(letter) for letter in row] for row in XTRANS]


def a_table(cfa: ArrayLike, bits: int, black_level: float, **keys: Any) -> TransformTable:
    """A random table in which what is not saturated has case 0: there chromas, structures and leaves decide."""
    table = random_table(cfa, bits, black_level, **keys)
    cases = table.first.rule.case_of_code.copy()
    cases[0], cases[-1] = 0, cases.max()
    return with_first(table, rule=dataclasses.replace(table.first.rule, case_of_code=cases))


def with_strengths(table: TransformTable, *edges: int) -> TransformTable:
    """The table with other edges of strength in its refinement layers, as many as they had."""
    later = []
    for layer in table.later:
        assert isinstance(layer.rule, StructureRule)
        few = np.array(edges[: layer.rule.strengths], np.uint32)
        later.append(dataclasses.replace(layer, structure=dataclasses.replace(layer.rule, strength_edges=few)))
    return dataclasses.replace(table, later=tuple(later))


TABLES: dict[str, Callable[[], TransformTable]] = {
    "one layer, 2 × 3, 16 bits": lambda: a_table([[0, 1, 2], [2, 0, 1]], 16, 600.25, contrasts=(0.5, 3.0)),
    "directions, two outputs": lambda: a_table(
        [[0, 1], [1, 2]], 10, 40.0, outputs=("a", "b"), contrasts=(),
        direction=direction.DirectionKeys(orientations=8, strengths=(4.0,), coherence=0.5),
    ),
    "three layers, 2 × 4, 16 bits": lambda: with_strengths(
        with_refinement(a_table([[0, 1, 2, 1], [2, 1, 0, 1]], 16, 64.0, patch=7, contrasts=(), chroma_dither=True), 3, 5),
        5_000_000, 100_000_000, 700_000_000, 1_500_000_000,
    ),
    "smoothed chroma": lambda: with_smoothed_chroma(a_table([[0, 1], [1, 2]], 12, 64.0, patch=5)),
    "raised luminance": lambda: with_clipped_white(
        with_smoothed_chroma(a_table([[0, 1, 2, 1], [1, 2, 1, 0]], 12, 64.0, patch=5)), 0.5
    ),
    "smoothed spectra": lambda: with_spectra(a_table([[0, 1], [2, 3]], 12, 64.0, outputs=tuple("abcd")), 5, 0.4),
    "corrected bands": lambda: with_components(
        a_table([[0, 1], [2, 3]], 16, 600.25, patch=7, outputs=tuple("abcdef"), contrasts=()), 3
    ),
    "colours and polarisation": lambda: with_clipped_white(
        with_stokes_layer(a_table([[0, 1], [2, 3]], 12, 64.0, outputs=COLOUR_STOKES, contrasts=())), 0.2
    ),
    "coarse chroma": lambda: with_clipping(
        with_coarse_chroma(with_refinement(a_table([[0, 1], [2, 3]], 12, 64.0, contrasts=(), chroma_dither=True), 5), 0.1)
    ),
    "clipped white": lambda: with_clipped_white(
        with_refinement(a_table([[0, 1], [2, 3]], 12, 64.0, contrasts=()), 5), 0.2
    ),
    "no filters": lambda: a_table([[0]], 12, 64.0),
    "luminance": lambda: a_table([[0, 1], [1, 2]], 12, 64.0, outputs=("Y",)),
    "a tree, 6 × 6": lambda: with_tree(a_table(SIX, 12, 64.0, contrasts=()), ratios=2),
}  # fmt: skip
needs_compiler = pytest.mark.skipif(CC is None, reason="there is no C compiler (cc, gcc or CC)")


class Built:
    """A table, the folder with its C source, and l3_render of it."""

    def __init__(self, table: TransformTable, folder: Path, words: Words) -> None:
        self.table, self.folder, self.words = table, folder, words
        for name, content in c_files(table, words).items():
            (folder / name).write_bytes(content)
        compile_c(folder, "-O1", "-fPIC", "-c", "l3_table.c")
        compile_c(folder, "-O1", "-fPIC", "-shared", "l3.c", "l3_table.o", "-o", "l3.so")
        self._library: Any = ctypes.CDLL(str(folder / "l3.so"))
        self._library.l3_workspace_bytes.restype = ctypes.c_size_t

    def render(self, frame: RawFrame) -> tuple[NDArray[np.uint32], NDArray]:
        """Labels (layer, row, col) and outputs (output, row, col); the workspace is full of rubbish before."""
        rows, columns = frame.values.shape
        workspace = np.full(self._library.l3_workspace_bytes(rows, columns), 0xA5, np.uint8)
        labels = np.empty((len(self.table.layers), rows, columns), np.uint32)
        outputs = np.empty((len(self.table.outputs), rows, columns), self.words)
        raw, *buffers = (
            array.ctypes.data_as(ctypes.c_void_p)
            for array in (np.ascontiguousarray(frame.values), workspace, labels, outputs)
        )
        assert self._library.l3_render(raw, rows, columns, *frame.phase, *buffers) == 0
        return labels, outputs

    def refuses(self, rows: int, columns: int, phase: tuple[int, int]) -> bool:
        return bool(self._library.l3_render(None, rows, columns, *phase, None, None, None) == -1)


def compile_c(folder: Path, *arguments: str, compiler: str | None = CC) -> None:
    done = subprocess.run([str(compiler), *WARNINGS, *arguments], cwd=folder, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


CASES: list[tuple[str, Words]] = [(name, "float32") for name in TABLES]
CASES += [
    ("one layer, 2 × 3, 16 bits", "int16"),
    ("coarse chroma", "int16"),
    ("clipped white", "int16"),
    ("no filters", "int16"),
    ("luminance", "int16"),
    ("a tree, 6 × 6", "int16"),
    ("raised luminance", "int16"),
    ("smoothed chroma", "int16"),
]


@pytest.fixture(scope="module", params=CASES, ids=", ".join)
def built(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Built:
    name, words = request.param
    return Built(TABLES[name](), tmp_path_factory.mktemp("c"), words)


def mosaic(table: TransformTable, shape: tuple[int, int], seed: int, level: float, phase: tuple[int, int]) -> RawFrame:
    """Texture about a level, a share of full scale; every seventh pixel is anything that 16 bits hold."""
    rng = np.random.default_rng(seed)
    span = table.white_level - table.black_level
    blocks = rng.normal(size=(shape[0] // 5 + 1, shape[1] // 5 + 1)).repeat(5, 0).repeat(5, 1)[: shape[0], : shape[1]]
    values = table.black_level + level * span * (1 + 0.4 * blocks + 0.1 * rng.normal(size=shape))
    values = np.where(rng.random(shape) < seed % 2 / 7, rng.integers(0, 2**16, shape), values)
    return RawFrame("drawn", np.clip(values, 0, 2**16 - 1).astype(np.uint16), table.black_level, table.white_level, phase)


def steps_rounded_off(table: TransformTable) -> float:
    """By how many steps words can differ because weights are rounded, on the worst of all frames."""
    last, words = table.layers[-1], short_words(table)
    off = np.abs(words.in_floats(table).astype(float) - last.weights).sum(axis=-1).max()
    return float(off * (16 if table.later else 1) * 2 ** output_fraction(table))


@needs_compiler
@settings(max_examples=12, deadline=None, derandomize=True)
@given(st.data())
def test_any_mosaic_gets_the_classes_and_outputs_of_the_reference(built: Built, data: st.DataObject) -> None:
    table = built.table
    shape = data.draw(st.tuples(st.integers(1, 24), st.sampled_from([1, 2, 3, 7, 30, 131, 160])))
    phase = data.draw(st.tuples(*(st.integers(0, length - 1) for length in table.cfa.shape)))
    frame = mosaic(table, shape, data.draw(st.integers(0, 999)), data.draw(st.sampled_from([0.003, 0.05, 0.4, 1.1])), phase)
    labels, outputs = built.render(frame)
    exact, expected_labels = ReferenceRenderer(table).exact_classified(frame)
    np.testing.assert_array_equal(labels, expected_labels)
    if built.words == "int16":
        words = np.clip(np.rint(np.ldexp(exact, output_fraction(table))), -OUTPUT_TOP, OUTPUT_TOP)
        most = 4 if table.chroma_smoothing else 1  # weights of the smoothing amplify rounding errors
        if table.chroma_smoothing and table.white_signals is not None:
            most = 32  # ratios of random outputs, by which pixels are raised, are much larger than ratios of real colours
        assert np.abs(outputs - words).max() <= most + steps_rounded_off(table)
        return
    weights = np.abs(table.layers[-1].weights).sum(axis=-1).max()  # 16 in random layers: terms cancel, roundings do not
    errors = 16 if table.chroma_smoothing else 4
    assert np.abs(outputs - exact).max() <= errors * 2.0**-24 * weights * max(1.0, np.abs(exact).max())


def test_words_of_smoothed_spectra_are_refused() -> None:
    with pytest.raises(InputFileError, match="smooths spectra, which the C source supports only in floating point"):
        c_files(TABLES["smoothed spectra"](), "int16")


@needs_compiler
@pytest.mark.parametrize(
    "built",
    [CASES[0], ("raised luminance", "float32"), pytest.param(CASES[2], marks=pytest.mark.soak), CASES[-1]],
    indirect=True,
    ids=", ".join,
)
def test_the_test_program_agrees_under_sanitizers(built: Built) -> None:
    compile_c(built.folder, "-O1", "-fsanitize=address,undefined", "l3.c", "test.c", "l3_table.o", "-o", "l3_test")
    done = subprocess.run(["./l3_test"], cwd=built.folder, capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.startswith("classes that differ: 0 of ")
    wrong = bytearray((built.folder / "test_labels.bin").read_bytes())
    wrong[-4] ^= 1
    other = built.folder / "spoiled"
    other.mkdir()
    for name in ("test_raw.bin", "test_outputs.bin"):
        shutil.copy(built.folder / name, other)
    (other / "test_labels.bin").write_bytes(wrong)
    done = subprocess.run(["../l3_test"], cwd=other, capture_output=True, text=True)
    assert done.returncode == 1
    assert done.stdout.startswith("classes that differ: 1 of ")


@needs_compiler
@pytest.mark.parametrize("built", [case for case in CASES if case[1] == "int16"], indirect=True, ids=", ".join)
def test_short_words_cost_what_is_stated(built: Built) -> None:
    table = built.table
    frame = RawFrame("drawn", drawn_mosaic(table, SHAPE, SEED), table.black_level, table.white_level)
    top = OUTPUT_TOP / 2 ** output_fraction(table)
    exact = np.clip(ReferenceRenderer(table).exact_outputs(frame), -top, top)
    made = np.ldexp(built.render(frame)[1].astype(float), -output_fraction(table))
    stated, _ = short_cost(table, short_words(table))
    assert abs(-10 * np.log10(np.square(made - exact).mean()) - stated) < 0.1
    assert f"relative to the reference is {stated:.1f} dB" in (built.folder / "README.md").read_text(encoding="utf-8")


@needs_compiler
@pytest.mark.parametrize("built", [case for case in CASES if case[1] == "int16"], indirect=True, ids=", ".join)
def test_short_words_pass_the_test_of_their_own_folder(built: Built) -> None:
    compile_c(built.folder, "-O1", "l3.c", "test.c", "l3_table.o", "-o", "l3_test")
    done = subprocess.run(["./l3_test"], cwd=built.folder, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout
    found = re.search(r"largest difference of an output: (\d+) ", done.stdout)
    limit = re.search(r"L3_TEST_STEPS (\d+)", (built.folder / "l3_table.h").read_text())
    assert found is not None
    assert limit is not None
    assert int(limit[1]) <= 2 * max(1, int(found[1])), "a limit that no fault exceeds tests nothing"


def test_the_range_of_short_words_holds_the_clipped_white() -> None:
    table, brighter = (with_clipped_white(a_table([[0, 1], [1, 2]], 12, 64.0), luminance) for luminance in (1.6, 5.6))
    assert (output_fraction(table), output_fraction(brighter)) == (12, 11)
    files = c_files(brighter, "int16")
    assert b"#define L3_OUTPUT_FRACTION 11\n" in files["l3_table.h"]
    assert "range is ±16" in files["README.md"].decode()


@needs_compiler
def test_sizes_and_phases_that_cannot_be_are_refused(built: Built) -> None:
    rows, _ = built.table.cfa.shape
    for shape, phase in (((0, 9), (0, 0)), ((9, -1), (0, 0)), ((70_000, 9), (0, 0)), ((9, 9), (rows, 0)), ((9, 9), (0, -1))):
        assert built.refuses(*shape, phase)


@needs_compiler
@pytest.mark.parametrize("built", [case for case in CASES if case[0] == "a tree, 6 × 6"], indirect=True, ids=", ".join)
@pytest.mark.skipif(ARM is None or QEMU is None, reason="needs arm-linux-gnueabihf-gcc and qemu-arm")
def test_32_bit_arm_agrees(built: Built) -> None:
    compile_c(built.folder, "-O1", "-static", "l3.c", "l3_table.c", "test.c", "-o", "l3_arm", compiler=ARM)
    done = subprocess.run([str(QEMU), "./l3_arm"], cwd=built.folder, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr


def test_numbers_do_not_follow_the_print_options_of_numpy() -> None:
    table = with_tree(random_table([[0, 1], [1, 2]], 12, 64.1, patch=3))
    with np.printoptions(legacy=False):
        plain = c_files(table)
    with np.printoptions(legacy="1.13", precision=3):  # as a library may set them
        assert c_files(table) == plain
    text = plain["l3_table.c"].decode()
    numbers = re.search(r"float layer2_threshold\[\d+\] = {([^}]*)}", text)
    assert numbers is not None
    (rule,) = [layer.rule for layer in table.later if isinstance(layer.rule, TreeRule)]
    found = np.array(re.findall(r"[-+.e0-9]+(?=f)", numbers[1]), np.float32)
    assert set(found) <= set(rule.threshold.ravel().astype(np.float32))


def test_transforms_beyond_short_words_are_refused() -> None:
    table = random_table([[0, 1], [1, 2]])
    with pytest.raises(InputFileError, match="too large for 16-bit words"):
        short_words(with_first(table, weights=table.first.weights * 1e6))
    zero = short_words(with_first(table, weights=table.first.weights * 0))
    assert not zero.whole.any()


@pytest.mark.parametrize("name", ["one layer, 2 × 3, 16 bits", "a tree, 6 × 6"])
def test_no_sum_of_short_words_leaves_32_bits(name: str) -> None:
    table = TABLES[name]()
    table = dataclasses.replace(table, later=table.later[-1:])
    words, weights = short_words(table), table.layers[-1].weights
    whole, high = np.abs(words.whole).astype(np.int64), 2**11
    sums = whole.sum(axis=-1) * high + np.abs(words.intercept.astype(np.int64)) + (1 << words.fraction.astype(np.int64) >> 1)
    assert sums.max() < 2**31 - whole.sum(axis=-1).max()
    assert (whole.sum(axis=-1) << words.split).max() < 2**31
    windows = table.later[-1].window_taps if table.later else whole.shape[-1]
    second = np.maximum(np.sort(whole[..., :windows], axis=-1)[..., -2], whole[..., windows:].max(axis=-1, initial=0))
    assert (second < 2**15).all(), "only the largest of a window may be beyond 16 bits"
    finer = sums > 2**30 - 2**26
    finer |= second > 2**14 - 16
    assert finer.all(), "a bit more fits"
    off = (words.in_floats(table).astype(float) - weights)[..., :windows]
    unit = np.abs(off).max(axis=-1) / (np.abs(weights).max(axis=-1) / whole.max(axis=-1))
    assert 0.5 < np.median(unit) < 2, "weights are moved by more than what rounding them leaves"
    assert np.abs(off.sum(axis=-1)).max() < np.abs(off).sum(axis=-1).min(), "errors of neighbours add up"


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


def test_arrays_of_the_second_set_stand_next_to_the_usual_ones() -> None:
    """As another table's would; what both sets share stands once, and a table of one set is written as ever."""
    table = with_low_noise(with_refinement(random_table([[0, 1], [1, 2]], 12, 64.0), 3), 0.25)
    document, arrays = read_folder(table)
    usual, usual_arrays = read_folder(dataclasses.replace(table, conditions=()))
    other, other_arrays = read_folder(table.under(table.conditions[0]))
    (low,) = document.pop("conditions")["sets"]
    assert low["noise"] == {"gain": 1.0, "noise_left": 0.25, "limit": 0.25**0.75}
    assert (low["layers"], low["word_lengths"]) == (other["layers"], other["word_lengths"])
    after = {name: values for name, values in arrays.items() if not name.startswith("conditions/0/")}
    assert set(after) == set(usual_arrays)
    assert document | {"arrays": []} == usual | {"arrays": []}
    for name, values in other_arrays.items():
        np.testing.assert_array_equal(arrays.get(f"conditions/0/{name}", arrays[name]), values)
    assert {"conditions/0/layer0/weights", "conditions/0/layer0/contrast_edges", "conditions/0/test_outputs"} < set(arrays)
    assert not {"conditions/0/test_raw", "conditions/0/layer0/level_edges", "conditions/0/layer0/count"} & set(arrays)
