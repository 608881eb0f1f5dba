"""Inputs are never replaced: outputs are compared with all inputs by file identity and not by name."""

import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from l3cli.artifacts.store import save
from l3cli.io.pictures.registry import write_picture
from l3cli.recipes import builtin
from l3cli.system.files import atomic_output, protecting, refuse_protected
from tests.helpers.calls import L3, Refused
from tests.helpers.hostile_inputs import CURVE_CAMERA
from tests.helpers.paths import contents
from tests.helpers.sequences import FAST, RGGB, RUN, frames

CURVES = "\n".join(f"{nm},{nm / 700},{1 - nm / 900},{nm / 900}" for nm in range(390, 721, 10))
CUBE = 'exposure_share = [0.9]\n[[scene]]\nsource = "cube"\nfile = "cube.npy"\nwavelength_range_nm = [400, 700, 50]\n'


@pytest.fixture
def desk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder to work in: a camera that names its curves, a scene, a sequence and a table."""
    for name, text in {"camera.toml": CURVE_CAMERA, "cube.toml": CUBE, "curves.csv": CURVES}.items():
        (tmp_path / name).write_text(text)
    np.save(tmp_path / "cube.npy", np.random.default_rng(0).random((18, 20, 7)).astype(np.float32))
    frames().tofile(tmp_path / "clip.raw")
    save(RGGB, tmp_path / "table.h5")
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture
def protected(desk: Path, refused: Refused) -> Callable[..., str]:
    """Run a command that must be refused because of an output, by one line, and must change nothing."""

    def call(line: str) -> str:
        stored = contents(desk)
        answer = refused(2, *line.split())
        assert "is an input" in answer
        assert contents(desk) == stored
        return answer

    return call


def test_stored_frames_are_not_removed_where_they_are_what_is_read(desk: Path, protected: Callable[..., str]) -> None:
    (desk / "t.h5.parts").mkdir()
    (desk / "t.h5.parts/run").write_text("")
    os.link(desk / "cube.npy", desk / "t.h5.parts/000000.h5")
    protected("simulate cube.toml --camera camera.toml -o t.h5")


def test_what_is_named_like_ours_is_not_removed_where_it_is_read(desk: Path, protected: Callable[..., str], l3: L3) -> None:
    protected_name = desk / ".a.0123abcd.l3tmp.npy"
    np.save(protected_name, frames()[0])
    stored = protected_name.read_bytes()
    assert l3("render", "table.h5", protected_name, "-o", "a.png", *FAST)[0] == 0
    assert l3("render", "table.h5", protected_name, "-o", "pictures", *FAST)[0] == 0
    np.save(desk / "a.npy", frames()[0])
    (desk / "a.npy").rename(desk / ".b.png.l3lock")
    protected("render table.h5 .b.png.l3lock -o b.png")
    assert protected_name.read_bytes() == stored


def test_recipes_are_not_copied_over_themselves(
    desk: Path, protected: Callable[..., str], monkeypatch: pytest.MonkeyPatch
) -> None:
    shutil.copytree(builtin.recipe_folder(), desk / "configs")
    monkeypatch.setattr(builtin, "recipe_folder", lambda: desk / "configs")
    protected("init bayer configs/pipelines --force")


def streamed(line: str, more: str) -> tuple[int, str]:
    words = f'{sys.executable} -c "{RUN}" {line} {" ".join(FAST)} {more}'
    ended = subprocess.run(["bash", "-c", words], capture_output=True, check=False)
    return ended.returncode, ended.stderr.decode()


@pytest.mark.parametrize("output", ["link.mkv", "out"])
def test_a_stream_from_a_file_is_not_replaced(desk: Path, output: str) -> None:
    (desk / "out").mkdir()
    for name in ("link.mkv", "out/000003.png"):
        os.link(desk / "clip.raw", desk / name)
    stored = contents(desk)
    code, answer = streamed("render table.h5 - --size 20x28 --force", f"-o {output} < clip.raw")
    assert (code, answer.count("\n")) == (2, 1), answer
    assert f"{'link.mkv' if output[0] == 'l' else 'out/000003.png'} is an input (the same file as stdin);" in answer
    assert contents(desk) == stored


def test_a_stream_is_not_written_behind_what_is_read(desk: Path) -> None:
    stored = contents(desk)
    code, answer = streamed("render table.h5 clip.raw --size 20x28", "-o - >> clip.raw")
    assert (code, answer) == (2, "l3: stdout is an input (the same file as clip.raw); choose another output\n")
    assert contents(desk) == stored


@pytest.mark.parametrize("changed", ["curves.csv", "cube.img"])
def test_a_simulation_is_not_resumed_with_other_files_behind_its_recipes(
    desk: Path, l3: L3, refused: Refused, changed: str
) -> None:
    cube = np.load(desk / "cube.npy")
    cube.astype("<f4").tofile(desk / "cube.img")
    (desk / "cube.hdr").write_text(
        "ENVI\nsamples = 20\nlines = 18\nbands = 7\ndata type = 4\ninterleave = bip\nwavelength = "
        "{400, 450, 500, 550, 600, 650, 700}\n"
    )
    broken = '[[scene]]\nsource = "rgb"\nfile = "broken.png"\n'  # it fails when the other frames are stored
    (desk / "envi.toml").write_text(
        f'exposure_share = [0.9]\n[[scene]]\nsource = "envi"\nfile = "cube.hdr"\nholds = "reflectance"\n{broken}'
    )
    write_picture(desk / "broken.png", np.random.default_rng(0).integers(0, 256, (20, 24, 3)).astype(np.uint8))
    (desk / "broken.png").write_bytes((desk / "broken.png").read_bytes()[:-400])  # its header is whole
    call = ["simulate", "envi.toml", "--camera", "camera.toml", "-o", "t.h5", "--quiet"]
    assert l3(*call)[0] == 3
    content = (desk / changed).read_bytes()
    (desk / changed).write_bytes(content[::-1] if changed == "cube.img" else content.replace(b",0.6", b",0.5"))
    assert "remove --resume" in refused(2, *call, "--resume")


def test_a_name_is_compared_by_what_it_leads_to(tmp_path: Path) -> None:
    source, other = tmp_path / "source", tmp_path / "other"
    source.write_text("raw")
    other.write_text("other")
    (tmp_path / "link").symlink_to(source)
    os.link(source, tmp_path / "hard")
    with protecting([tmp_path / "link", tmp_path / "none"]), protecting([source]):
        for name in ("source", "link", "hard"):
            with pytest.raises(Exception, match="is an input"), atomic_output(tmp_path / name):
                raise AssertionError("work is done")
        with atomic_output(other) as temporary:
            temporary.write_text("new")
    refuse_protected(source)  # no longer
    assert (source.read_text(), other.read_text()) == ("raw", "new")
