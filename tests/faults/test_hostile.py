"""Nobody's file harms: spoilt inputs of every kind are refused in one line, and decoders run apart, within limits."""

import dataclasses
import io
import json
import os
import re
import shutil
import struct
import subprocess
import sys
import tempfile
import time
import tracemalloc
import zlib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from l3cli.artifacts.container import seal
from l3cli.artifacts.layers import MosaicLayer
from l3cli.artifacts.store import save
from l3cli.classes.names import kind_name
from l3cli.errors import InputFileError
from l3cli.io import apart
from l3cli.io.images import read_image, write_mosaic
from l3cli.limits import MEGAPIXELS, MOST_TEXT, TRUST
from tests.helpers import hostile_numbers, hostile_physics
from tests.helpers.cameras import BAYER
from tests.helpers.decoders import abort, crash, echo, hoard, sleep, stumble, work, write_much
from tests.helpers.fuzz import Seeded
from tests.helpers.hostile import SUBJECTS, Subject, Workshop, confined, watched
from tests.helpers.hostile_identities import Identities
from tests.helpers.hostile_numbers import OPTIONS, RECIPES, Call
from tests.helpers.hostile_special_files import SpecialFiles
from tests.helpers.paths import CONFIGS, ROOT
from tests.helpers.tables import random_table
from tests.helpers.tasks import PATIENCE

IDENTITIES = 40
INPUTS = int(os.environ.get("L3_HOSTILE_INPUTS", "500"))  # of all subjects together
PHYSICS = 3  # inputs of each physical mistake
EACH = settings(
    max_examples=-(-INPUTS // len(SUBJECTS)),
    deadline=None,
    derandomize=True,
    database=None,
    suppress_health_check=list(HealthCheck),
)


class Drawn:
    """Choices of Hypothesis."""

    def __init__(self, data: st.DataObject) -> None:
        self._data = data

    def integer(self, least: int, most: int) -> int:
        return self._data.draw(st.integers(least, most))


@pytest.fixture(scope="module")
def workshop(tmp_path_factory: pytest.TempPathFactory) -> Workshop:
    return Workshop(tmp_path_factory.mktemp("hostile"))


@pytest.fixture
def shop(workshop: Workshop) -> Iterator[Workshop]:
    with confined():
        yield workshop


@pytest.mark.parametrize("subject", SUBJECTS, ids=lambda subject: subject.name)
def test_a_spoilt_input_is_refused_or_read_and_nothing_else(shop: Workshop, subject: Subject) -> None:
    @EACH
    @given(st.data())
    def judge(data: st.DataObject) -> None:
        with watched(Path(tempfile.gettempdir())) as seen:
            assert shop.judge(subject, Drawn(data)) is None
        assert not seen

    judge()


def test_an_output_that_is_an_input_is_refused_whatever_it_is_called(shop: Workshop) -> None:
    identities = Identities(shop)
    for seed in range(IDENTITIES):
        assert identities.judge(Seeded(seed)) is None


@pytest.fixture(scope="module")
def lab(tmp_path_factory: pytest.TempPathFactory) -> hostile_physics.Lab:
    return hostile_physics.Lab(tmp_path_factory.mktemp("physics") / "lab")


@pytest.mark.parametrize("seed", range(PHYSICS))
@pytest.mark.parametrize("mistake", hostile_physics.MISTAKES, ids=lambda mistake: mistake.__name__)
def test_a_physical_mistake_is_named_or_undone(
    lab: hostile_physics.Lab, mistake: Callable[..., hostile_physics.Expected], seed: int
) -> None:
    assert lab.judge(mistake, Seeded(seed)) is None


@pytest.mark.parametrize(("name", "trials"), [("options", 60), ("environment", 6), *((name, 6) for name in RECIPES)])
def test_a_number_that_nobody_meant_is_refused_or_taken(shop: Workshop, name: str, trials: int) -> None:
    subject = next(subject for subject in hostile_numbers.subjects(shop) if subject.name == name)
    for seed in range(trials):
        call = subject.draw(Seeded(seed))
        assert subject.judge(shop, call) is None, call


@pytest.mark.parametrize("seed", range(60))
def test_a_place_that_is_no_file_is_refused_at_once(shop: Workshop, seed: int) -> None:
    trial = SpecialFiles().draw(Seeded(seed))
    assert SpecialFiles().judge(shop, trial) is None, trial


KEPT_NUMBERS = [
    Call(OPTIONS[0].replace("{n}", "29.97002997")),
    Call("train training.h5 --classes classes.toml -o {out}/t.h5 --shard 1/1" + 23 * "0"),
    Call("render table.h5 stack.npy -o {out}/p --backend reference --frames 0-9999999999 --skip-bad"),
    Call("render table.h5 - -o {out}/%d.png --backend reference --size 2000000x24000000"),  # memory of the size
]


@pytest.mark.parametrize("call", KEPT_NUMBERS, ids=str)
def test_numbers_that_once_failed_stay_mended(shop: Workshop, call: Call) -> None:
    assert hostile_numbers.judge(shop, call) is None


# Failures of the long runs, each mended at its cause: a subject, a command, what is replaced in the whole file.
KEPT: list[tuple[str, int, bytes, bytes]] = [
    ("frame.npy", 0, b"(20, 24)", b"(20, 24\n"),  # Python's tokenizer fails on the header
    ("lab.toml", 0, b"step_nm = 30.0", b"step_nm = 1e-30"),  # more wavelengths than there is memory
    ("lab.toml", 0, b"hot_pixels_per_million = 400", b"hot_pixels_per_million = 1e20"),
    ("classes.toml", 0, b"draws = 2", b"draws = 100000"),  # years
    ("classes.toml", 0, b"patches = 300", b"patches = 4294967296"),
    ("classes.toml", 0, b"chromas = 2", b"chromas = 1000"),  # k-means of minutes before the limit was checked
    ("curves.toml", 0, b"fixed_pattern_seed = 3", b"fixed_pattern_seed = 9223372036854775808"),
    ("camera.toml", 0, b"bits = 12", b"bits = 2147483647"),
    ("camera.toml", 0, b"[400, 700, 10]", b"[400, 1e20, 1e-9]"),
    ("scenes.toml", 0, b"count = 1", b"count = 4294967296"),
    ("lab/MEASUREMENTS.toml", 0, b"cols = 128", b"cols = 128282828"),
    ("lab/spectra/chart_010_D65.csv", 0, b"\n419", b"\n418.9" + 24 * b",-1e300" + b"\n419"),  # least squares never end
    ("evaluation.json", 0, b"30.5", b"1e300"),  # an axis without end
    ("evaluation.json", 0, b": 10", b": -10"),
    ("training.h5", 1, b"SNOD", b"SNOX"),  # HDF5's own list of a group's members is broken
    ("table.h5", 0, b"SNOD", b"SNOX"),
    ("scenes.toml", 0, b"analog_gain = 1.5", b"analog_gain = 1e-300"),  # a gain at which black and white fall together
    ("lab.toml", 0, b"[white]", b"[white]\nluminance = -1"),
    ("classes.toml", 0, b"chromas = 2", b"chromas = 0"),
    ("channels.exr", 0, b"lineOrder\0lineOrder", b"lineOrder\0lineOr\x01er"),  # a control character in the decoder's message
]


@pytest.mark.parametrize(("name", "command", "old", "new"), KEPT)
def test_files_that_once_failed_stay_mended(shop: Workshop, name: str, command: int, old: bytes, new: bytes) -> None:
    subject = next(subject for subject in SUBJECTS if subject.name == name)
    assert old in shop.whole[name]
    assert shop.judge_content(subject, shop.whole[name].replace(old, new), command) is None


KEPT_VALUES: list[tuple[str, int, str, Any]] = [
    ("training.h5", 1, "frames/00000/white", np.array([-1e30, 100.0, 108.9])),  # moments that run over
    ("training.h5", 1, "frames/00000/luminance", -1.0),
    ("training.h5", 2, "outputs", np.array([b"X", b"Y"])),
    ("sums.h5", 0, "sites", np.array([1, 2, 3])),  # sums of sites that the camera does not train
    ("sums.h5", 0, "training/camera/pixel_pitch", 1e-25),  # a pixel that takes ages to fill
    ("table.h5", 0, "first/rule/shift", -1),
    ("table.h5", 1, "bits", 4096),
    ("camera.h5", 2, "wavelength", np.linspace(1.0, 1e12, 31)),
    ("camera.h5", 2, "gain", 0.0),
    ("camera.h5", 0, "history", np.bytes_(b'[{"command": 1, "options": []}]')),
]


@pytest.mark.parametrize(("name", "command", "dataset", "value"), KEPT_VALUES)
def test_values_that_once_passed_stay_refused(shop: Workshop, name: str, command: int, dataset: str, value: Any) -> None:
    subject = next(subject for subject in SUBJECTS if subject.name == name)
    image = io.BytesIO(shop.whole[name])
    with h5py.File(image, "r+") as root:
        attributes = dict(root[dataset].attrs)
        del root[dataset]
        root[dataset] = value
        root[dataset].attrs.update(attributes)
    assert shop.judge_content(subject, image.getvalue(), command) is None


def test_a_camera_of_many_channels_does_not_compare_all_patterns_in_pairs() -> None:
    """16 channels have 65536 patterns: all against all would be 32 GB."""
    table = random_table(np.arange(16).reshape(4, 4), patch=5)
    rule = dataclasses.replace(table.first.rule, case_of_code=np.minimum(np.arange(2**16), 2).astype(np.uint16))
    weights = np.zeros((table.cfa.size * rule.classes_per_site, 3, 25), np.float32)
    each: dict[str, Any] = {
        "intercept": weights[:, :, 0],
        "samples": np.ones(len(weights)),
        "condition": np.ones(len(weights), np.float32),
    }
    first = MosaicLayer(rule, weights, **each)
    table = dataclasses.replace(table, first=first, channels=tuple("abcdefghijklmnop"))
    assert kind_name(table, table.first.rule.chromas) == "saturated a"
    assert kind_name(table, table.first.rule.chromas + 1) == "saturated a+b+c+d+e+f+g+h+i+j+k+l+m+n+o+p"


# ----------------------------------------------------------------------------------------------------- decoding apart
@pytest.fixture
def limited(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    for name in ("f", "bad.dng"):
        (tmp_path / name).touch()
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join(sys.path))
    monkeypatch.setenv("L3_DECODE_SECONDS", "1")
    monkeypatch.setenv(MEGAPIXELS, "4")
    monkeypatch.delenv(TRUST, raising=False)


def test_values_come_back_as_they_went_and_one_child_decodes_all(limited: None) -> None:
    first, second = echo(Path("f"), "é\udcff", None), echo(Path("f"), "", 2**70)
    assert first["process"] == second["process"] != os.getpid()
    assert (first["told"], second["told"]) == (("é\udcff", None, [1.5, True]), ("", 2**70, [1.5, True]))
    arrays = first["arrays"]
    assert (arrays["empty"].shape, arrays["empty"].dtype, arrays["one"]) == ((0, 3), np.float32, 2.5)
    assert arrays["F"].tolist() == [[0, 1, 2], [3, 4, 5]]
    assert (arrays["F"].dtype, arrays["F"].flags.f_contiguous) == (np.dtype(">u2"), True)
    assert arrays["C"].tolist() == [False, False, True, True]


@pytest.mark.parametrize(
    ("decoder", "message"),
    [
        (crash, "makes its decoder crash (SIGSEGV)"),
        (abort, "makes its decoder crash (SIGABRT)"),
        (work, "takes longer than 1 s to decode"),
        (hoard, "needs more memory to decode"),
        (stumble, "cannot be decoded (IndexError: list index"),
        (write_much, "File too large"),
    ],
)
def test_a_file_at_worst_ends_its_decoder(limited: None, decoder: Callable[[Path], None], message: str) -> None:
    with pytest.raises(InputFileError, match=r"^bad.dng") as caught:
        decoder(Path("bad.dng"))
    assert message in str(caught.value)
    assert echo(Path("f"), "still here", 0)["told"][0] == "still here"


def test_a_decoder_that_sleeps_is_ended_by_the_clock(limited: None, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(apart, "PATIENCE", 1)
    with pytest.raises(InputFileError, match="takes longer"):
        sleep(Path("bad.dng"))


def test_who_trusts_decodes_here(limited: None, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(TRUST, "1")
    assert echo(Path("f"), "", 0)["process"] == os.getpid()
    with pytest.raises(InputFileError, match=r"^f cannot be decoded \(IndexError"):
        stumble(Path("f"))


def test_trust_is_an_option(l3: Callable, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    seen = []
    monkeypatch.setattr(apart._Child, "ask", lambda *_: seen.append("asked"))
    table = dataclasses.replace(random_table(BAYER, bits=12, black_level=64.0), rows=20, cols=24)
    save(table, tmp_path / "table.h5")
    write_mosaic(tmp_path / "a.tif", np.full((20, 24), 900, np.uint16))
    call = ("render", tmp_path / "table.h5", tmp_path / "a.tif", "--backend", "reference", "-o", tmp_path / "a.png")
    assert l3(*call, "--trust")[0] == 0
    assert (seen, os.environ.get(TRUST)) == ([], None)


@pytest.mark.parametrize(
    "answer",
    [
        b"no json",
        b"[]",
        b'{"dict": {}}',
        b'{"dict": {"error": "SystemExit", "message": "0"}}',
        b'{"dict": {"value": {"array": ["<f8", [1000000000000], "C", 0]}}}',
        b'{"dict": {"value": {"array": ["<f8", [4], "C", -8]}}}',
        b'{"dict": {"value": {"array": ["O", [1], "C", 0]}}}',
        b'{"dict": {"value": {"array": ["<u2", [-1, -4], "C", 0]}}}',
        b"[" * 100_000,
    ],
)
def test_a_child_that_lies_is_not_believed(limited: None, monkeypatch: pytest.MonkeyPatch, answer: bytes) -> None:
    monkeypatch.setattr(apart, "receive", lambda *_: answer)
    with pytest.raises(InputFileError, match=r"^f makes its decoder talk nonsense"):
        echo(Path("f"), "", 0)


def test_the_child_ends_with_its_parent(limited: None) -> None:
    program = "import os, signal\nfrom pathlib import Path\nfrom tests.helpers.decoders import echo\n"
    program += "print(echo(Path('f'), '', 0)['process'], flush=True)\nos.kill(os.getpid(), signal.SIGKILL)"
    child = int(subprocess.run([sys.executable, "-c", program], capture_output=True, check=False).stdout)
    deadline = time.monotonic() + PATIENCE
    while lives(child):
        assert time.monotonic() < deadline, f"process {child} lives on"
        time.sleep(0.05)


def lives(process: int) -> bool:
    try:
        return "(zombie)" not in Path(f"/proc/{process}/status").read_text()
    except OSError:  # it is gone, perhaps since a moment ago
        return False


# -------------------------------------------------------------------------------------- refused before it is allocated


def png_bomb(rows: int, cols: int, bits: int = 16) -> bytes:
    """A grey PNG that claims so many pixels and unpacks to them."""

    def chunk(kind: bytes, content: bytes) -> bytes:
        return struct.pack(">I", len(content)) + kind + content + struct.pack(">I", zlib.crc32(kind + content))

    packer = zlib.compressobj(9)
    line = bytes(1 + cols * bits // 8)
    packed = b"".join(packer.compress(line) for _ in range(min(rows, 2000))) + packer.flush()
    header = struct.pack(">IIBBBBB", cols, rows, bits, 0, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", packed) + chunk(b"IEND", b"")


def tiff_bomb(rows: int, cols: int) -> bytes:
    """A grey 16-bit TIFF whose header claims so many pixels in one strip of nothing."""
    tags = [(256, 4, cols), (257, 4, rows), (258, 3, 16), (259, 3, 1), (262, 3, 1), (273, 4, 8), (277, 3, 1)]
    tags += [(278, 4, rows), (279, 4, 8)]
    entries = b"".join(struct.pack("<HHII", tag, kind, 1, value) for tag, kind, value in tags)
    return struct.pack("<2sHI", b"II", 42, 8) + struct.pack("<H", len(tags)) + entries + bytes(4)


def npy_header(shape: str, descr: str = "<u2") -> bytes:
    text = f"{{'descr': '{descr}', 'fortran_order': False, 'shape': {shape}, }}"
    text = text.ljust(117) + "\n"
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(text)) + text.encode()


BOMBS = {
    "png.png": png_bomb(60_000, 60_000),
    "unpacks.png": png_bomb(2000, 40_000),
    "tiff.tif": tiff_bomb(100_000, 100_000),
    "header.npy": npy_header("(100000, 100000)"),
    "overflow.npy": npy_header("(4294967296, 4294967296)"),
    "negative.npy": npy_header("(-3, -4)"),
    "object.npy": npy_header("(1, 1)", "|O"),
    "pgm.dng": b"P5 99999999 99999999 65535\n",
}


def test_bombs_are_refused_before_they_go_off(
    refused: Callable[..., str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(MEGAPIXELS, "60")
    save(random_table(BAYER, bits=12, black_level=64.0), tmp_path / "table.h5")
    for name, content in BOMBS.items():
        (tmp_path / name).write_bytes(content)
        start = time.monotonic()
        line = refused(3, "render", tmp_path / "table.h5", tmp_path / name, "-o", tmp_path / "a.png")
        assert name in line
        assert time.monotonic() - start < 5


def test_a_sparse_file_of_honest_size_is_refused_too(refused: Callable[..., str], tmp_path: Path) -> None:
    save(random_table(BAYER, bits=12, black_level=64.0), tmp_path / "table.h5")
    with open(tmp_path / "big.npy", "wb") as file:
        file.write(npy_header("(30000, 20000)"))
        file.truncate(128 + 2 * 30000 * 20000)
    tracemalloc.start()
    try:
        line = refused(3, "render", tmp_path / "table.h5", tmp_path / "big.npy", "-o", tmp_path / "a.png")
        assert tracemalloc.get_traced_memory()[1] < 100e6  # bytes: nothing of the file's 1.2 GB
    finally:
        tracemalloc.stop()
    assert "30000×20000 pixels" in line
    assert MEGAPIXELS in line


def test_endless_and_nested_texts_are_refused(
    refused: Callable[..., str], tmp_path: Path, bayer_recipe: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    call = ("--camera", bayer_recipe, "-o", tmp_path / "out.h5")
    with open(tmp_path / "endless.toml", "wb") as file:
        file.truncate(MOST_TEXT + 1)
    assert "MB" in refused(3, "simulate", tmp_path / "endless.toml", *call)
    assert "is a device; give a scene recipe" in refused(3, "simulate", "/dev/zero", *call)
    os.mkfifo(tmp_path / "pipe.toml")
    assert "is a pipe; give a scene recipe" in refused(3, "simulate", tmp_path / "pipe.toml", *call)
    for text in ("a = " + "[" * 5000 + "]" * 5000, "a = " + "9" * 5000, 'name = "\\u0000"', "exposure_s = [inf]"):
        (tmp_path / "odd.toml").write_text(text)
        assert "odd.toml" in refused(2, "simulate", tmp_path / "odd.toml", *call)
    (tmp_path / "odd.json").write_text("[" * 100_000)
    assert "odd.json" in refused(3, "compare", tmp_path / "odd.json")
    recipe = 'illuminants = ["{}"]\nexposure_share = [0.9]\n[[scene]]\nsource = "grey ramp"\nsize = [16, 16]\n'
    os.mkfifo(tmp_path / "pipe.csv")
    (tmp_path / "fifo.toml").write_text(recipe.format("pipe.csv"))
    assert "pipe.csv is a pipe; give a CSV file" in refused(3, "simulate", tmp_path / "fifo.toml", *call)


def test_hdf5_reaches_nowhere_else(refused: Callable[..., str], tmp_path: Path) -> None:
    """Links, data in other files and virtual datasets are refused by whatever reads them; info shows nothing of them."""
    secret = tmp_path / "secret"
    secret.write_bytes(b"top secret words" * 64)
    with h5py.File(tmp_path / "other.h5", "w") as root:
        root["frames"] = np.ones((2, 20, 24), np.uint16)
    makers: dict[str, Callable[[h5py.File, str], Any]] = {
        "external.h5": lambda root, name: root.__setitem__(name, h5py.ExternalLink("other.h5", "/frames")),
        "soft.h5": lambda root, name: root.__setitem__(name, h5py.SoftLink("/elsewhere")),
        "stored.h5": lambda root, name: root.create_dataset(name, (1, 16, 32), "u2", external=[(str(secret), 0, 1024)]),
        "virtual.h5": lambda root, name: root.create_virtual_dataset(name, virtual()),
    }

    def virtual() -> h5py.VirtualLayout:
        layout = h5py.VirtualLayout((2, 20, 24), "u2")
        layout[:] = h5py.VirtualSource(str(tmp_path / "other.h5"), "frames", (2, 20, 24))
        return layout

    save(random_table(BAYER, bits=12, black_level=64.0), tmp_path / "table.h5")
    for name, make in makers.items():
        with h5py.File(tmp_path / name, "w") as root:
            make(root, "frames")
        for more in ((), ("--dataset", "frames")):
            line = refused(3, "render", tmp_path / "table.h5", tmp_path / name, "-o", tmp_path / "a.png", *more)
            assert name in line
    with h5py.File(tmp_path / "table.h5", "r+") as root:
        del root["black_level"]
        root.create_dataset("black_level", (2,), "f8", external=[(str(secret), 0, 16)])
    seal(tmp_path / "table.h5")
    assert "another file" in refused(3, "info", tmp_path / "table.h5")


def test_groups_in_a_circle_are_walked_once(l3: Callable, tmp_path: Path) -> None:
    save(random_table(BAYER, bits=12, black_level=64.0), tmp_path / "table.h5")
    with h5py.File(tmp_path / "table.h5", "r+") as root:
        for name in ("round", "and", "again"):
            root[f"first/rule/{name}"] = root
            root[name] = root["first/rule"]
    seal(tmp_path / "table.h5")
    code, out, _ = l3("info", tmp_path / "table.h5")
    assert code == 0
    assert out.count("level_edges") == 1


def test_a_playlist_is_no_video(refused: Callable[..., str], tmp_path: Path) -> None:
    """FFmpeg would open what it names."""
    save(random_table(BAYER, bits=12, black_level=64.0), tmp_path / "table.h5")
    (tmp_path / "list.mkv").write_text("ffconcat version 1.0\nfile secret.mkv\n")
    (tmp_path / "stream.mkv").write_text("#EXTM3U\n#EXTINF:1,\nhttp://127.0.0.1:9/a.ts\n#EXT-X-ENDLIST\n")
    for name in ("list.mkv", "stream.mkv"):
        assert name in refused(3, "render", tmp_path / "table.h5", tmp_path / name, "-o", tmp_path / "a.png")


def test_names_within_files_never_become_paths(l3: Callable, tmp_path: Path) -> None:
    """Scenes, lights and captures are called as their files say; what is written is called after numbers and letters."""
    recipe = tmp_path / "in/scenes.toml"
    recipe.parent.mkdir()
    picture = np.full((20, 24, 3), 120, np.uint8)
    from l3cli.io.images import write_picture

    write_picture(tmp_path / "in/..hurt..png", picture)
    recipe.write_text('exposure_share = [0.9]\n[[scene]]\nsource = "rgb"\nfile = "..hurt..png"\n')
    camera = CONFIGS / "cameras/bayer.toml"
    assert l3("simulate", recipe, "--camera", camera, "-o", tmp_path / "t.h5", "--pictures", tmp_path / "p")[0] == 0
    with h5py.File(tmp_path / "t.h5", "r+") as root:
        del root["frames/00000/scene"]
        root["frames/00000/scene"] = np.bytes_(b"../../../hurt/\x1b[31m")
    seal(tmp_path / "t.h5")
    table = tmp_path / "table.h5"
    save(random_table(BAYER, bits=12, black_level=64.0), table)
    before = set(tmp_path.rglob("*"))
    code, out, err = l3("evaluate", table, tmp_path / "t.h5", "--backend", "reference", "--pictures", tmp_path / "e")
    assert code in (0, 3), err
    new = set(tmp_path.rglob("*")) - before
    assert all(path == tmp_path / "e" or path.parent == tmp_path / "e" for path in new)
    assert "\x1b" not in out + err


def test_no_control_character_reaches_the_terminal(l3: Callable, tmp_path: Path) -> None:
    table = dataclasses.replace(random_table(BAYER, bits=12, black_level=64.0), camera_name="a\x1b[2J\x07b")
    save(table, tmp_path / "table.h5")
    code, out, _ = l3("info", tmp_path / "table.h5")
    assert code == 0
    assert "\x1b" not in out
    name = tmp_path / "\x1b[31mred.npy"
    _, _, err = l3("render", tmp_path / "table.h5", name, "-o", tmp_path / "a.png")
    assert "\x1b" not in err


HURT = "r\x1b[31m\x07\x9b\u202e\nmean  0.00"


def test_what_names_say_moves_no_cursor_and_makes_no_line(l3: Callable, pipeline: Path, tmp_path: Path) -> None:
    """Names of channels, scenes and lights in artifacts, and whatever stands in the JSON of others."""
    from l3cli.artifacts.store import load
    from l3cli.artifacts.table import TransformTable

    table = load(TransformTable, pipeline / "table.h5")
    names = (HURT, *table.channels[1:])
    assert table.camera is not None
    camera = dataclasses.replace(table.camera, channels=names)
    save(dataclasses.replace(table, channels=names, camera=camera), tmp_path / "table.h5")
    shutil.copy(pipeline / "unseen.h5", tmp_path / "unseen.h5")
    with h5py.File(tmp_path / "unseen.h5", "r+") as root:
        values: dict[str, Any] = {f"frames/00000/{name}": np.bytes_(HURT.encode()) for name in ("scene", "illuminant")}
        values["camera/channels"] = np.char.encode([HURT, *table.channels[1:]], "utf-8")
        for name, value in values.items():
            attributes = dict(root[name].attrs)
            del root[name]
            root[name] = value
            root[name].attrs.update(attributes)
    seal(tmp_path / "unseen.h5")
    (tmp_path / "e.json").write_text(
        json.dumps({"camera": HURT, "frames": [{"luminance": light, "ours": {"scielab": 2.0}} for light in (1.0, 10.0)]})
    )
    quiet = ("--backend", "reference", "--quiet")
    for call in (
        ("evaluate", tmp_path / "table.h5", tmp_path / "unseen.h5", *quiet),
        ("evaluate", tmp_path / "table.h5", tmp_path / "unseen.h5", *quiet, "--json"),
        ("compare", tmp_path / "e.json", tmp_path / "e.json"),
        ("compare", tmp_path / "e.json", "--json"),
        ("info", tmp_path / "table.h5"),
        ("info", tmp_path / "table.h5", "--json"),
        ("info", "--verify", tmp_path / "table.h5"),
    ):
        code, out, err = l3(*call)
        assert code == 0, err
        assert all(letter.isprintable() or letter == "\n" for letter in out + err), call
        assert not any(line.startswith("mean  0.00") for line in out.splitlines()), call


def test_one_place_prints() -> None:
    package = ROOT / "l3cli"
    for path in package.rglob("*.py"):
        if path.relative_to(package).as_posix() != "cli/terminal.py":
            assert not re.search(r"click\.s?echo|\bprint\(|std(out|err)\.write|print_exc|click\.style", path.read_text()), (
                path
            )


def test_a_picture_is_read_alike_by_both_readers(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_mosaic(tmp_path / "a.tif", np.arange(480, dtype=np.uint16).reshape(20, 24))
    away = read_image(tmp_path / "a.tif")
    monkeypatch.setenv(TRUST, "1")
    here = read_image(tmp_path / "a.tif")
    np.testing.assert_array_equal(away[0], here[0])
    assert away[1] == here[1]
    assert json.dumps(away[1])
