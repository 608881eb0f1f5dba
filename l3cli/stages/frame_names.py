"""Names of the files that belong to one frame of a training set."""

import re


def frame_name(index: int, scene: str) -> str:
    """Stem of the files of one frame of a training set: its number and its scene, without odd characters."""
    return f"{index:05d}_{re.sub(r'[^A-Za-z0-9]+', '-', scene)}"
