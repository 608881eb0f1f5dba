"""Puts awkward numbers into every option, environment variable and recipe key that takes a number.

A call must end soon. It succeeds, or is refused with one line and an exit code from docs/guarantees.md.
"""

import contextlib
import os
import re
import shutil
from collections.abc import Iterator
from dataclasses import dataclass

from tests.helpers import hostile
from tests.helpers import hostile_inputs as whole
from tests.helpers.hostile import Workshop
from tests.helpers.hostile_spoiling import Choices, one_of

NUMBERS = (
    "0", "-0", "-1", "1", "2", "0.5", "1e-9", "nan", "inf", "-inf", "1e308", "-1e308", "5e-324", "1e999", "1e999999999",
    "1" + 23 * "0", "1" + 5000 * "0", 5000 * "0", "9999999999", "9223372036854775807", "9223372036854775808",
    "10²³", "²", "٣", "0x10", "1_000", "1,5", "1/3", "1/0", "29.97002997", "", " ", "three",
)  # fmt: skip
RENDER = "render table.h5 frame.npy -o {out}/a.png --backend reference"
SEQUENCE = "render table.h5 stack.npy -o {out}/p --backend reference"
MOVIE = "render table.h5 stack.npy -o {out}/a.mp4 --backend reference"
BARE = "render table.h5 frame.raw -o {out}/a.png --backend reference"
TRAIN = "train training.h5 --classes classes.toml -o {out}/t.h5"
SIMULATE = "simulate drawn.toml --camera camera.toml -o {out}/t.h5"
OPTIONS = (  # {n} is the number; "=" holds on to what begins with a minus
    "evaluate table.h5 training.h5 --backend reference --border={n}", MOVIE + " --fps={n}", MOVIE + " --crf={n}",
    "render table.h5 stack.npy -o {out}/a.y4m --backend reference --fps={n}",
    RENDER + " --exposure={n}", RENDER + " --exposure={n}EV", RENDER + " --exposure=+{n}",
    RENDER + " --white={n},0.33", RENDER + " --white=0.31,{n}", RENDER + " --white={n}K",
    RENDER + " --white=D{n}K", RENDER + " --black-level={n}", RENDER + " --white-level={n}", RENDER + " --phase={n},0",
    RENDER + " --exposure-time={n}",
    RENDER + " --gain={n}",
    BARE + " --size={n}x24", BARE + " --size=20x{n}", BARE + " --size=20x24 --stride={n}",
    BARE + " --size=20x24 --skip={n}", BARE + " --size=20x24 --packing={n}",
    "report table.h5 training.h5 -o {out}/r.html --at={n}",
    "render table.h5 - -o {out}/%d.png --backend reference --size={n}x{n}", RENDER + " --device={n}",
    SEQUENCE + " --frames={n}", SEQUENCE + " --frames=0-{n}", SEQUENCE + " --frames=0-{n} --skip-bad",
    SEQUENCE + " --every={n}",
    SEQUENCE + " --frames=0-2x{n}", "render table.h5 clip.mkv -o {out}/p --backend reference --frames=0-{n} --skip-bad",
    "render table.h5 stack.npy -o {out}/%0{n}d.png --backend reference", SEQUENCE + " --bits={n}",
    "evaluate table.h5 training.h5 --backend reference --viewing={n}", TRAIN + " --shard={n}/2", TRAIN + " --shard=1/{n}",
    TRAIN + " --shares={n}", TRAIN + " --seed={n}", SIMULATE + " --seed={n}", TRAIN + " --shard=1/1 --jobs={n}",
    "lab camera.toml --recipe lab.toml -o {out}/lab --seed={n}", "bench --list --device={n}",
    "design dyes -o {out}/d.h5 --truth={n}",
    "design dyes -o {out}/d.h5 --seed={n}", "design dyes -o {out}/d.h5 --jobs={n}",
    "calibrate curves_of.toml -o {out}/c.h5 --accept --jobs={n}", SIMULATE + " --scheduler=tcp://127.0.0.1:{n}",
)  # fmt: skip
VARIABLES = ("L3_MEGAPIXELS", "L3_DECODE_SECONDS", "L3_TRUST", "L3_DEVICE", "COLUMNS", "LINES")
RENDER_ONE = "render table.h5 frame.tif -o {out}/a.png --backend reference"
RECIPES = {  # each with a command that reads it, as {file}
    "camera.toml": "simulate drawn.toml --camera {file} -o {out}/t.h5",
    "scenes.toml": "simulate {file} --camera camera.toml -o {out}/t.h5",
    "classes.toml": "train training.h5 --classes {file} -o {out}/t.h5",
    "lab.toml": "lab camera.toml --recipe {file} -o {out}/lab",
    "table.toml": "calibrate {file} -o {out}/c.h5 --accept",
    "lab/MEASUREMENTS.toml": "calibrate {file} -o {out}/c.h5 --accept",
}
KEYS = {  # keys that the recipes above leave out
    "camera.toml": "[sensor] white_level_dn = 4000",
    "classes.toml": "[classes] saturation = 0.9 saturation_radius = 2 highest_level = 0.9 [learning] highlight_share = 0.25 "
    "highlight_from = 0.15 brightness_power = 0.5 error_power = 0.2 ridge = 1e-5 luminance_noise = 1 chroma_noise = 1 "
    "parent_patches = 20",
    "lab.toml": "[mono] trials = 1 stray_light = 0.0005 level = 0.5 radiance = 1e18 longest_exposure_s = 2.0 [chart] "
    "trials = 1 luminance = 500 level = 0.5 [white] luminance = 500 [defects] hot_current_e_per_s = 4000 "
    "dead_pixels_per_million = 10 dust_specks_per_million = 4 dust_depth = 0.03 dust_radius_px = 12 column_noise_e = 2",
    "lab/MEASUREMENTS.toml": "[uncertainty] lamp_drift = 0.01 wavelength_nm = 0.1",
}
TOML = ("1979-05-27", "1979-05-27T07:32:00Z", "07:32:00", "0x10", "1_000", "true", "[]", '"5"')
FIGURE = re.compile(r"(?<![\w\"])[-+]?\d[\d.]*(?:[eE][-+]?\d+)?(?![\w\"])")


@dataclass(frozen=True)
class Call:
    """A command that contains an awkward number, with its environment variables and its recipe."""

    command: str
    environment: tuple[tuple[str, str], ...] = ()
    name: str = ""
    text: str = ""

    def __str__(self) -> str:
        return "\n".join(filter(None, [self.command, *map("=".join, self.environment), self.name, self.text]))


@dataclass(frozen=True)
class Numbers:
    """Draws calls with an awkward number in an option, in a variable, or in one of the RECIPES."""

    name: str
    often: int = 3

    def draw(self, choices: Choices) -> Call:
        """Draw a call."""
        number = one_of(choices, NUMBERS)
        if self.name == "options":
            return Call(one_of(choices, OPTIONS).replace("{n}", number))
        if self.name == "environment":
            return Call(RENDER_ONE, ((one_of(choices, VARIABLES), number),))
        text = self.recipe()
        figure = one_of(choices, list(FIGURE.finditer(text)))
        new = one_of(choices, (number, one_of(choices, TOML)))
        return Call(RECIPES[self.name], name=self.name, text=text[: figure.start()] + new + text[figure.end() :])

    def recipe(self) -> str:
        """Return the recipe with every key that takes a number."""
        recipes = {"camera.toml": whole.CAMERA, "scenes.toml": whole.SCENES, "classes.toml": whole.CLASSES}
        recipes |= {"lab.toml": whole.LAB, "table.toml": whole.TABLE, "lab/MEASUREMENTS.toml": _MEASURED[0]}
        return with_keys(recipes[self.name], KEYS.get(self.name, ""))

    def judge(self, shop: Workshop, call: Call) -> str | None:
        """Return what went wrong, or None."""
        return judge(shop, call)


_MEASURED = [""]  # the measurement file of the workshop, once there is one


def with_keys(text: str, keys: str) -> str:
    """Add keys to the tables of a recipe. Missing tables are added too."""
    for table, assignments in re.findall(r"\[(\w+)\]((?: \w+ = \S+)*)", keys):
        lines = "\n".join(re.findall(r"\w+ = \S+", assignments)) + "\n"
        head = f"[{table}]\n"
        text = text.replace(head, head + lines, 1) if head in text else f"{text}\n{head}{lines}"
    return text


def judge(shop: Workshop, call: Call) -> str | None:
    """Call l3 and return what went wrong, or None."""
    path, out = shop.inputs / (call.name or "none"), shop.folder / "out"
    before = path.read_bytes() if call.name else b""
    if call.name:
        path.write_text(call.text, encoding="utf-8")
    words = [word.format(file=path, out=out) if "{" in word else word for word in _words(call.command)]
    try:
        with contextlib.chdir(shop.inputs), set_environment(call.environment):
            return hostile.verdict(words) or shop.strays(out)
    finally:
        if call.name:
            path.write_bytes(before)
        shutil.rmtree(out, ignore_errors=True)


def _words(command: str) -> list[str]:
    """Split a command at single spaces. An option may end with an empty word."""
    return re.split(r" (?=\S)", command)


@contextlib.contextmanager
def set_environment(variables: tuple[tuple[str, str], ...]) -> Iterator[None]:
    """Set environment variables for the duration of the block."""
    before = {name: os.environ.get(name) for name, _ in variables}
    os.environ.update(variables)
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value


def subjects(shop: Workshop) -> tuple[Numbers, ...]:
    """Return the sources of calls for a workshop."""
    _MEASURED[0] = (shop.inputs / "lab/MEASUREMENTS.toml").read_text()
    return (Numbers("options"), Numbers("environment", often=1), *(Numbers(name, often=1) for name in RECIPES))
