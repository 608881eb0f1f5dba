"""From a raw file to a picture with `l3 init --from` and make, as documented: processor time, and chroma of greys.

The raw files are a real file (L3_DATA) and simulated files of a ColorChecker that fills the frame, under daylight.
"""

import os
import resource
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from l3cli.io.images import read_image
from l3cli.physics.display import daylight, displayed_xyz, lab, srgb_decoded
from tests.helpers.calls import L3

SCENE = """
illuminants = ["D65"]
luminances_cd_m2 = [400.0]
exposure_share = [0.7]
[[scene]]
source = "colorchecker"
size = [480, 720]
"""
GREYS = {  # row and columns of the middles of the chart's greys, of the frame's height and width
    "canon_550d": (926 / 1156, np.array([716, 820, 926, 1032, 1144, 1252]) / 1734),
    "": (7 / 8, (np.arange(6) + 0.5) / 6),
}
MOST = {"canon_550d": 5.0, "fujifilm_x_t3": 3.0, "quad_bayer": 3.0}  # C*ab of the greys but black


def raw_file(name: str, folder: Path, l3: L3) -> Path:
    """A raw file of a camera; simulated, unless a real one is there."""
    if name == "canon_550d":
        data = Path(os.environ.get("L3_DATA", ""))
        if not os.environ.get("L3_DATA") or not data.is_dir():
            pytest.skip("L3_DATA does not name the folder of real data")
        return data / "raw/colorchart.dng"
    (folder / "scenes.toml").write_text(SCENE)
    camera = name
    if name.startswith("fujifilm"):
        assert l3("init", name, folder / "named", "--quiet")[0] == 0
        camera = str(folder / "named/camera.toml")
    to = ("-o", folder / "set.h5", "--dng", folder / "raw", "--quiet")
    assert l3("simulate", folder / "scenes.toml", "--camera", camera, *to)[0] == 0
    (path,) = (folder / "raw").glob("*.dng")
    return path


@pytest.mark.slow
@pytest.mark.parametrize("name", MOST)
def test_from_a_raw_file_to_its_picture(name: str, tmp_path: Path, l3: L3) -> None:
    raw, before = raw_file(name, tmp_path, l3), resource.getrusage(resource.RUSAGE_CHILDREN)
    l3_command = f"{sys.executable} -m l3cli"
    first = subprocess.run(
        [*l3_command.split(), "init", "--from", raw, "mine"], cwd=tmp_path, check=True, capture_output=True
    )
    subprocess.run(["make", "-C", "mine", f"L3={l3_command}", "picture.png"], cwd=tmp_path, check=True, capture_output=True)
    spent = resource.getrusage(resource.RUSAGE_CHILDREN)
    seconds = spent.ru_utime + spent.ru_stime - before.ru_utime - before.ru_stime
    picture = read_image(tmp_path / "mine/picture.png")[0] / 255.0
    row, columns = GREYS.get(name, GREYS[""])
    rows, cols = picture.shape[:2]
    patches = [(int(row * rows), int(col * cols)) for col in columns]
    windows = [srgb_decoded(picture[y - 15 : y + 15, x - 15 : x + 15]).mean(axis=(0, 1)) for y, x in patches]
    colours = lab(displayed_xyz(np.array(windows)), daylight())
    chroma = np.hypot(colours[:, 1], colours[:, 2])
    print(f"{name}: {seconds:.0f} s of processor, C*ab {chroma.round(2)}, L* {colours[:, 0].round(1)}")
    print(first.stderr.decode())
    assert (np.diff(colours[:, 0]) < -8).all()  # from white to black
    assert chroma[:-1].max() < MOST[name]
