"""A short sequence of small mosaics and a table for it, with functions that write the frames and read rendered pictures."""

import dataclasses
from collections.abc import Sequence
from fractions import Fraction
from pathlib import Path

import av
import h5py
import numpy as np
import pytest
import tifffile

from l3cli.artifacts.table import TransformTable
from l3cli.frames.frame import RawFrame
from l3cli.io.images import read_image
from l3cli.io.pictures.openimageio import write_mosaic
from l3cli.rendering.temporal.chunks import Chunks
from tests.helpers.cameras import BAYER, random_camera
from tests.helpers.tables import random_table

RGGB = dataclasses.replace(random_table(BAYER, bits=12, black_level=64.0), camera_name="RGGB", rows=20, cols=28)
COUNT = 5
RUN = "import sys; from l3cli.cli import run; sys.exit(run(sys.argv[1:]))"
FAST = ("--backend", "reference", "--quiet")


def frames(count: int = COUNT) -> np.ndarray:
    """Return mosaics (frame, row, col) of increasing brightness."""
    rng = np.random.default_rng(0)
    light = np.linspace(0.4, 0.9, count)[:, None, None]
    return np.clip(64 + 4031 * light * rng.uniform(0.3, 1, (count, RGGB.rows, RGGB.cols)), 0, 4095).astype(np.uint16)


def with_row_noise() -> tuple[TransformTable, np.ndarray]:
    """Return the table of a camera with row noise, and mosaics (frame, row, col) of a still scene with this noise."""
    rng, rows, cols = np.random.default_rng(1), 20, 192
    camera = random_camera(BAYER, 3, 12, RGGB.black_level)
    noise = dataclasses.replace(camera.noise, row_temporal_noise=camera.noise.read_noise)
    camera = dataclasses.replace(camera, noise=noise, rows=rows, cols=cols)
    electrons = rng.poisson(400.0, (COUNT, rows, cols)) + rng.normal(0, noise.row_temporal_noise, (COUNT, rows, 1))
    values = np.rint(camera.gain * electrons + camera.black_level).astype(np.uint16)
    return dataclasses.replace(RGGB, camera=camera, rows=rows, cols=cols), values


def write_frames(folder: Path) -> Path:
    """Write frame_07.tif to frame_11.tif."""
    folder.mkdir()
    for number, mosaic in enumerate(frames(), 7):
        write_mosaic(folder / f"frame_{number:02d}.tif", mosaic)
    return folder


def write_stack(path: Path, mosaics: np.ndarray | None = None) -> Path:
    """Write `frames()`, or other mosaics (frame, row, col), in the format given by the file's suffix."""
    mosaics = frames() if mosaics is None else mosaics
    if path.suffix == ".npy":
        np.save(path, mosaics)
    elif path.suffix == ".raw":
        mosaics.astype("<u2").tofile(path)
    elif path.suffix == ".fits":
        from astropy.io import fits  # not installed in the tests of the VapourSynth filter

        fits.PrimaryHDU(mosaics).writeto(path)
    elif path.suffix == ".tif":
        tifffile.imwrite(path, mosaics, photometric="minisblack")
    else:
        with h5py.File(path, "w") as root:
            root.create_dataset("take/raw", data=mosaics, chunks=(1, 20, 28), maxshape=(None, 20, 28), compression="gzip")
            root["take/other"] = frames(1)[0]
    return path


def pictures(folder: Path, pattern: str = "*.png") -> dict[str, np.ndarray]:
    return {path.name: read_image(path)[0] for path in sorted(folder.glob(pattern))}


def write_raw_video(
    path: Path, pixels: str = "gray12le", rate: int = 24, group: int = 1, mosaics: np.ndarray | None = None,
    times: Sequence[int] | None = None,
) -> Path:  # fmt: skip
    """Write a raw video. `times` are the frame times in ms; if None, frames have a constant rate."""
    mosaics = frames() if mosaics is None else mosaics
    with av.open(str(path), "w") as video:
        options = {"level": "3", "slicecrc": "1", "slices": "4", "g": str(group)}
        stream = video.add_stream("ffv1", rate=rate, options=options)
        stream.height, stream.width, stream.pix_fmt = *mosaics.shape[1:], pixels
        if times is not None:
            stream.codec_context.time_base = Fraction(1, 1000)
        for number, mosaic in enumerate(mosaics):
            values = (mosaic >> 4).astype(np.uint8) if pixels == "gray" else mosaic
            frame = av.VideoFrame.from_ndarray(values, format=pixels)
            if times is not None:
                frame.pts, frame.time_base = times[number], Fraction(1, 1000)
            video.mux(stream.encode(frame))
        video.mux(stream.encode())
    return path


def filtered_places(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Return a list to which the index of each temporally filtered frame is added from now on."""
    taken: list[int] = []
    filtered = Chunks.filtered

    def counted(chunks: Chunks, place: int, frame: RawFrame) -> RawFrame:
        taken.append(place)
        return filtered(chunks, place, frame)

    monkeypatch.setattr(Chunks, "filtered", counted)
    return taken
