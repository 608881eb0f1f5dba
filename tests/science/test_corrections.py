"""Corrections of bad pixels and shading: equal classes on all backends, and pictures as from a camera without defects."""

import json
import pickle
from collections.abc import Iterable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from l3cli import api
from l3cli.artifacts.camera import CameraModel, DefectMap, FlatField
from l3cli.artifacts.container import seal
from l3cli.artifacts.schema import equal
from l3cli.artifacts.store import load, save
from l3cli.artifacts.table import TransformTable
from l3cli.artifacts.training_set import TrainingFrame, open_training_set
from l3cli.calibration.captures import corner_falloff, flat_field
from l3cli.calibration.statistics import defect_counts, defect_map, joined_defects, outliers
from l3cli.errors import InputFileError
from l3cli.frames.correction import NEIGHBOURS, CameraFile, Correction, HotTest, correction_of, plan_correction
from l3cli.frames.frame import RawFrame
from l3cli.frames.measurement import Body
from l3cli.frames.shading import FRACTION, NODE_SPACING_COLUMNS, clipped_from, colour_corrected, shading_of
from l3cli.io.sequences import FrameReference
from l3cli.physics.display import displayed, srgb_curve
from l3cli.rendering.display import encode, make_display
from l3cli.rendering.exposure import LightMeter
from l3cli.rendering.opencl import work
from l3cli.rendering.opencl.renderer import OpenCLRenderer
from l3cli.rendering.reference import ReferenceRenderer
from l3cli.rendering.rendition import Rendition
from l3cli.rendering.white.source import usual_balance
from l3cli.simulation.sensor import expose, mosaic
from l3cli.stages.rendering.pictures import LocalPictures, RemotePictures, RenderSetup
from l3cli.stages.rendering.reading import FrameTask
from tests.helpers.calls import L3, Refused
from tests.helpers.cameras import BAYER, FIVE_BAND, X_TRANS, random_camera
from tests.helpers.flaws import Flaws, flaws, seen, shading
from tests.helpers.tables import frame_of_all_levels, random_table, with_refinement

SHAPE = (61, 150)
CORNERS = (0.5, 0.54, 0.58, 0.52, 0.56)


def field_of(shape: tuple[int, int], corners: tuple[float, ...]) -> FlatField:
    """What evens out `flaws.shading`."""
    rows, cols = np.linspace(0, shape[0] - 1, 33), np.linspace(0, shape[1] - 1, 49)
    y, x = np.linspace(-1, 1, 33)[:, None], np.linspace(-1, 1, 49)
    gain = [(1 + (share**-0.5 - 1) * (y**2 + x**2) / 2) ** 2 for share in corners]
    return FlatField(rows, cols, np.array(gain))


def map_of(wrong: Flaws) -> DefectMap:
    position = np.argwhere(wrong.kind > 0)
    return DefectMap(position, ("hot",) * len(position))


TABLES = {
    "processor": lambda: random_table(X_TRANS, bits=16, black_level=2048.4, patch=5),
    "graphics": lambda: with_refinement(random_table(BAYER, black_level=100.4, patch=5), 3),
}


@pytest.mark.parametrize("variant", TABLES)
def test_backends_agree_on_shaded_frames(variant: str, monkeypatch: pytest.MonkeyPatch) -> None:
    table, rng = TABLES[variant](), np.random.default_rng(4)
    corners = tuple(np.linspace(0.5, 0.6, len(table.channels)))
    taken = shading_of(field_of(SHAPE, corners), SHAPE, table.cfa)
    assert taken.colour is not None
    frame = replace(frame_of_all_levels(table, rng, SHAPE), shading=taken, dark=1.3)
    reference, device = ReferenceRenderer(table), OpenCLRenderer(table, variant=variant)
    display = make_display(table.white_point, 1.0, 8)
    unshaded = replace(frame, shading=None)  # the same renderer renders other frames as ever
    (exact, labels), exact_unshaded = reference.exact_classified(frame), reference.exact_outputs(unshaded)
    for pixels in (SHAPE[0] * SHAPE[1], 20 * SHAPE[1]):  # a single band, and several
        monkeypatch.setattr(work, "BAND_PIXELS", pixels)
        device._frame_bands = None
        for layer, expected in enumerate(labels):
            np.testing.assert_array_equal(device.labels(frame, layer), expected)
        np.testing.assert_allclose(device.outputs(frame), exact, atol=2e-5)
        assert np.abs(device.picture(frame, display).astype(int) - encode(exact, display)).max() <= 1
        np.testing.assert_allclose(device.outputs(unshaded), exact_unshaded, atol=1e-5)
    gain = taken.gain_map(SHAPE[1])
    assert gain.max() > 1.6
    np.testing.assert_allclose(
        exact,
        gain * reference.exact_outputs(replace(frame, shading=replace(taken, gain=np.ones_like(taken.gain)))),
    )


@pytest.mark.parametrize(("bits", "black_level"), [(8, 0.0), (12, 108.93), (16, 2048.5), (16, 0.0)])
def test_shading_correction_keeps_clipped_pixels_clipped_and_others_not(bits: int, black_level: float) -> None:
    top = 2**bits - 1
    values = np.arange(1 << bits).astype(np.uint16)
    clipped = clipped_from(black_level, top)
    for share in (-0.5, -0.01, 0.0, 0.01, 0.5):
        colour = np.full(values.shape, round(share * 2**FRACTION), np.int16)
        after = colour_corrected(values, colour, black_level, top)
        np.testing.assert_array_equal(after[clipped:], values[clipped:])
        assert after[:clipped].max() < clipped
        wanted = np.clip(black_level + (values[:clipped] - black_level) * (1 + share), 0, clipped - 1)
        assert np.abs(after[:clipped] - wanted).max() <= 1.01 + top / 2 ** (FRACTION + 1)  # black level and tint are rounded


def test_correction_takes_the_nearest_sound_pixels_of_the_channel() -> None:
    rng = np.random.default_rng(6)
    for cfa in (BAYER, FIVE_BAND, X_TRANS):
        array = np.array(cfa, np.uint8)
        shape = (60, 84)
        channel = array[np.ix_(np.arange(60) % array.shape[0], np.arange(84) % array.shape[1])]
        bad = rng.random(shape) < 0.01
        bad[20:27, 30:35] = bad[:, 50:52] = bad[40] = bad[:3, :3] = True
        plan = plan_correction(bad, array)
        np.testing.assert_array_equal(np.sort(plan.target), np.flatnonzero(bad))
        assert plan.source.shape == (bad.sum(), NEIGHBOURS)
        assert not bad.ravel()[plan.source].any()
        assert (channel.ravel()[plan.source] == channel.ravel()[plan.target][:, None]).all()
        flat = (1000 + 100 * channel.astype(int)).astype(np.uint16)
        broken = np.where(bad, rng.integers(0, 4096, shape), flat).astype(np.uint16)
        left = broken.copy()
        np.testing.assert_array_equal(plan.corrected(broken), flat)
        np.testing.assert_array_equal(broken, left)
    with pytest.raises(InputFileError, match="100% of the pixels"):
        plan_correction(np.ones((8, 8), bool), np.array(BAYER, np.uint8))
    large = np.zeros((200, 200), bool)
    large[50:100, 50:100] = True
    with pytest.raises(InputFileError, match=r"pixel in row \d+, column \d+ has no good neighbour of the same channel"):
        plan_correction(large, np.array(BAYER, np.uint8))


# ------------------------------------------------------------------------------------------------------------ quality


def test_defects_cost_less_than_a_tenth_of_a_decibel(pipeline: Path) -> None:
    """0.1 % of the pixels, pairs and clusters included, of a simulated frame that the table has not seen."""
    table = load(TransformTable, pipeline / "table.h5")
    with open_training_set(pipeline / "unseen.h5") as reader:
        frame = next(iter(reader))
        assert isinstance(frame, TrainingFrame)
        rows, cols = frame.raw.shape
        camera = replace(reader.head.camera, rows=rows, cols=cols)
    electrons = mosaic(frame.electrons, camera.cfa)
    scale = frame.exposure / table.output_unit
    renderer = ReferenceRenderer(table)

    def codes(xyz: np.ndarray) -> np.ndarray:
        return 255 * srgb_curve(displayed(xyz, table.white_point, 0.5))

    target = codes(scale * frame.target.astype(np.float64))

    def error(wrong: Flaws, correction: Correction | None = None) -> float:
        """dB of the mean squared error."""
        raw = RawFrame("f", seen(camera, wrong, electrons, np.random.default_rng(2)), camera.black_level, camera.white_level)
        raw = raw if correction is None else correction.corrected(raw)
        return float(10 * np.log10(np.mean((codes(renderer.exact_outputs(raw)) - target) ** 2)))

    wrong = flaws(camera, (1.0,) * 3, share=0.001, lines=False)
    clean, broken = error(replace(wrong, kind=0 * wrong.kind)), error(wrong)
    fixed = error(wrong, correction_of(replace(camera, defects=map_of(wrong))))
    assert broken > clean + 0.2
    assert fixed < clean + 0.1


def test_corners_are_within_a_percent_of_the_middle(pipeline: Path) -> None:
    """Of a white with noise, by a lens that lets half of the light through to the corners, of each channel another share."""
    table, camera = load(TransformTable, pipeline / "table.h5"), load(CameraModel, pipeline / "camera.h5")
    renderer, shape = ReferenceRenderer(table), (camera.rows, camera.cols)
    sound = flaws(camera, (1.0,) * 3, share=0.0, lines=False)
    lens = correction_of(replace(camera, defects=None, flat_field=field_of(shape, CORNERS[:3])))
    light = np.full(shape, 0.8 * camera.full_scale)

    def taken(wrong: Flaws) -> RawFrame:
        return RawFrame(
            "white", seen(camera, wrong, light, np.random.default_rng(3)), camera.black_level, camera.white_level
        )

    white = taken(replace(sound, light=shading(camera, CORNERS[:3])))
    for frame, least, most in ((white, 0.4, 0.7), (lens.corrected(white), 0.99, 1.01)):
        outputs = renderer.exact_outputs(frame)
        middle = outputs[:, 80:112, 112:144].mean(axis=(1, 2))
        corners = [outputs[:, row, col].mean(axis=(1, 2)) / middle for row in ENDS for col in ENDS]
        assert least < np.min(corners) < np.max(corners) < most
    meter = LightMeter(table)
    assert meter.brightness(lens.corrected(white)) == pytest.approx(meter.brightness(taken(sound)), rel=0.02)


ENDS = (slice(0, 16), slice(-16, None))


# ------------------------------------------------------------------------------------------------------------- l3 render


@pytest.fixture
def flawed(tmp_path: Path) -> Path:
    """A table, camera.h5 with its defects and flat field, and frames of a flawed sensor as .npy in frames/."""
    plain = random_camera(BAYER, 3, 12, 100.0)
    wrong = flaws(plain, CORNERS[:3], share=0.01, lines=False)
    camera = replace(plain, defects=map_of(wrong), flat_field=field_of((24, 32), CORNERS[:3]))
    save(camera, tmp_path / "camera.h5")
    save(replace(random_table(BAYER, black_level=100.0, patch=3), camera=plain), tmp_path / "table.h5")
    (tmp_path / "frames").mkdir()
    for number in range(3):
        electrons = np.full((24, 32), 3000.0 + 500 * number)
        np.save(tmp_path / f"frames/{number}.npy", seen(plain, wrong, electrons, np.random.default_rng(number)))
    return tmp_path


def test_render_corrects_what_the_camera_knows(flawed: Path, l3: L3) -> None:
    call = ("render", flawed / "table.h5", flawed / "frames/0.npy", "--backend", "reference", "-o")
    camera, table = load(CameraModel, flawed / "camera.h5"), load(TransformTable, flawed / "table.h5")
    assert l3(*call, flawed / "a.npy.exr", "--camera", flawed / "camera.h5")[0] == 0
    assert l3(*call, flawed / "plain.exr")[0] == 0
    assert (flawed / "plain.exr").read_bytes() != (flawed / "a.npy.exr").read_bytes()
    save(replace(table, camera=camera), flawed / "knowing.h5")
    assert l3(*call, flawed / "table.exr", "--camera", flawed / "knowing.h5")[0] == 0
    assert (flawed / "table.exr").read_bytes() == (flawed / "a.npy.exr").read_bytes()
    frame = RawFrame(
        "f", np.load(flawed / "frames/0.npy"), table.black_level, table.white_level, dark=table.dark_signal(None)
    )
    corrected = correction_of(camera).corrected(frame)
    by_name = api.read_raw(flawed / "frames/0.npy", table, camera=camera)
    np.testing.assert_array_equal(by_name.values, corrected.values)
    assert by_name.shading is not None
    assert corrected.shading is not None
    assert (corrected.values != frame.values).sum() <= len(camera.defects.position if camera.defects else ())


def test_cameras_that_do_not_fit_are_refused(flawed: Path, refused: Refused) -> None:
    camera, frame = load(CameraModel, flawed / "camera.h5"), flawed / "frames/0.npy"
    call = ("render", flawed / "table.h5", frame, "-o", flawed / "a.png", "--camera")
    save(replace(camera, cfa=np.roll(camera.cfa, 1, axis=1)), flawed / "turned.h5")
    assert "turned.h5" in refused(3, *call, flawed / "turned.h5")
    save(replace(camera, defects=None, flat_field=None), flawed / "plain.h5")
    assert camera.name in refused(3, *call, flawed / "plain.h5")
    save(replace(camera, rows=48, flat_field=None), flawed / "large.h5")
    assert "0.npy" in refused(3, *call, flawed / "large.h5")
    assert "1,0" in refused(3, *call, flawed / "camera.h5", "--phase", "1,0")
    assert camera.name in refused(3, *call, flawed / "table.h5")
    refused(3, *call, flawed / "frames")
    (flawed / "linked.png").hardlink_to(flawed / "camera.h5")
    assert "linked.png" in refused(2, *call[:4], flawed / "linked.png", "--force", "--camera", flawed / "camera.h5")


def test_resume_knows_the_camera(flawed: Path, l3: L3) -> None:
    (flawed / "frames/3.npy").write_bytes(b"broken")
    call = (
        "render",
        flawed / "table.h5",
        flawed / "frames",
        "-o",
        flawed / "out",
        "--exposure",
        1,
        "--backend",
        "reference",
    )
    assert l3(*call, "--camera", flawed / "camera.h5")[0] == 3
    camera = load(CameraModel, flawed / "camera.h5")
    save(replace(camera, defects=None), flawed / "other.h5")
    assert "remove --resume" in l3(*call, "--camera", flawed / "other.h5", "--resume")[2]
    assert "remove --resume" in l3(*call, "--resume")[2]
    (flawed / "frames/3.npy").unlink()
    np.save(flawed / "frames/3.npy", np.load(flawed / "frames/0.npy"))
    assert l3(*call, "--camera", flawed / "camera.h5", "--resume")[0] == 0
    assert (flawed / "out/3.png").read_bytes() == (flawed / "out/0.png").read_bytes()


def test_workers_correct_alike_whoever_reads(flawed: Path) -> None:
    """Jobs are pickled, as on their way to a worker; neither map nor gains travel with them."""
    from l3cli.io.raw.files import RawOverrides, read_raw
    from l3cli.system.files import sha256

    table = load(TransformTable, flawed / "table.h5")
    file = CameraFile(flawed / "camera.h5", sha256(flawed / "camera.h5"))
    known = RawOverrides(correction=correction_of(load(CameraModel, file.path)))
    shading = known.correction.shading if known.correction else None
    path, rendition = flawed / "frames/1.npy", Rendition(usual_balance(table), 1.0, 8)
    frame, reference = read_raw(path, table, known), FrameReference(1, "1", path)

    def pool(function: Any, jobs: Iterable[Any], fits: Any) -> Iterator[Any]:
        for job in jobs:
            sent = pickle.dumps(job)
            assert shading is not None
            assert shading.gain.tobytes() not in sent
            made = function(pickle.loads(sent))
            assert fits(job, made)
            yield made

    setup = RenderSetup(flawed / "table.h5", sha256(flawed / "table.h5"), "reference", {}, known, rendition, None, file)
    read = FrameTask(reference, 0, frame=frame, scale=1.0)
    ((_, local),) = LocalPictures(setup, ReferenceRenderer(table)).pictures([read])
    for task in (read, FrameTask(reference, 0, digest=sha256(path), scale=1.0)):
        ((_, remote),) = RemotePictures(pool, setup).pictures([task])  # type: ignore[arg-type]
        np.testing.assert_array_equal(remote.pixels, local.pixels)
    assert NODE_SPACING_COLUMNS % 16 == 0  # of the kernels' vectors none lies over a node


def frame_of(camera: CameraModel, electrons: np.ndarray, seed: int = 1) -> RawFrame:
    values = expose(camera, electrons, 0.01, np.random.default_rng(seed))
    return RawFrame("f", values, camera.black_level, camera.white_level)


@pytest.mark.parametrize("bits", [12, 16])
def test_hot_pixels_are_found_and_sound_ones_kept(bayer: CameraModel, bits: int) -> None:
    scale = 2 ** (bits - 12)
    camera = replace(
        bayer, bits=bits, gain=bayer.gain * scale, black_level=64.0 * scale, white_level=bayer.white_level * scale
    )
    rng, shape = np.random.default_rng(3), (camera.rows, camera.cols)
    light = np.kron(rng.uniform(20, 9000, (24, 32)), np.ones((8, 8)))
    light[:40, :40] = 40000  # clipped
    frame, test = frame_of(camera, light), HotTest.of(camera)
    assert np.count_nonzero(test.without_hot(frame, camera.cfa).values != frame.values) == 0
    flat = frame_of(camera, np.full(shape, 500.0))
    places = rng.choice(flat.values.size, 100, replace=False)
    raised = flat.values.astype(int)
    raised.ravel()[places] += 400 * scale
    fixed = test.without_hot(replace(flat, values=raised.astype(np.uint16)), camera.cfa)
    found = (fixed.values != raised).ravel()
    assert found.sum() == found[places].sum() > 85  # the others touch, or a neighbour is as bright
    assert np.abs(fixed.values.ravel()[places[found[places]]] - flat.values.mean()).max() < 60 * scale
    assert test.without_hot(replace(flat, values=flat.values[:4, :4]), camera.cfa).values.shape == (4, 4)


def test_stars_are_no_hot_pixels(bayer: CameraModel) -> None:
    """From 500 electrons in all on; fainter ones that half a pixel holds are as dark beside it as noise."""
    rng = np.random.default_rng(5)
    down, across = np.mgrid[-4:5, -4:5]
    for blur in (0.5, 0.7, 1.0):  # pixels; a lens at f/2.8 and half a pixel of defocus make as much
        sky = np.full((bayer.rows, bayer.cols), 100.0)
        for _ in range(200):
            row, col = rng.integers(6, bayer.rows - 6), rng.integers(6, bayer.cols - 6)
            spot = np.exp(-((down - rng.uniform(-0.5, 0.5)) ** 2 + (across - rng.uniform(-0.5, 0.5)) ** 2) / 2 / blur**2)
            sky[row - 4 : row + 5, col - 4 : col + 5] += np.exp(rng.uniform(6.2, 11)) * spot / spot.sum()
        frame = frame_of(bayer, sky)
        np.testing.assert_array_equal(HotTest.of(bayer).without_hot(frame, bayer.cfa).values, frame.values)


def test_a_simulated_frame_is_hardly_touched(pipeline: Path) -> None:
    with open_training_set(pipeline / "unseen.h5") as reader:
        frame, camera = next(iter(reader)), reader.head.camera
    assert isinstance(frame, TrainingFrame)
    for share in (1.0, 0.1, 0.01):
        raw = frame_of(camera, share * mosaic(frame.electrons, camera.cfa))
        changed = HotTest.of(camera).without_hot(raw, camera.cfa).values != raw.values
        assert changed.mean() < 5e-5


def test_render_corrects_them_where_it_is_asked_to(tmp_path: Path, l3: L3, refused: Refused) -> None:
    camera = random_camera(BAYER, 3, 12, 100.0)
    save(replace(random_table(BAYER, black_level=100.0, patch=3), camera=camera), tmp_path / "table.h5")
    frame = frame_of(camera, np.full((24, 32), 3000.0)).values
    hot = frame.copy()
    hot[11, 13] += 2500
    np.save(tmp_path / "hot.npy", hot)
    call = ("render", tmp_path / "table.h5", tmp_path / "hot.npy", "--backend", "reference", "-o")
    for name, options in (("plain", ()), ("off", ("--hot", "off")), ("auto", ("--hot", "auto"))):
        assert l3(*call, tmp_path / f"{name}.exr", *options)[0] == 0
    plain, off, auto = ((tmp_path / f"{name}.exr").read_bytes() for name in ("plain", "off", "auto"))
    assert plain == off != auto
    assert "--hot" in refused(2, *call, tmp_path / "no.exr", "--hot", "yes")
    with h5py.File(tmp_path / "table.h5", "r+") as root:
        del root["camera"]
    seal(tmp_path / "table.h5")
    assert "--hot" in refused(2, *call, tmp_path / "no.exr", "--hot", "auto")


DARK_CORNERS = (0.45, 0.5, 0.6)
CAPTURES = """
base = "{}"
[[dark]]
frames = [{}]
exposure_s = 0.01
[[white]]
frames = [{}]
exposure_ms = 10
"""


def body_of(camera: CameraModel) -> Body:
    return Body(
        camera.name, camera.rows, camera.cols, camera.pixel_pitch, camera.bits, camera.channels, camera.cfa, camera.optics
    )


@pytest.fixture(scope="module")
def wrong(bayer: CameraModel) -> Flaws:
    return flaws(bayer, DARK_CORNERS)


@pytest.fixture(scope="module")
def captures(bayer: CameraModel, wrong: Flaws, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Four darks and eight whites as .npy, the camera's model, and the measurement file."""
    folder, rng = tmp_path_factory.mktemp("captures"), np.random.default_rng(5)
    names: dict[str, list[str]] = {"dark": [], "white": []}
    for kind, count, share in (("dark", 4, 0.0), ("white", 8, 0.8)):
        for number in range(count):
            electrons = np.full((bayer.rows, bayer.cols), share * bayer.full_scale)
            np.save(folder / f"{kind}{number}.npy", seen(bayer, wrong, electrons, rng))
            names[kind].append(f'"{kind}{number}.npy"')
    save(bayer, folder / "camera.h5")
    (folder / "M.toml").write_text(CAPTURES.format("camera.h5", *(", ".join(each) for each in names.values())))
    return folder


def test_darks_and_whites_alone_give_defects_and_flat_field(
    captures: Path, bayer: CameraModel, wrong: Flaws, tmp_path: Path, l3: L3
) -> None:
    code, out, err = l3("calibrate", captures / "M.toml", "-o", tmp_path / "camera.h5", "--json")
    assert code == 0, err
    camera, result = load(CameraModel, tmp_path / "camera.h5"), json.loads(out)
    assert camera.defects
    assert camera.flat_field
    bad = np.zeros(wrong.kind.shape, bool)
    bad[tuple(camera.defects.position.T)] = True
    missed = (wrong.kind > 0) & ~bad
    assert not missed.any()
    assert (bad & (wrong.kind == 0)).sum() <= 2
    assert (result["defect map"]["rows"], result["defect map"]["columns"]) == (1, 1)
    assert result["defect map"]["clusters"] >= 3
    assert set(camera.defects.pixel_kind) == {"hot", "dead", "row", "column"}
    assert list(result["corner fall-off %"].values()) == pytest.approx([100 * (1 - each) for each in DARK_CORNERS], abs=1.0)
    assert equal(replace(camera, defects=None, flat_field=None, fit=None), bayer)
    assert [stage.command for stage in camera.history] == ["calibrate"]
    assert set(camera.history[0].inputs) == {"measurements", "frames", "camera"}
    code, out, _ = l3("calibrate", captures / "M.toml", "-o", tmp_path / "again.h5")
    assert "rows 1, columns 1, clusters" in out
    assert "loss of light in the darkest corner: r 5" in out
    assert (tmp_path / "camera.h5").read_bytes() == (tmp_path / "again.h5").read_bytes()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ('[[white]]\nframes = ["white0.npy"]\nexposure_ms = 0', "white[1].exposure_ms is 0; use more than 0"),
        ('[[white]]\nframes = ["dark1.npy"]\nexposure_ms = 10', "dark1.npy: channel r is too dark"),
        ('[[white]]\nframes = ["clipped.npy"]\nexposure_ms = 10', "clipped.npy: channel r is clipped"),
        ('[[white]]\nframes = ["scene.npy"]\nexposure_ms = 10', "evenly lit white target"),
        (
            '[[white]]\nframes = ["deep.npy"]\nexposure_ms = 10',
            "deep.npy contains the value 4096 DN",
        ),
        ('[[white]]\nframes = ["small.npy"]\nexposure_ms = 10', "uncropped raw frames"),
        ('[[white]]\nframes = ["nowhere.npy"]\nexposure_ms = 10', "nowhere.npy"),
        ('[[grey]]\nframes = ["white0.npy"]\nexposure_ms = 10', "`grey`"),
    ],
)
def test_captures_that_cannot_serve_are_refused(
    captures: Path, bayer: CameraModel, change: str, message: str, tmp_path: Path, refused: Refused
) -> None:
    rng, shape = np.random.default_rng(3), (bayer.rows, bayer.cols)
    np.save(captures / "clipped.npy", np.full(shape, 4095, np.uint16))
    np.save(captures / "deep.npy", np.full(shape, 4096, np.uint16))
    np.save(captures / "scene.npy", rng.integers(500, 2000, (24, 32)).repeat(8, 0).repeat(8, 1).astype(np.uint16))
    np.save(captures / "small.npy", np.full((96, 128), 2000, np.uint16))
    text = (captures / "M.toml").read_text().partition("[[white]]")[0] + change
    (captures / "BAD.toml").write_text(text)
    code = 2 if "`" in message or "white[1]" in message else 3  # a key is wrong, or a file
    assert message in refused(code, "calibrate", captures / "BAD.toml", "-o", tmp_path / "c.h5")


def test_lines_that_are_off_by_less_than_a_pixel_may_be(bayer: CameraModel) -> None:
    """Twice what pixels differ by: one alone is no defect, a whole row is. Column noise is none either."""
    rng, shape = np.random.default_rng(4), (96, 128)
    dark = 64 + rng.normal(size=shape) + rng.normal(size=shape[1])
    assert not len(outliers(dark, bayer.cfa))
    dark[30] += 4
    found = outliers(dark, bayer.cfa)
    assert len(found) == 128
    assert set(found[:, 0]) == {30}


def test_lines_clusters_and_kinds() -> None:
    shape = (20, 30)
    column = np.array([(row, 7) for row in range(20) if row != 3])
    single, cluster = np.array([(5, 20)]), np.array([(10, 10), (11, 11), (12, 10)])
    found = defect_map(joined_defects(column, single, cluster), single, shape)
    assert defect_counts(found, shape) == {"hot": 1, "dead": 3, "rows": 0, "columns": 1, "clusters": 1}
    assert found.pixel_kind.count("column") == 20  # the one that had seemed sound, too


def test_the_surface_is_that_of_cos4_whatever_its_width(bayer: CameraModel) -> None:
    for share in (0.9, 0.3):
        field = flat_field(1000 * shading(bayer, (share,) * 3), body_of(bayer))
        np.testing.assert_allclose(corner_falloff(field), 1 - share, rtol=1e-3)
        assert field.shading_gain[:, 16, 24] == pytest.approx(1.0, abs=1e-6)


def test_a_camera_without_any_correction_is_refused(bayer: CameraModel) -> None:
    with pytest.raises(InputFileError, match=r"defect map.*flat field.*polariser field"):
        correction_of(bayer)


def test_a_map_beyond_the_sensor_or_a_field_of_nonsense_is_refused(bayer: CameraModel) -> None:
    with pytest.raises(ValueError, match="outside the 192×256"):
        replace(bayer, defects=DefectMap(np.array([[192, 0]]), ("hot",)))
    with pytest.raises(ValueError, match="the flat field does not cover"):
        replace(bayer, flat_field=FlatField(np.array([0.0, 95.0]), np.array([0.0, 255.0]), np.ones((3, 2, 2))))
    with pytest.raises(ValueError, match="twice"):
        DefectMap(np.array([[1, 0], [1, 0]]), ("hot", "hot"))
    with pytest.raises(ValueError, match="known types are hot"):
        DefectMap(np.array([[1, 0]]), ("warm",))
    lines = np.array([0.0, 100.0])
    for gain in (0.0, 20.0, np.array([1.0, 1.0, 4.0])[:, None, None]):
        with pytest.raises(ValueError, match="flat field"):
            FlatField(lines, lines, np.ones((3, 2, 2)) * gain)
    with pytest.raises(InputFileError, match="dark"):
        flat_field(np.zeros((bayer.rows, bayer.cols)), body_of(bayer))
