"""Exported tuning files are read by libcamera: the Raspberry Pi module loads a file without a camera.

L3_LIBCAMERA is a folder that contains unpacked packages. The packages libcamera-dev and libcamera-ipa of Debian 12 need g++.
Later packages are built for ARM. They need libcamera-ipa, libcamera-dev and libstdc++-14-dev for arm64 with their
dependencies, and clang++, lld and qemu-aarch64.
"""

import os
import re
import shutil
import subprocess
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

from l3cli.artifacts.camera_recipe import load_camera
from l3cli.artifacts.store import save
from l3cli.recipes.builtin import find_recipe
from tests.helpers.calls import L3
from tests.helpers.lenses import flat_field

ROOT = Path(os.environ.get("L3_LIBCAMERA", "/"))
HEADERS = ROOT / "usr/include/libcamera"
PROGRAM = """
#include <dlfcn.h>
#include <libcamera/version.h>
#include <libcamera/ipa/raspberrypi_ipa_interface.h>
int main(int, char **argument) {
    void *module = dlopen(argument[1], RTLD_NOW);
    if (!module) return 9;
    auto create = (libcamera::IPAInterface * (*)()) dlsym(module, "ipaCreate");
    auto *pipeline = static_cast<libcamera::ipa::RPi::IPARPiInterface *>(create());
#if LIBCAMERA_VERSION_MINOR
    libcamera::ipa::RPi::InitParams params;
    libcamera::ipa::RPi::InitResult result;
    return pipeline->init({argument[2], "imx219"}, params, &result) ? 1 : 0;
#else
    libcamera::ipa::RPi::IPAInitResult result;
    return pipeline->init({argument[2], "imx219"}, &result) ? 1 : 0;
#endif
}
"""
ARM = "aarch64-linux-gnu"
Read = Callable[[Path], tuple[int, str]]  # a file → 0 if libcamera takes it, and what it says


@pytest.fixture(scope="module")
def read(tmp_path_factory: pytest.TempPathFactory) -> Read:
    """libcamera's reader of tuning files."""
    modules = sorted(ROOT.glob("usr/lib/*/libcamera/ipa_rpi*.so"))
    needed = ("clang++", "ld.lld", "qemu-aarch64") if modules and ARM in str(modules[0]) else ("g++",)
    if not modules or not HEADERS.is_dir() or not all(map(shutil.which, needed)):
        pytest.skip(f"libcamera's Raspberry Pi module, its headers or {' '.join(needed)} are not installed")
    folder, libraries = tmp_path_factory.mktemp("reader"), modules[0].parent.parent
    (folder / "read.cpp").write_text(PROGRAM)
    build = [
        needed[0],
        "-std=c++17",
        f"-I{HEADERS}",
        "read.cpp",
        "-o",
        "read",
        f"-L{libraries}",
        "-lcamera",
        "-lcamera-base",
    ]
    run = ["env", f"LD_LIBRARY_PATH={libraries}", str(folder / "read")]
    if needed[0] == "clang++":
        include = next(ROOT.glob("usr/include/c++/*"))
        found = ["-isystem", str(include), "-isystem", str(ROOT / f"usr/include/{ARM}/c++" / include.name)]
        build += [f"--target={ARM}", f"--sysroot={ROOT}", f"--gcc-toolchain={ROOT}/usr", "-fuse-ld=lld", *found, "-ldl"]
        build.append("-Wl,--allow-shlib-undefined")
        run = ["qemu-aarch64", "-L", str(ROOT), str(folder / "read")]
    else:
        build += ["-ldl", f"-Wl,-rpath,{libraries},-rpath-link,{libraries}"]
    subprocess.run(build, cwd=folder, check=True)

    def call(path: Path) -> tuple[int, str]:
        done = subprocess.run([*run, str(modules[0]), str(path)], check=False, capture_output=True, text=True)
        return done.returncode, done.stderr

    return call


@pytest.mark.slow
@pytest.mark.parametrize("camera", ["bayer", "bayer_gbrg"])
def test_libcamera_reads_the_tuning_file(read: Read, camera: str, tmp_path: Path, l3: L3) -> None:
    model = load_camera(find_recipe(camera, "cameras"))
    save(replace(model, flat_field=flat_field(model)), tmp_path / "camera.h5")
    assert l3("export", tmp_path / "camera.h5", "-o", tmp_path, "--quiet")[0] == 0
    path = tmp_path / "libcamera_rpi.json"
    assert read(path)[0] == 0
    for right, wrong in (
        ('"ct": 2856', '"ct": 9999'),
        ('"reference_slope"', '"slope"'),
        ('"version": 2.0', '"version": 9.0'),
        ('"luminance_lut": [', '"luminance_lut": [1.0, '),
    ):
        (tmp_path / "wrong.json").write_text(path.read_text().replace(right, wrong))
        assert read(tmp_path / "wrong.json")[0] == 1, right


@pytest.mark.slow
def test_libcamera_reads_that_of_a_raspberry_pi_5(read: Read, tmp_path: Path, l3: L3) -> None:
    """By the module for older boards, which reads all of a file by its target, and only then refuses the target."""
    if not re.search(r"_VERSION_MINOR\s+[1-9]", (HEADERS / "libcamera/version.h").read_text()):
        pytest.skip("this libcamera is older than the board")
    model = load_camera(find_recipe("bayer", "cameras"))
    save(replace(model, flat_field=flat_field(model)), tmp_path / "camera.h5")
    assert l3("export", tmp_path / "camera.h5", "-o", tmp_path, "--quiet")[0] == 0
    text = (tmp_path / "libcamera_pisp.json").read_text()
    code, said = read(tmp_path / "libcamera_pisp.json")
    assert (code, said.count("ERROR")) == (1, 1)
    assert 'target returned "pisp", expected "bcm2835"' in said
    (tmp_path / "older.json").write_text(text.replace('"pisp"', '"bcm2835"'))
    assert "Invalid number of entries in LSC table" in read(tmp_path / "older.json")[1]
