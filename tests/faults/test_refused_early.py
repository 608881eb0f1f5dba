"""Harmful inputs are rejected before memory is allocated or links are followed: bombs, endless texts, links and names."""

import dataclasses
import json
import os
import re
import shutil
import struct
import tracemalloc
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from l3cli.artifacts.container import seal
from l3cli.artifacts.store import save
from l3cli.io.images import read_image
from l3cli.io.pictures.openimageio import write_mosaic
from l3cli.system.limits import MEGAPIXELS, MOST_TEXT, TRUST
from tests.helpers.calls import L3, Refused
from tests.helpers.cameras import BAYER
from tests.helpers.hostile import HANGS, timed
from tests.helpers.paths import CONFIGS, ROOT
from tests.helpers.tables import random_table


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


def bombs() -> dict[str, bytes]:
    return {
        "png.png": png_bomb(60_000, 60_000),
        "unpacks.png": png_bomb(2000, 40_000),
        "tiff.tif": tiff_bomb(100_000, 100_000),
        "header.npy": npy_header("(100000, 100000)"),
        "overflow.npy": npy_header("(4294967296, 4294967296)"),
        "negative.npy": npy_header("(-3, -4)"),
        "object.npy": npy_header("(1, 1)", "|O"),
        "pgm.dng": b"P5 99999999 99999999 65535\n",
    }


def test_bombs_are_refused_before_they_go_off(refused: Refused, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(MEGAPIXELS, "60")
    save(random_table(BAYER, bits=12, black_level=64.0), tmp_path / "table.h5")
    for name, content in bombs().items():
        (tmp_path / name).write_bytes(content)
        with timed(HANGS):
            line = refused(3, "render", tmp_path / "table.h5", tmp_path / name, "-o", tmp_path / "a.png")
        assert name in line


def test_a_sparse_file_of_honest_size_is_refused_too(refused: Refused, tmp_path: Path) -> None:
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
    refused: Refused, tmp_path: Path, bayer_recipe: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    call = ("--camera", bayer_recipe, "-o", tmp_path / "out.h5")
    with open(tmp_path / "endless.toml", "wb") as file:
        file.truncate(MOST_TEXT + 1)
    assert "endless.toml" in refused(3, "simulate", tmp_path / "endless.toml", *call)
    assert "/dev/zero" in refused(3, "simulate", "/dev/zero", *call)
    os.mkfifo(tmp_path / "pipe.toml")
    assert "pipe.toml" in refused(3, "simulate", tmp_path / "pipe.toml", *call)
    for text in ("a = " + "[" * 5000 + "]" * 5000, "a = " + "9" * 5000, 'name = "\\u0000"', "exposure_s = [inf]"):
        (tmp_path / "odd.toml").write_text(text)
        assert "odd.toml" in refused(2, "simulate", tmp_path / "odd.toml", *call)
    (tmp_path / "odd.json").write_text("[" * 100_000)
    assert "odd.json" in refused(3, "compare", tmp_path / "odd.json")
    recipe = 'illuminants = ["{}"]\nexposure_share = [0.9]\n[[scene]]\nsource = "grey ramp"\nsize = [16, 16]\n'
    os.mkfifo(tmp_path / "pipe.csv")
    (tmp_path / "fifo.toml").write_text(recipe.format("pipe.csv"))
    assert "pipe.csv" in refused(3, "simulate", tmp_path / "fifo.toml", *call)


def test_hdf5_reaches_nowhere_else(refused: Refused, tmp_path: Path) -> None:
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
    assert "black_level" in refused(3, "info", tmp_path / "table.h5")


def test_groups_in_a_circle_are_walked_once(l3: L3, tmp_path: Path) -> None:
    save(random_table(BAYER, bits=12, black_level=64.0), tmp_path / "table.h5")
    with h5py.File(tmp_path / "table.h5", "r+") as root:
        for name in ("round", "and", "again"):
            root[f"first/rule/{name}"] = root
            root[name] = root["first/rule"]
    seal(tmp_path / "table.h5")
    code, out, _ = l3("info", tmp_path / "table.h5")
    assert code == 0
    assert out.count("level_edges") == 1


def test_a_playlist_is_no_video(refused: Refused, tmp_path: Path) -> None:
    """FFmpeg would open what it names."""
    save(random_table(BAYER, bits=12, black_level=64.0), tmp_path / "table.h5")
    (tmp_path / "list.mkv").write_text("ffconcat version 1.0\nfile secret.mkv\n")
    (tmp_path / "stream.mkv").write_text("#EXTM3U\n#EXTINF:1,\nhttp://127.0.0.1:9/a.ts\n#EXT-X-ENDLIST\n")
    for name in ("list.mkv", "stream.mkv"):
        assert name in refused(3, "render", tmp_path / "table.h5", tmp_path / name, "-o", tmp_path / "a.png")


def test_names_within_files_never_become_paths(l3: L3, tmp_path: Path) -> None:
    """Scenes, lights and captures are called as their files say; what is written is called after numbers and letters."""
    recipe = tmp_path / "in/scenes.toml"
    recipe.parent.mkdir()
    picture = np.full((20, 24, 3), 120, np.uint8)
    from l3cli.io.pictures.registry import write_picture

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


def test_no_control_character_reaches_the_terminal(l3: L3, tmp_path: Path) -> None:
    table = dataclasses.replace(random_table(BAYER, bits=12, black_level=64.0), camera_name="a\x1b[2J\x07b")
    save(table, tmp_path / "table.h5")
    code, out, _ = l3("info", tmp_path / "table.h5")
    assert code == 0
    assert "\x1b" not in out
    name = tmp_path / "\x1b[31mred.npy"
    _, _, err = l3("render", tmp_path / "table.h5", name, "-o", tmp_path / "a.png")
    assert "\x1b" not in err


HURT = "r\x1b[31m\x07\x9b\u202e\nmean  0.00"


def test_what_names_state_moves_no_cursor_and_makes_no_line(l3: L3, pipeline: Path, tmp_path: Path) -> None:
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
        json.dumps(
            {
                "camera": HURT,
                "frames": [
                    {"luminance": light, "clipped": 0.0, "exposure": 0.01, "ours": {"scielab": 2.0}} for light in (1.0, 10.0)
                ],
            }
        )
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
    place = read_image(tmp_path / "a.tif")
    np.testing.assert_array_equal(away[0], place[0])
    assert away[1] == place[1]
    assert json.dumps(away[1])


OUTPUTS = (  # calls in a folder in which the pipeline has run, whose output {out} exists
    "calibrate lab/MEASUREMENTS.toml -o {out}/c.h5",
    "calibrate --draft lab -o {out}/M.toml",
    "simulate scenes.toml --camera camera.h5 -o {out}/t.h5",
    "train training.h5 --classes classes.toml -o {out}/t.h5",
    "train training.h5 --classes classes.toml --shard 1/2 -o {out}/s.h5",
    "render table.h5 {raw} -o {out}/p.png",
    "render table.h5 unseen/*_raw.tif -o {out}/p/####.tif",
    "evaluate table.h5 unseen.h5 --pictures {out}/p",
    "report camera.h5 table.h5 -o {out}/r.html",
    "export camera.h5 -o {out}/e",
    "lab camera.toml -o {out}/lab",
    "init bayer {out}/demo",
)


@pytest.mark.parametrize("sentence", OUTPUTS)
def test_an_output_that_exists_is_refused(sentence: str, pipeline: Path, tmp_path: Path, refused: Refused) -> None:
    """Before any work, which would warn or report progress, and without touching it or leaving anything."""
    raw = next((pipeline / "unseen").glob("*_raw.tif"))
    names = {path.name for path in pipeline.iterdir()}
    words = sentence.format(out=tmp_path, raw=raw).split()
    call = [str(pipeline / word) if index and word.partition("/")[0] in names else word for index, word in enumerate(words)]
    output = next(Path(word) for word in call if word.startswith(str(tmp_path)))
    folder = output.parent if output.suffix else output
    folder.mkdir(exist_ok=True)
    mine = [folder / f"{number:04d}.tif" for number in range(40)] if "#" in output.name or not output.suffix else [output]
    mine += [] if output.suffix else [folder / "MEASUREMENTS.toml", folder / "rawtoaces.json"]
    for path in mine:
        path.write_text("mine")
    before = sorted(tmp_path.rglob("*"))
    assert str(tmp_path) in refused(1, *call)
    assert sorted(tmp_path.rglob("*")) == before
    assert {path.read_text() for path in mine} == {"mine"}


def test_wrong_inputs_are_refused(pipeline: Path, tmp_path: Path, refused: Refused) -> None:
    calls = {
        "none.tif": (3, "render", pipeline / "table.h5", pipeline / "none.tif", "-o", tmp_path / "p.png"),
        "table.h5": (3, "train", pipeline / "table.h5", "-o", tmp_path / "t.h5"),
        "camera.toml": (2, "calibrate", pipeline / "camera.toml", "-o", tmp_path / "c.h5"),
    }
    for name, (code, *call) in calls.items():
        assert name in refused(code, *call)
    assert not list(tmp_path.iterdir())
