"""What must hold on a Bayer array: at least Menon's demosaicking without noise, 2 dB more in the dark.

Tables learn from dead leaves, three faces and three pictures, and are judged on two other faces and four other pictures.
"""

import json
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.helpers.paths import CONFIGS

HEAD = 'illuminants = ["D65"]\nexposure_share = [{share}]\n[sensor]\nnoise = "{noise}"\n'
LEAVES = '[[scene]]\nsource = "dead leaves"\nsize = [160, 160]\ncount = 30\n'
SEEN = ((1, 2, 4), {"BanteaySrei_01.jpg": 4, "zebra.jpg": 1, "bears.png": 1})  # faces; pictures and their shrinking
UNSEEN = ((5, 6), {"BanteaySrei_03.jpg": 4, "FruitMCC_6500.tif": 3, "woodDuck.png": 3, "elephant.png": 2})
# Least squares, as PSNR is: noise weighs what it is; nothing where there is none. The default weighs it for the eye.
CLASSES = "[classes]\npatch = 9\n[learning]\npatches = {patches}\nluminance_noise = {noise}\nchroma_noise = {noise}\n"


def scenes(data: Path, which: tuple) -> str:
    faces, pictures = which
    lines = [f'[[scene]]\nsource = "iset"\nfile = "{data}/scenes/people_small_{face}_scene.mat"\n' for face in faces]
    lines += [
        f'[[scene]]\nsource = "rgb"\nfile = "{data}/pictures/{name}"\nshrink = {shrink}\n'
        for name, shrink in pictures.items()
    ]
    return "".join(lines)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("share", "noise", "weight", "patches", "gain"), [(0.9, "none", 0, 40000, 0.0), (0.09, "all", 1, 100000, 2.0)]
)
def test_learned_is_better_than_menon(
    share: float, noise: str, weight: float, patches: int, gain: float, l3_data: Path, tmp_path: Path, l3: Callable
) -> None:
    pytest.importorskip("colour_demosaicing")
    data = l3_data.resolve()
    recipes = {
        "training": HEAD.format(share=0.9, noise="all") + scenes(data, SEEN) + LEAVES,
        "unseen": HEAD.format(share=share, noise=noise) + scenes(data, UNSEEN),
    }
    for name, text in recipes.items():
        (tmp_path / f"{name}.toml").write_text(text)
        arguments = ("simulate", tmp_path / f"{name}.toml", "--camera", CONFIGS / "cameras/bayer.toml", "--quiet")
        assert l3(*arguments, "-o", tmp_path / f"{name}.h5")[0] == 0
    (tmp_path / "classes.toml").write_text(CLASSES.format(patches=patches, noise=weight))
    table = tmp_path / "table.h5"
    assert l3("train", tmp_path / "training.h5", "--classes", tmp_path / "classes.toml", "-o", table, "--quiet")[0] == 0
    document = json.loads(l3("evaluate", table, tmp_path / "unseen.h5", "--json", "--quiet")[1])
    print()
    for frame in document["frames"]:
        figures = ", ".join(f"{name} {frame[name]['psnr']:.2f} dB" for name in ("ours", "menon"))
        print(f"{frame['scene']:22} level {frame['level']:.3f}: {figures}")
    ours, menon = (document["mean"][name]["psnr"] for name in ("ours", "menon"))
    print(f"mean PSNR {ours:.2f} dB, Menon {menon:.2f} dB")
    assert ours >= menon + gain
    if noise == "all":
        assert 0.01 < sum(frame["level"] for frame in document["frames"]) / len(document["frames"]) < 0.03
