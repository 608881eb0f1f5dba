"""Arrays of frames in HDF5, FITS, .npy, TIFF and MATLAB files: order of the axes, and number types."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
import scipy.io
import tifffile
from astropy.io import fits

from l3cli.errors import InputFileError
from l3cli.io.frames import raw_content
from l3cli.io.raw.files import RawOverrides
from l3cli.io.sequences import find_frames
from tests.helpers.calls import Refused
from tests.helpers.raw_files import RGGB

FRAMES = np.random.default_rng(7).integers(0, 4096, (5, 32, 40)).astype(np.uint16)  # (frame, row, col)
LEVELS = RawOverrides(black_level=0.0625, white_level=1.0)


def read(path: Path, known: RawOverrides | None = None, dataset: str | None = None) -> np.ndarray:
    """The values (frame, row, col) of all frames of a file."""
    sequence = find_frames((path,), RGGB, known or RawOverrides(), dataset=dataset)
    return np.array([frame.values for each in sequence.frames if (frame := sequence.frames.read(each.number))])


def written(path: Path, values: np.ndarray, about: Callable[[Any], None] = lambda data: None, name: str = "a/raw") -> Path:
    """An HDF5 file of one dataset, about which something is said."""
    with h5py.File(path, "w") as file:
        file[name] = values
        about(file[name])
    return path


def labels(*names: str) -> Callable[[Any], None]:
    def label(data: Any) -> None:
        for dimension, name in zip(data.dims, names, strict=True):
            dimension.label = name

    return label


def scales(*names: str) -> Callable[[Any], None]:
    def attach(data: Any) -> None:
        for dimension, name, length in zip(data.dims, names, data.shape, strict=True):
            data.file[name] = np.arange(length)
            data.file[name].make_scale()
            dimension.attach_scale(data.file[name])

    return attach


def attribute(name: str, value: Any, of_group: bool = False) -> Callable[[Any], None]:
    def attach(data: Any) -> None:
        (data.parent if of_group else data).attrs[name] = value
        if of_group:
            data.parent.attrs["signal"] = "raw"

    return attach


NAMED = {
    "labels": (labels("y", "x", "frame"), (1, 2, 0)),
    "labels of another order": (labels("Col", "Time", "Row"), (2, 0, 1)),
    "scales": (scales("row", "column", "n"), (1, 2, 0)),
    "xarray": (attribute("_ARRAY_DIMENSIONS", ["time", "x", "y"]), (0, 2, 1)),
    "NeXus list": (attribute("axes", ["y", "x", "t"], of_group=True), (1, 2, 0)),
    "NeXus text": (attribute("axes", "[t,y,x]"), (0, 1, 2)),
    "letters": (attribute("axes", "yxt"), (1, 2, 0)),
    "MATLAB": (attribute("MATLAB_class", np.bytes_("uint16")), (0, 2, 1)),
    "no names": (lambda data: None, (0, 1, 2)),
}


@pytest.mark.parametrize("case", NAMED)
def test_names_of_axes_decide(tmp_path: Path, case: str) -> None:
    about, stored = NAMED[case]
    path = written(tmp_path / "a.h5", FRAMES.transpose(stored), about)
    np.testing.assert_array_equal(read(path), FRAMES)
    np.testing.assert_array_equal(read(path, dataset="a/raw"), FRAMES)


def test_names_of_the_axes_of_one_frame(tmp_path: Path) -> None:
    path = written(tmp_path / "a.h5", FRAMES[0].T, labels("x", "y"))
    np.testing.assert_array_equal(read(path, dataset="a/raw"), FRAMES[:1])


PICTURE = np.moveaxis(FRAMES[:3], 0, -1)  # (row, col, 3)
REFUSED = {
    "(row, col, 3)": (PICTURE, lambda data: None),
    "(row, col, 4)": (np.moveaxis(FRAMES[:4], 0, -1), lambda data: None),
    "channels first, named": (FRAMES[:3], labels("channel", "y", "x")),
    "wavelengths": (FRAMES, labels("wavelength", "y", "x")),
    "HDF5 Image": (FRAMES[:3], attribute("IMAGE_SUBCLASS", np.bytes_("IMAGE_TRUECOLOR"))),
    "MATLAB's (row, col, 3)": (PICTURE.T, attribute("MATLAB_class", np.bytes_("uint16"))),
    "frames last": (np.zeros((480, 640, 20), np.uint16), lambda data: None),
}


@pytest.mark.parametrize("case", REFUSED)
def test_pictures_of_several_channels_are_no_frames(tmp_path: Path, case: str) -> None:
    values, about = REFUSED[case]
    with pytest.raises(InputFileError, match=r"picture|channels|probably contains frames"):
        read(written(tmp_path / "a.h5", values, about))


def test_planes_of_fits_and_arrays_of_numpy(tmp_path: Path, refused: Refused, raw_table: Path) -> None:
    for number, (values, header) in enumerate([(FRAMES[:3], {}), (PICTURE, {}), (FRAMES, {"CTYPE3": "RGB"})]):
        fits.writeto(tmp_path / f"{number}.fits", values, fits.Header(header))
        assert "hannel" in refused(3, "render", raw_table, tmp_path / f"{number}.fits", "-o", tmp_path / "out/")
    for number, header in enumerate([{"BAYERPAT": "RGGB"}, {"CTYPE3": "TIME"}, {"CTYPE3": "frame"}]):
        fits.writeto(tmp_path / f"a{number}.fits", FRAMES[:3], fits.Header(header))
        np.testing.assert_array_equal(read(tmp_path / f"a{number}.fits"), FRAMES[:3])
    fits.writeto(tmp_path / "five.fits", FRAMES)
    np.testing.assert_array_equal(read(tmp_path / "five.fits"), FRAMES)
    fits.writeto(tmp_path / "four.fits", np.stack([FRAMES, FRAMES]))
    assert "(2, 5, 32, 40)" in refused(3, "render", raw_table, tmp_path / "four.fits", "-o", tmp_path / "out/")
    np.save(tmp_path / "last.npy", np.zeros((480, 640, 20), np.uint16))
    assert "last axis" in refused(3, "render", raw_table, tmp_path / "last.npy", "-o", tmp_path / "out/")


TIFFS: dict[str, Callable[[Path], None]] = {
    "ImageJ's channels": lambda path: tifffile.imwrite(path, FRAMES[:3], imagej=True, metadata={"axes": "CYX"}),
    "tifffile's channels": lambda path: tifffile.imwrite(path, FRAMES, photometric="minisblack", metadata={"axes": "CYX"}),
    "OME's channels": lambda path: tifffile.imwrite(
        path, FRAMES[:3], ome=True, photometric="minisblack", metadata={"axes": "CYX"}
    ),
    "pages of pixels": lambda path: tifffile.imwrite(path, PICTURE, photometric="minisblack"),
}


@pytest.mark.parametrize("case", TIFFS)
def test_pages_of_tiff_that_are_channels(tmp_path: Path, case: str) -> None:
    path = tmp_path / ("a.ome.tif" if "OME" in case else "a.tif")
    TIFFS[case](path)
    with pytest.raises(InputFileError, match="channels"):
        read(path)
    kinds: list[dict[str, Any]] = [{}, {"imagej": True}, {"ome": True}, {"metadata": {"axes": "TYX"}}]
    for number, options in enumerate(kinds):
        named = tmp_path / f"b{number}{'.ome' if 'ome' in options else ''}.tif"
        tifffile.imwrite(named, FRAMES, photometric="minisblack", **options)
        np.testing.assert_array_equal(read(named), FRAMES)


# ----------------------------------------------------------------------------------------------- values of any type


def hdf5(path: Path, values: np.ndarray) -> Path:
    return written(path.with_suffix(".h5"), values)


def npy(path: Path, values: np.ndarray) -> Path:
    np.save(path.with_suffix(".npy"), values)
    return path.with_suffix(".npy")


def fits_file(path: Path, values: np.ndarray) -> Path:
    fits.writeto(path.with_suffix(".fits"), values)
    return path.with_suffix(".fits")


def tiff(path: Path, values: np.ndarray) -> Path:
    tifffile.imwrite(path.with_suffix(".tif"), values, photometric="minisblack")
    return path.with_suffix(".tif")


def mat(path: Path, values: np.ndarray) -> Path:
    scipy.io.savemat(path.with_suffix(".mat"), {"raw": values})
    return path.with_suffix(".mat")


WRITERS = (hdf5, npy, fits_file, tiff, mat)


@pytest.mark.parametrize("write", WRITERS)
@pytest.mark.parametrize("dtype", ["int16", "int32", "uint32", "float32", "float64"])
def test_whole_numbers_of_any_type_are_dn(tmp_path: Path, write: Callable[[Path, np.ndarray], Path], dtype: str) -> None:
    values = FRAMES.astype(dtype)
    np.testing.assert_array_equal(read(write(tmp_path / "a", values)), FRAMES)


@pytest.mark.parametrize("write", WRITERS)
def test_fractions_of_full_scale_need_their_levels(tmp_path: Path, write: Callable[[Path, np.ndarray], Path]) -> None:
    path = write(tmp_path / "a", (FRAMES / 4096).astype(np.float32))
    for known in (RawOverrides(), RawOverrides(white_level=1.0), RawOverrides(black_level=240.0, white_level=4095.0)):
        with pytest.raises(InputFileError, match=r"float32 values from .*‹black_level›"):
            read(path, known)
    light = (read(path, LEVELS) - 8192.0) / (57344 - 8192)
    np.testing.assert_allclose(light, (FRAMES / 4096 - 0.0625) / (1 - 0.0625), atol=1.1e-5)


def test_values_below_zero_keep_their_noise(tmp_path: Path) -> None:
    values = FRAMES.astype(np.int16) - 300
    light = (read(npy(tmp_path / "a", values), RawOverrides(black_level=0.0, white_level=3795.0)) - 8192.0) / (57344 - 8192)
    np.testing.assert_allclose(light, values / 3795, atol=1.1e-5)


def test_values_that_are_no_numbers_and_captures_of_fractions(tmp_path: Path) -> None:
    values = FRAMES / 4096
    values[:, 3, 3] = np.nan
    with pytest.raises(InputFileError, match="infinite or not a number"):
        read(npy(tmp_path / "a", values), LEVELS)
    with pytest.raises(InputFileError, match="save the values in DN"):
        raw_content(npy(tmp_path / "b", FRAMES[0] / 4096))
    np.testing.assert_array_equal(raw_content(npy(tmp_path / "c", FRAMES[0].astype(np.int32)))["values"], FRAMES[0])
