"""Devices: chosen by index and name; one line where there is none."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from l3cli.errors import DeviceError, RecipeError
from l3cli.rendering.opencl import devices as opencl_devices
from l3cli.rendering.opencl.devices import choose_device, devices
from l3cli.rendering.opencl.renderer import OpenCLRenderer
from l3cli.rendering.renderer import make_renderer
from tests.helpers.cameras import BAYER
from tests.helpers.tables import random_table


def test_device_is_chosen_by_index_and_name() -> None:
    first = devices()[0]
    assert choose_device("0") == first
    assert choose_device(first.name[2:8].lower()) == first
    for wrong in ("99", "no such device"):
        with pytest.raises(DeviceError, match="‹device›"):
            choose_device(wrong)


def test_no_device_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(opencl_devices, "_platforms", list)
    with pytest.raises(DeviceError, match=r'pip install "pyopencl\[pocl\]"'):
        OpenCLRenderer(random_table(BAYER))


def test_variant_follows_the_device_unless_chosen() -> None:
    table = random_table(BAYER, patch=3)
    gpu = OpenCLRenderer(table).device.type & 4
    assert OpenCLRenderer(table).variant == ("graphics" if gpu else "processor")
    chosen = make_renderer("opencl", table, device="0", variant="graphics")
    assert isinstance(chosen, OpenCLRenderer)
    assert chosen.variant == "graphics"
    with pytest.raises(RecipeError, match="processor, graphics"):
        OpenCLRenderer(table, variant="vector")


def test_survey_says_what_is_missing(monkeypatch: pytest.MonkeyPatch) -> None:
    assert opencl_devices.survey()[0].startswith("0: ")
    monkeypatch.setattr(opencl_devices, "_platforms", list)
    assert opencl_devices.survey() == [f"no OpenCL driver (ICD) is installed; {opencl_devices.INSTALL}"]


def test_a_processor_without_a_linker_shows_no_device(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """The PoCL of the wheels would end the process at its first kernel."""
    platforms = {device.platform.version for device in devices()}
    if not all(opencl_devices.LINKS_BY_PROGRAM.match(version) for version in platforms):
        pytest.skip("there is a device that needs no linker")
    for nowhere in (str(tmp_path), ""):
        monkeypatch.setenv("PATH", nowhere)
        assert devices() == []
        with pytest.raises(DeviceError, match=r'no OpenCL device: .* the linker "ld", .* install .* gcc'):
            choose_device("")


def test_unknown_backend_is_refused() -> None:
    with pytest.raises(RecipeError, match="opencl, reference"):
        make_renderer("cuda", random_table(BAYER))


def test_pocl_works_with_an_unwritable_home() -> None:
    """PoCL without a folder for its cache finds no device at all."""
    script = (
        "import os; from l3cli.rendering.opencl.devices import choose_device\n"
        "choose_device(''); print(os.environ['POCL_CACHE_DIR'])"
    )
    kept = {key: value for key, value in os.environ.items() if key not in ("POCL_CACHE_DIR", "XDG_CACHE_HOME")}
    done = subprocess.run(
        [sys.executable, "-c", script], env={**kept, "HOME": "/proc"}, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    assert "l3-kernels-" in done.stdout
    assert not Path(done.stdout.strip()).exists()
