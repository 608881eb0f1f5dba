"""Inputs of the tests of several commands: table files, frames of a sequence, a mosaic, a browser."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from l3cli.artifacts.store import save
from l3cli.calibration.draft import sorting
from l3cli.calibration.photo import responsivity
from l3cli.rendering.white import source
from tests.helpers import raw_files, sequences, still_scene
from tests.helpers.browser import CHROMIUM, Browser
from tests.helpers.charts import small_charts
from tests.helpers.photos import locating_once

__all__ = ["small_charts"]  # an autouse fixture of all tests in this folder


@pytest.fixture(autouse=True, scope="session")
def charts_located_once() -> Iterator[None]:
    """Each image is searched for a chart only once, because the search is slow."""
    with pytest.MonkeyPatch.context() as patch:
        for module in (responsivity, sorting, source):
            patch.setattr(module, "locate", locating_once())
        yield


@pytest.fixture
def table(tmp_path: Path) -> Path:
    """The table file of the short sequence (tests.helpers.sequences)."""
    save(sequences.RGGB, tmp_path / "table.h5")
    return tmp_path / "table.h5"


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """The frames of the short sequence: frame_07.tif to frame_11.tif."""
    return sequences.write_frames(tmp_path / "frames")


@pytest.fixture
def still_table(tmp_path: Path) -> Path:
    """The table file of the still scene (tests.helpers.still_scene)."""
    save(still_scene.TABLE, tmp_path / "table.h5")
    return tmp_path / "table.h5"


@pytest.fixture
def still_frames(tmp_path: Path) -> Path:
    """The frames of the still scene: frame_0.tif to frame_8.tif."""
    return still_scene.write_frames(tmp_path / "frames")


@pytest.fixture
def raw_table(tmp_path: Path) -> Path:
    """The table file of tests.helpers.raw_files."""
    save(raw_files.RGGB, tmp_path / "table.h5")
    return tmp_path / "table.h5"


@pytest.fixture
def mosaic() -> np.ndarray:
    """A random 12-bit mosaic (row, col) of the size that `raw_table` expects."""
    shape = raw_files.RGGB.rows, raw_files.RGGB.cols
    return np.random.default_rng(0).integers(0, 4096, shape).astype(np.uint16)


@pytest.fixture(scope="session")
def tab() -> Iterator[Browser]:
    """A browser tab that all tests share."""
    if CHROMIUM is None:
        pytest.skip("no Chromium here; .ci/run installs it")
    with Browser() as browser:
        yield browser
