"""Scenes from pictures behind a polariser and from Stokes parameters: known light is recovered, wrong files are rejected."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import OpenImageIO as oiio
import pytest
import tifffile

from l3cli.artifacts.camera_recipe import load_camera
from l3cli.artifacts.training_set import TrainingFrame, open_training_set
from l3cli.errors import InputFileError
from l3cli.frames.scene import PolarisedPictures
from l3cli.io.scenes import polariser, stokes
from l3cli.physics.stokes import STOKES, stokes_of
from l3cli.recipes.builtin import find_recipe
from l3cli.simulation.polarised_pictures import scene_of_stokes, stokes_of_pictures
from l3cli.simulation.reflectances import DRAWN, primaries
from l3cli.simulation.sources import BehindPolariser, StokesPictures, WantedScene
from tests.helpers.calls import L3, Refused

SIZE = (20, 24)
ANGLES = (0.0, 45.0, 90.0, 135.0)
RECIPE = """illuminants = ["D65"]
exposure_s = [0.01]
[sensor]
noise = "none"
[lens]
diffraction = false
[target]
outputs = "{outputs}"
[[scene]]
source = "{source}"
file = "{file}"
"""


def light(colours: int = 1) -> np.ndarray:
    """Return S0, S1 and S2, (3, row, col, colour), which vary from pixel to pixel. A white behind a polariser is 1."""
    rng = np.random.default_rng(60)
    bright = rng.uniform(0.1, 1.0, (*SIZE, colours))
    degree, angle = rng.uniform(0, 0.9, bright.shape), rng.uniform(0, np.pi, bright.shape)
    return np.stack([bright, bright * degree * np.cos(2 * angle), bright * degree * np.sin(2 * angle)])


def behind(stokes: np.ndarray, angle: float) -> np.ndarray:
    """Return the intensity behind a polariser: cos² of the angle to the polarised part, and half of the rest.

    A polariser halves unpolarised light, and the pictures are as bright as white without polarisation is without it.
    """
    polarised = np.hypot(stokes[1], stokes[2])
    direction = 0.5 * np.arctan2(stokes[2], stokes[1])
    return 2 * (polarised * np.cos(np.radians(angle) - direction) ** 2 + (stokes[0] - polarised) / 2)


def write(path: Path, pixels: np.ndarray, names: tuple[str, ...] = ()) -> Path:
    """Write a picture (row, col, channel)."""
    path.parent.mkdir(exist_ok=True)
    pixels = np.ascontiguousarray(pixels)
    spec = oiio.ImageSpec(pixels.shape[1], pixels.shape[0], pixels.shape[2], str(pixels.dtype).replace("float32", "float"))
    if names:
        spec.channelnames = names
    sink = oiio.ImageOutput.create(str(path))
    assert sink is not None
    assert sink.open(str(path), spec)
    assert sink.write_image(pixels)
    sink.close()
    return path


def pictures(folder: Path, of: np.ndarray, angles: tuple[float, ...] = ANGLES, name: str = "wall_{:03.0f}.png") -> Path:
    """Write 16-bit pictures of the light `of` behind a polariser into a folder. A white has the value 30000."""
    for angle in angles:
        write(folder / name.format(angle), np.rint(30000 * behind(of, angle)).astype(np.uint16))
    return folder


@pytest.fixture
def simulated(l3: L3, tmp_path: Path) -> Callable[..., tuple[TrainingFrame, str]]:
    """Return a function that simulates the frame of a scene. It returns the frame and the messages."""

    def run(file: Path, source: str, keys: str = "", camera: str = "polarised", outputs: str = "Stokes") -> tuple:
        (tmp_path / "scenes.toml").write_text(RECIPE.format(outputs=outputs, source=source, file=file) + keys)
        arguments = ("--camera", camera, "-o", tmp_path / "out.h5", "--force")
        code, out, err = l3("simulate", tmp_path / "scenes.toml", *arguments)
        assert code == 0, err
        with open_training_set(tmp_path / "out.h5") as reader:
            return reader.frame(0), out + err

    return run


def compare(frame: TrainingFrame, of: np.ndarray, tolerance: float) -> None:
    """Compare the target with the light `of` (3, row, col)."""
    np.testing.assert_allclose(stokes_of(frame.target, STOKES) / frame.white[1], of, atol=tolerance)


# ----------------------------------------------------------------------------------------------- known light comes back


@pytest.mark.parametrize("angles", [ANGLES, (0.0, 60.0, 120.0), (10.0, 40.0, 70.0, 100.0, 130.0, 160.0)])
def test_pictures_behind_a_polariser(
    simulated: Callable[..., tuple[TrainingFrame, str]], tmp_path: Path, angles: tuple[float, ...]
) -> None:
    frame, messages = simulated(pictures(tmp_path / "wall", light(), angles), "polariser", "white = 30000")
    compare(frame, light()[..., 0], 4e-5)  # half a step of 30000, in three pictures or more
    assert "warning" not in messages
    assert frame.scene == "wall"


def test_electrons_of_pictures(simulated: Callable[..., tuple[TrainingFrame, str]], tmp_path: Path) -> None:
    """The electrons behind each polariser of the camera follow Malus's law."""
    of = light()
    array = np.stack([behind(of, angle)[..., 0] for angle in ANGLES]).astype(np.float32)
    np.save(tmp_path / "wall.npy", array)
    frame, _ = simulated(tmp_path / "wall.npy", "polariser", f"angles_deg = {list(ANGLES)}")
    np.save(tmp_path / "white.npy", np.ones((4, *SIZE), np.float32))
    white, _ = simulated(tmp_path / "white.npy", "polariser", f"angles_deg = {list(ANGLES)}")
    camera = load_camera(find_recipe("polarised", "cameras"))
    assert camera.polarisers is not None
    leakage = 1 / camera.polarisers.extinction
    assert np.ptp(leakage, axis=0).max() == 0  # all channels have the same polarisers, apart from their angle
    weights = white.electrons[:, 0, 0] / white.electrons.max()
    np.testing.assert_allclose(weights, 1, rtol=1e-5)
    for channel, angle in enumerate(camera.polarisers.polariser_deg):
        through, across = behind(of, angle)[..., 0], behind(of, angle + 90)[..., 0]
        ratio = frame.electrons[channel] / white.electrons[channel]
        share = (ratio - through).ravel() @ (across - through).ravel() / np.sum((across - through) ** 2)
        assert leakage.min() / 2 < share / (1 - share) < leakage.max()  # mean over the spectrum
        np.testing.assert_allclose(ratio, through * (1 - share) + across * share, rtol=1e-4, atol=1e-5)


def test_stacks_and_file_types(tmp_path: Path) -> None:
    values = np.stack([behind(light(), angle)[..., 0] for angle in ANGLES]).astype(np.float32)
    tifffile.imwrite(tmp_path / "stack.tif", values, photometric="minisblack")
    np.save(tmp_path / "stack.npy", values)
    np.save(tmp_path / "colour.npy", np.repeat(values[..., None], 3, axis=3))
    for angle, picture in zip(ANGLES, values, strict=True):
        write(tmp_path / "folder" / f"{angle:g}deg_7.tif", picture[..., None])
    for name in ("stack.tif", "stack.npy", "colour.npy"):
        content = polariser.read(tmp_path / name, "*", ANGLES)
        assert content.angles == ANGLES
        assert polariser.size(tmp_path / name, "*", ANGLES) == SIZE
        np.testing.assert_array_equal(content.values[..., 0], values)
    content = polariser.read(tmp_path / "folder", "*", None)
    assert content.angles == ANGLES
    np.testing.assert_array_equal(content.values[..., 0], values)


def test_srgb_pictures_are_decoded(tmp_path: Path) -> None:
    """The grey 188 of sRGB is half of white, and unpolarised."""
    for angle in (0, 45, 90, 135):
        write(tmp_path / "grey" / f"{angle}.png", np.full((*SIZE, 3), 188, np.uint8))
    made = stokes_of_pictures(polariser.read(tmp_path / "grey", "*", None), BehindPolariser(file="", holds="sRGB"))
    np.testing.assert_allclose(made.stokes[0], 0.5, atol=0.003)
    np.testing.assert_allclose(made.stokes[1:], 0, atol=1e-6)


def test_each_colour_has_its_polarisation() -> None:
    """Colours that are polarised differently have electrons between those of their own polarisations."""
    of = light(3)
    made = stokes_of_pictures(PolarisedPictures(of.astype(np.float32), None), StokesPictures(file=""))
    scene = scene_of_stokes(made, DRAWN, "colours")
    assert scene.polarisation is not None
    weights = scene.polarisation.weights(DRAWN)
    for index in (0, 1):
        spectrum = scene.reflectance * (scene.polarisation.ratio[:, :, index] @ weights)
        error = (spectrum - of[index + 1] @ primaries()).mean(axis=2) / scene.reflectance.mean(axis=2)
        assert np.sqrt((error**2).mean()) < 3e-3
        assert abs(error).max() < 0.02
    same = PolarisedPictures(np.repeat(light(), 3, axis=3).astype(np.float32), None)
    grey = scene_of_stokes(stokes_of_pictures(same, StokesPictures(file="")), DRAWN, "grey")
    assert grey.polarisation is not None
    wanted = np.moveaxis(light()[1:, ..., 0] / light()[0, ..., 0], 0, 2)[..., None]
    np.testing.assert_allclose(grey.polarisation.ratio, np.broadcast_to(wanted, grey.polarisation.ratio.shape), atol=1e-5)


def test_stokes_files(simulated: Callable[..., tuple[TrainingFrame, str]], tmp_path: Path) -> None:
    of = light()[..., 0].astype(np.float32)
    rows_first = np.moveaxis(of, 0, 2)
    np.save(tmp_path / "last.npy", rows_first)
    np.save(tmp_path / "first.npy", of)
    tifffile.imwrite(tmp_path / "pages.tif", of, photometric="minisblack")
    five = np.concatenate([rows_first, np.zeros((*SIZE, 2), np.float32)], axis=2)
    write(tmp_path / "l3.tif", five)
    write(tmp_path / "named.exr", rows_first[..., [2, 0, 1]], ("S2", "S0", "S1"))
    for name in ("last.npy", "first.npy", "pages.tif", "l3.tif", "named.exr"):
        content = stokes.read(tmp_path / name)
        assert content.angles is None
        assert stokes.size(tmp_path / name) == SIZE
        np.testing.assert_array_equal(content.values[..., 0], of)
    frame, _ = simulated(tmp_path / "named.exr", "stokes")
    compare(frame, of, 1e-6)
    frame, _ = simulated(tmp_path / "named.exr", "stokes", "white = 2.0")
    compare(frame, of / 2, 1e-6)


def test_a_camera_without_polarisers_sees_s0(simulated: Callable[..., tuple[TrainingFrame, str]], tmp_path: Path) -> None:
    np.save(tmp_path / "wall.npy", light()[..., 0])
    frame, _ = simulated(tmp_path / "wall.npy", "stokes", camera="bayer", outputs="CIE 1931")
    np.testing.assert_allclose(frame.target[1] / frame.white[1], light()[0, ..., 0], rtol=1e-5)


# ------------------------------------------------------------------------------------------------------- contradictions


def test_pictures_that_contradict_each_other_are_reported(
    simulated: Callable[..., tuple[TrainingFrame, str]], tmp_path: Path
) -> None:
    """One exposure that is 20 % too long changes one intensity by 20 %, of which a quarter contradicts the others."""
    rng = np.random.default_rng(3)
    values = np.stack([np.full((48, 64), 0.4)] * 4) + 0.05 * rng.standard_normal((4, 48, 64))
    stated = f"angles_deg = {list(ANGLES)}"
    np.save(tmp_path / "noise.npy", values.astype(np.float32))
    assert "Malus" not in simulated(tmp_path / "noise.npy", "polariser", stated)[1]
    values[3] *= 1.2
    np.save(tmp_path / "wrong.npy", values.astype(np.float32))
    messages = simulated(tmp_path / "wrong.npy", "polariser", stated)[1]
    found = stokes_of_pictures(polariser.read(tmp_path / "wrong.npy", "*", ANGLES), BehindPolariser(file=""))
    assert found.contradiction == pytest.approx(0.05, rel=0.1)
    assert "wrong.npy: the pictures contradict" in messages
    assert "4.8%" in messages or "4.9%" in messages or "5.0%" in messages


def test_impossible_polarisation_is_limited_and_counted() -> None:
    of = np.zeros((3, *SIZE, 1))
    of[0] = 0.5
    of[1, :4] = 0.6  # a fifth of the rows
    of[2, :2] = 0.8
    of[0, 19, :6], of[1, 19, :6] = -0.1, 0.01  # a hundredth of all pixels is 4.8 pixels
    found = stokes_of_pictures(PolarisedPictures(of.astype(np.float32), None), StokesPictures(file=""))
    assert found.impossible == pytest.approx((4 * 24 + 6) / 480)
    degree = np.hypot(found.stokes[1], found.stokes[2]) / np.maximum(found.stokes[0], 1e-9)
    np.testing.assert_allclose(degree[:4], 1, rtol=1e-6)
    np.testing.assert_allclose(found.stokes[1:, 0, 0, 0], [0.3, 0.4], rtol=1e-6)  # the angle stays
    assert degree[4:].max() == 0
    assert found.stokes[0].min() == 0


# --------------------------------------------------------------------------------------------------- angles and refusals


@pytest.mark.parametrize(
    ("names", "angles"),
    [
        (["wall_000", "wall_045", "wall_090", "wall_135"], ANGLES),
        (["0_1", "45_1", "90_1", "135_1"], ANGLES),
        (["shot1_0deg", "shot2_45deg", "shot3_90deg", "shot4_135deg"], ANGLES),
        (["I0", "p45", "i_90", "x135"], ANGLES),
        (["a22.5", "a67.5", "a112.5"], (22.5, 67.5, 112.5)),
        (["shot1_0", "shot2_45", "shot3_90", "shot4_135"], None),
        (["horizontal", "diagonal", "vertical"], None),
        (["a1_0", "b2_45", "c3_90"], None),
    ],
)  # fmt: skip
def test_angles_in_names(names: list[str], angles: tuple[float, ...] | None) -> None:
    assert polariser._named_angles(names) == angles


def folder_of(path: Path, *names: str) -> Path:
    for name in names:
        write(path / "wall" / name, np.full((*SIZE, 1), 20000, np.uint16))
    return path / "wall"


@pytest.mark.parametrize(
    ("names", "keys", "culprit"),
    [
        (["0.png", "90.png"], "", "2 pictures"),
        (["a_0.png", "b_0.png", "a_45.png", "b_45.png", "a_90.png", "b_90.png"], "", "several"),
        (["0_1.png", "0_2.png", "45_1.png", "45_2.png", "90_1.png"], "", "angle"),
        (["1.png", "2.png", "3.png", "4.png"], "", "1, 2, 3, 4"),
        (["a.png", "b.png", "c.png", "d.png"], "angles_deg = [0.0, 0.785, 1.571, 2.356]\n", "radians"),
        (["a.png", "b.png", "c.png", "d.png"], "angles_deg = [0, 45, 90]\n", "3 angles"),
        (["0.png", "45.png", "90.png", "135.png"], "angles_deg = [90, 45, 135, 0]\n", "order"),
        (["0.png", "90.png", "180.png", "270.png"], "", "0, 90, 180, 270"),
        (["0.png", "45.png", "90.png", "135.png"], 'pictures = "*_1.png"\n', "0 pictures"),
    ],
)  # fmt: skip
def test_pictures_with_unclear_angles_are_refused(
    names: list[str], keys: str, culprit: str, refused: Refused, tmp_path: Path
) -> None:
    folder = folder_of(tmp_path, *names)
    (tmp_path / "scenes.toml").write_text(RECIPE.format(outputs="Stokes", source="polariser", file=folder) + keys)
    line = refused(3, "simulate", tmp_path / "scenes.toml", "--camera", "polarised", "-o", tmp_path / "out.h5")
    assert "wall" in line
    assert culprit in line


def test_pictures_that_differ_are_refused(refused: Refused, tmp_path: Path) -> None:
    folder = folder_of(tmp_path, "0.png", "45.png", "90.png", "135.png")
    (tmp_path / "scenes.toml").write_text(RECIPE.format(outputs="Stokes", source="polariser", file=folder))
    call = ("simulate", tmp_path / "scenes.toml", "--camera", "polarised", "-o", tmp_path / "out.h5")
    assert "white" in refused(3, *call)  # 20000 of 16 bits
    for pixels in (
        np.zeros((20, 25, 1), np.uint16), np.zeros((20, 24, 1), np.uint8), np.zeros((20, 24, 3), np.uint16),
    ):  # fmt: skip
        write(folder / "90.png", pixels)
        assert "90.png" in refused(3, *call)
    (folder / "90.png").write_text("no picture")
    assert "90.png" in refused(3, *call)


def test_the_message_about_an_unreadable_stokes_file_lists_formats_that_are_read(tmp_path: Path) -> None:
    """Stokes parameters can be negative, so a PNG file never contains them."""
    (tmp_path / "wall.exr").write_text("no picture")
    with pytest.raises(InputFileError, match=r"wall\.exr .*OpenEXR, TIFF or \.npy"):
        stokes.read(tmp_path / "wall.exr")


@pytest.mark.parametrize("source", ["polariser", "stokes"])
def test_other_files_are_refused(source: str, refused: Refused, tmp_path: Path) -> None:
    files = {
        "shape.npy": np.zeros((4, 20)),
        "text.npy": np.full((3, 20, 24), "a"),
        "nan.npy": np.full((3, 20, 24), np.nan),
        "bright.npy": np.full((3, 20, 24), 1000.0),
        "unsigned.npy": np.full((3, 20, 24), 7, np.uint16),
    }
    keys = "angles_deg = [0, 60, 120]\n" if source == "polariser" else ""
    for name, values in files.items():
        np.save(tmp_path / name, values)
        (tmp_path / "scenes.toml").write_text(RECIPE.format(outputs="Stokes", source=source, file=name) + keys)
        line = refused(3, "simulate", tmp_path / "scenes.toml", "--camera", "polarised", "-o", tmp_path / "out.h5")
        assert name in line
    write(tmp_path / "rgb.exr", np.zeros((*SIZE, 3), np.float32))
    (tmp_path / "scenes.toml").write_text(RECIPE.format(outputs="Stokes", source=source, file="rgb.exr") + keys)
    assert "rgb.exr" in refused(3, "simulate", tmp_path / "scenes.toml", "--camera", "polarised", "-o", tmp_path / "out.h5")
    if source == "polariser":
        np.save(tmp_path / "few.npy", np.zeros((4, 20, 24)))
        for name, stated in (("few.npy", keys), ("few.npy", "")):
            (tmp_path / "scenes.toml").write_text(RECIPE.format(outputs="Stokes", source=source, file=name) + stated)
            line = refused(3, "simulate", tmp_path / "scenes.toml", "--camera", "polarised", "-o", tmp_path / "out.h5")
            assert "angles" in line


@pytest.mark.parametrize(
    ("glob", "name"),
    [("*", "both"), ("*.png", "both"), ("*_1.png", "both 1"), ("left_*", "both left"), ("a*b-2.tif", "both a b 2")],
)
def test_scenes_of_one_folder_have_different_names(glob: str, name: str) -> None:
    source = BehindPolariser(file="both", pictures=glob)
    assert WantedScene(source, Path("pictures/both")).name == name


def test_frames_of_two_scenes_of_one_folder_have_different_names(tmp_path: Path, l3: L3) -> None:
    for number in (1, 2):
        pictures(tmp_path / "both", light() / number, name=f"{{:g}}_{number}.png")
    scenes = "".join(
        f'[[scene]]\nsource = "polariser"\nfile = "both"\nwhite = 30000\npictures = "*_{number}.png"\n' for number in (1, 2)
    )
    (tmp_path / "scenes.toml").write_text(RECIPE.split("[[scene]]")[0].format(outputs="Stokes") + scenes)
    assert l3("simulate", tmp_path / "scenes.toml", "--camera", "polarised", "-o", tmp_path / "new.h5", "--quiet")[0] == 0
    with open_training_set(tmp_path / "new.h5") as reader:
        assert [frame.scene for frame in reader] == ["both 1", "both 2"]
