"""Checks that no command overwrites its inputs, whatever name is used for the output.

The output is an input under the same name, another spelling, or a link. Choices are drawn as in hostile_spoiling.py.
"""

import contextlib
import functools
import io
import os
import shutil
from dataclasses import dataclass
from pathlib import Path

from l3cli.cli import run
from tests.helpers.hostile import Workshop
from tests.helpers.hostile_spoiling import Choices, one_of

RENDER = "--backend reference --exposure 0.8"
COLD = "--scheduler tcp://127.0.0.1:1 --tls-ca other.json --tls-cert lab.toml --tls-key evaluation.json"  # no scheduler


@dataclass(frozen=True)
class Sentence:
    """A command that writes below {out}, the files it reads (globs), and the files it writes.

    If the written files are not stated, a run of the command shows them.
    """

    command: str
    reads: str
    recipe: str = ""  # text of recipe.toml
    writes: str = ""


def _scenes(source: str, name: str) -> str:
    ranged = "" if source in ("iset", "rgb", "envi") else "wavelength_range_nm = [400, 700, 50]\n"
    return f'exposure_share = [0.9]\nilluminants = ["lamp.csv"]\n[[scene]]\nsource = "{source}"\nfile = "{name}"\n{ranged}'


def _simulated(source: str, name: str, reads: str = "") -> Sentence:
    command = "simulate recipe.toml --camera camera.toml -o {out}/t.h5 --pictures {out}/p"
    return Sentence(command, f"recipe.toml camera.toml lamp.csv {reads or name}", _scenes(source, name))


def _rendered(name: str, output: str, more: str = "") -> Sentence:
    return Sentence(f"render table.h5 {name} -o {{out}}/{output} {RENDER} {more}", f"table.h5 {name}")


SENTENCES = (
    Sentence(
        "calibrate lab/MEASUREMENTS.toml -o {out}/camera.h5 --accept --truth curves.toml",
        "lab/MEASUREMENTS.toml lab/*/*.tif lab/spectra/*.csv curves.toml curves.csv",
    ),
    Sentence("calibrate table.toml -o {out}/camera.h5 --accept", "table.toml sweep.csv diode.csv"),
    Sentence("calibrate curves_of.toml -o {out}/camera.h5 --accept", "curves_of.toml curves.json"),
    Sentence("export curves.toml -o {out}", "curves.toml curves.csv"),
    Sentence(
        "simulate scenes.toml --camera curves.toml -o {out}/t.h5 --pictures {out}/p --dng {out}/d",
        "scenes.toml lamp.csv picture.png frame.tif curves.toml curves.csv",
    ),
    Sentence("simulate drawn.toml --camera camera.h5 -o {out}/t.h5 --resume", "drawn.toml camera.h5"),
    _simulated("iset", "scene.mat"),
    _simulated("rgb", "picture.jpg"),
    _simulated("bands", "bands", "bands/*.png"),
    _simulated("envi", "cube.hdr", "cube.hdr cube.img"),
    _simulated("cube", "cube.npy"),
    _simulated("cube", "cube.h5"),
    _simulated("channels", "channels.exr"),
    Sentence("train training.h5 --classes classes.toml -o {out}/t.h5", "training.h5 classes.toml"),
    Sentence("train training.h5 --classes classes.toml --shard 1/2 -o {out}/s.h5", "training.h5 classes.toml"),
    Sentence("train --merge sums.h5 -o {out}/t.h5", "sums.h5"),
    Sentence(f"train training.h5 -o {{out}}/t.h5 {COLD}", "training.h5 lab.toml *.json", writes="t.h5"),
    *(_rendered(f"frame.{suffix}", "a.png") for suffix in ("npy", "tif", "png", "dng", "pgm", "fits")),
    _rendered("frame.raw", "a.tif", "--size 20x24"),
    _rendered("frame.tif", "p_%02d.tif"),
    _rendered("bands/*.png", "out", "--skip-bad --format png --size 18x20"),
    *(_rendered("stack.npy", output) for output in ("%d.png", "pictures", "a.y4m", "a.mkv")),
    _rendered("frame.h5", "a.mp4"),
    *(_rendered("frame.mkv", output) for output in ("%d.jpg", "pictures", "b.mkv", "b.mov")),
    Sentence("evaluate table.h5 training.h5 --backend reference --pictures {out}/p", "table.h5 training.h5"),
    Sentence("report camera.h5 training.h5 table.h5 --backend reference -o {out}/r.html", "camera.h5 training.h5 table.h5"),
    Sentence("compare evaluation.json other.json --figure psnr -o {out}/c.html", "evaluation.json other.json"),
    Sentence(
        "check curves.toml scenes.toml lab/MEASUREMENTS.toml --plot {out}/c.html",
        "curves.toml curves.csv scenes.toml lamp.csv picture.png frame.tif lab/MEASUREMENTS.toml lab/*/*.tif",
    ),
    Sentence("lab curves.toml --recipe lab.toml -o {out}", "curves.toml curves.csv lab.toml"),
)
DISGUISES = ("its name", "another spelling", "a linked folder", "a symbolic link", "a link to a link", "a hard link")


class Identities:
    """Commands in a workshop whose outputs are made identical to inputs."""

    def __init__(self, shop: Workshop) -> None:
        self._inputs, self._out = shop.inputs, shop.folder / "out"
        self._written = functools.cache(self._write)

    def judge(self, choices: Choices) -> str | None:
        """Make an output of a command one of its inputs, and return what went wrong, or None."""
        sentence = one_of(choices, SENTENCES)
        with contextlib.chdir(self._inputs):
            before = (self._inputs / "recipe.toml").read_bytes()
            if sentence.recipe:
                (self._inputs / "recipe.toml").write_text(sentence.recipe)
            try:
                return self._judge(sentence, choices)
            finally:
                (self._inputs / "recipe.toml").write_bytes(before)
                shutil.rmtree(self._out, ignore_errors=True)

    def _judge(self, sentence: Sentence, choices: Choices) -> str | None:
        written = one_of(choices, self._written(sentence))
        source = one_of(choices, [path for glob in sentence.reads.split() for path in sorted(Path().glob(glob))])
        disguise = one_of(choices, DISGUISES)
        arguments = self._disguised(sentence, written, source, disguise)
        stored, placed = self._contents(), sorted(self._out.rglob("*"))
        code, answer = _called([*arguments, "--force"] if "--force" not in arguments else arguments)
        call = f"{' '.join(arguments)} --force, where {written} is {source} by {disguise}: exit code {code}: {answer}"
        changed = [str(path) for path, content in self._contents().items() if stored.get(path) != content]
        if changed or len(stored) != len(self._contents()):
            return f"{call}changed {changed}"
        if code not in (1, 2, 3) or answer.count("\n") != 1:
            return call
        return f"{call}left {sorted(self._out.rglob('*'))}" if sorted(self._out.rglob("*")) != placed else None

    def _disguised(self, sentence: Sentence, written: str, source: Path, disguise: str) -> list[str]:
        """Return the command with `written` replaced by `source` under a disguise.

        The path on the command line names the input if it can. Otherwise a link at the output's path does.
        """
        words = sentence.command.format(out=self._out).split()
        place = self._out / written
        place.parent.mkdir(parents=True, exist_ok=True)
        typed = {
            DISGUISES[0]: source,
            DISGUISES[1]: self._inputs / "lab" / ".." / source,
            DISGUISES[2]: self._out / "linked" / source,
        }
        if disguise in typed and str(place) in words:
            if disguise == DISGUISES[2]:
                (self._out / "linked").symlink_to(self._inputs)
            return [str(typed[disguise]) if word == str(place) else word for word in words]
        if disguise == DISGUISES[4]:
            (self._out / "link").symlink_to(source.absolute())
            place.symlink_to(self._out / "link")
        elif disguise == DISGUISES[5]:
            os.link(source, place)
        else:
            place.symlink_to(source.absolute())
        return words

    def _write(self, sentence: Sentence) -> list[str]:
        """Return the files that an undisturbed run writes, relative to {out}."""
        if sentence.writes:
            return sentence.writes.split()
        code, answer = _called(sentence.command.format(out=self._out).split())
        assert code == 0, (sentence.command, answer)
        written = sorted(str(path.relative_to(self._out)) for path in self._out.rglob("*") if path.is_file())
        shutil.rmtree(self._out)
        return written

    def _contents(self) -> dict[Path, bytes]:
        return {path: path.read_bytes() for path in self._inputs.rglob("*") if path.is_file()}


def _called(arguments: list[str]) -> tuple[int, str]:
    with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()) as stderr:
        code = run(arguments)
    return code, "".join(line + "\n" for line in stderr.getvalue().splitlines() if line.startswith("l3: "))
