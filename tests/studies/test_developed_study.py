"""Quality of DNG files of rendered frames, for the unseen scene of the demo and two faces with pixel-sharp detail.

python -m pytest -m slow -s tests/studies/test_developed_study.py      two minutes on two cores

The table is for the five-band camera, with the class recipe `fast`. Each frame is rendered to a picture, to a DNG file and
to a remosaicked DNG file. LibRaw develops both DNG files as the files state. Menon's demosaicking develops the remosaicked
file with its matrix. ΔE00 is relative to the picture of l3, and the PSNR is relative to the ideal picture.
"""

from pathlib import Path

import numpy as np
import pytest
import rawpy
import tifffile
from numpy.typing import NDArray

from l3cli.artifacts.training_set import open_training_set
from l3cli.io.pictures.dng import HEADROOM, WHITE_LEVEL
from l3cli.physics.display import displayed, displayed_delta_e, srgb_curve, white_luminance
from l3cli.physics.spaces import REC2020, SRGB
from tests.helpers.calls import L3
from tests.helpers.paths import CONFIGS

Array = NDArray[np.floating]
FACES = 'illuminants = ["D65"]\nexposure_share = [0.8]\n' + "".join(
    f'[[scene]]\nsource = "iset"\nfile = "{{data}}/scenes/people_small_{face}_scene.mat"\n' for face in (1, 4)
)
OUTPUTS = {"p.tif": ("--space", "srgb", "--bits", 32), "l.dng": (), "m.dng": ("--remosaic", "bayer")}
MOST = 3.0  # ΔE00 to our own picture
LOST = 2.5  # dB, by remosaicking and demosaicking again


def psnr(one: Array, other: Array) -> float:
    return float(-10 * np.log10(np.square(srgb_curve(one) - srgb_curve(other)).mean()))


@pytest.mark.slow
def test_developers_show_our_pictures(l3: L3, tmp_path: Path, l3_data: Path) -> None:
    menon = pytest.importorskip("colour_demosaicing").demosaicing_CFA_Bayer_Menon2007
    (tmp_path / "faces.toml").write_text(FACES.format(data=l3_data.resolve()))
    for name, scenes in (("training", "default"), ("demo", "demo_unseen"), ("faces", tmp_path / "faces.toml")):
        output, camera = tmp_path / f"{name}.h5", CONFIGS / "cameras/fiveband.toml"
        assert l3("simulate", scenes, "--camera", camera, "-o", output, "--pictures", tmp_path / name, "--quiet")[0] == 0
    training, table = tmp_path / "training.h5", tmp_path / "table.h5"
    assert l3("train", training, "--classes", "fast", "-o", table, "--quiet", "--jobs", 2)[0] == 0
    lines = ["of a frame: mean ΔE00 to our picture; PSNR to the ideal one"]
    for name in ("demo", "faces"):
        with open_training_set(tmp_path / f"{name}.h5") as frames:
            for frame, raw in zip(frames, sorted((tmp_path / name).glob("*_raw.tif")), strict=True):
                ideal = displayed(frame.target, frame.white, white_luminance(frame.target[1]))
                for file, further in OUTPUTS.items():
                    output = tmp_path / file
                    assert l3("render", table, raw, "-o", output, *further, "--exposure", 1, "--force", "--quiet")[0] == 0
                ours = np.asarray(tifffile.imread(tmp_path / "p.tif"), np.float64)
                scale = np.median(ideal[..., 1]) / np.median(ours[..., 1])
                again = menon(tifffile.imread(tmp_path / "m.dng") * (HEADROOM / WHITE_LEVEL), "RGGB")
                shown = {
                    "ours": ours,
                    "DNG by LibRaw": developed(tmp_path / "l.dng"),
                    "mosaic by LibRaw": developed(tmp_path / "m.dng"),
                    "mosaic by Menon": again @ (SRGB.from_xyz @ REC2020.to_xyz).T,
                }
                shown = {each: np.clip(scale * picture, 0, 1) for each, picture in shown.items()}
                errors = {each: float(displayed_delta_e(picture, shown["ours"]).mean()) for each, picture in shown.items()}
                ratios = {each: psnr(picture, ideal) for each, picture in shown.items()}
                for each in shown:
                    lines.append(
                        f"{frame.scene:24} {each:18} ΔE00 to ours {errors[each]:5.2f}   PSNR {ratios[each]:6.2f} dB"
                    )
                assert errors["DNG by LibRaw"] < 0.1
                assert max(errors.values()) < MOST
                assert min(ratios.values()) > ratios["ours"] - LOST
    print("\n".join(lines))


def developed(path: Path) -> Array:
    """LibRaw's picture, linear, as the file's white level stands for it."""
    with rawpy.imread(str(path)) as raw:
        picture = raw.postprocess(use_camera_wb=True, no_auto_bright=True, output_bps=16, gamma=(1, 1))
    return picture * (HEADROOM / 65535)
