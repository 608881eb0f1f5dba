"""Exported tuning files in libcamera's own reader: the Raspberry Pi module that Debian builds for every processor loads one
without a camera. Wants libcamera-dev, libcamera-ipa and g++, in / or below L3_LIBCAMERA (unpacked packages)."""

import os
import shutil
import subprocess
from pathlib import Path

import pytest

from tests.helpers.calls import L3

ROOT = Path(os.environ.get("L3_LIBCAMERA", "/"))
HEADERS = ROOT / "usr/include/libcamera"
PROGRAM = """
#include <dlfcn.h>
#include <libcamera/ipa/raspberrypi_ipa_interface.h>
int main(int, char **argument) {
    void *module = dlopen(argument[1], RTLD_NOW);
    if (!module) return 9;
    auto create = (libcamera::IPAInterface * (*)()) dlsym(module, "ipaCreate");
    auto *pipeline = static_cast<libcamera::ipa::RPi::IPARPiInterface *>(create());
    libcamera::ipa::RPi::IPAInitResult result;
    return pipeline->init({argument[2], "imx219"}, &result) ? 1 : 0;
}
"""


@pytest.fixture(scope="module")
def reader(tmp_path_factory: pytest.TempPathFactory) -> list[str]:
    """A program, and its first argument, whose exit code says whether libcamera reads the file named second."""
    modules = sorted(ROOT.glob("usr/lib/*/libcamera/ipa_rpi.so"))
    header = HEADERS / "libcamera/ipa/raspberrypi_ipa_interface.h"
    if not modules or not header.exists() or shutil.which("g++") is None:
        pytest.skip("libcamera's Raspberry Pi module, its headers or g++ are not installed")
    folder, libraries = tmp_path_factory.mktemp("reader"), modules[0].parent.parent
    (folder / "read.cpp").write_text(PROGRAM)
    build = [
        "g++",
        "-std=c++17",
        f"-I{HEADERS}",
        "read.cpp",
        "-o",
        "read",
        f"-L{libraries}",
        "-lcamera",
        "-lcamera-base",
        "-ldl",
    ]
    subprocess.run([*build, f"-Wl,-rpath,{libraries},-rpath-link,{libraries}"], cwd=folder, check=True)
    return ["env", f"LD_LIBRARY_PATH={libraries}", str(folder / "read"), str(modules[0])]


@pytest.mark.slow
@pytest.mark.parametrize("camera", ["bayer", "bayer_gbrg"])
def test_libcamera_reads_the_tuning_file(reader: list[str], camera: str, tmp_path: Path, l3: L3) -> None:
    assert l3("export", camera, "-o", tmp_path, "--quiet")[0] == 0
    path = tmp_path / "libcamera_rpi.json"
    assert subprocess.run([*reader, str(path)], check=False).returncode == 0
    for right, wrong in (
        ('"ct": 2856', '"ct": 9999'),
        ('"reference_slope"', '"slope"'),
        ('"version": 2.0', '"version": 9.0'),
    ):
        (tmp_path / "wrong.json").write_text(path.read_text().replace(right, wrong))
        assert subprocess.run([*reader, str(tmp_path / "wrong.json")], check=False).returncode == 1, right
