"""Checkpoints of runs."""

import hashlib
import json
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

from l3cli import __version__
from l3cli.io.sequences import frame_files
from l3cli.options.option import Options
from l3cli.system.files import sha256


def run_key(options: Options, *facts: Any, files: Callable[[Path], Iterable[Path]] = frame_files) -> str:
    """Return what tells a run from others: a digest of all that the bytes of its outputs depend on, the options with the
    `files` that they name, and `facts` about its inputs."""
    inputs = {
        name: [sha256(file) for path in paths for file in files(path)] for name, paths in options.inputs(all=False).items()
    }
    about = [__version__, options.chosen(), inputs, *facts]
    return hashlib.sha256(json.dumps(about, sort_keys=True, default=str).encode()).hexdigest()
