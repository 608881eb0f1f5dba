"""Runs of `l3 render` that are stopped and resumed."""

import itertools
import os
from pathlib import Path
from typing import Any

import pytest

from l3cli.io import destination
from tests.helpers.calls import L3, Refused
from tests.helpers.sequences import FAST


class Runs:
    """Runs of `l3 render table.h5 frames/ -o out` in one folder. A run can be stopped early."""

    def __init__(self, l3: L3, refused: Refused, patch: pytest.MonkeyPatch, folder: Path) -> None:
        self._l3, self._refused, self._patch, self.folder = l3, refused, patch, folder
        self.frames, self.out = folder / "frames", folder / "out"

    def call(self, *options: object, out: str = "out", source: object = None, table: str = "table.h5") -> tuple:
        inputs = source if isinstance(source, list) else [source or self.frames]
        exposure = () if "--exposure" in options else ("--exposure", 0.8)
        return "render", self.folder / table, *inputs, *exposure, *options, *FAST, "-o", self.folder / out

    def __call__(self, *options: object, **others: Any) -> tuple[int, str, str]:
        return self._l3(*self.call(*options, **others))

    def refused(self, code: int, *options: object, **others: Any) -> str:
        return self._refused(code, *self.call(*options, **others))

    def stop(self, after: int, *options: object, **others: Any) -> None:
        """Run a call and kill it after `after` finished pictures or videos, before the next picture gets its final name."""

        class Killed(BaseException):
            pass

        rename, named = os.replace, itertools.count(1)

        def renamed(source: Path, path: Path) -> None:
            if path.suffix in (".png", ".mkv") and next(named) > after:
                raise Killed
            rename(source, path)

        with self._patch.context() as patch:
            patch.setattr(destination, "PICTURE_WRITERS", 1)
            patch.setattr(os, "replace", renamed)
            with pytest.raises(Killed):
                self(*options, **others)

    def require_whole(self, *options: object, **others: Any) -> None:
        """Assert that out/ contains exactly the files of an uninterrupted run."""
        assert self(*options, **others, out="whole") == (0, "", "")
        assert self.made("out") == self.made("whole")

    def made(self, out: str = "out") -> dict[str, bytes]:
        return {path.name: path.read_bytes() for path in sorted((self.folder / out).glob("[!.]*"))}
