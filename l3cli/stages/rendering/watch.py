"""Rendering what arrives in a folder: whole files and folders of frames, each once, whenever the watch was begun."""

import stat
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NoReturn

from l3cli.errors import InputFileError, RecipeError
from l3cli.files import UNFINISHED
from l3cli.io.numbered import natural_order
from l3cli.io.raw.registry import BY_SUFFIX
from l3cli.ledger import close_ledger
from l3cli.stages.console import Console
from l3cli.stages.rendering.clips import ClipJob
from l3cli.stages.rendering.job_state import identity_of_clip

STATE = f".watched{UNFINISHED}"
KINDS = {stat.S_IFLNK: "link", stat.S_IFIFO: "pipe", stat.S_IFSOCK: "socket", stat.S_IFCHR: "device", stat.S_IFBLK: "device"}


def watch(job: ClipJob, folder: Path, every: float, sleep: Callable[[float], None] = time.sleep) -> NoReturn:
    """Render each file and each folder of frames that lies in a folder or arrives there, until interrupted. What stayed the
    same for `every` seconds is whole. What was rendered or has failed is not tried again unless it changes, nor by the
    next watch.

    InputFileError if the folder cannot be read, RecipeError if outputs would arrive in it, L3Error as by `ClipJob.run`.
    """
    here, there = folder.resolve(), job.folder.resolve()
    if here in (there, *there.parents) or there in here.parents:
        raise RecipeError(f"{job.folder} and {folder} lie in one another; name an output elsewhere")
    close_ledger()  # it would grow for ever; the state has all that is rendered
    arrivals = Arrivals(folder, job.console)
    arrivals.whole()
    with job.opened(STATE, take_over=not job.force):
        job.state.begin()
        job.console.say(f"{folder}: watched every {every:g} s; Ctrl-C ends it")
        while True:
            sleep(every)
            whole = arrivals.whole()
            job.state.keep_only(arrivals.paths)
            for path, identity in whole:
                entry = job.state.entry(path)
                if entry is None or entry.of != identity or not (entry.made or entry.error):
                    job.one(path, identity)


class Arrivals:
    """What lies in a folder."""

    def __init__(self, folder: Path, console: Console) -> None:
        self._folder, self._console = folder, console
        self._before: dict[Path, str] = {}  # identity of each at the last look, "" of what is never rendered
        self._told: set[Path] = set()  # of these what has been said

    @property
    def paths(self) -> list[Path]:
        """All that was there at the last look."""
        return list(self._before)

    def whole(self) -> list[tuple[Path, str]]:
        """What is as it was at the last look, in order, with its identity. Of what can be no clip a line is said once."""
        now, before = dict(self._look()), self._before
        self._before, self._told = now, self._told & now.keys()
        return [(path, identity) for path, identity in now.items() if identity and before.get(path) == identity]

    def _look(self) -> Iterator[tuple[Path, str]]:
        try:
            paths = sorted((path for path in self._folder.iterdir() if not path.name.startswith(".")), key=natural_order)
        except OSError as error:
            raise InputFileError(f"{self._folder} cannot be watched: {error.strerror}; name a folder") from error
        for path in paths:
            try:
                mode = path.lstat().st_mode
                if stat.S_ISDIR(mode) or (stat.S_ISREG(mode) and path.suffix.lower() in BY_SUFFIX):
                    yield path, identity_of_clip(path)
                else:
                    yield path, self._refused(path, KINDS.get(stat.S_IFMT(mode), "file of no raw format"))
            except OSError:  # gone since, or may not be read
                continue

    def _refused(self, path: Path, what: str) -> str:
        if path in self._before and path not in self._told:  # a file that is copied may get another name in the end
            self._told.add(path)
            self._console.alert(f"l3: {path} is a {what}; left out")
        return ""
