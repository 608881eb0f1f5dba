"""`l3 render --deflicker`: all pictures of a scene with a flickering lamp have equal brightness."""

import itertools
import os
from pathlib import Path

import numpy as np
import pytest

from l3cli.artifacts.store import load
from l3cli.artifacts.table import TransformTable
from l3cli.io.images import read_image
from tests.helpers.calls import L3, Refused

COUNT, RATE = 24, 30
RUN = ("--format", "tif", "--bits", "16", "--fps", RATE, "--backend", "reference")
FLICKER = 1 + 0.0806 * np.sin(2 * np.pi * 100 / RATE * np.arange(COUNT) + 1)  # 5.7 % RMS


def write_clip(path: Path, table: TransformTable, light: np.ndarray) -> Path:
    """A still scene of plain patches, seen by the camera of a table."""
    rng = np.random.default_rng(0)
    scene = rng.uniform(0.05, 0.4, (6, 8)).repeat(8, 0).repeat(8, 1)
    mosaic = table.black_level + (table.white_level - table.black_level) * scene * light[:, None, None]
    np.save(path, np.rint(mosaic + rng.normal(0, 1, mosaic.shape)).clip(0, table.white_level).astype(np.uint16))
    return path


def brightness(folder: Path) -> np.ndarray:
    """Log of the mean linear value of each picture."""
    codes = [read_image(path)[0] / 65535 for path in sorted(folder.glob("*.tif"))]
    return np.array(
        [np.log(np.where(code <= 0.04045, code / 12.92, ((code + 0.055) / 1.055) ** 2.4).mean()) for code in codes]
    )


def test_flicker_goes_and_a_change_of_light_stays(pipeline: Path, tmp_path: Path, l3: L3) -> None:
    table = pipeline / "table.h5"
    step = np.where(np.arange(COUNT) < 12, 1.0, 1.5)
    clip = write_clip(tmp_path / "clip.npy", load(TransformTable, table), FLICKER * step)
    assert l3("render", table, clip, "-o", tmp_path / "out", "--exposure", 0.4, "--deflicker", *RUN)[0] == 0
    change = np.diff(brightness(tmp_path / "out"))
    assert np.delete(change, 11).std() < 0.005
    assert change[11] == pytest.approx(np.log(1.5), rel=0.05)


def test_parts_and_stopped_runs_give_the_same_bytes(pipeline: Path, tmp_path: Path, l3: L3) -> None:
    table = pipeline / "table.h5"
    clip = write_clip(tmp_path / "clip.npy", load(TransformTable, table), FLICKER)
    for part in (["all"], ["2/3"], ["1/3"], ["3/3"]):
        shard = () if part == ["all"] else ("--shard", *part)
        folder = tmp_path / ("whole" if part == ["all"] else "parts")
        code, _, told = l3("render", table, clip, "-o", folder, "--deflicker", *shard, *RUN)
        assert code == 0
        assert "100 Hz" in told
    whole = {path.name: path.read_bytes() for path in (tmp_path / "whole").glob("*.tif")}
    assert len(whole) == COUNT
    assert whole == {path.name: path.read_bytes() for path in (tmp_path / "parts").glob("*.tif")}
    assert brightness(tmp_path / "whole").std() < 0.005


def test_what_has_no_exposure_in_time_is_refused(table: Path, folder: Path, tmp_path: Path, refused: Refused) -> None:
    stills = sorted(folder.iterdir())[:2]
    assert "--deflicker" in refused(2, "render", table, *stills, "-o", tmp_path / "out", "--deflicker")
    assert "--deflicker" in refused(2, "render", table, folder, "-o", tmp_path / "out", "--format", "exr", "--deflicker")


def test_a_resumed_run_gives_the_same_bytes(pipeline: Path, tmp_path: Path, l3: L3, monkeypatch: pytest.MonkeyPatch) -> None:
    table = pipeline / "table.h5"
    clip = write_clip(tmp_path / "clip.npy", load(TransformTable, table), FLICKER)
    call = ("render", table, clip, "--deflicker", *RUN)
    assert l3(*call, "-o", tmp_path / "whole")[0] == 0
    rename, named = os.replace, itertools.count(1)

    def stopped(source: Path, path: Path) -> None:
        if path.suffix == ".tif" and next(named) > 9:
            raise KeyboardInterrupt
        rename(source, path)

    with monkeypatch.context() as patch:
        patch.setattr(os, "replace", stopped)
        assert l3(*call, "-o", tmp_path / "out")[0] != 0
    assert 0 < len(list((tmp_path / "out").glob("*.tif"))) < COUNT
    assert l3(*call, "-o", tmp_path / "out", "--resume")[0] == 0
    whole, resumed = (
        {path.name: path.read_bytes() for path in (tmp_path / name).glob("*.tif")} for name in ("whole", "out")
    )
    assert len(whole) == COUNT
    assert resumed == whole
