"""Valid files of every kind, from which hostile inputs are made."""

import contextlib
import io
import re
import struct
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from l3cli.artifacts.store import load, save
from l3cli.artifacts.table import TransformTable
from l3cli.cli import run
from tests.helpers.dng_files import gain_map, opcode_list
from tests.helpers.tables import with_tree

CAMERA = """
name = "small Bayer"
[sensor]
rows = 96
cols = 128
pixel_pitch_um = 4.0
bits = 12
gain_dn_per_e = 0.25
black_level_dn = 64
fixed_pattern_seed = 3
[cfa]
channels = ["r", "g", "b"]
pattern = ["r g", "g b"]
[responsivity]
wavelength_nm = [400, 700, 10]
peak_efficiency = 0.4
[responsivity.gaussians]
r = [{ peak = 0.8, centre_nm = 600, sigma_nm = 35 }]
g = [{ peak = 1.0, centre_nm = 535, sigma_nm = 40 }]
b = [{ peak = 0.9, centre_nm = 460, sigma_nm = 30, sigma_above_nm = 31 }]
[noise]
read_noise_e = 4.0
dark_current_e_per_s = 5.0
dsnu_e = 2.0
prnu = 0.005
well_capacity_e = 15000
column_noise_e = 0.5
[optics]
focal_length_mm = 25
f_number = 2.8
object_distance_m = 2.0
"""
CURVE_CAMERA = re.sub(r"\[responsivity.gaussians\].*?(?=\[noise\])", "", CAMERA, flags=re.S).replace(
    "peak_efficiency = 0.4", 'peak_efficiency = 0.4\nfile = "curves.csv"'
)
LAB = """
[mono]
step_nm = 30.0
bandwidth_nm = 30.0
overexposed = 1
[chart]
illuminants = ["D65", "A"]
[white]
levels = [0.1, 0.5, 1.6]
trials = 2
[dark]
exposures_s = [0.01, 1.0]
trials = 2
[defects]
hot_pixels_per_million = 400
"""
DRAWN = 'exposure_share = [0.9]\n[[scene]]\nsource = "grey ramp"\nsize = [16, 20]\n'
SCENES = """
illuminants = ["D65", "3200K", "0.7 D65 + 0.3 lamp.csv"]
luminances_cd_m2 = [100.0]
exposure_share = [0.5]
[lens]
diffraction = true
defocus_um = 0.5
transmittance = 0.9
[sensor]
noise = "shot"
analog_gain = 1.5
[target]
outputs = "CIE 1931"
illuminant = "D65"
[[scene]]
source = "surfaces"
size = [16, 20]
patches = [2, 3]
count = 1
seed = 4
[[scene]]
source = "slanted edge"
size = [18, 20]
angle_deg = 5.0
[[scene]]
source = "rgb"
file = "picture.png"
shrink = 1
[[pair]]
raw = "frame.tif"
picture = "picture.png"
scale = 0.5
"""
CLASSES = """
[classes]
patch = 3
levels = 4
lowest_level = 0.01
contrasts = [1.4]
chromas = 2
max_cases = 3
[learning]
patches = 300
draws = 2
first_draws = 1
darkest = 0.01
brightest = 2.5
level_pool = [0.5, 0.25]
"""
TABLE = """
name = "table"
[sensor]
rows = 300
cols = 400
pixel_pitch_um = 5.0
bits = 12
[cfa]
channels = ["r", "g", "b"]
pattern = ["r g", "g b"]
[optics]
focal_length_mm = 50
f_number = 4
[sweep]
table = "sweep.csv"
photodiode = "diode.csv"
[datasheet]
black_level_dn = 64
white_level_dn = 4000
well_capacity_e = 20000
"""
CURVES = re.sub(r"\[sweep\].*?(?=\[datasheet\])", '[curves]\nfile = "curves.json"\n', TABLE, flags=re.S)
EVALUATION = (
    '{"camera": "a", "frames": [{"luminance": 10, "clipped": 0, "exposure": 0.01, "ours": {"psnr": 30.5, "scielab": 2}}]}'
)


def make_inputs(folder: Path) -> None:
    """Write the valid file of every subject, and the files that its commands read with it, below `folder`."""
    folder.mkdir(parents=True, exist_ok=True)
    texts = {
        "camera.toml": CAMERA, "curves.toml": CURVE_CAMERA, "lab.toml": LAB, "drawn.toml": DRAWN, "scenes.toml": SCENES,
        "classes.toml": CLASSES, "table.toml": TABLE, "curves_of.toml": CURVES, "evaluation.json": EVALUATION,
        "other.json": EVALUATION.replace("30.5", "20").replace('"a"', '"b"'), "recipe.toml": DRAWN,
    }  # fmt: skip
    nm = np.arange(380.0, 781.0, 10.0)
    texts["lamp.csv"] = "nm,power\n" + "\n".join(f"{x:g},{1 + x / 1000:g}" for x in nm)
    texts["diode.csv"] = "390,0.5\n710,0.9\n"
    texts["sweep.csv"] = "\n".join(f"{x},100,110,{90 + x / 10},64,64,64,{x / 10},1" for x in (400, 500, 600, 700))
    curves = {f"{x:g}": [float(np.exp(-(((x - c) / 60) ** 2))) for c in (600, 535, 460)] for x in nm}
    texts["curves.csv"] = "\n".join(f"{x},{','.join(map(str, row))}" for x, row in curves.items())
    rows = ", ".join(f'"{x}": {row}' for x, row in curves.items())
    texts["curves.json"] = f'{{"spectral_data": {{"data": {{"main": {{{rows}}}}}}}}}'
    for name, text in texts.items():
        (folder / name).write_text(text)
    _make_frames(folder)
    _make_scenes(folder)
    import colour_demosaicing  # noqa: F401  runs git
    import distributed  # noqa: F401  both modules unpickle their own files

    with contextlib.chdir(folder):
        for command in (
            "lab camera.toml --recipe lab.toml -o lab --quiet",
            "calibrate lab/MEASUREMENTS.toml -o camera.h5 --accept --quiet",
            "simulate scenes.toml --camera camera.toml -o training.h5 --quiet",
            "train training.h5 --classes classes.toml -o table.h5 --quiet",
            "train training.h5 --classes classes.toml --shard 1/1 -o sums.h5 --quiet",
        ):
            with contextlib.redirect_stdout(io.StringIO()):
                assert run(command.split()) == 0, command
        save(with_tree(load(TransformTable, Path("table.h5")), leaves=9), Path("tree.h5"))
    import OpenImageIO as oiio

    for path in sorted((folder / "lab/dark").glob("015*.tif")):
        assert oiio.ImageBuf(str(path)).write(str(path.with_suffix(".pgm")), "uint16")
    text = (folder / "lab/MEASUREMENTS.toml").read_text()
    (folder / "lab/pgm.toml").write_text(re.sub(r"(dark/015_cap_\d)\.tif", r"\1.pgm", text))


def _make_frames(folder: Path) -> None:
    import av
    import tifffile
    from astropy.io import fits
    from scipy.io import savemat

    rng = np.random.default_rng(0)
    stack = rng.integers(0, 4096, (3, 20, 24)).astype(np.uint16)
    np.save(folder / "frame.npy", stack[0])
    np.save(folder / "stack.npy", stack)
    stack[0].tofile(folder / "frame.raw")
    (folder / "frame.raw10").write_bytes(stack.tobytes()[: 20 * 30])
    savemat(folder / "frame.mat", {"take": np.moveaxis(stack, 0, 2)})
    header = struct.pack("<14s7i", b"LUCAM-RECORDER", 0, 8, 1, 24, 20, 12, len(stack)) + bytes(120 + 16)
    (folder / "frame.ser").write_bytes(header + stack.tobytes())
    (folder / "frame.pgm").write_bytes(b"P5 24 20 4095\n" + stack[0].astype(">u2").tobytes())
    fits.PrimaryHDU(stack[0]).writeto(folder / "frame.fits")
    _write_image(folder / "frame.tif", stack[0][..., None], compression="zip")
    _write_image(folder / "frame.png", stack[0][..., None])
    cfa = [(33421, "H", 2, (2, 2), True), (33422, "B", 4, (0, 1, 1, 2), True)]
    dng: list[tuple[int, Any, int, Any, bool]] = [
        (50706, "B", 4, (1, 4, 0, 0), True),
        (50717, "I", 1, 4095, True),
        (50714, "I", 1, 64, True),
    ]
    fixed, gains = struct.pack(">5I", 0, 1, 0, 3, 4), gain_map(np.full((2, 3), 1.5), (0, 0, 30, 30))
    for code, opcode in ((51008, (5, 0, fixed)), (51009, (9, 1, gains)), (51022, (3, 0, struct.pack(">7d", *[0.1] * 7)))):
        content = bytes(opcode_list(opcode)[1])
        dng.append((code, 7, len(content), content, True))
    tifffile.imwrite(folder / "frame.dng", np.tile(stack[0], (3, 3)), photometric=32803, extratags=cfa + dng)
    with h5py.File(folder / "frame.h5", "w") as root:
        root.create_dataset("take/raw", data=stack, chunks=(1, 20, 24), compression="gzip")
    with av.open(str(folder / "frame.mkv"), "w") as video:
        stream = video.add_stream("ffv1", rate=25, options={"level": "3", "slicecrc": "1"})
        stream.height, stream.width, stream.pix_fmt = 20, 24, "gray12le"
        for frame in stack:
            video.mux(stream.encode(av.VideoFrame.from_ndarray(frame, format="gray12le")))
        video.mux(stream.encode())


def _make_scenes(folder: Path) -> None:
    from scipy.io import savemat

    rng = np.random.default_rng(1)
    wave = np.arange(400.0, 701.0, 50.0)
    cube = rng.random((18, 20, wave.size)).astype(np.float32)
    light = {"data": {"photons": np.full(wave.size, 2.0)}, "spectrum": {"wave": wave}}
    scene = {"spectrum": {"wave": wave}, "data": {"photons": cube}, "illuminant": light, "name": "x", "list": ["a", 1.5]}
    savemat(folder / "scene.mat", {"scene": scene})
    savemat(folder / "packed.mat", {"cube": cube, "text": "hello"}, do_compression=True)
    with h5py.File(folder / "scene73.mat", "w", userblock_size=512) as root:
        root["scene/data/photons"], root["scene/spectrum/wave"] = cube.T, wave[:, None]
        root["scene/illuminant/data/photons"] = np.full((1, wave.size), 2.0)
    with h5py.File(folder / "cube.h5", "w") as root:
        root.create_dataset("a/cube", data=cube, compression="gzip", shuffle=True)
        root["a/note"] = "text"
    np.save(folder / "cube.npy", cube)
    (folder / "cube.img").write_bytes(cube.astype("<f4").tobytes())
    (folder / "cube.hdr").write_text(
        f"ENVI\ndescription = {{a = b}}\nsamples = 20\nlines = 18\nbands = {wave.size}\nheader offset = 0\ndata type = 4\n"
        "interleave = bip\nbyte order = 0\nwavelength units = Nanometers\nreflectance scale factor = 1\n"
        f"wavelength = {{{', '.join(map(str, wave))}}}\n"
    )
    (folder / "bands").mkdir(exist_ok=True)
    for band in range(wave.size):
        _write_image(folder / f"bands/band_{band}.png", np.rint(cube[..., band : band + 1] * 65535).astype(np.uint16))
    _write_image(folder / "channels.exr", cube, [f"{nm:g}nm" for nm in wave], compression="zip")
    import tifffile

    tifffile.imwrite(folder / "pages.tif", np.moveaxis(cube, 2, 0), photometric="minisblack", compression="zlib")
    for name in ("picture.png", "picture.jpg", "picture.tif"):
        _write_image(
            folder / name, np.rint(cube[..., :3] * 255).astype(np.uint8), compression="zip" if name[-1] == "f" else ""
        )


def _write_image(path: Path, pixels: np.ndarray, names: list[str] | None = None, compression: str = "") -> None:
    import OpenImageIO as oiio

    spec = oiio.ImageSpec(pixels.shape[1], pixels.shape[0], pixels.shape[2], str(pixels.dtype))
    if names:
        spec.channelnames = names
    if compression:
        spec.attribute("compression", compression)
    spec.attribute("DateTime", "")  # instead of the time, so that a seed always makes the same file
    sink = oiio.ImageOutput.create(str(path))
    assert sink is not None
    assert sink.open(str(path), spec)
    assert sink.write_image(np.ascontiguousarray(pixels))
    sink.close()
