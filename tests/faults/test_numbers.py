"""Ranges of numbers and names of units are checked during parsing, and messages suggest a valid value."""

import re
import subprocess
import sys
from fractions import Fraction
from pathlib import Path

import av
import click
import numpy as np
import pytest

from l3cli.artifacts.store import load, save
from l3cli.artifacts.table import TransformTable
from l3cli.cli import COMMANDS
from l3cli.cli import l3 as every_command
from l3cli.errors import InputFileError, L3Error, RecipeError
from l3cli.io.pictures.openimageio import write_mosaic
from l3cli.recipes.load import parse_recipe
from l3cli.system.text import NoSuchNumber, Quantity
from l3cli.training.recipe import TrainingRecipe
from tests.helpers.calls import L3, Refused
from tests.helpers.hostile import HANGS, timed
from tests.helpers.recipes import CLASSES
from tests.helpers.sequences import COUNT, FAST, RGGB, RUN, frames, pictures, write_raw_video

FAR = "1" + 23 * "0"  # beyond 64 bits
LONG = "1" + 5000 * "0"  # more digits than Python reads


@pytest.fixture
def table(tmp_path: Path) -> Path:
    save(RGGB, tmp_path / "table.h5")
    return tmp_path / "table.h5"


@pytest.fixture
def stack(tmp_path: Path) -> Path:
    np.save(tmp_path / "stack.npy", frames())
    return tmp_path / "stack.npy"


# ------------------------------------------------------------------------------------------------------------- parsing


@pytest.mark.parametrize(
    ("text", "number"),
    [("2", 2), ("2.5", 2.5), ("1e3", 1000), (".5e1", 5), ("+7", 7), ("1000", 1000), ("0002", 2)],
)
def test_plain_numbers_are_read(text: str, number: float) -> None:
    assert Quantity(2, 1000).read(text) == number


ODD = ["nan", "inf", "-inf", "", " ", "3 ", "0x10", "1_000", "٣", "²", "3²", "1/2", "1,5", "1e", "e3"]


@pytest.mark.parametrize("text", ODD)
def test_what_is_no_plain_number_is_refused(text: str) -> None:
    for whole in (False, True):
        with pytest.raises(NoSuchNumber, match=r"is not a number; use a number within 2…1000 samples/degree"):
            Quantity(2, 1000, "samples/degree", whole).read(text)


def test_the_nearest_number_is_named() -> None:
    fine, whole = Quantity(2, 1000, "DN"), Quantity(0, 2**63 - 1, whole=True)
    for text, nearest in (("1e999", "1000"), ("1.9", "2"), ("-1e308", "2"), (LONG, "1000"), ("1e999999999", "1000")):
        with pytest.raises(NoSuchNumber, match=f"is not within 2…1000 DN; the nearest valid value is {nearest}$"):
            fine.read(text)
    for text, nearest in (("-1", "0"), (FAR, str(2**63 - 1)), (LONG, str(2**63 - 1)), (f"-{LONG}", "0")):
        with pytest.raises(NoSuchNumber, match=f"the nearest valid value is {nearest}$") as caught:
            whole.read(text)
        assert len(str(caught.value)) < 150
    assert whole.read(str(2**63 - 1)) == 2**63 - 1
    assert isinstance(whole.read(5000 * "0" + "7"), int)
    assert whole.read(5000 * "0" + "7") == 7
    with pytest.raises(NoSuchNumber, match="is not a whole number"):
        whole.read("2.5")


REFUSED = f"""
    evaluate a b --viewing nan
        "nan" is not a number; use a number within 2…1000 samples/degree
    train a -o b --shard 1/10²³
        "10²³" is not a number; use a number within 0…1000000 shards
    train a -o b --shard 1/{LONG}
        the nearest valid value is 1000000
    train a -o b --shard 0/3
        use a shard from 1/3 to 3/3
    train a -o b --shares 1,1e308
        the nearest valid value is 1e+06
    train a -o b --seed {FAR}
        the nearest valid value is 9223372036854775807
    simulate a.toml --camera b.toml -o c --seed ٣
        "٣" is not a number
    render a b -o c.png --exposure 1e308
        1e308 is not within 1e-09…1e+09 times Y; the nearest valid value is 1e+09
    render a b -o c.png --exposure bright
        1e-09…1e+09 times Y; other values are auto, camera, and EV relative to auto, such as -1EV
    render a b -o c.mp4 --fps 1e999999999
        1e999999999 is not within 0.001…1000 frames/s; the nearest valid value is 1000
    render a b -o c.mp4 --fps 1/3000000000
        the nearest valid value is 0.001
    render a b -o c.mp4 --crf nan
        "nan" is not a number; use a number within 0…51
    render a b -o c.png --black-level nan
        "nan" is not a number; use a number within 0…65535 DN
    render a b -o c.png --size {FAR}x24
        the nearest valid value is 1000000
    render a b -o c --frames 0-{LONG}
        the nearest valid value is 999999999999999999
"""


@pytest.mark.parametrize(("call", "words"), re.findall(r"^    (\S.+)\n {8}(.+)$", REFUSED, re.MULTILINE))
def test_a_number_is_refused_when_it_is_parsed(refused: Refused, call: str, words: str) -> None:
    assert words in refused(2, *call.split())


def test_every_option_with_a_number_declares_its_range() -> None:
    for name in COMMANDS:
        command = every_command.get_command(click.Context(every_command), name)
        assert command is not None
        for option in command.params:
            assert not isinstance(option.type, click.types.IntParamType | click.types.FloatParamType), option.opts


@pytest.mark.parametrize("name", ["L3_MEGAPIXELS", "L3_DECODE_SECONDS"])
@pytest.mark.parametrize("number", ["nan", "0", "1e300"])
def test_variables_have_ranges_too(
    refused: Refused, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, table: Path, name: str, number: str
) -> None:
    write_mosaic(tmp_path / "raw.png", frames()[0])  # decoded by the isolated process, as plain TIFFs are not
    monkeypatch.setenv(name, number)
    line = refused(2, "render", table, tmp_path / "raw.png", "-o", tmp_path / "a.png", *FAST)
    assert line.startswith(f"l3: {name}: ")
    assert "within" in line
    assert "unset the environment variable" in line


def test_a_device_is_not_chosen_by_digits_that_are_no_number(refused: Refused) -> None:
    for wanted in (LONG, "²", "99"):
        assert wanted[:40] in refused(4, "bench", "--quiet", "--device", wanted)


# ---------------------------------------------------------------------------------------------------------------- rates


@pytest.mark.parametrize(
    ("given", "rate"),
    [("29.97002997", Fraction(30000, 1001)), ("23.976", Fraction(2997, 125)), ("0.001", Fraction(1, 1000))],
)
def test_a_rate_is_the_nearest_that_a_video_holds(
    l3: L3, tmp_path: Path, table: Path, stack: Path, given: str, rate: Fraction
) -> None:
    for name in ("a.mp4", "a.mkv", "a.mov"):
        assert l3("render", table, stack, "-o", tmp_path / name, "--fps", given, *FAST) == (0, "", "")
    with av.open(str(tmp_path / "a.mp4")) as video:
        assert video.streams.video[0].average_rate == rate
    assert l3("render", table, stack, "-o", tmp_path / "a.y4m", "--fps", given, *FAST) == (0, "", "")
    assert f" F{rate.numerator}:{rate.denominator} ".encode() in (tmp_path / "a.y4m").read_bytes()[:80]


def test_a_film_of_a_nonsense_rate_has_the_usual_one(l3: L3, tmp_path: Path) -> None:
    import tifffile

    from l3cli.io.raw import dng

    for stored, rate in (((4294967295, 1), None), ((1, 4294967295), None), ((2997002997, 100000000), Fraction(30000, 1001))):
        path = tmp_path / "a.dng"
        tifffile.imwrite(path, frames()[0], photometric=32803, extratags=[(51044, 5, 1, stored, True)])
        assert dng.rate(path) == rate


# -------------------------------------------------------------------------------------------------------- frame numbers


def test_digits_of_other_scripts_number_no_frame(l3: L3, tmp_path: Path, table: Path) -> None:
    (tmp_path / "in").mkdir()
    for name in ("5²3", "53", "٣", "a4"):
        write_mosaic(tmp_path / f"in/{name}.tif", frames()[0])
    assert l3("render", table, tmp_path / "in", "-o", tmp_path / "out", *FAST) == (0, "", "")
    assert set(pictures(tmp_path / "out")) == {"5²3.png", "53.png", "٣.png", "a4.png"}
    assert l3("render", table, tmp_path / "in/*3.tif", "-o", tmp_path / "%d.png", *FAST) == (0, "", "")
    assert {path.name for path in tmp_path.glob("*.png")} == {"3.png", "53.png"}


def test_a_pattern_is_no_wider_than_a_name(refused: Refused, tmp_path: Path, table: Path, stack: Path) -> None:
    for digits, code in ((9 * "9", 2), (5000 * "9", 1)):
        refused(code, "render", table, stack, "-o", tmp_path / f"%0{digits}d.png", *FAST)


@pytest.mark.parametrize("kind", ["stack", "pattern", "stdin", "video"])
def test_frames_that_are_far_away_are_listed_at_once(l3: L3, tmp_path: Path, table: Path, kind: str) -> None:
    """Each gap in one line, whatever its length."""
    given = b""
    if kind == "stack":
        np.save(tmp_path / "a.npy", frames())
        source: Path | str = tmp_path / "a.npy"
    elif kind == "pattern":
        for number, mosaic in enumerate(frames()):
            write_mosaic(tmp_path / f"a_{number}.tif", mosaic)
        source = tmp_path / "a_%d.tif"
    elif kind == "stdin":
        source, given = "-", frames().astype("<u2").tobytes()
    else:
        source = write_raw_video(tmp_path / "a.mkv")
    call = ("render", table, source, "--frames", "1-9999999999", "--skip-bad", "--size", "20x28", *FAST)
    for output in ("out", "out/%d.png"):
        words = [*map(str, call), "-o", str(tmp_path / output), "--force"]
        if kind == "stdin":
            run = subprocess.run([sys.executable, "-c", RUN, *words], input=given, capture_output=True, timeout=HANGS)
            code, message = run.returncode, run.stderr.decode()
        else:
            with timed(HANGS):
                code, _, message = l3(*words)
        assert code == 1, message
        assert message.count("\n") == 2, message
        assert f" {COUNT}-9999999999 " in message
        assert f"{9999999999 - COUNT + 1} of 9999999999 " in message
        assert len(pictures(tmp_path / "out")) == COUNT - 1
        for path in (tmp_path / "out").iterdir():
            path.unlink()


def test_gaps_are_listed_one_by_one(l3: L3, refused: Refused, tmp_path: Path, table: Path) -> None:
    for number in (2, 3, 7, 9):
        write_mosaic(tmp_path / f"a_{number}.tif", frames()[0])
    call = ("render", table, tmp_path / "a_%d.tif", "-o", tmp_path / "out", *FAST)
    assert " 4-6 " in refused(3, *call)
    assert " 0-1 " in refused(3, *call, "--frames", "0-9")
    assert " 4-8x2 " in refused(3, *call, "--frames", "2-9x2")
    code, _, err = l3(*call, "--skip-bad")
    assert (code, err.count("\n")) == (1, 3)
    assert " 4-6 " in err
    assert " 8 " in err
    assert "4 of 8 " in err


# -------------------------------------------------------------------------------------------------------------- recipes


def test_no_chromas_are_none(l3: L3, tmp_path: Path, pipeline: Path) -> None:
    tables = []
    for chromas in (0, 1):
        recipe = tmp_path / f"{chromas}.toml"
        recipe.write_text(CLASSES.replace("chromas = 3", f"chromas = {chromas}").replace("5000", "500"))
        output = tmp_path / f"{chromas}.h5"
        assert l3("train", pipeline / "training.h5", "--classes", recipe, "-o", output, "--quiet") == (0, "", "")
        tables.append(load(TransformTable, output))
    assert tables[0].first.rule.chromas == 1
    np.testing.assert_array_equal(tables[0].first.weights, tables[1].first.weights)


@pytest.mark.parametrize(
    ("key", "words"),
    [
        ("[classes]\nchromas = -1", "classes.chromas is -1"),
        ("[classes]\nchromas = 10000000", "classes.chromas is 10000000"),
        ("[classes]\nmax_cases = 0", "classes.max_cases is 0"),
        ("[classes]\nsaturation_radius = -2", "classes.saturation_radius is -2"),
        (
            f"[classes]\nlevels = {FAR}",
            "classes.levels is 100000000000000000000000",
        ),
        ("[classes]\nlevels = 2.5", "Expected `int`"),
        ("[classes]\nlevels = 1979-05-27", "Expected `int`, got `date`"),
        ("[learning]\ndarkest = nan", "learning.darkest is nan"),
        ("[learning]\ndraws = 1001", "learning.draws is 1001"),
    ],
)
def test_a_recipes_number_out_of_range_is_named(key: str, words: str) -> None:
    with pytest.raises(RecipeError) as caught:
        parse_recipe(key, TrainingRecipe, "a.toml")
    assert str(caught.value).startswith("a.toml:2: ")
    assert words in str(caught.value)


# --------------------------------------------------------------------------------------------------------------- memory


@pytest.mark.parametrize("kilobytes", [60_000, 140_000, 300_000])
def test_too_little_address_space_is_reported_before_any_work(
    tmp_path: Path, table: Path, stack: Path, kilobytes: int
) -> None:
    """Libraries end the program, hang or send it signals where they get no memory."""
    command = f"ulimit -v {kilobytes}; exec {sys.executable} -m l3cli render {table} {stack} -o {tmp_path}/out"
    run = subprocess.run(["bash", "-c", command], capture_output=True, timeout=HANGS, text=True)
    assert run.returncode == 1
    assert (run.stdout, run.stderr.count("\n")) == ("", 1), run.stderr
    assert "ulimit -v" in run.stderr
    assert not (tmp_path / "out").exists()


def test_what_cannot_be_loaded_or_started_is_one_line(
    refused: Refused, tmp_path: Path, table: Path, stack: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    import threading

    def none(*_: object) -> None:
        raise RuntimeError("can't start new thread")

    with monkeypatch.context() as patched:
        patched.setattr(threading.Thread, "start", none)
        assert "out of memory or threads" in refused(1, "render", table, stack, "-o", tmp_path / "out", *FAST)

    def unmapped(*_: object) -> None:
        raise ImportError("libfoo.so: failed to map segment from shared object")

    monkeypatch.setattr("l3cli.stages.rendering.job.load", unmapped)
    assert "libfoo.so: failed to map segment" in refused(1, "render", table, stack, "-o", tmp_path / "out", *FAST)


def test_a_decoder_that_cannot_start_is_no_damaged_file(
    refused: Refused, tmp_path: Path, table: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from l3cli.io import isolated

    write_mosaic(tmp_path / "raw.png", frames()[0])
    call = ("render", table, tmp_path / "raw.png", "-o", tmp_path / "a.png", *FAST)
    isolated._end_child()
    with monkeypatch.context() as patched:
        patched.setattr(sys, "executable", "/bin/false")
        assert "the process that decodes files cannot start" in refused(1, *call)


def test_a_library_that_cannot_be_loaded_is_no_damaged_file() -> None:
    from l3cli.io.isolated import _decoded

    def decode(path: Path) -> None:
        raise ImportError("libfoo.so: failed to map segment from shared object")

    with pytest.raises(L3Error, match=r"cannot be loaded \(libfoo.so: failed to map") as caught:
        _decoded(decode, Path("a.tif"))
    assert not isinstance(caught.value, InputFileError)


def test_a_library_without_memory_is_not_missing(
    refused: Refused, tmp_path: Path, table: Path, stack: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    import builtins

    whole = builtins.__import__

    def cramped(name: str, *rest: object) -> object:
        if name == "av":
            raise ImportError("libavcodec.so: cannot allocate memory")
        return whole(name, *rest)  # type: ignore[arg-type]

    monkeypatch.delitem(sys.modules, "av", raising=False)
    monkeypatch.setattr(builtins, "__import__", cramped)
    line = refused(1, "render", table, stack, "-o", tmp_path / "a.mp4", *FAST)
    assert "pip install" not in line
    assert "cannot allocate memory" in line
