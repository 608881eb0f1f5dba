"""Puts pipes, sockets, devices, folders and broken links in places where a file is read or written.

A call must end with one line and an exit code from docs/guarantees.md. It must not wait for a writer of a pipe.
"""

import contextlib
import os
import shutil
import socket
from dataclasses import dataclass
from pathlib import Path

from tests.helpers import hostile
from tests.helpers.hostile import SUBJECTS, Workshop
from tests.helpers.hostile_inputs import DRAWN
from tests.helpers.hostile_spoiling import Choices, one_of

OUTPUTS = (
    "render table.h5 frame.npy -o {file}.png --backend reference --force",
    "render table.h5 stack.npy -o {file}.mp4 --backend reference --force",
    "render table.h5 stack.npy -o {file} --backend reference --force",
    "train training.h5 --classes classes.toml -o {file} --force",
    "simulate drawn.toml --camera camera.toml -o {out}/t.h5 --pictures {file}",
    "calibrate curves_of.toml -o {file} --accept --force",
    "compare evaluation.json other.json --figure psnr -o {file}.html --force",
    "lab camera.toml --recipe lab.toml -o {file}",
)
MORE = (  # inputs that no subject of hostile.py is
    "info --verify table.h5 {file}", "info {file} --json", "lab {file} -o {out}/lab", "train training.h5 --first {file} "
    "--shard 1/1 -o {out}/t.h5", "calibrate curves_of.toml --truth {file} -o {out}/c.h5 --accept",
    "lab camera.toml --recipe {file} -o {out}/lab", "render {file} frame.npy -o {out}/a.png --backend reference",
    "render table.h5 frame.npy {file} -o {out}/p --backend reference", "compare {file} other.json",
    "evaluate {file} training.h5 --backend reference", "simulate {file} --camera camera.toml -o {out}/t.h5",
    "simulate drawn.toml --camera camera.toml -o {out}/t.h5 --scheduler tls://127.0.0.1:9 --tls-ca {file} --tls-cert {file} "
    "--tls-key {file}",
)  # fmt: skip
SUFFIXES = ("", ".h5", ".toml", ".npy", ".dng", ".tif", ".raw", ".mkv", ".fits", ".pgm", ".json", ".mat", ".png", ".exr")


def _socket(path: Path) -> None:
    folder = os.open(path.parent, os.O_RDONLY)  # names of sockets are short
    with socket.socket(socket.AF_UNIX) as one, contextlib.chdir(path.parent):
        one.bind(path.name)
    os.close(folder)


def _unreadable(path: Path) -> None:
    path.write_bytes(b"secret")
    path.chmod(0)


def _remove(path: Path) -> None:
    if os.path.isdir(path) and not os.path.islink(path):  # which know broken links
        shutil.rmtree(path)
    else:
        path.unlink(missing_ok=True)


PLACES = {
    "pipe": os.mkfifo,
    "socket": _socket,
    "endless": lambda path: path.symlink_to("/dev/zero"),
    "nothing": lambda path: path.symlink_to("/dev/null"),
    "terminal": lambda path: path.symlink_to("/dev/tty"),
    "folder": lambda path: path.mkdir(),
    "dangling": lambda path: path.symlink_to("nowhere/at/all"),
    "loop": lambda path: path.symlink_to(path.name),
    "behind a file": lambda path: path.symlink_to("camera.toml/more"),
    "endless name": lambda path: path.symlink_to("x" * 300),
    "unreadable": _unreadable,
}
READABLE = ("unreadable",) if os.geteuid() == 0 else ()  # what is an ordinary file for root
REFUSED = (1, 2, 3)


@dataclass(frozen=True)
class Trial:
    """A special file in place of a regular file, and the command that meets it."""

    place: str
    name: str  # of the file, below the inputs
    command: str
    text: str = ""  # of recipe.toml
    is_output: bool = False

    def __str__(self) -> str:
        return f"{self.place} as {self.name}: {self.command}\n{self.text}"


@dataclass(frozen=True)
class SpecialFiles:
    """Draws special files in place of an input or an output, and runs commands on them."""

    name: str = "special files"
    often: int = 3

    def draw(self, choices: Choices) -> Trial:
        """Draw a trial."""
        place = one_of(choices, list(PLACES))
        kind = choices.integer(0, 3)
        if kind <= 1:
            subject = one_of(choices, SUBJECTS)
            return Trial(place, subject.name, one_of(choices, subject.commands), subject.text)
        if kind == 2:
            return Trial(place, "special" + one_of(choices, SUFFIXES), one_of(choices, MORE))
        command = one_of(choices, OUTPUTS)
        suffix = next((suffix for suffix in (".png", ".mp4", ".html") if "{file}" + suffix in command), "")
        return Trial(place, "special" + suffix, command.replace("{file}" + suffix, "{file}"), is_output=True)

    def judge(self, shop: Workshop, trial: Trial) -> str | None:
        """Return what went wrong, or None."""
        path, out = shop.inputs / trial.name, shop.folder / "out"
        (shop.inputs / "recipe.toml").write_text(trial.text or DRAWN)
        if trial.name in shop.whole:
            path.unlink()
        PLACES[trial.place](path)
        known = shop.files()
        words = [word.format(file=path, out=out) if "{" in word else word for word in trial.command.split()]
        try:
            with contextlib.chdir(shop.inputs):
                codes = (0, *REFUSED) if trial.is_output or trial.place in READABLE else REFUSED
                verdict = hostile.verdict(words, hostile.HANGS, codes)
            return verdict or (None if trial.is_output else shop.strays(out, known))
        finally:
            self._clear(shop, path, known, trial)
            shutil.rmtree(out, ignore_errors=True)

    def _clear(self, shop: Workshop, path: Path, known: set[Path], trial: Trial) -> None:
        for new in sorted(shop.files() - known, reverse=True):  # what was written through a link, or beside it
            _remove(new)
        _remove(path)
        if trial.name in shop.whole:
            path.write_bytes(shop.whole[trial.name])
        (shop.inputs / "recipe.toml").write_bytes(shop.recipe)
