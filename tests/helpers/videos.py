"""Frames and times of video files."""

from pathlib import Path

import av
import numpy as np


def decoded(path: Path, pixels: str = "rgb24") -> np.ndarray:
    """Return the frames (frame, row, col, …) of a video."""
    with av.open(str(path)) as video:
        return np.stack([frame.to_ndarray(format=pixels) for frame in video.decode(video=0)])


def frame_times(path: Path) -> list[float]:
    """Return the time of each frame of a video, in seconds."""
    with av.open(str(path)) as video:
        return [frame.time for frame in video.decode(video=0)]
