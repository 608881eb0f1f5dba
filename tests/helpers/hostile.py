"""Hostile inputs: whole files, changes to them, commands that read them, and what must hold whatever these make of it.

Choices come from whoever drives: Hypothesis (test_hostile.py), a seed or a coverage-guided fuzzer (fuzz.py).
"""

import contextlib
import io
import os
import re
import resource
import shutil
import signal
import struct
import sys
import traceback
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Protocol

import h5py
import numpy as np

from l3cli.artifacts import container
from l3cli.artifacts.store import load, save
from l3cli.artifacts.table import TransformTable
from l3cli.cli import run
from l3cli.limits import MEGAPIXELS
from tests.helpers.dng_files import gain_map, opcode_list
from tests.helpers.tables import with_tree

CACHE = str(Path(os.environ.get("XDG_CACHE_HOME") or Path("~/.cache").expanduser(), "l3cli"))  # l3's cache of kernels
SECONDS = 10  # of processor time: an input that takes longer hangs …
PATIENCE = 12  # … as does one that takes so many times longer by the clock
MEMORY = 1 << 30  # bytes that an input may take beside what the process had, which is far more than MOST_MEGAPIXELS asks for
MOST_MEGAPIXELS = 0.25
LARGEST_SPOILT = 1 << 20  # values of a dataset that are spoilt one by one
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
EVALUATION = '{"camera": "a", "frames": [{"luminance": 10, "ours": {"psnr": 30.5, "scielab": 2}}]}'


class Choices(Protocol):
    """Where an input's choices come from."""

    def integer(self, least: int, most: int) -> int:
        """A whole number from `least` to `most`."""


def one_of(choices: Choices, options: Any) -> Any:
    return options[choices.integer(0, len(options) - 1)]


# ------------------------------------------------------------------------------------------------------- spoiling

INTEGERS = (0, 1, 0x7F, 0x80, 0xFF, 0x7FFF, 0xFFFF, 0x7FFFFFFF, 0x80000000, 0xFFFFFFFF, 2**62, 2**63, 2**64 - 1, 255, 16)
WHOLE = (0, -1, 1, 2, 3, 7, 16, 2**31 - 1, 2**32, 2**63 - 1, 2**63, -(2**63), 10**9, 10**40)  # none that means long work
BROKEN = (1e30, 1e-30, 1e300, 1e-300, -1e300, 0.5, -0.5, 1.0000001, 1e9, 1e20, -3.5, 1e-9, float("nan"), float("inf"))
NUMBERS = (*map(str, WHOLE), *map(str, BROKEN), "-inf", "1_000", "0x10", "[]", "[1]", "[1, 2, 3, 4, 5]", "true", "{}")
TEXTS = (
    '""', '"."', '".."', '"../../../etc/passwd"', '"/etc/passwd"', '"/dev/zero"', '"/dev/stdin"', '"\\u0000"', '"*"', '"["',
    '"a/../../b"', '"$(touch hurt)"', '"`touch hurt`"', '"; touch hurt"', '"<script>"', '"\\u001b[31m"', '"%s%n"', '"~"',
    '"D65"',
    '"scene"', '"1e9K"', '"0K"', '"D4000K"', '"-1 D65 + 2 A"', '"camera"', '"r"', '"r r"', '"none.csv"', '"picture.png"',
    '"lamp.csv"', '"frame.tif"', '"scenes.toml"', f'"{"x" * 5000}"', "'''\n'''", '"row row row"', '"é\\u202e"', "[]",
    '["a"]', "{}",
)  # fmt: skip
WORDS = re.compile(r"""("[^"\n]*"|[-+]?\d[\d.eE+-]*|\btrue\b|\bfalse\b|[A-Za-z_]\w*)""")


def spoiled_bytes(content: bytes, choices: Choices) -> bytes:
    """Some bytes of a file changed, left out, doubled, or cut off."""
    spoilt = bytearray(content)
    for _ in range(choices.integer(1, 4)):
        if not spoilt:
            break
        reach = min(len(spoilt), one_of(choices, (64, 512, len(spoilt))))  # headers lie at the beginning …
        at = choices.integer(0, reach - 1)
        if choices.integer(0, 7) == 0:
            at = len(spoilt) - 1 - at  # … or at the end
        kind = choices.integer(0, 7)
        if kind <= 1:
            spoilt[at] ^= 1 << choices.integer(0, 7)
        elif kind == 2:
            spoilt[at] = choices.integer(0, 255)
        elif kind <= 4:
            width = one_of(choices, (2, 4, 8))
            number = one_of(choices, INTEGERS) % 2 ** (8 * width)
            spoilt[at : at + width] = number.to_bytes(width, one_of(choices, ("little", "big")))
        elif kind == 5:
            del spoilt[at : at + choices.integer(1, 64)]
        elif kind == 6:
            length = choices.integer(1, 64)
            spoilt[at:at] = spoilt[at : at + length] * choices.integer(1, 4)
        else:
            del spoilt[at:]
    return bytes(spoilt)


def spoiled_text(content: bytes, choices: Choices) -> bytes:
    """Some words of a text replaced by others that may hurt, some lines left out or doubled; now and then some bytes."""
    if choices.integer(0, 15) == 0:
        return spoiled_bytes(content, choices)
    text = content.decode()
    for _ in range(choices.integer(1, 3)):
        words = list(WORDS.finditer(text))
        change = choices.integer(0, 9)
        if change <= 7 and words:
            word = one_of(choices, words)
            with_quotes = word[0].startswith('"')
            kind = (TEXTS if with_quotes else NUMBERS) if choices.integer(0, 7) else TEXTS + NUMBERS
            new = one_of(choices, kind)
            text = text[: word.start()] + new + text[word.end() :]
        else:
            lines = text.split("\n")
            at = choices.integer(0, len(lines) - 1)
            lines[at : at + 1] = [] if change == 8 else [lines[at]] * choices.integer(2, 5)
            text = "\n".join(lines)
    return text.encode()


def spoiled_hdf5(content: bytes, choices: Choices) -> bytes:
    """Some members or values of an HDF5 file replaced by what l3 never writes; now and then some bytes."""
    if choices.integer(0, 2) == 0:
        return spoiled_bytes(content, choices)
    return _spoiled_members(content, choices, "")


def spoiled_layer(content: bytes, choices: Choices) -> bytes:
    """Some members or values of a table's second layer replaced by what l3 never writes."""
    return _spoiled_members(content, choices, "later/0")


def _spoiled_members(content: bytes, choices: Choices, below: str) -> bytes:
    image = io.BytesIO(content)
    with h5py.File(image, "r+") as root:
        for _ in range(choices.integer(1, 2)):
            names: list[str] = []
            root.visit(names.append)
            names = [name for name in names if name.startswith(below)]
            if names:
                _spoil_member(root, one_of(choices, names), choices)
    return image.getvalue()


def _spoil_member(root: h5py.File, name: str, choices: Choices) -> None:
    member = root[name]
    if not isinstance(member, h5py.Dataset) or member.size > LARGEST_SPOILT or choices.integer(0, 3) == 0:
        kind = choices.integer(0, 7)
        if kind >= 6:
            holder = root if kind == 6 else member
            holder.attrs[one_of(choices, ("kind", "version", "axes"))] = one_of(
                choices,
                (0, -1, 99, 2**62, "camera model", "x" * 1000, np.arange(5), np.bytes_(b"\xff"), h5py.Empty("f"), np.nan),
            )
            return
        del root[name]
        if kind == 1:
            root[name] = h5py.SoftLink("/")
        elif kind == 2:
            root[name] = h5py.ExternalLink("/etc/passwd", "/")
        elif kind == 3:
            root[name] = root  # a circle
        elif kind == 4:
            root.create_group(name)
        elif kind == 5:
            root.create_dataset(name, (2**20, 2**20), "f8", chunks=(64, 64), compression="gzip")
        return
    values = member[()]
    if choices.integer(0, 1) or member.dtype.kind not in "biuf":
        del root[name]
        root[name] = _other_values(values, choices)
    else:
        array = np.array(values)
        if array.size:
            flat = array.reshape(-1)
            flat[choices.integer(0, array.size - 1)] = _hurtful(array.dtype, choices)
        member[()] = array


def _hurtful(dtype: np.dtype, choices: Choices) -> Any:
    if dtype.kind in "SO":
        return one_of(choices, (b"", b"X", b"\xff\xfe", b"[]", b"{}", b'[{"command": 1}]', b"../../x", b"\x1b[31m<script>"))
    if dtype.kind == "f":
        return one_of(choices, (0.0, -1.0, 1e-300, 1e30, -1e30, np.nan, np.inf, 0.5, 1e6))
    if dtype.kind == "b":
        return bool(choices.integer(0, 1))
    if dtype.kind not in "iu":
        return 0
    limits = np.iinfo(dtype)
    return one_of(choices, (0, 1, limits.max, limits.min, 2, 3, 16, 100))


def _other_values(values: Any, choices: Choices) -> Any:
    array = np.asarray(values)
    kind = choices.integer(0, 6)
    if kind == 0:
        return np.asarray(array.reshape(-1)[: choices.integer(0, 2)])
    if kind == 1:
        return np.repeat(np.atleast_1d(array), 2, axis=0)
    if kind == 2:
        return array[None]
    if kind == 3:
        return np.zeros(array.shape, one_of(choices, ("u1", "i8", "f8", "f4", "S3", "c16", "?")))
    if kind == 4:
        return one_of(choices, ("text", b"\xff", 5, 2**60, 1.5, np.nan, True))
    if kind == 5:
        return np.full(array.shape, _hurtful(array.dtype, choices), array.dtype)
    return np.zeros((0,) * array.ndim, array.dtype if array.dtype.kind != "O" else "f8")


# ------------------------------------------------------------------------------------------------------- subjects


@dataclass(frozen=True)
class Subject:
    """A file to be spoilt, and the commands that read it: {file} is the file, {out} the folder that outputs go to."""

    name: str
    spoil: Callable[[bytes, Choices], bytes]
    commands: tuple[str, ...]
    text: str = ""  # of the recipe beside it that names it, as recipe.toml
    often: int = 3  # as the long run takes it; 1: those whose commands take long


def _scene(source: str, name: str, more: str = "") -> str:
    return f'exposure_share = [0.9]\nilluminants = ["D65"]\n[[scene]]\nsource = "{source}"\nfile = "{name}"\n{more}'


RANGE = "wavelength_range_nm = [400, 700, 50]\n"
SIMULATE = "simulate recipe.toml --camera camera.toml -o {out}/t.h5"
DRAW_WITH = "simulate drawn.toml --camera {file} -o {out}/t.h5"
REPORT = "report {file} -o {out}/r.html"
RENDER = "render table.h5 {file} -o {out}/a.png --backend reference"
SEQUENCE = "render table.h5 {file} -o {out}/%d.png --backend reference --skip-bad"
CALIBRATE = "calibrate {file} -o {out}/camera.h5 --accept --export {out}/curves"
LISTED = "calibrate lab/MEASUREMENTS.toml -o {out}/camera.h5 --accept"
CHECK = "check camera.toml {file}"
SUBJECTS = (
    Subject(
        "camera.h5",
        spoiled_hdf5,
        ("info {file}", "info {file} --json", DRAW_WITH, REPORT),
    ),
    Subject("table.h5", spoiled_hdf5, ("info {file}", "render {file} frame.npy -o {out}/a.png --backend reference", REPORT)),
    Subject("tree.h5", spoiled_layer, ("info {file}", "render {file} frame.npy -o {out}/a.png --backend reference", REPORT)),
    Subject(
        "training.h5",
        spoiled_hdf5,
        (
            "info {file}",
            "train {file} --classes classes.toml -o {out}/t.h5",
            "evaluate table.h5 {file} --backend reference --pictures {out}/p",
            REPORT,
        ),
        often=1,
    ),
    Subject("sums.h5", spoiled_hdf5, ("train --merge {file} -o {out}/t.h5",), often=1),
    Subject("camera.toml", spoiled_text, (DRAW_WITH, "check {file}")),
    Subject("curves.toml", spoiled_text, (DRAW_WITH, "check {file}")),
    Subject(
        "scenes.toml", spoiled_text, ("simulate {file} --camera camera.toml -o {out}/t.h5 --pictures {out}", CHECK), often=1,
    ),
    Subject("classes.toml", spoiled_text, ("train training.h5 --classes {file} -o {out}/t.h5", CHECK), often=1),
    Subject("lab.toml", spoiled_text, ("lab camera.toml --recipe {file} -o {out}/lab", CHECK), often=1),
    Subject("lab/MEASUREMENTS.toml", spoiled_text, (CALIBRATE, CHECK), often=1),
    Subject("table.toml", spoiled_text, (CALIBRATE,)),
    Subject("sweep.csv", spoiled_text, ("calibrate table.toml -o {out}/camera.h5 --accept",)),
    Subject("diode.csv", spoiled_text, ("calibrate table.toml -o {out}/camera.h5 --accept",)),
    Subject("curves.csv", spoiled_text, ("simulate drawn.toml --camera curves.toml -o {out}/t.h5",)),
    Subject("curves.json", spoiled_text, ("calibrate curves_of.toml -o {out}/camera.h5 --accept",)),
    Subject("lamp.csv", spoiled_text, (SIMULATE,), 'illuminants = ["lamp.csv"]\n' + DRAWN),
    Subject("lab/spectra/mono.csv", spoiled_text, (LISTED,), often=1),
    Subject("lab/spectra/chart_010_D65.csv", spoiled_text, (LISTED,), often=1),
    Subject("lab/white/012_D65_0.tif", spoiled_bytes, (LISTED,), often=1),
    Subject("lab/mono/000_430nm.tif", spoiled_bytes, (LISTED,), often=1),
    Subject("lab/dark/015_cap_0.pgm", spoiled_bytes, ("calibrate lab/pgm.toml -o {out}/camera.h5 --accept",), often=1),
    Subject("evaluation.json", spoiled_text, ("compare {file} other.json --figure psnr -o {out}/c.html",)),
    Subject("frame.npy", spoiled_bytes, (RENDER,)),
    Subject("frame.tif", spoiled_bytes, (RENDER,)),
    Subject("frame.png", spoiled_bytes, (RENDER,)),
    Subject("frame.dng", spoiled_bytes, (RENDER,)),
    Subject("frame.raw", spoiled_bytes, (RENDER + " --size 20x24",)),
    Subject("frame.raw10", spoiled_bytes, (RENDER + " --size 20x24",)),
    Subject("frame.pgm", spoiled_bytes, (RENDER,)),
    Subject("frame.fits", spoiled_bytes, (RENDER,)),
    Subject("stack.npy", spoiled_bytes, (SEQUENCE,)),
    Subject("stack.h5", spoiled_hdf5, (SEQUENCE, SEQUENCE + " --dataset take/raw")),
    Subject("clip.mkv", spoiled_bytes, (SEQUENCE,)),
    Subject("scene.mat", spoiled_bytes, (SIMULATE,), _scene("iset", "scene.mat")),
    Subject("scene73.mat", spoiled_hdf5, (SIMULATE,), _scene("iset", "scene73.mat")),
    Subject("packed.mat", spoiled_bytes, (SIMULATE,), _scene("cube", "packed.mat", RANGE)),
    Subject("cube.h5", spoiled_hdf5, (SIMULATE,), _scene("cube", "cube.h5", RANGE)),
    Subject("cube.npy", spoiled_bytes, (SIMULATE,), _scene("cube", "cube.npy", RANGE)),
    Subject("cube.hdr", spoiled_text, (SIMULATE,), _scene("envi", "cube.hdr")),
    Subject("bands/band_3.png", spoiled_bytes, (SIMULATE,), _scene("bands", "bands", RANGE)),
    Subject("channels.exr", spoiled_bytes, (SIMULATE,), _scene("channels", "channels.exr")),
    Subject("pages.tif", spoiled_bytes, (SIMULATE,), _scene("channels", "pages.tif", RANGE)),
    Subject("picture.png", spoiled_bytes, (SIMULATE,), _scene("rgb", "picture.png")),
    Subject("picture.jpg", spoiled_bytes, (SIMULATE,), _scene("rgb", "picture.jpg")),
    Subject("picture.tif", spoiled_bytes, (SIMULATE,), _scene("rgb", "picture.tif")),
)  # fmt: skip


def make_inputs(folder: Path) -> None:
    """Every subject's whole file, and what its commands read beside it, below `folder`."""
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
    import colour_demosaicing  # noqa: F401  asks git for its version
    import distributed  # noqa: F401  both unpickle what they wrote

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

    rng = np.random.default_rng(0)
    stack = rng.integers(0, 4096, (3, 20, 24)).astype(np.uint16)
    np.save(folder / "frame.npy", stack[0])
    np.save(folder / "stack.npy", stack)
    stack[0].tofile(folder / "frame.raw")
    (folder / "frame.raw10").write_bytes(stack.tobytes()[: 20 * 30])
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
    mended, evened = struct.pack(">5I", 0, 1, 0, 3, 4), gain_map(np.full((2, 3), 1.5), (0, 0, 30, 30))
    for code, opcode in ((51008, (5, 0, mended)), (51009, (9, 1, evened)), (51022, (3, 0, struct.pack(">7d", *[0.1] * 7)))):
        content = bytes(opcode_list(opcode)[1])
        dng.append((code, 7, len(content), content, True))
    tifffile.imwrite(folder / "frame.dng", np.tile(stack[0], (3, 3)), photometric=32803, extratags=cfa + dng)
    with h5py.File(folder / "stack.h5", "w") as root:
        root.create_dataset("take/raw", data=stack, chunks=(1, 20, 24), compression="gzip")
    with av.open(str(folder / "clip.mkv"), "w") as video:
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
    spec.attribute("DateTime", "")  # else the clock: a seed must mean one input
    sink = oiio.ImageOutput.create(str(path))
    assert sink is not None
    assert sink.open(str(path), spec)
    assert sink.write_image(np.ascontiguousarray(pixels))
    sink.close()


# ------------------------------------------------------------------------------------------------------- judgement


class Hang(BaseException):
    """An input takes too long."""


@contextlib.contextmanager
def confined() -> Iterator[None]:
    """Small inputs only, a short patience with decoders, and no more memory than a little above what this process has."""
    before = {name: os.environ.get(name) for name in (MEGAPIXELS, "L3_DECODE_SECONDS")}
    os.environ |= {MEGAPIXELS: str(MOST_MEGAPIXELS), "L3_DECODE_SECONDS": "3"}
    old = resource.getrlimit(resource.RLIMIT_AS)
    has = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (has + MEMORY, old[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_AS, old)
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value


class Workshop:
    """A folder of whole inputs in which one at a time is spoilt and read."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.inputs = folder, folder / "inputs"
        make_inputs(self.inputs)
        self.names = self.files()
        self.whole = {subject.name: (self.inputs / subject.name).read_bytes() for subject in SUBJECTS}
        self.recipe = (self.inputs / "recipe.toml").read_bytes()

    def files(self) -> set[Path]:
        """Everything there is."""
        return set(self.folder.rglob("*"))

    def judge(self, subject: Subject, choices: Choices) -> str | None:
        """Spoil the subject's file and have it read; what did not hold, or None."""
        content = subject.spoil(self.whole[subject.name], choices)
        return self.judge_content(subject, content, choices.integer(0, len(subject.commands) - 1))

    def judge_content(self, subject: Subject, content: bytes, command: int = 0) -> str | None:
        """What did not hold when a command of the subject read `content`, or None."""
        path, out = self.inputs / subject.name, self.folder / "out"
        (self.inputs / "recipe.toml").write_text(subject.text or DRAWN)
        path.write_bytes(content)
        if content.startswith(container.TITLE):
            container.seal(path)  # as who means harm would: else the digest alone shows it
        arguments = [word.format(file=path, out=out) if "{" in word else word for word in subject.commands[command].split()]
        try:
            with contextlib.chdir(self.inputs):
                return verdict(arguments) or self.strays(out)
        finally:
            path.write_bytes(self.whole[subject.name])
            (self.inputs / "recipe.toml").write_bytes(self.recipe)
            shutil.rmtree(out, ignore_errors=True)

    def strays(self, out: Path, known: set[Path] | None = None) -> str | None:
        """What is there that was not (`known`, or at the beginning), but for `out`."""
        new = {path for path in self.files() - (known or self.names) if path != out and out not in path.parents}
        return f"left {sorted(map(str, new))}" if new else None


def verdict(arguments: list[str], patience: float = PATIENCE * SECONDS, codes: tuple[int, ...] = (0, 1, 2, 3)) -> str | None:
    """What did not hold of `l3 ARGUMENTS`, or None: one of `codes`, with a line that says why, within `patience` by the
    clock."""
    stdout, stderr = io.StringIO(), io.StringIO()
    timers = ((signal.ITIMER_PROF, signal.SIGPROF, SECONDS), (signal.ITIMER_REAL, signal.SIGALRM, patience))
    old = [signal.signal(number, _ring) for _, number, _ in timers]
    for timer, _, seconds in timers:
        signal.setitimer(timer, seconds)
    try:
        with contextlib.redirect_stdout(stdout), contextlib.redirect_stderr(stderr):
            code = run(arguments)
    except Hang:
        return "hangs\n" + traceback.format_exc()
    except BaseException:
        return traceback.format_exc()
    finally:
        for (timer, number, _), handler in zip(timers, old, strict=True):
            signal.setitimer(timer, 0)
            signal.signal(number, signal.SIG_DFL if handler is None else handler)  # None: set by another than Python
    said = stderr.getvalue()
    messages = [line for line in said.splitlines() if line.startswith("l3: ")]
    if "Traceback" in said or "out of memory" in said:
        return f"exit code {code}: {said}"
    if code not in codes or (code and not messages):
        return f"exit code {code} without a word: {said}"
    if len(messages) > 1 and "--skip-bad" not in arguments:
        return f"exit code {code} in {len(messages)} lines: {said}"
    if any(not (letter.isprintable() or letter == "\n") for letter in said):
        return f"exit code {code} with control characters: {said!r}"
    return None


@contextlib.contextmanager
def timed(seconds: float) -> Iterator[None]:
    """Raise Hang if the block takes longer by the clock."""
    old = signal.signal(signal.SIGALRM, _ring)
    signal.setitimer(signal.ITIMER_REAL, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, old)


def _ring(number: int, frame: object) -> None:
    raise Hang


_allowed: list[str] = []  # folders below which may be written while inputs are judged


@contextlib.contextmanager
def watched(*folders: Path) -> Iterator[list[str]]:
    """What Python opens for writing outside `folders`, runs in a shell, evaluates or unpickles by name meanwhile."""
    if not _allowed:
        sys.addaudithook(_audit)
    _allowed[:] = ["on", *(str(folder) for folder in folders), CACHE, "/dev/null"]
    _seen.clear()
    try:
        yield _seen
    finally:
        _allowed[:] = ["off"]


_seen: list[str] = []


def _audit(event: str, arguments: tuple[Any, ...]) -> None:
    if not _allowed or _allowed[0] != "on":
        return
    if event == "os.system" or event.startswith("pickle.") or (event == "subprocess.Popen" and not _is_decoder(arguments)):
        _seen.append(f"{event} {arguments}")
    elif event == "open" and isinstance(arguments[0], str) and (arguments[2] or 0) & (os.O_WRONLY | os.O_RDWR | os.O_CREAT):
        path = os.path.abspath(arguments[0])
        if not path.startswith(tuple(_allowed[1:])) and not any(part in path for part in ("__pycache__", "/.hypothesis/")):
            _seen.append(f"{event} {arguments}")


def _is_decoder(arguments: tuple[Any, ...]) -> bool:
    return "l3cli.io.decoder" in str(arguments[1])


def with_command(subject: Subject, command: str) -> Subject:
    """The same subject, read by another command."""
    return replace(subject, commands=(command,))
