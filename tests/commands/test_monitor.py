"""`monitor` of monochromatic captures: a table of readings has the same effect as numbers in the measurement file."""

import re
import shutil
from collections import Counter
from pathlib import Path

import numpy as np
import pytest

from l3cli.errors import InputFileError
from l3cli.io import measurements
from l3cli.io.measurements import read_measurements
from l3cli.spectra.file import read_table
from l3cli.spectra.table import CurveTable
from tests.helpers.calls import Refused

NUMBER = re.compile(r"^monitor = .*\n", re.MULTILINE)


@pytest.fixture
def lab(lab_folder: Path, tmp_path: Path) -> Path:
    """The virtual lab's folder, whose [[mono]] captures name no monitor yet."""
    folder = tmp_path / "lab"
    shutil.copytree(lab_folder, folder)
    file = folder / "MEASUREMENTS.toml"
    file.write_text(NUMBER.sub("", file.read_text()))
    return folder


def with_monitor(lab: Path, stated: str) -> Path:
    """The measurement file with a monitor for all [[mono]] captures."""
    path = lab / "WATCHED.toml"
    path.write_text(
        (lab / "MEASUREMENTS.toml").read_text().replace("[[mono]]", f"[common]\nmonitor = {stated}\n\n[[mono]]", 1)
    )
    return path


def test_each_table_is_read_once(lab: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    reads = Counter[Path]()

    def counted(path: Path) -> CurveTable:
        reads[path] += 1
        return read_table(path)

    monkeypatch.setattr(measurements, "read_table", counted)
    given = read_measurements(lab / "MEASUREMENTS.toml")
    assert len(given.measurements.mono) > len(reads)  # which share a table
    assert dict(reads) == dict.fromkeys(given.files["spectra"], 1)


def test_a_table_of_readings_gives_the_ratio_at_each_step(lab: Path) -> None:
    mono = read_measurements(lab / "MEASUREMENTS.toml").measurements.mono
    peaks = [float(step.wavelength[step.radiance.argmax()]) for step in mono]
    assert {step.monitor for step in mono} == {1.0}
    ratios = np.array(peaks) / 500
    rows = [f"{nm},{3e-7 * nm / 500:.9g},3e-7,{nm / 500:.9g}" for nm in sorted(set(peaks))]
    (lab / "power.csv").write_text("\n".join(["wavelength_nm,power (W),before (W),ratio", *rows]) + "\n")
    for stated in (
        '{ file = "power.csv", column = "ratio" }',
        '{ file = "power.csv", column = "power", reference = "before" }',
    ):
        path = with_monitor(lab, stated)
        np.testing.assert_allclose([step.monitor for step in read_measurements(path).measurements.mono], ratios, rtol=1e-6)
        assert lab / "power.csv" in read_measurements(path).files["spectra"]
    with pytest.raises(InputFileError, match=r"power\.csv"):  # readings in watts are no ratio
        read_measurements(with_monitor(lab, '{ file = "power.csv", column = "power" }'))
    (lab / "power.csv").write_text("nm,ratio\n400,1\n410,1\n420,1\n")
    with pytest.raises(InputFileError, match=r"power\.csv"):
        read_measurements(with_monitor(lab, '{ file = "power.csv" }'))


@pytest.mark.parametrize(
    ("heading", "reading", "before", "named", "ratio"),
    [
        ("share (%),", 110.0, 1.0, 'column = "share"', 1.1),
        ("now (mW),then (W)", 1.2, 1e-3, 'column = "now", reference = "then"', 1.2),
        ("now (µA),then (W)", 1.2, 1.0, 'column = "now", reference = "then"', None),
        ("now (µA),", 1.2, 1.0, 'column = "now"', None),  # near 1 by chance
        ("now,", 2.3, 1.0, 'column = "now"', None),
        ("now,", 0.4, 1.0, 'column = "now"', None),
        ("now,then", 2.3, 1.0, 'column = "now", reference = "then"', 2.3),
        ("now,then", 1.0, 0.0, 'column = "now", reference = "then"', None),
    ],
)
def test_readings_are_ratios_or_have_a_reference(
    lab: Path, heading: str, reading: float, before: float, named: str, ratio: float | None
) -> None:
    two = not heading.endswith(",")
    rows = [f"{nm},{reading}" + f",{before}" * two for nm in range(300, 1101, 50)]
    (lab / "power.csv").write_text("\n".join([f"wavelength_nm,{heading.rstrip(',')}", *rows]) + "\n")
    path = with_monitor(lab, f'{{ file = "power.csv", {named} }}')
    if ratio is None:
        with pytest.raises(InputFileError, match=r"power\.csv.*reference|power\.csv.*detector"):
            read_measurements(path)
        return
    np.testing.assert_allclose([step.monitor for step in read_measurements(path).measurements.mono], ratio, rtol=1e-9)


def test_a_table_is_for_monochromatic_captures(lab: Path, refused: Refused) -> None:
    path = lab / "CHART.toml"
    text = (lab / "MEASUREMENTS.toml").read_text()
    path.write_text(text.replace("[[chart]]", '[[chart]]\nmonitor = { file = "power.csv" }', 1))
    assert "monitor" in refused(2, "calibrate", path, "-o", lab / "camera.h5")
