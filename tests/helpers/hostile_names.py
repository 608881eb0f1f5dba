"""Runs the pipelines of `l3 init` with hostile file and folder names.

No part of a name may be executed. A name must reach l3 unchanged or be refused. Choices are drawn as in hostile_spoiling.py.
"""

import json
import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

from l3cli.recipes.builtin import folder_files, recipe_folder
from l3cli.recipes.toml import toml_value
from tests.helpers.hostile_spoiling import Choices, one_of
from tests.helpers.workplace import PATH, SBATCH

RAN = "PWNED"  # the file that a name makes if a shell executes the name
PIECES = (
    f"`touch {RAN}`", f"$(touch {RAN})", f"$(shell touch {RAN})", f"${{shell touch {RAN}}}", f"$(file >{RAN})",
    f";touch {RAN};", f"|touch {RAN}|", f"&touch {RAN}&", f"\ntouch {RAN}\n", f"\n\ttouch {RAN}\n", f">{RAN}",
    f"' ;touch {RAN};'", "#", " ", "\t", "'", '"', "%", "%04d", "*", "[a]", "?", "~", "\\", ":", "=", "{x}", "{{", "-",
    "--force", "ü", "漢", "\u202e", "\x1b[31m", "\udcff", "$", "$$", "!", "<", ",", "plain",
)  # fmt: skip
PIPELINES = ("make", "slurm", "snakemake")
PLACES = {"make": ("folder", "curves", "clip", "camera", "measurements"), "slurm": ("folder", "curves", "camera"),
          "snakemake": ("folder", "curves", "camera", "measurements")}  # fmt: skip
# A fake l3 that records its arguments and writes empty outputs.
L3 = """#!{python} -IS
import json, os, sys
words = sys.argv[1:]
with open({notes!r}, "a") as notes:
    notes.write(json.dumps(words) + "\\n")
made = [words[at + 1] for at, word in enumerate(words[:-1]) if word == "-o"]
if words[0] == "lab":
    made = [made[0] + "/MEASUREMENTS.toml"]
if "--pictures" in words:
    made.append(words[words.index("--pictures") + 1] + "/00000_a_raw.tif")
    made.append(words[words.index("--pictures") + 1] + "/00000_a_ideal.png")
for path in made if "videos" not in made else []:
    os.makedirs(os.path.dirname(path) or ".", exist_ok=True)
    open(path, "w").close()
if words[0] == "check":
    print('"sha256": "00"')
"""


def hostile_name(choices: Choices) -> str:
    """Draw a valid file name with characters that shells, make or Snakemake interpret."""
    return "".join(one_of(choices, PIECES) for _ in range(choices.integer(1, 4)))


class Pipelines:
    """The pipelines of a camera, in subfolders of `folder`."""

    def __init__(self, folder: Path) -> None:
        self._folder, self._bin, self._notes = folder, folder / "bin", folder / "notes"
        (self._bin / "jobs").mkdir(parents=True)
        for name, text in {"l3": L3, "sbatch": SBATCH}.items():
            written = text.format(python=sys.executable, notes=str(self._notes), jobs=str(self._bin / "jobs"))
            (self._bin / name).write_text(written)
            (self._bin / name).chmod(0o755)

    @property
    def pipelines(self) -> tuple[str, ...]:
        """The pipelines whose programs are installed."""
        return tuple(each for each in PIPELINES if each != "snakemake" or shutil.which(each, path=PATH))

    def judge(self, choices: Choices) -> str | None:
        """Run a pipeline with a hostile name, and return what went wrong, or None."""
        pipeline = one_of(choices, self.pipelines)
        return self.judge_name(pipeline, one_of(choices, PLACES[pipeline]), hostile_name(choices))

    def judge_name(self, pipeline: str, place: str, name: str) -> str | None:
        """Run a given pipeline with a given name in a given place, and return what went wrong, or None."""
        with tempfile.TemporaryDirectory(dir=self._folder) as outer:
            folder = Path(outer, name if place == "folder" else "folder")
            folder.mkdir()
            for each, origin in folder_files(recipe_folder() / "cameras/bayer.toml").items():
                shutil.copy(origin, folder / each)
            named = f"{name}.toml" if place in ("camera", "measurements") else name
            if place == "curves":
                with (folder / "camera.toml").open("a") as recipe:
                    recipe.write(f"[more]\nfile = {toml_value(name)}\nbase = {toml_value(name)}\n")
            elif place != "folder":
                (folder / "clips").mkdir()
                (folder / ("clips" if place == "clip" else "") / named).touch()
            self._notes.write_text("")
            ended = self._run(pipeline, place, named, folder)
            calls = [json.loads(line) for line in self._notes.read_text().splitlines()]
            answer = f"{pipeline} with the {place} {name!r}: exit code {ended.returncode}: {ended.stderr or ended.stdout}"
            if list(Path(outer).rglob(RAN)):
                return f"{answer}: it was run"
            if ended.returncode:
                refused = "rename the " in ended.stderr + ended.stdout and not any(words[0] != "check" for words in calls)
                return None if refused else answer
            arrived = f"clips/{named}" if place == "clip" else named
            if place not in ("folder", "curves") and not any(arrived in words for words in calls):
                return f"{answer}: {arrived!r} is in none of {calls}"
        return None

    def _run(self, pipeline: str, place: str, name: str, folder: Path) -> subprocess.CompletedProcess:
        environment = {key: value for key, value in os.environ.items() if key not in ("MAKEFLAGS", "MAKELEVEL")}
        environment |= {"PATH": f"{self._bin}:{PATH}"}
        if place in ("camera", "measurements") and pipeline != "snakemake":
            environment |= {place.upper(): name}
        command = {"make": ["make", "video" if place == "clip" else "all"], "slurm": ["./slurm.sh", "1"]}.get(pipeline)
        if command is None:
            (folder / "config.json").write_text(json.dumps({"shards": 1, place: name}))
            command = ["snakemake", "--cores", "1", "--quiet", "progress", "--configfile", "config.json"]
        return subprocess.run(
            command, cwd=folder, env=environment, text=True, errors="replace", capture_output=True, check=False, timeout=600,
        )  # fmt: skip
