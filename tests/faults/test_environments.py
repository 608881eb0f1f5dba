"""Environments of a command: closed streams, small disks, other file systems and locales, odd file names and variables."""

import os
import shutil
import stat
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from l3cli.system.limits import MEGAPIXELS, SECONDS, TRUST, trusted
from tests.helpers.calls import L3, Refused
from tests.helpers.desk import make_desk
from tests.helpers.dng_files import write_dng
from tests.helpers.paths import CONFIGS
from tests.helpers.terminal import in_terminal

RUN = [sys.executable, "-m", "l3cli"]


@pytest.fixture(scope="module")
def desk(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a table and a raw frame as .tif and .npy."""
    folder = tmp_path_factory.mktemp("desk")
    make_desk(folder)
    return folder


def environment(**variables: str) -> dict[str, str]:
    return {**os.environ, **variables}


# ------------------------------------------------------------------------------------------------ streams, locales
STREAMS = ("0>&-", "2>&-", "0>&- 1>&- 2>&-")  # closed by the shell


@pytest.mark.parametrize("closed", STREAMS)
def test_closed_streams_change_no_picture(desk: Path, tmp_path: Path, closed: str) -> None:
    """What a command opens must not lie where the streams were: the decoder would read it as its standard input."""
    line: list[str | Path] = [
        *RUN,
        "render",
        desk / "table.h5",
        desk / "raw.tif",
        "-o",
        tmp_path / "a.png",
        "--exposure",
        "1",
    ]
    script: list[str | Path] = ["sh", "-c", f'exec "$@" {closed}', "sh", *line, "--backend", "reference"]
    assert subprocess.run(script, env=environment(), capture_output=True, check=False).returncode == 0
    assert (tmp_path / "a.png").read_bytes() == (desk / "reference.png").read_bytes()


@pytest.mark.parametrize("encoding", ["ascii", "latin-1"])
def test_names_are_printed_in_any_encoding(desk: Path, encoding: str) -> None:
    ended = subprocess.run(
        [*RUN, "compare", desk / "evaluation.json"],
        env=environment(PYTHONIOENCODING=encoding),
        capture_output=True,
        check=False,
    )
    assert (ended.returncode, ended.stderr) == (0, b"")
    assert all(
        letter.isprintable() or letter == "\n"
        for letter in ended.stdout.decode(encoding if encoding == "latin-1" else "utf-8")
    )


def test_what_cannot_be_reported_changes_no_exit_code(desk: Path, tmp_path: Path) -> None:
    with open("/dev/full", "w") as full:
        for arguments, code in (
            (("info", "nothing.h5"), 3),
            (("render", "table.h5", "raw.tif", "-o", tmp_path / "a.png", "--backend", "reference", "--white", "A"), 0),
        ):
            ended = subprocess.run([*RUN, *arguments], cwd=desk, env=environment(), stdout=subprocess.PIPE, stderr=full)
            assert (ended.returncode, ended.stdout) == (code, b""), arguments
    assert (tmp_path / "a.png").exists()


# ---------------------------------------------------------------------------------------------------------- names
C_LOCALE = {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}


@pytest.mark.parametrize(("name", "locale"), [(b"f\xff", {}), ("éµ".encode(), C_LOCALE)])
def test_file_names_of_any_bytes(desk: Path, tmp_path: Path, name: bytes, locale: dict[str, str]) -> None:
    folder = os.fsencode(tmp_path) + b"/in" + name
    os.mkdir(folder)
    for source, suffix in (("table", b".h5"), ("raw", b".tif"), ("raw", b".npy")):
        shutil.copy(os.fsencode(desk / source) + suffix, folder + b"/" + name + suffix)
    start: list[str | bytes] = [*RUN, "render", name + b".h5", name + b".tif", "--backend", "reference", "--quiet"]
    for command in ([*start, "-o", name + b".exr"], [*start, name + b".npy", "-o", name + b".mkv"]):
        ended = subprocess.run(command, cwd=folder, env=environment(**locale), capture_output=True, check=False)
        assert (ended.returncode, ended.stdout, ended.stderr) == (0, b"", b""), command
    expected = {name + suffix for suffix in (b".h5", b".tif", b".npy", b".exr", b".mkv")}
    assert set(os.listdir(folder)) == expected | {b"." + name + b".mkv.l3-finished"}


def test_libraries_open_no_names_of_other_bytes_than_utf8(desk: Path, tmp_path: Path, refused: Refused) -> None:
    write_dng(tmp_path / "a\udcff.dng", np.full((64, 64), 500, np.uint16), np.array([[0, 1], [1, 2]]))
    call = ("render", desk / "table.h5", tmp_path / "a\udcff.dng", "-o", tmp_path / "a.png")
    assert "UTF-8; rename it" in refused(3, *call)


def test_other_line_ends_give_the_same_artifact(tmp_path: Path, l3: L3) -> None:
    camera = CONFIGS / "cameras/bayer.toml"
    text = 'exposure_share = [0.9]\n[[scene]]\nsource = "grey ramp"\nsize = [16, 20]\n'
    for name, content in {"a": text.encode(), "b": b"\xef\xbb\xbf" + text.replace("\n", "\r\n").encode()}.items():
        (tmp_path / f"{name}.toml").write_bytes(content)
        call = ("simulate", tmp_path / f"{name}.toml", "--camera", camera, "-o", tmp_path / f"{name}.h5", "--quiet")
        assert l3(*call) == (0, "", "")
    assert (tmp_path / "a.h5").read_bytes() == (tmp_path / "b.h5").read_bytes()
    code, out, _ = l3("info", "--verify", tmp_path / "a.h5", tmp_path / "b.toml", camera)
    assert code == 0
    assert "simulate recipe: 2 verified" in out


# ------------------------------------------------------------------------------------------------------ variables
@pytest.mark.parametrize("size", ["²", "0", "-3", "1e9", ""])
def test_a_terminal_of_no_size_gets_a_bar(size: str) -> None:
    bar = "from l3cli.cli import terminal; terminal.prepare(); list(terminal.Terminal().progress(range(3), 3, 'frames'))"
    assert "3/3" in in_terminal([sys.executable, "-c", bar], {"COLUMNS": size, "LINES": size})


def test_who_states_yes_trusts_and_who_states_no_does_not(monkeypatch: pytest.MonkeyPatch) -> None:
    for word in ("", "0", "false", "False", "no", "OFF", " no ", "n", "f", "1", "true", "Yes", "ON", "y", "t"):
        monkeypatch.setenv(TRUST, word)
        assert trusted() == (word.lower() in ("1", "true", "yes", "on", "y", "t"))


@pytest.mark.parametrize(
    ("name", "value", "words"),
    [(TRUST, "maybe", "neither yes nor no"), (SECONDS, "soon", "not a number"), (MEGAPIXELS, "-1", "not within")],
)
def test_what_a_variable_states_is_checked_where_nothing_depends_on_it(
    name: str, value: str, words: str, desk: Path, refused: Refused, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(name, value)
    line = refused(2, "info", desk / "table.h5")
    assert name in line
    assert words in line


# --------------------------------------------------------------------------------------------------------- caches
PROGRAM = """
import os, numpy as np
from l3cli.rendering.opencl import devices
from l3cli.rendering.opencl.programs import Compiler
device = devices.choose_device("")
cl = devices.pyopencl()
context = cl.Context([device])
with devices.refusals(device):
    program = Compiler(context, device).build("__kernel void f(__global int *a) { a[get_global_id(0)] = 7; }", {})
    kernel = cl.Kernel(program, "f")
queue, numbers = cl.CommandQueue(context), np.zeros(16, np.int32)
buffer = cl.Buffer(context, cl.mem_flags.WRITE_ONLY, numbers.nbytes)
kernel(queue, (16,), None, buffer)
cl.enqueue_copy(queue, numbers, buffer)
assert (numbers == 7).all()
print(os.environ["POCL_CACHE_DIR"], devices.cache_warning())
"""


def compute(**variables: str) -> "subprocess.CompletedProcess[str]":
    """Compile and run a small kernel in a process, which tells PoCL's folder and what is said of it."""
    known = {key: value for key, value in environment().items() if key not in ("POCL_CACHE_DIR", "XDG_CACHE_HOME")}
    return subprocess.run(
        [sys.executable, "-c", PROGRAM], env={**known, **variables}, capture_output=True, text=True, check=False
    )


def computed(**variables: str) -> str:
    ended = compute(**variables)
    assert (ended.returncode, ended.stderr) == (0, "")
    return ended.stdout.strip()


def compiled(folder: Path) -> dict[Path, int]:
    """When each file that holds something was written."""
    return {path: path.stat().st_mtime_ns for path in folder.rglob("*") if path.is_file() and path.stat().st_size}


def test_kernels_are_cached_for_this_user_alone(tmp_path: Path) -> None:
    before = os.umask(0)
    try:
        assert computed(XDG_CACHE_HOME=str(tmp_path)) == f"{tmp_path}/l3cli/pocl"
    finally:
        os.umask(before)
    assert (tmp_path / "l3cli/pocl").stat().st_mode & 0o777 == 0o700
    cached = compiled(tmp_path)
    assert cached
    old = tmp_path / "l3cli/pocl/tempfile_old"  # as PoCL leaves one in each process
    old.touch()
    os.utime(old, (0, 0))
    computed(XDG_CACHE_HOME=str(tmp_path))
    assert compiled(tmp_path) == cached
    assert not old.exists()


def test_an_error_of_a_damaged_cache_names_the_folder(tmp_path: Path) -> None:
    computed(XDG_CACHE_HOME=str(tmp_path))
    programs = list(tmp_path.rglob("program.bc"))
    if not programs:
        pytest.skip("no cache of PoCL")
    for path in programs:
        os.truncate(path, path.stat().st_size // 2)
    answer = compute(XDG_CACHE_HOME=str(tmp_path)).stderr
    assert f"DeviceError: {tmp_path}/l3cli/pocl contains damaged kernels; remove this folder" in answer


def test_a_cache_that_others_may_write_to_is_not_used(tmp_path: Path) -> None:
    tmp_path.chmod(0o703)
    answer = computed(POCL_CACHE_DIR=str(tmp_path))
    assert "compiled kernels cannot be cached" in answer
    assert "other users can write to this folder" in answer
    assert not [*tmp_path.iterdir()]


def test_no_other_user_can_exchange_the_folder_of_kernels(tmp_path: Path) -> None:
    """Whatever the umask, neither it nor a folder that is made above it: compiled kernels run as their user."""
    program = "import os; os.umask(0); from l3cli.rendering.opencl import devices; assert devices.prepare_cache() == ''"
    env = {name: value for name, value in os.environ.items() if name != "POCL_CACHE_DIR"}
    env |= {"XDG_CACHE_HOME": str(tmp_path / "caches")}
    subprocess.run([sys.executable, "-c", program], env=env, check=True, timeout=60)
    for folder in ("caches", "caches/l3cli", "caches/l3cli/pocl"):
        assert stat.S_IMODE((tmp_path / folder).stat().st_mode) == 0o700


@pytest.mark.parametrize("variables", [{"HOME": "/proc"}, {"HOME": ""}])
def test_kernels_are_compiled_without_a_cache(variables: dict[str, str]) -> None:
    answer = computed(**variables)
    assert "compiled kernels cannot be cached" in answer
    assert not Path(answer.split()[0]).exists()


def test_a_full_disk_for_the_cache_is_one_warning(desk: Path, tmp_path: Path) -> None:
    mount = f"mount -t tmpfs -o size=16k tmpfs {tmp_path}"
    if subprocess.run(["unshare", "-rm", "sh", "-c", mount], capture_output=True, check=False).returncode:
        pytest.skip("no small disk can be mounted here")
    line = f'{mount} && cd "{desk}" && "$@" render table.h5 raw.npy -o {desk}/full.png'
    known = environment(XDG_CACHE_HOME=str(tmp_path))
    known.pop("POCL_CACHE_DIR", None)
    ended = subprocess.run(
        ["unshare", "-rm", "sh", "-c", line, "sh", *RUN], env=known, capture_output=True, text=True, check=False
    )
    assert ended.returncode == 0, ended.stderr
    assert (desk / "full.png").exists()
    (warning,) = [line for line in ended.stderr.splitlines() if "kernels" in line]
    assert warning.startswith("warning: compiled kernels cannot be cached")
    assert "No space left" in warning
