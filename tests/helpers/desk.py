"""A folder with a table, a raw frame, and the pictures rendered from them."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np

from l3cli.artifacts.store import save
from l3cli.cli import run
from l3cli.io.pictures.openimageio import write_mosaic
from tests.helpers.cameras import BAYER
from tests.helpers.tables import random_table, with_first


def make_desk(folder: Path) -> None:
    """Make a table, a raw frame as .tif and .npy, an evaluation, and the rendered pictures reference.png and opencl.png."""
    table = random_table(BAYER, bits=12, black_level=64.0)
    cases = table.first.rule.case_of_code.copy()
    cases[0] = 0  # code 0: no channel clips
    save(with_first(table, rule=replace(table.first.rule, case_of_code=cases)), folder / "table.h5")
    values = np.random.default_rng(0).integers(700, 900, (20, 24)).astype(np.uint16)  # values without a warning
    write_mosaic(folder / "raw.tif", values)
    np.save(folder / "raw.npy", values)
    frames = [{"luminance": light, "clipped": 0.0, "exposure": 0.01, "ours": {"scielab": 2.0}} for light in (1.0, 10.0)]
    (folder / "evaluation.json").write_text(json.dumps({"camera": "µ\x1b[2J\u202e", "frames": frames}))
    for backend in ("reference", "opencl"):
        call = ["render", f"{folder}/table.h5", f"{folder}/raw.tif", "-o", f"{folder}/{backend}.png", "--exposure", "1"]
        assert run([*call, "--backend", backend, "--quiet"]) == 0
