"""Training sets whose targets are a known mixture of the channels, so that the best table is known."""

from pathlib import Path

import numpy as np

from l3cli.artifacts.camera import CameraModel
from l3cli.artifacts.training_set import TrainingFrame, TrainingSet, write_training_set
from tests.helpers.calls import L3

MIX = np.array([[0.4, 0.2, 0.1], [0.2, 0.7, 0.1], [0.0, 0.1, 0.9]])  # XYZ of red, green and blue


def a_frame(camera: CameraModel, seed: int, smooth: bool, size: tuple[int, int] = (48, 56)) -> TrainingFrame:
    """Return a frame whose target is MIX times its channels, in units of the table."""
    rng = np.random.default_rng(seed)
    shape = (3, 1, 1) if smooth else (3, *size)
    share = np.broadcast_to(rng.random(shape) * 0.7 + 0.1, (3, *size)).astype(np.float32)
    target = np.einsum("oc,crk->ork", MIX, share) * camera.saturation_exposure / 0.01
    return TrainingFrame(
        electrons=(share * camera.full_scale).astype(np.float32),
        raw=np.zeros(size, np.uint16),
        target=target.astype(np.float32),
        white=np.array([95.0, 100.0, 109.0]),
        scene=f"frame {seed}",
        illuminant="D65",
        luminance=100.0,
        exposure=0.01,
        seed=(0, seed),
    )


def a_set(
    path: Path,
    camera: CameraModel,
    count: int,
    smooth: bool = True,
    size: tuple[int, int] = (48, 56),
    target: str = "a known mix of the channels",
) -> Path:
    head = TrainingSet(camera=camera, outputs=("X", "Y", "Z"), target_description=target)
    with write_training_set(path, head) as writer:
        for seed in range(count):
            writer.append(a_frame(camera, seed, smooth, size))
    return path


def in_shards(l3: L3, run: tuple, shards: int, folder: Path, *first: object) -> tuple[list[Path], Path, str]:
    """Train a pass in shards. Returns the shards, their table, and the command's output."""
    name = f"{len(list(folder.iterdir()))}"
    paths, table = [folder / f"{name}_{index}.h5" for index in range(1, shards + 1)], folder / f"{name}.h5"
    for index, path in enumerate(paths, start=1):
        code, _, err = l3("train", *run, "--shard", f"{index}/{shards}", *first, "-o", path)
        assert code == 0, err
    code, _, err = l3("train", "--merge", *paths[::-1], "-o", table)
    assert code == 0, err
    return paths, table, err


def frame_of_squares(camera: CameraModel, seed: int, side: int = 160) -> TrainingFrame:
    """Return an unevenly lit frame of squares in many colours and sizes."""
    rng = np.random.default_rng(seed)
    share = np.full((len(camera.channels), side, side), 0.3)
    for size in np.geomspace(80, 3, 400).astype(int):
        row, col = rng.integers(0, side - size, 2)
        share[:, row : row + size, col : col + size] = rng.random((len(share), 1, 1))
    share *= np.linspace(0.3, 1.0, side)
    target = np.einsum("oc,crk->ork", rng.random((3, len(share))), share) * camera.saturation_exposure / 0.01
    return TrainingFrame(
        raw=np.zeros((side, side), np.uint16),
        electrons=(share * camera.full_scale).astype(np.float32),
        target=target.astype(np.float32),
        white=np.array([95.0, 100.0, 109.0]),
        scene="synthetic",
        illuminant="D65",
        luminance=100.0,
        exposure=0.01,
        seed=(0, seed),
    )
