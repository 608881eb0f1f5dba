"""A camera array, scene, class feature, raw format, picture format or option can be added in at most three places.

The additions (see docs/architecture.md) are made to a copy of the program, with one file or edit per place. The commands of
the copy then use the additions. A test fails if a fourth place is needed.
"""

import inspect
import os
import re
import shutil
import subprocess
import sys
import types
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from l3cli.classes.features import FEATURES, ClassRecipe, FeatureModule
from l3cli.io.images import read_image
from tests.helpers.paths import HIDDEN, ROOT

MOST = 3  # places
PAGE = ROOT / "docs/architecture.md"

Edits = list[tuple[str, str]]  # a line as it stands, and what follows it or stands in its place

CAMERA = """
name = "Diagonal stripes"
[sensor]
rows = 96
cols = 96
pixel_pitch_um = 4.0
bits = 12
gain_dn_per_e = 0.25
black_level_dn = 64
[cfa]
channels = ["r", "g", "b"]
pattern = ["r g b", "g b r", "b r g"]
[responsivity]
wavelength_nm = [400, 700, 10]
peak_efficiency = 0.4
[responsivity.gaussians]
r = [{ peak = 0.8, centre_nm = 600, sigma_nm = 35 }]
g = [{ peak = 1.0, centre_nm = 535, sigma_nm = 40 }]
b = [{ peak = 0.9, centre_nm = 460, sigma_nm = 30 }]
[noise]
read_noise_e = 4.0
dark_current_e_per_s = 5.0
dsnu_e = 2.0
prnu = 0.005
well_capacity_e = 15000
[optics]
focal_length_mm = 25
f_number = 2.8
"""

RINGS = '''
"""Rings about the middle, of random reflectance."""

import numpy as np


def rings(rng, size, wavelength):
    """Reflectance (row, col, band)."""
    row, col = np.mgrid[: size[0], : size[1]] - np.array(size)[:, None, None] / 2
    spectra = rng.uniform(0.05, 0.95, (64, wavelength.size)).astype(np.float32)
    return spectra[np.hypot(row, col).astype(int) // 5 % 64]
'''

GREY_TEXT = '''
"""Grey scenes as text: a row of reflectances a line."""

import numpy as np

from l3cli.frames.scene import NO_ILLUMINANT, Scene


def read(path):
    """The scene, of equal reflectance from 400 to 700 nm."""
    grey = np.loadtxt(path, dtype=np.float32)
    wavelength = np.arange(400.0, 701.0, 10.0)
    return Scene(path.stem, wavelength, np.repeat(grey[..., None], wavelength.size, axis=2), NO_ILLUMINANT)


def size(path):
    """(rows, cols)."""
    return read(path).reflectance.shape[:2]
'''

PEAK = '''
"""Peak: whether the middle of a neighbourhood lies farther above the whole than it does in half of the pilot."""

import numpy as np

from l3cli.artifacts.class_rule import Feature, Window
from l3cli.recipes.toml import Count, Recipe

SNIPPET = "peak.cl"


class PeakKeys(Recipe):
    steps: Count = 2


def _above(feature, sums):
    return sums[..., 0] * int(feature.constants[0]) - sums[..., 1] * 9


def fits(camera, patch):
    return patch >= 3


def make_feature(keys, camera, rule, dark, observed):
    whole, middle = rule.patch, rule.radius - 1
    windows = (Window(0, middle, middle, 3, 3, 1), Window(1, 0, 0, whole, whole, 1))
    shares = np.arange(1, keys.steps) / keys.steps
    edges = np.zeros(keys.steps - 1) if observed is None else np.quantile(observed[:, 0], shares)
    return Feature("peak", keys.steps, windows, np.array([whole**2, *np.rint(edges)], np.int32))


def check(feature, rule):
    if len(feature.constants) != feature.size or feature.sums != 2:
        raise ValueError("constants are missing")


def observe(feature, rule, sums, level):
    return _above(feature, sums)[:, None].astype(np.float64)


def values(feature, rule, sums, level):
    return (_above(feature, sums)[..., None] > feature.constants[1:]).sum(axis=-1)


def with_less_noise(feature, noise_fraction):
    return feature


def turned(feature, transposed, turns):
    return np.arange(feature.size)


def macros(feature, rule):
    return {"PEAKS": feature.size}


def entry(table, index):
    return {"peak": index}


def heading(entry):
    return f"{entry['peak']}"


def name(table, index):
    return f"peak {index}"
'''

PEAK_CL = """
// Peak: the formula of l3cli/classes/peak.py.

INLINE uints peak_of(const ints *sum, uints level, __global const int *constants) {
    const ints above = sum[0] * constants[0] - sum[1] * 9;
    uints peak = 0;
    for (int k = 1; k < PEAKS; k++) peak = above > constants[k] ? peak + 1 : peak;
    return peak;
}
"""

DECIMAL = '''
"""Raw frames as decimal text."""

import numpy as np

from l3cli.io.raw import RawContent

def read(path):
    """Values (row, col) in DN."""
    return {"values": np.loadtxt(path, dtype=np.uint16, ndmin=2)}
'''

FARBFELD = '''
"""Farbfeld, which OpenImageIO does not write: red, green, blue and opacity of 16 bits."""

import struct

import numpy as np


def encode(path, picture):
    """The file of a picture."""
    rows, cols, _ = picture.pixels.shape
    pixels = np.dstack([picture.pixels, np.full((rows, cols), 65535)])
    return b"farbfeld" + struct.pack(">II", cols, rows) + pixels.astype(">u2").tobytes()
'''

ADDITIONS: dict[str, dict[str, str | Edits]] = {
    "camera array": {"configs/cameras/diagonal.toml": CAMERA},
    "synthetic scene": {
        "l3cli/simulation/rings.py": RINGS,
        "l3cli/simulation/sources.py": [
            (
                "class GreyRamp(",
                'class Rings(Random, tag_field="source", tag="rings", kw_only=True):\n    pass\n\n\nclass GreyRamp(',
            ),
            ("Source = (\n", "Source = (\n    Rings |"),
        ],
        "l3cli/simulation/procedural.py": [
            ("import fields, leaves, reflectances, sources", "import fields, leaves, reflectances, rings, sources"),
            (
                "= {\n    sources.DeadLeaves:",
                "= {\n    sources.Rings: lambda s, rng, nm: rings.rings(rng, s.size, nm),\n    sources.DeadLeaves:",
            ),
        ],
    },
    "file scene": {
        "l3cli/io/scenes/grey_text.py": GREY_TEXT,
        "l3cli/simulation/sources.py": [
            (
                "class IsetScenes(",
                'class GreyText(FileSource, tag_field="source", tag="grey text"):\n    pass\n\n\nclass IsetScenes(',
            ),
            ("Source = (\n", "Source = (\n    GreyText |"),
        ],
        "l3cli/io/scenes/__init__.py": [
            ("FORMATS = (\n", 'FORMATS = (\n    SceneFormat("grey text", "grey_text"),\n'),
        ],
    },
    "class feature": {
        "l3cli/classes/peak.py": PEAK,
        "opencl/peak.cl": PEAK_CL,
        "l3cli/classes/features.py": [
            ("direction, level, saturation", "direction, level, peak, saturation"),
            ('    "direction": direction,\n', '    "direction": direction,\n    "peak": peak,\n'),
            ("import DirectionKeys\n", "import DirectionKeys\nfrom l3cli.classes.peak import PeakKeys\n"),
            ("    direction: Dir", "    peak: PeakKeys | None = None\n    direction: Dir"),
        ],
    },
    "raw format": {
        "l3cli/io/raw/decimal.py": DECIMAL,
        "l3cli/io/raw/files.py": [
            ("FORMATS = (\n", 'FORMATS = (\n    RawFormat((".txt",), "decimal"),\n'),
        ],
    },
    "picture format": {
        "l3cli/io/pictures/farbfeld.py": FARBFELD,
        "l3cli/io/pictures/registry.py": [
            ("FORMATS = (\n", 'FORMATS = (\n    PictureFormat((".ff",), "farbfeld", (16,)),\n'),
        ],
    },
    "option": {
        "l3cli/options/render.py": [
            (
                "    temporal: bool = option(",
                '    grain: float | None = option(None, "Grain of pictures.", Number(0, 9, "DN"), metavar="DN")\n'
                "    temporal: bool = option(",
            ),
        ],
    },
}  # fmt: skip

SCENES = """
exposure_share = [0.8]
[[scene]]
source = "rings"
size = [64, 64]
count = 2
[[scene]]
source = "grey text"
file = "grey.txt"
"""
CLASSES = """
[classes]
patch = 5
levels = 4
chromas = 1
[classes.peak]
steps = 3
[classes.direction]
[learning]
patches = 500
draws = 2
first_draws = 0
"""
COMPARED = """
import numpy as np
from pathlib import Path
from l3cli.artifacts.store import load
from l3cli.artifacts.table import TransformTable
from l3cli.frames.frame import RawFrame
from l3cli.rendering.opencl.renderer import OpenCLRenderer
from l3cli.rendering.reference import ReferenceRenderer

table = load(TransformTable, Path("table.h5"))
assert [feature.name for feature in table.first.rule.feature_list] == ["direction", "peak"]
values = np.random.default_rng(0).integers(60, 4096, (70, 300)).astype(np.uint16)
values[:35] = 1000 + 20 * np.arange(300)[None] % 900
frame = RawFrame("f", values, table.black_level, table.white_level, (1, 2))
labels = ReferenceRenderer(table).labels(frame)
directions, peaks = table.first.rule.split_features(table.first.rule.split(labels).combination)
assert np.unique(directions).tolist() == [0, 1, 2, 3, 4] and np.unique(peaks).tolist() == [0, 1, 2]
for variant in ("processor", "graphics"):
    np.testing.assert_array_equal(OpenCLRenderer(table, variant=variant).labels(frame), labels)
"""


@pytest.fixture(scope="module")
def copy(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A copy of the program with all additions made."""
    folder = tmp_path_factory.mktemp("program")
    for name in ("l3cli", "opencl", "configs"):
        shutil.copytree(ROOT / name, folder / name)  # with compiled modules, which are valid at the times that are copied
    for places in ADDITIONS.values():
        assert len(places) <= MOST
        for name, change in places.items():
            path = folder / name
            if isinstance(change, str):
                assert not path.exists()
                path.write_text(change, encoding="utf-8")
                continue
            text = path.read_text(encoding="utf-8")
            for old, new in change:
                assert text.count(old) == 1, f"{name}: {old}"
                text = text.replace(old, new)
            path.write_text(text, encoding="utf-8")
    return folder


COMMANDS = """
import sys
from l3cli.cli import run

for line in sys.argv[1:]:
    code = run(line.split())
    if code:
        sys.exit(f"l3 {line}: {code}")
"""


def run(program: Path, folder: Path, *words: str) -> str:
    """What `python WORDS` prints in `folder` with the changed program."""
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(map(str, (program, HIDDEN)))}
    done = subprocess.run([sys.executable, *words], cwd=folder, env=environment, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
    return done.stdout + done.stderr


OPTION = """
import inspect
import l3cli as l3
from l3cli.cli import run
from l3cli.errors import RecipeError
from l3cli.options.render import RenderOptions

assert run(["render", "--help"]) == 0
assert run(["render", "a.h5", "b", "-o", "c", "--grain", "10"]) == 2
grain = inspect.signature(l3.render).parameters["grain"]
assert (grain.annotation, grain.default) == (float | None, None)
try:
    l3.render("a.h5", "b", "c", grain=10)
except RecipeError as error:
    print("in Python:", error)
chosen = {}, {"grain": None}, {"grain": 1}, {"grain": 2}, {"resume": True}
keys = [RenderOptions(**options).run_key() for options in chosen]
assert keys[0] == keys[1] == keys[4] and len(set(keys)) == 3, keys
"""


def test_an_option_is_one_field(copy: Path, tmp_path: Path) -> None:
    """On the command line, in Python and in what tells runs apart, with its range."""
    output = run(copy, tmp_path, "-c", OPTION)
    assert re.search(r"^  --grain DN +Grain of pictures\.$", output, re.MULTILINE)
    assert "Invalid value for '--grain': 10 is not within 0…9 DN; the nearest valid value is 9" in output
    assert "in Python: ‹grain›: 10 is not within 0…9 DN; the nearest valid value is 9" in output


def test_all_work_jointly(copy: Path, tmp_path: Path) -> None:
    """Simulated, trained and rendered; labels of the new feature by OpenCL are those of numpy."""
    (tmp_path / "scenes.toml").write_text(SCENES)
    (tmp_path / "classes.toml").write_text(CLASSES)
    rng = np.random.default_rng(0)
    np.savetxt(tmp_path / "grey.txt", rng.uniform(0.02, 0.9, (12, 12)).repeat(4, 0).repeat(4, 1), fmt="%.3f")
    np.savetxt(tmp_path / "frame.txt", rng.integers(64, 3000, (96, 96)), fmt="%d")
    commands = (
        "simulate scenes.toml --camera diagonal -o training.h5 --quiet",
        "info training.h5",
        "train training.h5 --classes classes.toml -o table.h5",
        "render table.h5 frame.txt -o picture.png --bits 16 --quiet",
        "render table.h5 frame.txt -o picture.ff --bits 16 --quiet",
        "info table.h5",
        "schema classes",
        "evaluate table.h5 training.h5 --backend reference --quiet",
        "report table.h5 -o page.html --quiet",
        "export table.h5 -o source --quiet",
    )
    output = run(copy, tmp_path, "-c", COMMANDS, *commands)
    for answer in ("3 frames", "× 5 values of direction × 3 values of peak ×", "peak 2"):
        assert answer in output
    added = np.frombuffer((tmp_path / "picture.ff").read_bytes()[16:], ">u2").reshape(96, 96, 4)
    np.testing.assert_array_equal(added[..., :3], read_image(tmp_path / "picture.png")[0])
    run(copy, tmp_path, "-c", COMPARED)
    if shutil.which("make") and shutil.which("cc"):
        done = subprocess.run(
            ["make", "-C", tmp_path / "source", "CFLAGS=-O1 -Werror", "test"], capture_output=True, text=True
        )
        assert done.returncode == 0, done.stdout + done.stderr
        assert "classes that differ: 0 of" in done.stdout


@pytest.mark.parametrize("name", FEATURES)
def test_a_feature_has_every_member_of_its_protocol(name: str) -> None:
    """Each member, and the parameters of each function by name; what fails is named."""
    assert_is_feature(FEATURES[name])
    assert name in ClassRecipe.__annotations__, f"the recipe has no table {name}, which l3cli/classes/features.py describes"


def test_what_a_feature_lacks_is_named(tmp_path: Path) -> None:
    module = types.ModuleType("peak")
    exec(PEAK.replace("def with_less_noise(feature,", "def less_noisy(feature,"), vars(module))
    with pytest.raises(AssertionError, match="peak lacks with_less_noise"):
        assert_is_feature(module)
    exec(PEAK.replace("def observe(feature, rule,", "def observe(axis, rule,"), vars(module))
    with pytest.raises(AssertionError, match=r"peak\.observe takes axis, rule, sums, level"):
        assert_is_feature(module)


def assert_is_feature(module: Any) -> None:
    """Compare a module with the protocol of features."""
    for member in sorted(typing_members(FeatureModule)):
        assert hasattr(module, member), f"{module.__name__} lacks {member}, which l3cli/classes/features.py describes"
        expected = getattr(FeatureModule, member, None)
        if inspect.isfunction(expected):
            parameters = list(inspect.signature(expected).parameters)[1:]  # without self
            found = list(inspect.signature(getattr(module, member)).parameters)
            assert found == parameters, f"{module.__name__}.{member} takes {', '.join(found)}, not {', '.join(parameters)}"


def typing_members(protocol: type) -> set[str]:
    """Return the names of the members of a protocol and of those that it extends."""
    names: set[str] = set()
    for each in protocol.__mro__[:-1]:
        names |= {name for name in (*vars(each), *getattr(each, "__annotations__", {})) if not name.startswith("_")}
    return names


def rows() -> dict[str, list[str]]:
    """What the page's table says: the places that each addition takes, without what stands in brackets."""
    section = PAGE.read_text(encoding="utf-8").partition("## To add a …\n")[2].partition("\n## ")[0]
    cells = [[cell.strip() for cell in line.strip("|").split("|")] for line in section.splitlines() if line[:1] == "|"]
    return {what: re.sub(r"\(.*?\)", "", places).split(";") for what, places in cells[2:]}


def test_the_page_names_the_places() -> None:
    """Three at most, all of them there; of what is added above, those that it takes."""
    assert rows().keys() >= {*ADDITIONS, "backend", "output", "video codec", "command"}
    for what, places in rows().items():
        assert 1 <= len(places) <= MOST, what
        named = {name for place in places for name in re.findall(r"`([\w/.]+/[\w.]*)`", place)}
        for name in named:
            assert (ROOT / name).exists(), name
        for path, change in ADDITIONS.get(what, {}).items():
            place = path if not isinstance(change, str) else path.rpartition("/")[0] + "/"
            assert place in named, f"{what}: {place}"
