"""Mistakes about raw files that l3 render cannot be sure of: pictures are made, and one line says what may be wrong."""

import dataclasses
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from l3cli.artifacts.camera import CameraModel
from l3cli.artifacts.store import save
from tests.helpers.tables import colorimetric_table

SHAPE = (64, 100)


@pytest.fixture
def table(bayer: CameraModel, tmp_path: Path) -> Path:
    save(dataclasses.replace(colorimetric_table(bayer), exposure=0.02), tmp_path / "table.h5")
    return tmp_path / "table.h5"


def test_one_line_of_each(l3: Callable, table: Path, bayer: CameraModel, tmp_path: Path) -> None:
    row, col = np.indices(SHAPE)
    light = (0.4 + 0.3 * np.sin(col / 8) + 0.2 * np.cos(row / 30)) * (bayer.white_level - bayer.black_level)
    values = np.rint(bayer.black_level + light).astype("<u2")
    values.tofile(tmp_path / "a.raw")
    values.byteswap().tofile(tmp_path / "b.raw")
    right, exchanged = "{}x{}".format(*SHAPE), "{1}x{0}".format(*SHAPE)

    def warnings(name: str, *options: object) -> list[str]:
        call = ("render", table, tmp_path / name, "-o", tmp_path / "a.png", "--backend", "reference", "--force", *options)
        code, _, err = l3(*call)
        assert code == 0
        return [line for line in err.splitlines() if "classes" not in line and "clipped" not in line]

    timed = ("--exposure-time", 0.02)
    assert warnings("a.raw", "--size", right, *timed) == []
    (torn,) = warnings("a.raw", "--size", exchanged, *timed)
    assert torn.endswith(f"give --size {right}: rows first, then columns")
    (swapped,) = warnings("b.raw", "--size", right, *timed)
    assert "bytes of its values are exchanged" in swapped
    (long,) = warnings("a.raw", "--size", right, "--exposure-time", 20)
    assert long.startswith("warning: --exposure-time 20 is 20 seconds, 1000 times that of the training (0.02 s)")
    assert long.endswith("give seconds, not milliseconds")
