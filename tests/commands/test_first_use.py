"""First use: l3 without arguments, recipes by name, and pictures of any size."""

import shutil
from pathlib import Path
from typing import Any

import click
import numpy as np
import pytest

from l3cli.artifacts.camera import CameraModel
from l3cli.cli import l3 as program
from l3cli.io.pictures.registry import write_picture
from tests.helpers.calls import L3, Refused
from tests.helpers.paths import CONFIGS

ASKED = {  # every place where a recipe is asked for: what goes before it ← what goes after, kind, parameter
    ("lab",): (("-o", "x"), "cameras", "camera"),
    ("lab", "camera.toml", "-o", "x", "--recipe"): ((), "lab", "recipe"),
    ("calibrate", "m.toml", "-o", "x", "--truth"): ((), "cameras", "truth"),
    ("export",): (("-o", "x"), "cameras", "artifact"),
    ("simulate",): (("--camera", "c.h5", "-o", "x"), "scenes", "scenes"),
    ("simulate", "s.toml", "-o", "x", "--camera"): ((), "cameras", "camera"),
    ("train", "t.h5", "-o", "x", "--classes"): ((), "classes", "classes"),
}
EXAMPLES = {"cameras": "fiveband", "lab": "default", "scenes": "small", "classes": "best"}
TYPOS = {"cameras": "fivebnd", "lab": "defualt", "scenes": "smal", "classes": "bestt"}
places = pytest.mark.parametrize("place", ASKED, ids=" ".join)


def parsed(place: tuple[str, ...], word: str) -> Path:
    """What a command takes for `word` at a place where a recipe is asked for."""
    after, _, parameter = ASKED[place]
    command = program.get_command(click.Context(program), place[0])
    assert command is not None
    return command.make_context(place[0], [*place[1:], word, *after]).params[parameter]


# ---------------------------------------------------------------------------------------------------------- l3 alone


def test_l3_alone_explains_itself_and_is_a_wrong_call(l3: L3) -> None:
    helped = l3("--help")
    assert helped[0] == 0
    assert len(helped[1].splitlines()) > 15
    assert l3() == (2, "", helped[1])


# ------------------------------------------------------------------------------------------------- recipes by name


@places
def test_a_recipe_is_opened_by_its_name(place: tuple[str, ...], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    kind = ASKED[place][1]
    name = EXAMPLES[kind]
    assert parsed(place, name) == CONFIGS / kind / f"{name}.toml"
    (tmp_path / name).mkdir()  # as `l3 init fiveband fiveband` leaves it
    assert parsed(place, name) == CONFIGS / kind / f"{name}.toml"
    (tmp_path / name).rmdir()
    (tmp_path / name).touch()  # a file of that name is what is meant
    assert parsed(place, name) == Path(name)
    assert parsed(place, f"./{name}") == Path(name)


@places
def test_a_misspelt_name_brings_the_one_that_was_meant(
    place: tuple[str, ...], refused: Refused, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    after, kind, _ = ASKED[place]
    assert f'did you mean "{EXAMPLES[kind]}"?' in refused(2, *place, TYPOS[kind], *after)
    missing = f"configs/{kind}/{EXAMPLES[kind]}.toml"  # as a checkout has it, typed where there is none
    assert f'{missing} does not exist; write "{EXAMPLES[kind]}"' in refused(3, *place, missing, *after)
    assert parsed(place, "mine/nothing.toml") == Path("mine/nothing.toml")  # whoever opens it says so


def test_the_shell_is_offered_names_next_to_files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)

    def offered(*words: str) -> list[str]:
        from click.shell_completion import ShellComplete

        *before, incomplete = words
        completion = ShellComplete(program, {}, "l3", "_L3_COMPLETE")
        return [item.value for item in completion.get_completions(before, incomplete)]

    assert offered("train", "t.h5", "--classes", "be") == ["best"]
    assert offered("simulate", "de") == ["default", "demo_unseen"]
    (tmp_path / "camera.toml").touch()
    (tmp_path / "cameras").mkdir()
    assert offered("simulate", "s.toml", "--camera", "c") == ["cmy", "camera.toml", "cameras/"]
    assert offered("simulate", "s.toml", "--camera", "ca") == ["ca"]  # no name begins so: the shell's own files


# ------------------------------------------------------------------------------------------------- pictures of any size


def picture(path: Path, rows: int, cols: int) -> None:
    write_picture(path, np.random.default_rng(rows).integers(0, 255, (rows, cols, 3)).astype(np.uint8))


@pytest.fixture
def pictures(tmp_path: Path) -> Path:
    """A recipe of pictures of which two are too large, one is too small, and one is none."""
    for name, size in {"a": (40, 50), "b": (300, 400), "c": (64, 48), "d": (193, 60), "e": (10, 90)}.items():
        picture(tmp_path / f"{name}.png", *size)
    (tmp_path / "f.png").write_bytes(b"no picture")
    (tmp_path / "scenes.toml").write_text('exposure_share = [0.9]\n[[scene]]\nsource = "rgb"\nfile = "*.png"\n')
    return tmp_path / "scenes.toml"


def test_all_pictures_that_do_not_fit_are_named_before_any_work(
    pictures: Path, bayer_recipe: Path, refused: Refused, monkeypatch: pytest.MonkeyPatch
) -> None:
    from l3cli.stages.simulation import simulate as stage

    monkeypatch.chdir(pictures.parent)  # a line of many names is cut short, and how long a path is differs
    monkeypatch.setattr(stage, "simulate_unit", lambda unit: pytest.fail("work has begun"))
    line = refused(3, "simulate", pictures.name, "--camera", bayer_recipe, "-o", "out.h5")
    for part in ("4 of 6 scenes", "b.png", "300×400", "d.png", "193×60", "192×256", "e.png", "10×90", "16×16", "f.png"):
        assert part in line
    assert all(cure in line for cure in ("scale", "shrink", "--skip-bad"))
    many = pictures.parent / "many"
    many.mkdir()
    for number in range(40):
        shutil.copy(pictures.parent / "b.png", many / f"{number}.png")
    pictures.write_text(pictures.read_text().replace("*.png", "many/*.png"))
    line = refused(3, "simulate", pictures.name, "--camera", bayer_recipe, "-o", "out.h5")
    assert "40 of 40 scenes" in line
    assert " more" in line
    assert len(line) < 1000


def test_pictures_that_do_not_fit_are_left_out_if_asked(
    pictures: Path, bayer_recipe: Path, l3: L3, refused: Refused
) -> None:
    folder = pictures.parent
    call = ("simulate", pictures, "--camera", bayer_recipe, "-o")
    code, out, err = l3(*call, folder / "some.h5", "--skip-bad")
    assert (code, out) == (1, "")
    assert [name for name in "abcdef" if f"{name}.png" in err] == ["b", "d", "e", "f"]
    assert "2 frames; 4 scenes skipped" in err.splitlines()[-1]
    for name in "bdef":
        (folder / f"{name}.png").unlink()
    assert l3(*call, folder / "whole.h5", "--skip-bad", "--quiet") == (0, "", "")
    assert (folder / "some.h5").read_bytes() == (folder / "whole.h5").read_bytes()
    picture(folder / "a.png", 300, 400)
    (folder / "c.png").unlink()
    assert "scenes can be used" in refused(3, *call, folder / "none.h5", "--skip-bad").splitlines()[-1]


def test_a_size_is_that_of_the_framed_scene(bayer: CameraModel, tmp_path: Path) -> None:
    from l3cli.frames.scene import Scene
    from l3cli.simulation.sources import Framing, framed, framed_size

    scene = Scene("x", np.array([550.0]), np.zeros((31, 45, 1), np.float32), None)
    for text in ({}, {"crop": (1, 2, 20, 30)}, {"rotate": 90}, {"scale": 0.7}, {"scale": 9.0, "rotate": 270},
                 {"field_of_view_deg": 2.0}, {"crop": (0, 0, 17, 33), "rotate": 90, "field_of_view_deg": 1.0}):  # fmt: skip
        framing = Framing(**text)
        assert framed_size((31, 45), framing, bayer) == framed(scene.reflectance, framing, bayer).shape[:2], text


def test_headers_give_the_size_that_reading_gives(tmp_path: Path, bayer: CameraModel) -> None:
    import h5py
    from scipy.io import savemat

    from l3cli.io.images import picture_size
    from l3cli.io.scenes import format_of, iset
    from tests.helpers.cubes import a_cube, basis_file

    cube, path = a_cube(), tmp_path / "cube"
    picture(tmp_path / "a.png", 33, 44)
    assert picture_size(tmp_path / "a.png") == (33, 44)
    np.save(f"{path}.npy", cube)
    savemat(f"{path}.mat", {"one": cube, "wave": np.arange(31)})
    savemat(tmp_path / "struct.mat", {"s": {"cube": cube, "other": 3}})
    with h5py.File(f"{path}.h5", "w") as file:
        file["group/values"] = cube
    for name, variable in {"cube.npy": None, "cube.mat": None, "struct.mat": "s.cube", "cube.h5": "group/values"}.items():
        for axes in ("row col band", "col row band", "band row col"):
            stored = format_of("cube", tmp_path / name)
            scene: Any = stored.read(tmp_path / name, variable=variable, axes=axes)
            read = scene.values.shape[:2]
            assert stored.size(tmp_path / name, variable=variable, axes=axes) == read, (name, axes)
    basis_file(tmp_path / "iset.mat", "photons")
    read = iset.read(tmp_path / "iset.mat").reflectance.shape[:2]
    assert iset.size(tmp_path / "iset.mat") == read == (20, 24)
    savemat(tmp_path / "scene.mat", {"scene": {"data": {"photons": cube}, "spectrum": {"wave": np.arange(31)}}})
    assert iset.size(tmp_path / "scene.mat") == (20, 24)
