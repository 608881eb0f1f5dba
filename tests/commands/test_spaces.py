"""Colour spaces of pictures: values compared with colour-science, and profiles read by Little CMS."""

import dataclasses
import io
from pathlib import Path
from typing import Any, get_args, get_type_hints

import av
import numpy as np
import OpenImageIO as oiio
import pytest
import tifffile
from PIL import Image, ImageCms

import l3cli as l3_python
from l3cli.artifacts.store import save
from l3cli.frames.frame import RawFrame
from l3cli.io.images import read_image
from l3cli.io.pictures.icc import icc_profile
from l3cli.io.pictures.registry import Picture, picture_file
from l3cli.options.render import RenderOptions
from l3cli.physics.display import TONES, scene_white
from l3cli.physics.spaces import D65, SPACES, SRGB, adaptation_matrix, chromaticity_of, xyz_of
from l3cli.physics.spectra import colour_science
from l3cli.rendering.display import encode, make_display
from l3cli.rendering.reference import ReferenceRenderer
from tests.helpers.calls import L3, Refused
from tests.helpers.cameras import BAYER
from tests.helpers.tables import random_table

TABLE = random_table(BAYER, bits=12, black_level=64.0, patch=5)
ENCODED = [name for name, space in SPACES.items() if space.curve]
KNOWN = {"srgb": "sRGB", "display-p3": "Display P3", "rec2020": "ITU-R BT.2020", "acescg": "ACEScg"}


@pytest.fixture(scope="module")
def desk(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a table and a frame of it."""
    folder = tmp_path_factory.mktemp("spaces")
    save(TABLE, folder / "table.h5")
    np.save(folder / "frame.npy", np.random.default_rng(5).integers(60, 3000, (24, 30)).astype(np.uint16))
    return folder


def outputs(folder: Path) -> np.ndarray:
    """(output, row, col) of the folder's frame."""
    frame = RawFrame("f", np.load(folder / "frame.npy"), TABLE.black_level, TABLE.white_level)
    return ReferenceRenderer(TABLE).exact_outputs(frame)


def words(path: Path) -> Any:
    """What a file says of itself, by OpenImageIO."""
    source = oiio.ImageInput.open(str(path))
    assert source is not None
    return source.spec()


# -------------------------------------------------------------------------------------------------------- formulas


@pytest.mark.parametrize("name", KNOWN)
def test_spaces_are_those_of_the_standards(name: str) -> None:
    space, theirs = SPACES[name], colour_science().RGB_COLOURSPACES[KNOWN[name]]
    np.testing.assert_allclose(space.primaries, theirs.primaries)
    np.testing.assert_allclose(space.white, theirs.whitepoint)
    np.testing.assert_allclose(space.from_xyz, theirs.matrix_XYZ_to_RGB, atol=2e-4)  # theirs are rounded
    linear = np.linspace(0, 1, 1001)
    if space.curve:
        np.testing.assert_allclose(space.curve.encoded(linear), theirs.cctf_encoding(linear), atol=3e-4)  # BT.2020: 12 bits


@pytest.mark.parametrize("name", SPACES)
def test_white_is_white(name: str) -> None:
    space, white = SPACES[name], scene_white("A")
    if space.curve:
        codes = encode(white[:, None, None], make_display(white, 1.0, 16, space))
        assert codes.tolist() == [[[65535] * 3]]
    np.testing.assert_allclose(space.from_xyz @ space.neutral_xyz, xyz_of(D65) if name == "xyz" else np.ones(3), atol=1e-12)


@pytest.mark.parametrize("name", SPACES)
def test_little_cms_reads_the_primaries(name: str) -> None:
    """A profile's colorants are those of the connection space, whose white is D50."""
    space = SPACES[name]
    profile = ImageCms.ImageCmsProfile(io.BytesIO(icc_profile(space))).profile
    assert (profile.profile_description, profile.is_matrix_shaper) == (space.title, True)
    adapted = adaptation_matrix(space.neutral_xyz, np.array([0.9642, 1.0, 0.8249])) @ space.to_xyz
    primaries: Any = (profile.red_primary, profile.green_primary, profile.blue_primary)
    for column, (xyz, _) in zip(adapted.T, primaries, strict=True):
        np.testing.assert_allclose(xyz, column, atol=3e-5)
    assert icc_profile(space) == icc_profile.__wrapped__(space)


@pytest.mark.parametrize("suffix", [".png", ".tif", ".jpg"])
@pytest.mark.parametrize("name", ENCODED)
def test_whoever_follows_the_profile_sees_the_same_colours(name: str, suffix: str) -> None:
    """Colours of sRGB in a file of each space, brought to sRGB by Little CMS and its own profile."""
    codes = np.random.default_rng(2).integers(40, 216, (8, 8, 3))
    xyz = np.moveaxis(((codes / 255 + 0.055) / 1.055) ** 2.4 @ np.linalg.inv(SRGB.from_xyz).T, -1, 0)
    picture = encode(xyz, make_display(SRGB.neutral_xyz, 1.0, 8, SPACES[name])).repeat(8, 0).repeat(8, 1)
    stored = Image.open(io.BytesIO(picture_file(Path("a" + suffix), Picture(picture, SPACES[name]))))
    profile = ImageCms.ImageCmsProfile(io.BytesIO(stored.info["icc_profile"]))
    shown = ImageCms.profileToProfile(
        stored, profile, ImageCms.createProfile("sRGB"), renderingIntent=ImageCms.Intent.RELATIVE_COLORIMETRIC
    )
    assert shown is not None
    assert np.abs(np.asarray(shown).astype(int)[4::8, 4::8] - codes).max() <= (
        8 if suffix == ".jpg" else 3
    )  # a step of a wide space


# -------------------------------------------------------------------------------------------------------- l3 render


@pytest.mark.parametrize(
    ("name", "bits", "backend"),
    [("rec2020", 8, "opencl"), ("rec2020", 16, "opencl"), *((name, 16, "reference") for name in ENCODED)],
)
def test_codes_are_those_of_the_reference(l3: L3, desk: Path, name: str, bits: int, backend: str) -> None:
    options = ("--exposure", 0.7, "--white", "A", "--bits", bits, "--backend", backend, "--force", "--quiet")
    assert l3("render", desk / "table.h5", desk / "frame.npy", "-o", desk / "a.tif", "--space", name, *options)[0] == 0
    truth = encode(outputs(desk), make_display(scene_white("A"), 0.7, bits, SPACES[name]))
    assert np.abs(read_image(desk / "a.tif")[0].astype(int) - truth).max() <= (1 if bits == 8 else 2)


def test_the_tone_curve_is_the_published_one() -> None:
    """Its points, and what it makes of all values: rising, from 0 to 1, 2.9 EV above white."""
    tone = TONES["aces"]
    x = np.array([0.0, 0.18, 1.0, 2.0, 7.2416])
    expected = [0.0, 0.0867 / 0.3249, 2.54 / 3.16, 10.1 / 11.04, 1.0]
    np.testing.assert_allclose(tone.toned(x), expected, atol=2e-4)
    ramp = tone.toned(np.linspace(-1, 10, 1001))
    assert (np.diff(ramp) >= 0).all()
    assert (ramp[0], ramp[-1], tone.toned(np.array(1e300))) == (0, 1, 1)
    assert get_args(get_args(get_type_hints(RenderOptions)["tone"])[0]) == tuple(TONES)


@pytest.mark.parametrize("backend", ["opencl", "reference"])
def test_a_tone_curve_of_stills_and_of_video(l3: L3, desk: Path, tmp_path: Path, backend: str) -> None:
    options = ("--exposure", 3, "--white", "A", "--backend", backend, "--quiet", "--tone", "aces")
    np.save(tmp_path / "clip.npy", np.load(desk / "frame.npy")[None].repeat(2, axis=0))
    made = [tmp_path / "a.png", tmp_path / "b.mkv"]
    for frames, output, more in ((desk / "frame.npy", made[0], ()), (tmp_path / "clip.npy", made[1], ("--codec", "ffv1"))):
        assert l3("render", desk / "table.h5", frames, "-o", output, *options, *more)[0] == 0
    display = make_display(scene_white("A"), 3.0, 8)
    plain, truth = encode(outputs(desk), display), encode(outputs(desk), dataclasses.replace(display, tone=TONES["aces"]))
    still = read_image(made[0])[0]
    assert np.abs(still.astype(int) - truth).max() <= 1
    assert (plain == 255).mean() > 2 * (truth == 255).mean()  # highlights that were white
    with av.open(str(made[1])) as video:
        for frame in video.decode(video=0):
            np.testing.assert_array_equal(frame.to_ndarray(format="rgb24"), still)


@pytest.mark.parametrize("file", ["a.exr", "a.exr --space srgb", "a.tif --bits 32", "a.dng"])
def test_a_tone_curve_is_refused_for_linear_values(desk: Path, tmp_path: Path, file: str, refused: Refused) -> None:
    name, *options = file.split()
    call = ("render", desk / "table.h5", desk / "frame.npy", "--tone", "aces", "-o", tmp_path / name, *options)
    assert "--tone applies only to display images" in refused(2, *call)


@pytest.mark.parametrize("file", ["a.exr", "a.tif"])
@pytest.mark.parametrize("name", SPACES)
def test_floating_point_is_linear_and_whole(l3: L3, desk: Path, name: str, file: str) -> None:
    options = ("--bits", 32, "--exposure", 2, "--white", "A", "--force", "--quiet")
    assert l3("render", desk / "table.h5", desk / "frame.npy", "-o", desk / file, "--space", name, *options)[0] == 0
    pixels, channels = read_image(desk / file)
    space = SPACES[name]
    matrix = space.from_xyz @ adaptation_matrix(scene_white("A"), space.neutral_xyz) * 2
    truth = np.einsum("po,orc->rcp", matrix, outputs(desk))
    np.testing.assert_allclose(pixels, truth, atol=1e-5)
    assert truth.max() > 1
    assert pixels.dtype == np.float32
    assert channels == (("X", "Y", "Z") if (name, file) == ("xyz", "a.exr") else ("R", "G", "B"))
    again = l3_python.Renderer(TABLE).picture(np.load(desk / "frame.npy"), exposure=2, white="A", space=name, bits=32)
    np.testing.assert_array_equal(again, pixels)


@pytest.mark.parametrize(("stops", "times"), [("+1EV", 2.0), ("-1.5 ev", 2**-1.5)])
def test_stops_are_from_the_automatic_exposure(l3: L3, desk: Path, tmp_path: Path, stops: str, times: float) -> None:
    frame = np.load(desk / "frame.npy")
    np.save(tmp_path / "still.npy", frame)
    np.save(tmp_path / "clip.npy", np.stack([frame, frame // 2]))
    for frames in ("still", "clip"):
        call = ("render", desk / "table.h5", tmp_path / f"{frames}.npy", "--space", "xyz", "--format", "exr")
        for name, exposure in (("auto", "auto"), ("other", stops)):
            output = tmp_path / frames / name
            assert l3(*call, "-o", output, "--exposure", exposure, "--backend", "reference", "--quiet")[0] == 0
        for path in (tmp_path / frames / "auto").glob("[!.]*"):
            usual, other = (read_image(tmp_path / frames / name / path.name)[0] for name in ("auto", "other"))
            np.testing.assert_allclose(other, usual * times, rtol=1e-5, atol=1e-6)


def test_stops_of_a_picture_and_of_what_a_raw_file_states(l3: L3, desk: Path) -> None:
    call = ("render", desk / "table.h5", desk / "frame.npy", "--backend", "reference", "--quiet")
    stated = []
    for exposure in ("auto", "+1EV"):
        assert l3(*call, "--exposure", exposure, "-o", desk / "a.dng", "--force")[0] == 0
        with tifffile.TiffFile(desk / "a.dng") as file:
            stated.append(np.divide(*file.pages[0].tags.valueof(50730)))
        assert l3(*call, "--exposure", exposure, "-o", desk / f"{exposure}.png")[0] == 0
    assert stated[1] - stated[0] == pytest.approx(1, abs=0.01)
    assert read_image(desk / "+1EV.png")[0].mean() > 1.1 * read_image(desk / "auto.png")[0].mean()


def test_outputs_as_they_are_state_their_white(l3: L3, desk: Path) -> None:
    for name in ("o.exr", "o.tif"):
        assert l3("render", desk / "table.h5", desk / "frame.npy", "-o", desk / name, "--bits", 32)[0] == 0
        np.testing.assert_allclose(np.moveaxis(read_image(desk / name)[0], -1, 0), outputs(desk), atol=1e-5)
    spec = words(desk / "o.exr")
    np.testing.assert_allclose(spec["chromaticities"], (1, 0, 0, 1, 0, 0, 1 / 3, 1 / 3), atol=1e-6)
    np.testing.assert_allclose(spec["adoptedNeutral"], chromaticity_of(TABLE.white_point), atol=1e-6)
    profile = ImageCms.ImageCmsProfile(io.BytesIO(words(desk / "o.tif")["ICCProfile"].tobytes()))
    assert profile.profile.profile_description == "CIE XYZ"


def test_exr_has_the_chromaticities_of_its_space(l3: L3, desk: Path) -> None:
    assert l3("render", desk / "table.h5", desk / "frame.npy", "-o", desk / "c.exr", "--space", "acescg")[0] == 0
    spec = words(desk / "c.exr")
    np.testing.assert_allclose(
        spec["chromaticities"], (0.713, 0.293, 0.165, 0.83, 0.128, 0.044, 0.32168, 0.33767), atol=1e-6
    )
