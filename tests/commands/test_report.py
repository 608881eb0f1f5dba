"""`l3 report`: accepted artifacts, the content of their sections, and rejected files."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from l3cli.artifacts.camera import CameraModel
from l3cli.artifacts.fit import Fit, PhotoFit
from l3cli.artifacts.store import load, save
from l3cli.artifacts.training_set import open_training_set, write_training_set
from l3cli.physics import spectra
from tests.helpers.browser import Browser
from tests.helpers.calls import L3, Refused

REFERENCE = ("--backend", "reference")  # saves the compilation of kernels that no other test uses


@pytest.mark.parametrize(
    ("names", "sections", "lead"),
    [
        (["camera"], ["Camera", "History"], "nothing can be evaluated"),
        (["table"], ["Table", "History"], "Add a training set on which it was not trained"),
        (["training"], ["Camera", "Training set", "History"], "Without a transform table"),
        (
            ["training", "table"],
            ["Camera", "Training set", "Table", "History"],
            "Add a training set on which it was not trained",
        ),
        (
            ["table", "unseen"],
            ["Pictures", "Camera", "Training set", "Table", "Evaluation", "History"],
            "Mean ΔE00 over 1 frame: ours ",
        ),
        (["camera", "camera"], ["Camera", "History"], "1 artifact."),
    ],
)
def test_a_report_shows_what_it_is_given(
    names: list[str], sections: list[str], lead: str, pipeline: Path, tmp_path: Path, l3: L3
) -> None:
    out = tmp_path / "report.html"
    assert l3("report", *(pipeline / f"{name}.h5" for name in names), "-o", out)[0] == 0
    text = out.read_text()
    assert [re.split("[:<]", heading)[0] for heading in re.findall(r'<h2 id="section-\d+">([^\n]*)', text)] == sections
    assert lead in text


def test_a_described_camera_and_odd_outputs_are_shown(bayer: CameraModel, tmp_path: Path, l3: L3) -> None:
    save(bayer, tmp_path / "camera.h5")
    bands = 'exposure_share = [0.5]\n[target]\noutputs = "camera"\n[[scene]]\nsource = "dead leaves"\nsize = [96, 96]\n'
    (tmp_path / "bands.toml").write_text(bands)
    simulate = ("simulate", tmp_path / "bands.toml", "--camera", tmp_path / "camera.h5", "-o", tmp_path / "bands.h5")
    assert l3(*simulate)[0] == 0
    assert l3("report", tmp_path / "camera.h5", tmp_path / "bands.h5", "-o", tmp_path / "report.html", *REFERENCE)[0] == 0
    text = (tmp_path / "report.html").read_text()
    assert "The camera was not measured" in text
    assert "The report shows no pictures" in text


def test_a_table_of_bands_is_judged_by_angles(pipeline: Path, tmp_path: Path, l3: L3) -> None:
    scenes = '[target]\noutputs = "camera"\n[[scene]]\nsource = "dead leaves"\nsize = [96, 96]\ncount = 2\nseed = {}\n'
    for name in ("training", "unseen"):
        (tmp_path / "scenes.toml").write_text("exposure_share = [0.5]\n" + scenes.format(len(name)))
        simulate = ("simulate", tmp_path / "scenes.toml", "--camera", pipeline / "camera.h5", "-o", tmp_path / f"{name}.h5")
        assert l3(*simulate)[0] == 0
    train = ("train", tmp_path / "training.h5", "--classes", pipeline / "classes.toml", "-o", tmp_path / "table.h5")
    assert l3(*train)[0] == 0
    assert l3("report", tmp_path / "table.h5", tmp_path / "unseen.h5", "-o", tmp_path / "report.html", *REFERENCE)[0] == 0
    assert "Mean spectral angle (°) over 2 frames: ours " in (tmp_path / "report.html").read_text()


def test_a_camera_that_was_accepted_although_it_falls_short_states_it(pipeline: Path, tmp_path: Path, l3: L3) -> None:
    camera = load(CameraModel, pipeline / "camera.h5")
    assert camera.fit is not None
    assert camera.fit.chart is not None
    assert camera.fit.noise is not None
    chart = replace(camera.fit.chart, relative_rmse=np.array([0.01, 0.05, 0.01]))
    noise = camera.fit.noise
    line = noise.conversion_gain * noise.photon_transfer_mean + (noise.conversion_gain * noise.read_noise) ** 2
    line[-1, 0] /= 2  # where a channel saturates
    noise = replace(noise, white_level_reached=False, photon_transfer_variance=line)
    save(replace(camera, fit=replace(camera.fit, chart=chart, noise=noise)), tmp_path / "camera.h5")
    assert l3("report", tmp_path / "camera.h5", "-o", tmp_path / "report.html")[0] == 0
    text = (tmp_path / "report.html").read_text()
    assert "The model is not reliable: the validation of channel g has R²" in text
    assert "No white frame saturates" in text
    assert " Below the lines: 1 saturated point." in text
    assert l3("report", pipeline / "camera.h5", "-o", tmp_path / "sound.html")[0] == 0
    assert "not reliable" not in (tmp_path / "sound.html").read_text()


# ------------------------------------------------------------------------------------------------------- refusals


def test_what_is_no_report_is_refused(pipeline: Path, tmp_path: Path, refused: Refused, l3: L3) -> None:
    out = tmp_path / "report.html"
    shard = ("train", pipeline / "training.h5", "--classes", pipeline / "classes.toml", "--shard", "1/2")
    assert l3(*shard, "-o", tmp_path / "sums.h5")[0] == 0
    assert "use camera models, training sets, transform tables or designs" in refused(
        3, "report", tmp_path / "sums.h5", "-o", out
    )


def test_a_table_and_frames_of_different_outputs_are_refused(pipeline: Path, tmp_path: Path, refused: Refused) -> None:
    with open_training_set(pipeline / "unseen.h5") as reader:
        head, frame = replace(reader.head, outputs=("a", "b", "c")), reader.frame(0)
    with write_training_set(tmp_path / "bands.h5", head) as writer:
        writer.append(frame)
    line = refused(3, "report", pipeline / "table.h5", tmp_path / "bands.h5", "-o", tmp_path / "report.html")
    assert "have different outputs" in line


SURFACES = spectra.colorchecker(np.arange(400.0, 701.0, 10.0))[1][:, ::12]  # (24, 3) some values of a chart


def photographed(bayer: CameraModel, names: tuple[str, ...], guessed: bool, deficit: float) -> CameraModel:
    """A camera of photos whose first patch is 3 % of the brightest too bright in r, and whose last one is not used."""
    count = len(names)
    predicted = np.repeat(3000.0 * SURFACES[None] / SURFACES.max(axis=0), count, axis=0)
    measured, used = predicted.copy(), np.ones(predicted.shape, bool)
    measured[:, 0, 0] += 90.0
    used[:, 23] = False
    fit = PhotoFit(
        names=names,
        lights=("A",) * count,
        guessed=np.full(count, guessed),
        nearest=("3200K",) * count,
        deficit=np.full(count, deficit),
        charts=("classic",) * count,
        corners=np.zeros((count, 4, 2)),
        prior="measured cameras",
        error=0.01,
        illumination=np.tile([1.0, 0.05, 0.0, 0.0, 0.0, 0.0], (count, 1)),
        glare=np.full((count, 3), 30.0),
        noise_from_patches=True,
        response_band=np.array([0.004, 0.005, 0.006]),
        next_light="LED-B3",
        next_share=0.61,
        left_out=("<b>one.dng</b>: patch 24 in r: clipped",),
        used=used,
        measured=measured,
        predicted=predicted,
    )
    band = np.full_like(bayer.responsivity, 0.02)
    declared = ("dark current", "DSNU", "PRNU")
    return replace(bayer, responsivity_band=band, absolute=False, declared=declared, fit=Fit(photo=fit))


def page(camera: CameraModel, folder: Path, l3: L3) -> str:
    save(camera, folder / "camera.h5")
    code, _, err = l3("report", folder / "camera.h5", "-o", folder / "report.html", "--force")
    assert code == 0, err
    (folder / "camera.h5").unlink()
    return (folder / "report.html").read_text()


def test_a_page_states_what_to_rely_on(bayer: CameraModel, tmp_path: Path, l3: L3) -> None:
    text = page(photographed(bayer, ("<b>one.dng</b>",), guessed=False, deficit=2.0), tmp_path, l3)
    plain = re.sub(r"\s+", " ", re.sub("<[^>]*>", " ", text))
    curve = 2.0 / bayer.responsivity.max(axis=1).min()
    assert f"The 95 % bands are ± {curve:.1f} % of the peak for the responsivity curves" in plain
    assert "± 0.6 % of the brightest patch for colours" in plain
    assert "reduce the uncertainty most under LED-B3. The colour error would decrease to 61 % of its present value" in plain
    assert re.search(r"classic\s+A\s+9.5\s+1\s+0.63", plain)  # uneven by 0.1 of 1.05, glare, residual RMS
    assert "A was specified, but the common illuminant that fits the patches best is 3200K" in plain
    assert "69 values of 24 patches" in plain
    assert "The largest residual is 3 %, for patch 1 in channel r" in plain
    assert "1 patch value not used" in plain
    assert "Not measured, assumed to be 0" in plain
    assert "<b>one" not in text
    assert text.count("<b>") == 0
    bands = re.findall(r"\b([rgb])\s+(\d\.\d+|\d)\s+(0\.\d)\b", plain[plain.index("95 % bands, RMS") :])
    assert [(name, colours) for name, _, colours in bands] == [("r", "0.4"), ("g", "0.5"), ("b", "0.6")]
    assert "Values per channel" not in plain


def test_it_is_painted_without_complaint(bayer: CameraModel, tmp_path: Path, l3: L3, tab: Browser) -> None:
    page(photographed(bayer, ("one.dng",), guessed=False, deficit=0.0), tmp_path, l3)
    for dark in (False, True):
        tab.open(tmp_path / "report.html", width=500, dark=dark)
        assert tab.complaints() == []
        assert tab.run("document.documentElement.scrollWidth") <= 500
