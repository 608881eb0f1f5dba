"""Corrupted inputs of all types are read or are rejected in one line. `make fuzz` runs 20 000 of them."""

import dataclasses
import io
import os
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from l3cli.artifacts.layers import MosaicLayer
from l3cli.classes.names import kind_name
from tests.helpers import hostile_forks, hostile_physics
from tests.helpers.fuzz import Seeded
from tests.helpers.hostile import SUBJECTS, Subject, Workshop, confined, watched
from tests.helpers.hostile_dng import DngTags
from tests.helpers.hostile_identities import Identities
from tests.helpers.tables import random_table

IDENTITIES = 6
INPUTS = int(os.environ.get("L3_HOSTILE_INPUTS", "92"))  # of all subjects together
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
def workshop(tmp_path_factory: pytest.TempPathFactory) -> Workshop:
    return Workshop(tmp_path_factory.mktemp("hostile"))


@pytest.fixture
def shop(workshop: Workshop) -> Iterator[Workshop]:
    with confined():
        yield workshop


@pytest.mark.parametrize("subject", SUBJECTS, ids=lambda subject: subject.name)
def test_a_spoilt_input_is_refused_or_read_and_nothing_else(shop: Workshop, subject: Subject) -> None:
    @EACH
    @given(st.data())
    def judge(data: st.DataObject) -> None:
        with watched(Path(tempfile.gettempdir())) as seen:
            assert shop.judge(subject, Drawn(data)) is None
        assert not seen

    judge()


def test_an_output_that_is_an_input_is_refused_whatever_it_is_called(shop: Workshop) -> None:
    identities = Identities(shop)
    for seed in range(IDENTITIES):
        assert identities.judge(Seeded(seed)) is None


@pytest.fixture(scope="module")
def lab(tmp_path_factory: pytest.TempPathFactory) -> hostile_physics.Lab:
    return hostile_physics.Lab(tmp_path_factory.mktemp("physics") / "lab")


@pytest.mark.parametrize("seed", [0, pytest.param(1, marks=pytest.mark.soak)])
@pytest.mark.parametrize("mistake", hostile_physics.MISTAKES, ids=lambda mistake: mistake.__name__)
def test_a_physical_mistake_is_named_or_undone(
    lab: hostile_physics.Lab, mistake: Callable[..., hostile_physics.Expected], seed: int
) -> None:
    assert lab.judge(mistake, Seeded(seed)) is None


def test_a_dng_is_read_to_the_pixels_that_its_tags_describe_or_refused(shop: Workshop) -> None:
    for seed in range(30):
        trial = DngTags().draw(Seeded(seed))
        assert DngTags().judge(shop, trial) is None, trial


# Failures of the long runs, each mended at its cause: a subject, a command, what is replaced in the whole file.
SAVED: list[tuple[str, int, bytes, bytes]] = [
    ("frame.npy", 0, b"(20, 24)", b"(20, 24\n"),  # Python's tokenizer fails on the header
    ("lab.toml", 0, b"step_nm = 30.0", b"step_nm = 1e-30"),  # more wavelengths than there is memory
    ("lab.toml", 0, b"hot_pixels_per_million = 400", b"hot_pixels_per_million = 1e20"),
    ("classes.toml", 0, b"draws = 2", b"draws = 100000"),  # years
    ("classes.toml", 0, b"patches = 300", b"patches = 4294967296"),
    ("classes.toml", 0, b"chromas = 2", b"chromas = 1000"),  # k-means of minutes before the limit was checked
    ("curves.toml", 0, b"fixed_pattern_seed = 3", b"fixed_pattern_seed = 9223372036854775808"),
    ("camera.toml", 0, b"bits = 12", b"bits = 2147483647"),
    ("camera.toml", 0, b"[400, 700, 10]", b"[400, 1e20, 1e-9]"),
    ("scenes.toml", 0, b"count = 1", b"count = 4294967296"),
    ("lab/MEASUREMENTS.toml", 0, b"cols = 128", b"cols = 128282828"),
    ("lab/spectra/chart_010_D65.csv", 0, b"\n419", b"\n418.9" + 24 * b",-1e300" + b"\n419"),  # least squares never end
    ("evaluation.json", 0, b"30.5", b"1e300"),  # an axis without end
    ("evaluation.json", 0, b": 10", b": -10"),
    ("training.h5", 1, b"SNOD", b"SNOX"),  # HDF5's own list of a group's members is broken
    ("table.h5", 0, b"SNOD", b"SNOX"),
    ("scenes.toml", 0, b"analog_gain = 1.5", b"analog_gain = 1e-300"),  # a gain at which black and white fall together
    ("lab.toml", 0, b"[white]", b"[white]\nluminance = -1"),
    ("classes.toml", 0, b"chromas = 2", b"chromas = 0"),
    ("channels.exr", 0, b"lineOrder\0lineOrder", b"lineOrder\0lineOr\x01er"),  # a control character in the decoder's message
]


@pytest.mark.parametrize(("name", "command", "old", "new"), SAVED)
def test_files_that_once_failed_stay_corrected(shop: Workshop, name: str, command: int, old: bytes, new: bytes) -> None:
    subject = next(subject for subject in SUBJECTS if subject.name == name)
    assert old in shop.whole[name]
    assert shop.judge_content(subject, shop.whole[name].replace(old, new), command) is None


SAVED_VALUES: list[tuple[str, int, str, Any]] = [
    ("training.h5", 1, "frames/00000/white", np.array([-1e30, 100.0, 108.9])),  # moments that run over
    ("training.h5", 1, "frames/00000/luminance", -1.0),
    ("training.h5", 2, "outputs", np.array([b"X", b"Y"])),
    ("sums.h5", 0, "sites", np.array([1, 2, 3])),  # sums of sites that the camera does not train
    ("sums.h5", 0, "training/camera/pixel_pitch", 1e-25),  # a pixel that takes ages to fill
    ("table.h5", 0, "first/rule/shift", -1),
    ("table.h5", 1, "bits", 4096),
    ("camera.h5", 2, "wavelength", np.linspace(1.0, 1e12, 31)),
    ("camera.h5", 2, "gain", 0.0),
    ("camera.h5", 0, "history", np.bytes_(b'[{"command": 1, "options": []}]')),
]


@pytest.mark.parametrize(("name", "command", "dataset", "value"), SAVED_VALUES)
def test_values_that_once_passed_stay_refused(shop: Workshop, name: str, command: int, dataset: str, value: Any) -> None:
    subject = next(subject for subject in SUBJECTS if subject.name == name)
    image = io.BytesIO(shop.whole[name])
    with h5py.File(image, "r+") as root:
        attributes = dict(root[dataset].attrs)
        del root[dataset]
        root[dataset] = value
        root[dataset].attrs.update(attributes)
    assert shop.judge_content(subject, image.getvalue(), command) is None


def test_a_camera_of_many_channels_does_not_compare_all_patterns_in_pairs() -> None:
    """16 channels have 65536 patterns: all against all would be 32 GB."""
    table = random_table(np.arange(16).reshape(4, 4), patch=5)
    rule = dataclasses.replace(table.first.rule, case_of_code=np.minimum(np.arange(2**16), 2).astype(np.uint16))
    weights = np.zeros((table.cfa.size * rule.classes_per_site, 3, 25), np.float32)
    each: dict[str, Any] = {
        "intercept": weights[:, :, 0],
        "samples": np.ones(len(weights)),
        "condition": np.ones(len(weights), np.float32),
    }
    first = MosaicLayer(rule, weights, **each)
    table = dataclasses.replace(table, first=first, channels=tuple("abcdefghijklmnop"))
    assert kind_name(table, table.first.rule.chromas) == "saturated a"
    assert kind_name(table, table.first.rule.chromas + 1) == "saturated a+b+c+d+e+f+g+h+i+j+k+l+m+n+o+p"


def test_a_forked_child_does_as_its_parent_or_names_the_cure() -> None:
    cases: list[hostile_forks.Case] = [
        (["use"], "use"),
        (["devices"], "command"),
        (["hold"], "by reference"),
        (["decode", "open"], "decode"),
        (["open"], "read"),
        (["use"], "leave"),
    ]
    assert list(hostile_forks.judge_cases(cases)) == []
