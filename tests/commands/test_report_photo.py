"""`l3 report` of a camera made from photos of a chart: what to rely on, the lights, the patches."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np

from l3cli.artifacts.camera import CameraModel
from l3cli.artifacts.fit import Fit, PhotoFit
from l3cli.artifacts.store import save
from l3cli.physics import spectra
from tests.helpers.browser import Browser
from tests.helpers.calls import L3

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


def test_a_page_says_what_to_rely_on(bayer: CameraModel, tmp_path: Path, l3: L3) -> None:
    text = page(photographed(bayer, ("<b>one.dng</b>",), guessed=False, deficit=2.0), tmp_path, l3)
    plain = re.sub(r"\s+", " ", re.sub("<[^>]*>", " ", text))
    curve = 2.0 / bayer.responsivity.max(axis=1).min()
    assert f"its curves stay uncertain (95 % within ± {curve:.1f} % of their peak)" in plain
    assert "its colours do not (± 0.6 % of the brightest)" in plain
    assert "Curves stay uncertain, colours do not" in plain
    assert "would help most under LED-B3: it would leave 61 % of the error of the colours" in plain
    assert re.search(r"classic\s+A\s+9.5\s+1\s+0.63", plain)  # uneven by 0.1 of 1.05, glare, residual RMS
    assert "of the usual lights, 3200K explains its patches best; A was named" in plain
    assert "69 values of 24 patches" in plain
    assert "Largest: patch 1 in r, 3 %" in plain
    assert "1 value of patches left out" in plain
    assert "Not measured, taken as 0" in plain
    assert "<b>one" not in text
    assert text.count("<b>") == 0
    bands = re.findall(r"\b([rgb])\s+(\d\.\d+|\d)\s+(0\.\d)\b", plain[plain.index("Half widths") :])
    assert [(name, colours) for name, _, colours in bands] == [("r", "0.4"), ("g", "0.5"), ("b", "0.6")]
    assert "Figures of each channel" not in plain


def test_several_photos_and_a_guessed_light(bayer: CameraModel, tmp_path: Path, l3: L3) -> None:
    text = page(photographed(bayer, ("one.dng", "two.dng"), guessed=True, deficit=0.0), tmp_path, l3)
    assert "Estimated from 2 photos of a chart" in text
    assert text.count("its light was guessed") == 2
    assert "A (guessed)" in text
    assert text.count("<h4>Patches of ") == 2
    again = page(photographed(bayer, ("one.dng", "two.dng"), guessed=True, deficit=0.0), tmp_path, l3)
    assert again == text


def test_it_is_painted_without_complaint(bayer: CameraModel, tmp_path: Path, l3: L3, tab: Browser) -> None:
    page(photographed(bayer, ("one.dng",), guessed=False, deficit=0.0), tmp_path, l3)
    for dark in (False, True):
        tab.open(tmp_path / "report.html", width=500, dark=dark)
        assert tab.complaints() == []
        assert tab.run("document.documentElement.scrollWidth") <= 500
