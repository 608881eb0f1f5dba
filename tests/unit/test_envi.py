"""ENVI cubes as the package spectral writes and reads them."""

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import spectral

from l3cli.errors import InputFileError
from l3cli.io.scenes import envi
from tests.helpers.cubes import WAVELENGTH, a_cube

TYPES = ["u1", "i2", "u2", "i4", "u4", "i8", "u8", "f4", "f8"]
KNOWN = {"wavelength": [f"{nm:.1f}" for nm in WAVELENGTH], "wavelength units": "Nanometers", "description": "of\ntwo lines"}


def save(path: Path, values: np.ndarray, **how: Any) -> np.ndarray:
    """What is written to an ENVI file by spectral."""
    spectral.envi.save_image(str(path), values, dtype=values.dtype, **{"metadata": KNOWN} | how)
    return values


@pytest.mark.parametrize("interleave", ["bsq", "bil", "bip"])
@pytest.mark.parametrize("byteorder", ["little", "big"])
@pytest.mark.parametrize("dtype", TYPES)
def test_what_spectral_writes_is_read(tmp_path: Path, interleave: str, byteorder: str, dtype: str) -> None:
    stored = (a_cube() * 250 - (dtype[0] != "u") * 100).astype(dtype)
    save(tmp_path / "scene.hdr", stored, interleave=interleave, byteorder=byteorder)
    cube = envi.read(tmp_path / "scene.hdr")
    assert np.array_equal(cube.values, stored)
    assert cube.values.dtype.newbyteorder("=") == dtype
    assert cube.wavelength is not None
    assert np.array_equal(cube.wavelength, WAVELENGTH)
    assert cube.white is None


@pytest.mark.parametrize("ext", ["", "img", "dat", "raw", "IMG"])
def test_data_lie_beside_the_header_under_any_of_spectrals_names(tmp_path: Path, ext: str) -> None:
    stored = save(tmp_path / "scene.hdr", a_cube(), ext=ext)
    assert np.array_equal(envi.read(tmp_path / "scene.hdr").values, stored)
    assert envi.files(tmp_path / "scene.hdr")[1].name == f"scene.{ext}".rstrip(".")


@pytest.mark.parametrize(("unit", "nm"), [("Nanometers", 1.0), ("Micrometers", 1000.0), ("Unknown", 1000.0)])
def test_bands_lie_where_spectral_finds_them(tmp_path: Path, unit: str, nm: float) -> None:
    listed = [f"{each / nm:.4f}" for each in WAVELENGTH]
    save(tmp_path / "scene.hdr", a_cube(), metadata={"wavelength": listed, "wavelength units": unit})
    cube, theirs = envi.read(tmp_path / "scene.hdr"), spectral.open_image(str(tmp_path / "scene.hdr"))
    assert cube.wavelength is not None
    assert np.allclose(cube.wavelength, np.array(theirs.bands.centers) * nm, rtol=1e-12)


def test_both_read_the_same_from_a_header_of_other_writers(tmp_path: Path) -> None:
    stored = np.rint(a_cube() * 10000).astype(">u2")
    (tmp_path / "scene.bil").write_bytes(bytes(128) + np.ascontiguousarray(stored.transpose(0, 2, 1)).tobytes())
    (tmp_path / "scene.hdr").write_text(
        "ENVI\r\ndescription = {\r\n  lines = 3, of another}\r\n; fields = {not closed\r\nsamples = 24\r\nlines   = 20\r\n"
        "bands =31\r\nheader offset = 128\r\ndata type = 12\r\ninterleave = bil\r\nbyte order = 1\r\n"
        f"reflectance scale factor = 10000\r\nwavelength = {{\r\n {', '.join(map(str, WAVELENGTH))} }}\r\n",
        newline="",
    )
    ours, theirs = envi.read(tmp_path / "scene.hdr"), spectral.open_image(str(tmp_path / "scene.hdr"))
    assert ours.white is not None
    assert ours.wavelength is not None
    assert np.allclose(ours.values / ours.white, np.asarray(theirs.load()), rtol=1e-6)
    assert np.array_equal(ours.wavelength, theirs.bands.centers)


@pytest.mark.parametrize("dtype", ["c8", "c16"])
def test_complex_values_are_refused(tmp_path: Path, dtype: str) -> None:
    save(tmp_path / "scene.hdr", a_cube().astype(dtype))
    with pytest.raises(InputFileError, match=r"scene\.hdr: .* of no known kind"):
        envi.read(tmp_path / "scene.hdr")


def test_a_cube_cut_short_is_refused_with_both_sizes(tmp_path: Path) -> None:
    stored = save(tmp_path / "scene.hdr", a_cube())
    data = tmp_path / "scene.img"
    data.write_bytes(data.read_bytes()[:-1])
    with pytest.raises(InputFileError, match=f"{stored.nbytes - 1} bytes, its header wants {math.prod(stored.shape) * 4}"):
        envi.read(tmp_path / "scene.hdr")
