"""Standard metrics of simulated charts, compared with known values: MTF50, SNR10 and visual noise."""

import dataclasses

import numpy as np
import pytest

from l3cli.artifacts.camera import CameraModel
from l3cli.artifacts.training_set import TrainingFrame, TrainingSet
from l3cli.evaluation import standards
from l3cli.evaluation.basic import develop_bands, named_light
from l3cli.evaluation.demosaic import band_baselines
from l3cli.evaluation.quality import PlainPatches
from l3cli.evaluation.standards import EdgeError, edge_sharpness
from l3cli.physics.display import XYZ
from l3cli.simulation.light import XYZ as XYZ_TARGET
from l3cli.simulation.light import electron_weights, make_light
from l3cli.stages.evaluation import CHART_BANDS, edge_frame, standard_figures


def stopped_down(camera: CameraModel, f_number: float) -> CameraModel:
    return dataclasses.replace(camera, optics=dataclasses.replace(camera.optics, f_number=f_number))


def test_sharpness_is_that_of_lens_and_pixel(bayer: CameraModel, fiveband: CameraModel) -> None:
    """MTF50 of every channel within 1 % of diffraction times pixel, along rows and along columns, for lenses whose MTF50
    is below half a cycle a pixel, since simulation takes one sample a pixel."""
    for camera, across in ((stopped_down(bayer, 5.6), "rows"), (stopped_down(fiveband, 8.0), "columns")):
        light = make_light("D65", {}, camera.wavelength)
        weights = electron_weights(camera, light, CHART_BANDS)
        for seen, of_channel in zip(edge_frame(camera, light, across, XYZ_TARGET).electrons, weights, strict=True):
            plane = seen[24:-24, 24:-24]
            measured = edge_sharpness(plane if across == "rows" else plane.T)
            known = standards.known_sharpness(camera, CHART_BANDS, of_channel)
            resolved = measured.frequency < 0.5
            assert measured.mtf50 == pytest.approx(known.mtf50, rel=0.01)
            assert measured.transfer[resolved] == pytest.approx(known.transfer[resolved], abs=0.01)


def test_planes_without_a_slanted_edge_are_refused() -> None:
    row, col = np.indices((64, 64)) * 1.0
    for plane, words in ((0 * row, "no edge"), (col > 20 + row / 2 * 0.9, "24° from"), (col > 31, "° from")):
        with pytest.raises(EdgeError, match=words):
            edge_sharpness(plane * 1.0)


def test_least_light_is_that_of_the_closed_form(fiveband: CameraModel) -> None:
    """SNR10 of raw values within 2 %; of a picture whose variance is its lux, times 0.2, at 20 lux."""
    rng = np.random.default_rng(0)

    def pipelines(frame: TrainingFrame) -> dict[str, np.ndarray]:
        if frame.scene == "edge":
            return {"ours": frame.electrons[2:3]}
        lux = np.pi * frame.luminance
        return {"ours": rng.normal(lux, np.sqrt(0.2 * lux), (1, *frame.raw.shape))}

    document = standard_figures(TrainingSet(stopped_down(fiveband, 8.0), ("one",), ""), pipelines)
    grey = document["grey"]
    closed, raw = (np.array(list(grey[part].values())) for part in ("closed_form", "raw"))
    assert raw == pytest.approx(closed, rel=0.02, abs=0.02)
    assert grey["snr10"]["raw"] == pytest.approx(grey["snr10"]["closed_form"], rel=0.02)
    assert document["figures"]["ours"] == {
        "mtf50_rows": pytest.approx(document["edge"]["rows"]["mtf50"]["lens and pixel"], rel=0.1),  # of light as eyes see it
        "mtf50_columns": pytest.approx(document["edge"]["columns"]["mtf50"]["lens and pixel"], rel=0.1),
        "snr10": pytest.approx(20.0, rel=0.03),
        "camera_delta_e": None,
    }


@pytest.mark.parametrize("relit", [False, True])
@pytest.mark.parametrize("name", ["bayer", "fiveband"])
def test_charts_have_the_outputs_that_are_evaluated(name: str, relit: bool, request: pytest.FixtureRequest) -> None:
    """Where outputs are the camera's bands, under the light of the frame or another, a baseline develops the edge to its
    target in every band: within 3 % on the mean of the frame."""
    camera: CameraModel = request.getfixturevalue(name)
    light = named_light("A", camera) if relit else None
    head, demosaic = TrainingSet(camera, camera.channels, "", light), next(iter(band_baselines(camera.cfa).values()))
    edges = []

    def pipelines(frame: TrainingFrame) -> dict[str, np.ndarray]:
        planes = develop_bands(frame, camera, relit, demosaic)
        if frame.scene == "edge":
            edges.append((planes.mean(axis=(1, 2)), frame.target.mean(axis=(1, 2))))
        return {"basic": planes}

    assert standard_figures(head, pipelines)["figures"]["basic"]["mtf50_rows"] is not None
    for developed, wanted in edges:
        assert developed == pytest.approx(wanted, rel=0.03)


def test_colours_are_as_uncertain_as_the_curves(bayer: CameraModel) -> None:
    """ΔE00 of a pipeline that takes XYZ from each channel's mean grows as the bands, from nothing; and drawn curves lie
    outside their 95 % band as often as they should."""

    def pipelines(frame: TrainingFrame) -> dict[str, np.ndarray]:
        return {"ours": frame.electrons * (frame.white / frame.electrons.mean(axis=(1, 2)).max())[:, None, None]}

    def uncertain(share: float) -> float | None:
        camera = dataclasses.replace(bayer, responsivity_band=share * bayer.responsivity)
        return standard_figures(TrainingSet(camera, XYZ, ""), pipelines)["figures"]["ours"]["camera_delta_e"]

    assert uncertain(0.0) is None
    small, large = uncertain(0.01), uncertain(0.02)
    assert small is not None
    assert 0.02 < small < 1.0
    assert large == pytest.approx(2 * small, rel=0.1)
    known = dataclasses.replace(bayer, responsivity_band=0.1 * bayer.responsivity)
    errors = [each.responsivity - known.responsivity for each in standards.drawn_cameras(known, np.random.default_rng(1))]
    outside = np.mean(np.abs(errors) > known.responsivity_band + 1e-12)
    assert 0.02 < outside < 0.09


def test_visual_noise_is_weighted_and_less_of_fine_grain() -> None:
    target = np.full((80, 80, 3), (60.0, 5.0, 5.0))
    patches, rng = PlainPatches(target), np.random.default_rng(0)
    noise = rng.standard_normal((80, 80, 3)) * (2.0, 1.0, 3.0)
    assert patches.visual_noise(target + noise, target) == pytest.approx(2.0 + 0.852 + 3 * 0.323, rel=0.03)
    assert patches.visual_noise(target + 9.0, target) == pytest.approx(0, abs=1e-9)
    assert PlainPatches(rng.random((80, 80, 3)) * 50).visual_noise(target, target) is None
