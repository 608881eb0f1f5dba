"""Nobody's file harms: spoilt inputs of every kind are refused in one line, and decoders run apart, within limits."""

import dataclasses
import json
import os
import signal
import struct
import subprocess
import sys
import tempfile
import time
import zlib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from test_render import BAYER, random_table

from l3cli.artifacts.base import save
from l3cli.errors import InputFileError
from l3cli.io import apart
from l3cli.io.apart import apart as decoded_apart
from l3cli.io.images import read_image, write_mosaic
from l3cli.limits import MEGAPIXELS, MOST_TEXT, TRUST
from tests.hostile import SUBJECTS, Subject, Workshop, confined, watched

INPUTS = int(os.environ.get("L3_HOSTILE_INPUTS", "500"))  # of all subjects together
EACH = settings(
    max_examples=-(-INPUTS // len(SUBJECTS)),
    deadline=None,
    derandomize=True,
    database=None,
    suppress_health_check=list(HealthCheck),
)


class Drawn:
    """Choices of Hypothesis."""

    def __init__(self, data: st.DataObject) -> None:
        self._data = data

    def integer(self, least: int, most: int) -> int:
        return self._data.draw(st.integers(least, most))


@pytest.fixture(scope="module")
def shop(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Workshop]:
    made = Workshop(tmp_path_factory.mktemp("hostile"))
    with confined():
        yield made


@pytest.mark.parametrize("subject", SUBJECTS, ids=lambda subject: subject.name)
def test_a_spoilt_input_is_refused_or_read_and_nothing_else(shop: Workshop, subject: Subject) -> None:
    @EACH
    @given(st.data())
    def judge(data: st.DataObject) -> None:
        with watched(Path(tempfile.gettempdir())) as seen:
            assert shop.judge(subject, Drawn(data)) is None
        assert not seen

    judge()
