"""`l3 check`: all faults of a recipe with their lines, and the summary of a recipe without faults."""

import json
import re
import shutil
import tomllib
from pathlib import Path

import msgspec
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from l3cli.artifacts.camera import CameraModel
from l3cli.artifacts.camera_recipe import load_camera
from l3cli.classes.rule import make_rule
from l3cli.design.recipe import DesignRecipe, design_faults, filter_curves, pixel_of
from l3cli.errors import L3Error
from l3cli.recipes.faults import refuse_first
from l3cli.recipes.load import load_recipe
from l3cli.simulation.lab import LabRecipe, plan
from l3cli.simulation.light import automatic_exposure, make_light
from l3cli.simulation.recipe import SceneRecipe
from l3cli.stages.check import KINDS, judge, names
from l3cli.stages.simulation.preparation import fitting, prepare
from l3cli.system.console import Silent
from l3cli.training.recipe import TrainingRecipe, layer_faults, learning_faults
from l3cli.training.summary import class_figures
from tests.helpers.calls import L3, Refused
from tests.helpers.cameras import bayer_camera
from tests.helpers.paths import CONFIGS
from tests.helpers.recipes import SMALL, as_toml, spoilt

MEASURED = """name = "a camera"
sensor = { rows = 192, cols = 256, pixel_pitch_um = 4.0, bits = 12 }
cfa = { channels = ["r", "g", "b"], pattern = ["r g", "g b"] }
optics = { focal_length_mm = 25, f_number = 2.8 }
"""
CAMERA = [
    ("bits = 12", 'bits = "twelve"\nbitz = 3', ("Expected `int`, got `str` in [sensor.bits]", "unknown key `bitz`")),
    ("rows = 192\n", "", ("missing key `rows` in [sensor]",)),
    ("prnu = 0.005", "prnu = 0.5", ("0.5 % is 0.005",)),
    ("focal_length_mm = 25", "focal_length_mm = 0.025", ("did you mean 25?",)),
    ('"g b"', '"g x"', ('"x" is not a channel',)),
    ("sigma_nm = 40", "sigma_nm = 0", ("responsivity.gaussians.g[1].sigma_nm is 0; use more than 0",)),
    ("well_capacity_e = 15000", "well_capacity_e = nan", ("noise.well_capacity_e is nan",)),
]
SCENES = """illuminants = ["D656", "lamp.csv", "0 D65"]  # "D656" is unknown | lamp.csv does not exist | proportion of 0
exposure_share = [0.9, -1]  # exposure_share[2] is -1; use more than 0
lens.transmittance = "none.csv"  # none.csv does not exist
lens.f_number = -3  # lens.f_number is -3
[target]
outputs = "CIE 1932"  # did you mean "CIE 1931"
[[scene]]
source = "dead leaves"
size = [4000, 8]  # at least 16×16
[[scene]]
source = "cube"
file = "cubes/*.npy"  # cubes/*.npy does not exist
wavelengths_nm = [400, 500, 450]  # neither increases nor decreases
axes = "row col"  # must contain row, col and band
[[pair]]
raw = "a.dng"  # a.dng does not exist
picture = "a.png"  # a.png does not exist
offset = [-1, 0]  # pair[1].offset[1] is -1; use at least 0
"""
CLASSES = """[classes]
patch = 4  # classes.patch is 4
contrasts = [2, 1]  # "contrasts" is [2.0, 1.0]
lowest_level = 2  # 0 < lowest_level < highest_level
[learning]
darkest = 0.5  # darkest < highlight_from
dark_share = 0.9  # learning.dark_share and learning.highlight_share is 1.15
ridge = 0  # learning.ridge is 0; use more than 0
level_power = 2  # learning.level_power is 2; use at most 1
[[layer]]
side = 4  # layer[1].side is 4
strengths = [2, 1]  # at least 0.001 apart
"""
LAB = """falloff = 2  # falloff is 2; use less than 1
monitor_error = -0.1  # monitor_error is -0.1; use at least 0
[mono]
step_nm = 0  # mono.step_nm is 0; use more than 0
overexposed = -1  # use at least 0
bandwidth_nm = 0.5  # must be larger than spectrometer_step_nm
stray_light = 0.5  # mono.stray_light is 0.5; use less than 0.01
[chart]
illuminants = ["D99"]  # illuminant "D99" is unknown
[white]
levels = [0.1, -1.0]  # white.levels[2] is -1.0; use more than 0
trials = 1  # white.trials is 1; use at least 2
[dark]
exposures_s = []  # dark.exposures_s has 0 values; use at least 1
[defects]
dust_depth = -1  # defects.dust_depth is -1; use at least 0
dust_radius_px = -1  # defects.dust_radius_px is -1; use more than 0
"""
MEASUREMENTS = """name = "measured"
uncertainty.lamp_drift = 2  # uncertainty.lamp_drift is 2; use less than 1
[sensor]
rows = 192
cols = 256
pixel_pitch_um = 4e-6  # did you mean 4?
bits = 12
[cfa]
channels = ["r", "g", "b"]
pattern = ["r g", "g"]  # the same number of channel names
[optics]
focal_length_mm = 25
f_number = 2.8
[[mono]]
frames = ["there.tif", "none.tif"]  # none.tif does not exist
exposure_s = 0.1
spectrum = "light.csv"  # no column is called
column = "500nm"
[[mono]]
frames = ["there.tif"]
exposure_us = 5
spectrum = "watts.csv"  # outside the plausible range
[[mono]]  # needs exactly one of the keys "exposure_s"
frames = ["there.tif"]
spectrum = "light.csv"
column = "450nm"
[[white]]
frames = []  # white[1].frames has 0 values; use at least 1
exposure_ms = 3
monitor = 20  # monitor is 20
"""


def comments(text: str) -> list[tuple[int, str]]:
    """The faults that comments announce: line, words."""
    lines = [(number, line.partition("  # ")[2]) for number, line in enumerate(text.splitlines(), 1)]
    return [(number, words) for number, noted in lines if noted for words in noted.split(" | ")]


def noted(out: str) -> list[tuple[str, int, str]]:
    """File, line and message of every fault that is listed."""
    found = [re.fullmatch(r"(.+?\.toml):(\d+): (.+)", line) for line in out.splitlines()]
    return [(match[1], int(match[2]), match[3]) for match in found if match]


def require_listed(path: Path, text: str, l3: L3) -> None:
    """Every fault announced, and no other one; each once, at its line."""
    path.write_text(text)
    code, out, err = l3("check", path)
    found = noted(out)
    assert code == 3
    assert len(found) == len(comments(text)), out
    assert err == f"l3: {len(found)} faults in 1 of 1 files; correct the files\n"
    for number, words in comments(text):
        assert [message for _, line, message in found if line == number and words in message], (number, words, out)


@pytest.mark.parametrize(("name", "text"), [("scenes", SCENES), ("classes", CLASSES), ("lab", LAB)])
def test_every_fault_is_reported_at_its_line(name: str, text: str, tmp_path: Path, l3: L3) -> None:
    require_listed(tmp_path / f"{name}.toml", text, l3)


def test_every_fault_of_a_measurement_file_is_reported(tmp_path: Path, l3: L3) -> None:
    (tmp_path / "there.tif").touch()
    (tmp_path / "light.csv").write_text("nm,450nm\n440,1e18\n450,2e18\n460,1e18\n")
    (tmp_path / "watts.csv").write_text("nm,550nm\n540,0.1\n550,0.2\n560,0.1\n")
    require_listed(tmp_path / "mine.toml", MEASUREMENTS, l3)


PHOTOS = """[[photo]]
frames = ["none.dng"]  # none.dng does not exist
light = "32K"  # cannot be computed as a black body
chart = "clasic"  # did you mean "classic"
[[photo]]
frames = ["there.tif"]
light = "lamp.csv"  # lamp.csv does not exist
layout = [4, 0]  # use at least 1
"""


def test_every_fault_of_photos_is_reported(tmp_path: Path, l3: L3) -> None:
    (tmp_path / "there.tif").touch()
    camera = (
        MEASUREMENTS.partition("[[mono]]")[0]
        .replace("4e-6", "4")
        .replace('"g"]', '"g b"]')
        .replace("drift = 2", "drift = 0")
    )
    require_listed(tmp_path / "mine.toml", re.sub("  # .*", "", camera) + PHOTOS, l3)


def test_every_fault_of_a_camera_is_reported_at_its_line(tmp_path: Path, l3: L3) -> None:
    path, text = tmp_path / "camera.toml", bayer_camera()
    for old, new, _ in CAMERA:
        assert old in text
        text = text.replace(old, new)
    path.write_text(text)
    code, out, _ = l3("check", path)
    assert code == 3
    lines, found = text.splitlines(), noted(out)
    assert len(found) == sum(len(what) for _, _, what in CAMERA)
    assert [line for _, line, _ in found] == sorted(line for _, line, _ in found)
    for _, new, what in CAMERA:
        for part, words in zip(new.splitlines() or ["[sensor]"], what, strict=True):
            number = next(line for _, line, message in found if words in message)
            assert part.partition(" ")[0] in lines[number - 1]


@pytest.mark.parametrize("name", sorted(names()))
def test_shipped_recipes_have_no_fault(name: str, l3: L3) -> None:
    code, out, err = l3("check", name)
    assert (code, err) == (0, "")
    assert [line.rpartition(": ")[2] for line in out.splitlines() if line[:1] == "/"] == [
        kind.title for kind, _ in names()[name]
    ]


def test_a_folder_of_init_is_checked_with_its_camera(tmp_path: Path, l3: L3) -> None:
    assert l3("init", "bayer_bggr", tmp_path / "demo", "--quiet")[0] == 0
    code, out, err = l3("check", tmp_path / "demo")
    assert (code, err) == (0, "")
    heads = [line for line in out.splitlines() if line[:1] == "/"]
    assert len(heads) == 8
    assert heads[0] == f"{tmp_path}/demo/camera.toml: a camera recipe"
    assert out.count("  for Bayer BGGR: ") == 6
    (tmp_path / "demo/unseen.toml").write_text('exposure_share = [1]\n[[scene]]\nsource = "skin"\nsize = [2000, 20]\n')
    code, out, _ = l3("check", tmp_path / "demo")
    assert (code, [found[1] for found in noted(out)]) == (3, [4])
    assert "larger than the sensor (1080×1920)" in out


# ------------------------------------------------------------------------------------------------------ meaning


def test_what_a_camera_means(tmp_path: Path, l3: L3) -> None:
    path = CONFIGS / "cameras/fiveband.toml"
    code, out, err = l3("check", "fiveband", "--json")
    assert (code, err) == (0, "")
    (listed_of,) = json.loads(out)["files"]
    camera, figures = load_camera(path), listed_of["meaning"]
    assert (listed_of["kind"], listed_of["faults"]) == ("camera", [])
    assert figures["array"][0] == ["b", "g", "c", "g"]
    assert figures["channels"]["g"]["sites"] == 8
    assert figures["saturation_exposure_cd_s_per_m2"]["D65"] == pytest.approx(camera.saturation_exposure, rel=2e-3)
    for light in ("D65", "A"):
        full = automatic_exposure(camera, make_light(light, {}, camera.wavelength).at(100.0), 1.0)
        assert figures["exposure_s"][light] == pytest.approx(full)
        assert max(channel[f"white_{light}"] for channel in figures["channels"].values()) == 1.0
    assert figures["channels"]["b"]["white_A"] < figures["channels"]["b"]["white_D65"]
    text = l3("check", "fiveband")[1]
    assert "\n  b g c g\n  g o g r\n  c g b g\n  g r g o\n" in text
    assert "cd s/m² of D65" in text


def test_the_width_of_a_curve(tmp_path: Path) -> None:
    path = tmp_path / "camera.toml"
    path.write_text(bayer_camera().replace("[400, 700, 10]", "[400, 700, 1]"))
    widths = [channel["fwhm_nm"] for channel in judge(path).meaning["channels"].values()]
    assert widths == pytest.approx([2.3548 * sigma for sigma in (35, 40, 30)], rel=1e-3)
    path.write_text(path.read_text().replace("[400, 700, 1]", "[400, 620, 1]"))
    assert judge(path).meaning["channels"]["r"]["fwhm_nm"] is None


def test_what_classes_mean(l3: L3) -> None:
    files = json.loads(l3("check", "fiveband", "default", "--json")[1])["files"]
    classes = next(each["meaning"] for each in files if each["kind"] == "classes")
    chromas = load_recipe(CONFIGS / "classes/default.toml", TrainingRecipe).classes.chromas
    assert [layer["classes_per_site"] for layer in classes["layers"]] == [10 * 5 * (chromas + 11), 10 * (28 + 11)]
    assert classes["sites"] == 16
    scenes = next(each["meaning"] for each in files if each["kind"] == "scenes")
    assert (scenes["frames"], scenes["bytes"]) == (66, 66 * 160**2 * 34)
    lab = next(each["meaning"] for each in files if each["kind"] == "lab")
    assert lab["frames"] * 1164 * 2048 * 2 == lab["bytes"]


def test_what_a_measurement_file_means(tmp_path: Path, l3: L3) -> None:
    text = bayer_camera().partition("[responsivity]")[0].replace("gain_dn_per_e = 0.25\n", "")
    text = re.sub("black_level_dn.*\nfixed.*\n", "", text) + "[optics]\nfocal_length_mm = 25\nf_number = 2.8\n"
    text += '[curves]\nfile = "c.csv"\n[datasheet]\nblack_level_dn = 64\nwhite_level_dn = 4000\nwell_capacity_e = 15000\n'
    (tmp_path / "m.toml").write_text(text)
    (tmp_path / "c.csv").write_text("nm,r,g,b\n400,1,2,3\n500,2,3,1\n600,3,1,1\n")
    code, out, err = l3("check", tmp_path / "m.toml")
    assert (code, err) == (0, "")
    assert out.splitlines()[0] == f"{tmp_path}/m.toml: a measurement file"
    assert "[curves] c.csv" in out
    assert "[datasheet] full-well capacity 15000 e-" in out
    (tmp_path / "m.toml").write_text(text.replace("[datasheet]", "[uncertainty]\n[datasheet]").partition("[datasheet]")[0])
    assert "either by [[white]] captures" in l3("check", tmp_path / "m.toml")[1]  # only the whole file says so


def test_a_page_shows_the_curves(tmp_path: Path, l3: L3) -> None:
    page = tmp_path / "cameras.html"
    code, out, err = l3("check", "from_curves", "default", "--plot", page)
    assert (code, err) == (0, f"{page}: 1 camera\n")
    assert "a camera recipe" in out
    text = page.read_text()
    assert "Peaks: r 0.459 at 605 nm, g 0.559 at 530 nm, b 0.47 at 460 nm." in text
    code, _, err = l3("check", "bayer", "--plot", page)
    assert (code, page.read_text()) == (1, text)
    assert "already exists" in err or "--force" in err
    assert l3("check", "bayer", "--plot", page, "--force", "--quiet")[0] == 0
    assert "needs a camera recipe without faults" in l3("check", "small", "--plot", page, "--force")[2]
    assert "ends in .html" in l3("check", "bayer", "--plot", tmp_path / "a.svg")[2]
    recipe = tmp_path / "scenes.html"
    recipe.write_text(SMALL["scenes"])
    assert "is an input" in l3("check", recipe, "bayer", "--plot", recipe, "--force")[2]
    assert recipe.read_text() == SMALL["scenes"]


# -------------------------------------------------------------------------------------------------- other files


@pytest.mark.parametrize(
    ("content", "line", "what"),
    [
        (b"a = 1\nb = \n", 2, "is not valid TOML"),
        (b"", 1, "the type of this file is unclear from its keys"),
        (b'name = "x"\n[sensor]\n[cfa]\n[optics]\n', 1, "the type of this file is unclear from its keys"),
        (b"\xff\xfe\x00", 1, "is not a text file"),
        (b'name = "x"\nbase = "none.toml"\nphase = [0, 0]\n', 2, "none.toml does not exist"),
        (b"exposure_s = [1]\n[[scene]]\nsource = 'rgb'\nfile = 'a**b'\n", 4, "a**b is not a valid glob"),
        (b"exposure_s = [1]\n[[scene]]\nsource = 'rgb'\nfile = '%s'\n" % (b"x" * 300), 4, "File name too long"),
        (b"[[scene]]\r\nsource = 'rgb'\r\n\r\nfile = 'x.png'\r\n", 4, "x.png does not exist"),
    ],
)
def test_files_of_other_kinds(content: bytes, line: int, what: str, tmp_path: Path, l3: L3) -> None:
    (tmp_path / "a.toml").write_bytes(content)
    code, out, _ = l3("check", tmp_path / "a.toml")
    assert code == 3
    assert [found[1] for found in noted(out) if what in found[2]] == [line]


@pytest.mark.parametrize(
    ("name", "content", "described"),
    [("raw.dng", b"II*\0\x08\0\0\0", True), ("camera.h5", b"\x89HDF\r\n", True), ("notes.txt", b"\xff\xfe", False)],
)
def test_binary_files_are_described_by_info(name: str, content: bytes, described: bool, tmp_path: Path, l3: L3) -> None:
    (tmp_path / name).write_bytes(content)
    code, out, _ = l3("check", tmp_path / name)
    assert code == 3
    assert (f"l3 info {tmp_path / name}" in out) == described


CORRECTIONS = """base = "camera.toml"
[[dark]]
frames = ["dark1.npy", "dark2.npy"]
exposure_s = 0.02
[[white]]
frames = ["white1.npy", "white2.npy"]
exposure_ms = 5
"""


def measured_folder(folder: Path) -> Path:
    """Dark and white frames of a camera that is known."""
    (folder / "camera.toml").write_text(bayer_camera())
    for name in ("dark1", "dark2", "white1", "white2"):
        np.save(folder / f"{name}.npy", np.full((192, 256), 100, np.uint16))
    path = folder / "MEASUREMENTS.toml"
    path.write_text(CORRECTIONS)
    return path


def test_measurements_of_a_known_camera(tmp_path: Path, l3: L3) -> None:
    path = measured_folder(tmp_path)
    code, out, err = l3("check", path)
    assert (code, err) == (0, "")
    assert out.splitlines()[0] == f"{path}: a measurement file"
    assert "  small Bayer: channels r, g, b" in out.splitlines()
    assert out.splitlines()[-2:] == ["  [white] 1 capture, 2 frames, 5 ms", "  [dark] 1 capture, 2 frames, 20 ms"]
    (document,) = json.loads(l3("check", path, "--json")[1])["files"]
    assert document["meaning"]["array"] == [["r", "g"], ["g", "b"]]
    assert l3("check", tmp_path)[0] == 0  # the whole folder, the camera beside it


@pytest.mark.parametrize(
    ("old", "new", "line", "what"),
    [
        ("camera.toml", "none.toml", 1, "none.toml does not exist"),
        ("camera.toml", "dark1.npy", 1, "dark1.npy"),
        ("dark2.npy", "dark3.npy", 3, "dark3.npy does not exist; copy the frame to this folder, or correct its file name"),
        ("exposure_s = 0.02", "", 2, "needs exactly one of the keys"),
        ("exposure_ms = 5", "exposure_ms = -5", 7, "white[1].exposure_ms is -5; use more than 0"),
        ("exposure_ms = 5", "exposure_min = 5", 7, "unknown key `exposure_min`"),
        ("[[white]]", "[[whites]]", 5, "unknown key `whites`"),
        ('base = "camera.toml"', "base = 5", 1, "Expected `str`, got `int` in [base]"),
        ('"camera.toml"', '"camera.toml"\nsweep = 3', 2, "unknown key `sweep`"),
    ],
)
def test_wrong_measurements_of_a_known_camera(old: str, new: str, line: int, what: str, tmp_path: Path, l3: L3) -> None:
    path = measured_folder(tmp_path)
    path.write_text(CORRECTIONS.replace(old, new, 1))
    code, out, _ = l3("check", path)
    assert code == 3
    assert [found[1] for found in noted(out) if what in found[2]] == [line]


def test_a_hundred_faults_are_listed_and_the_others_counted(tmp_path: Path, l3: L3) -> None:
    (tmp_path / "scenes.toml").write_text("exposure_share = [0.9]\n" + "[[scene]]\n" * 500)
    code, out, err = l3("check", tmp_path / "scenes.toml")
    assert code == 3
    listed, others = out.splitlines()
    assert listed.startswith(
        f"{tmp_path}/scenes.toml:2: missing key `source` in [scene[1]] (99 similar faults in lines 3, 4"
    )
    assert others == f"{tmp_path}/scenes.toml: 400 more faults are not listed"
    assert "500 faults in 1 of 1 files" in err
    (file,) = json.loads(l3("check", tmp_path / "scenes.toml", "--json")[1])["files"]
    assert (len(file["faults"]), file["more_faults"]) == (100, 400)


@pytest.mark.parametrize("name", ["", ".", "/", "a\\u0000b"])
def test_a_name_of_no_file_is_a_fault(name: str, tmp_path: Path, l3: L3) -> None:
    head = 'exposure_share = [0.9]\nilluminants = ["D65"]\n[[scene]]\nsource = "rgb"\n'
    for line, text in enumerate((f'file = "{name}"', f'file = "a"\n[lens]\ntransmittance = "{name}"')):
        (tmp_path / "scenes.toml").write_text(head + text)
        code, out, _ = l3("check", tmp_path / "scenes.toml")
        assert (code, out.splitlines()[-1].partition(": ")[0]) == (3, f"{tmp_path}/scenes.toml:{5 + 2 * line}")


def test_a_scene_without_its_file_misses_it_alone(tmp_path: Path, l3: L3) -> None:
    (tmp_path / "scenes.toml").write_text('exposure_share = [0.9]\nilluminants = ["D65"]\n[[scene]]\nsource = "rgb"\n')
    assert l3("check", tmp_path / "scenes.toml")[1] == f"{tmp_path}/scenes.toml:3: missing key `file` in [scene[1]]\n"


def test_wrong_calls(tmp_path: Path, refused: Refused) -> None:
    assert str(tmp_path) in refused(3, "check", tmp_path)


def test_the_classes_of_a_site_are_those_of_the_rule() -> None:
    """With a further feature, too."""
    camera = load_camera(CONFIGS / "cameras/bayer.toml")
    recipe = msgspec.convert(
        {"classes": {"direction": {"orientations": 8}, "chromas": 1, "contrasts": [2, 4]}}, TrainingRecipe
    )
    rule = make_rule(recipe.classes, camera, np.arange(8).astype(np.uint16))
    document = class_figures(recipe, camera)
    assert document["layers"][0]["classes_per_site"] == rule.classes_per_site
    assert [*KINDS] == ["camera", "lab", "scenes", "classes", "design", "measurements"]


# ------------------------------------------------------------------------------- it agrees with what commands refuse


def use(kind: str, path: Path, camera: CameraModel) -> None:
    """What the command that reads such a recipe asks of it; an L3Error if it is refused."""
    if kind == "camera":
        load_camera(path)
    elif kind == "lab":
        plan(camera, load_recipe(path, LabRecipe), 0)
    elif kind == "scenes":
        recipe = load_recipe(path, SceneRecipe)
        fitting(*prepare(recipe, path, camera, 0), path, False, Silent())
    elif kind == "design":
        designed = load_recipe(path, DesignRecipe)
        refuse_first(design_faults(designed))
        pixel = pixel_of(designed.pixel, path.parent)
        filter_curves(designed, pixel, pixel.wavelength, path.parent)
    else:
        classes = load_recipe(path, TrainingRecipe)
        refuse_first(learning_faults(classes.learning))
        refuse_first(layer_faults(classes.layer))
        make_rule(classes.classes, camera, np.zeros(8, np.uint16))


@settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data(), name=st.sampled_from(sorted(names())), number=st.integers(0, 2))
def test_what_is_reported_is_what_is_refused(
    data: st.DataObject, name: str, number: int, bayer: CameraModel, tmp_path: Path
) -> None:
    kind, shipped = names()[name][number % len(names()[name])]
    path = tmp_path / "recipe.toml"
    for needed in ("bayer.toml", "from_curves.csv"):
        shutil.copy(CONFIGS / "cameras" / needed, tmp_path / needed)
    path.write_text(as_toml(spoilt(tomllib.loads(shipped.read_text()), data.draw)))
    judged = judge(path, bayer)
    if judged.kind != kind.name:  # without the keys that tell it
        return
    try:
        use(kind.name, path, bayer)
    except L3Error:
        assert judged.findings
        assert all(1 <= finding.line <= len(path.read_text().splitlines()) for finding in judged.findings)
    else:
        assert [finding for finding in judged.findings if "light that can be seen" not in finding.message] == []
        assert judged.meaning


def test_equal_faults_of_many_entries_are_one_line(tmp_path: Path, l3: L3) -> None:
    """Each has its line in JSON; three are few enough to be shown."""
    for steps, lines in ((20, 5), (3, 13)):
        entries = [f'[[mono]]\nframes = ["m{step}.tif"]\nspectra = "mono.csv"\n' for step in range(steps)]
        (tmp_path / "m.toml").write_text(MEASURED + "".join(entries) + "[uncertainty]\nlamp = 1\n")
        code, out, err = l3("check", tmp_path / "m.toml")
        assert code == 3
        assert out.count("\n") == lines
        assert f"{4 * steps + 1} faults in 1 of 1 files" in err
        folded = f'unknown key `spectra` in [mono[1]]; did you mean "spectrum"? ({steps - 1} similar faults in lines 10, '
        assert (folded in out) == (steps == 20)
        assert "m0.tif does not exist" in out
        assert "unknown key `lamp`" in out
        faults = json.loads(l3("check", tmp_path / "m.toml", "--json")[1])["files"][0]["faults"]
        assert len(faults) == 4 * steps + 1
