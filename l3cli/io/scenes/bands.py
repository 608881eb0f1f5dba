"""Read spectral cubes from a folder with one picture per band, or from one file.

The file is a picture with one channel per band, such as EXR, or a TIFF file with one page per band.
"""

import re
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from l3cli.errors import InputFileError
from l3cli.frames.marks import missing, scaled
from l3cli.frames.scene import SpectralCube
from l3cli.io.images import open_image, picture_size, pixels_of, read_image, require_bearable
from l3cli.io.isolated import isolated
from l3cli.io.scenes.wavelengths import NAMES, in_nm, of_names
from l3cli.system.limits import require_values

BAND_PICTURES = (".png", ".tif", ".tiff", ".pgm", ".exr")
TIFF = (".tif", ".tiff")
GDAL_METADATA, GDAL_NODATA, PAGE_NAME = 42112, 42113, 285  # TIFF tags
ITEM = re.compile(r'<Item name="(\w+)"([^>]*)>([^<]*)</Item>')


def read(path: Path) -> SpectralCube:
    """Read a cube from a folder of pictures, from a picture with several channels, or from the pages of a TIFF file.

    The pictures in a folder are sorted by the numbers in their names, and only their first channel is used. Wavelengths are
    taken from the names of files, channels or pages ("450nm", "S0.450,5nm"). If only some names contain a wavelength, the
    other bands are omitted. If none does, the cube's wavelengths are None. Raises InputFileError if a folder contains no
    pictures, or if its pictures differ in size or bit depth.
    """
    if path.is_dir():
        pictures = _pictures(path)
        wanted, wavelength = _named([picture.stem for picture in pictures])
        return SpectralCube(_stacked([pictures[index] for index in wanted]), wavelength)
    if path.suffix.lower() in TIFF:
        return _of_tiff(*read_tiff(path))
    pixels, names = read_image(path)
    wanted, wavelength = _named(names)
    return SpectralCube(pixels[..., wanted], wavelength)


def size(path: Path) -> tuple[int, int]:
    """Return a cube's number of rows and columns. Raises InputFileError if a folder contains no pictures."""
    if path.suffix.lower() in TIFF and not path.is_dir():
        rows, cols = _tiff_size(path)
        return rows, cols
    return picture_size(_pictures(path)[0] if path.is_dir() else path)


def files(path: Path) -> list[Path]:
    """Return the pictures in a folder, sorted by the last number in their names, or the file itself if `path` is a file."""

    def order(path: Path) -> tuple[str, int]:
        numbers = re.findall(r"\d+", path.stem)
        return (re.sub(r"\d+$", "", path.stem), int(numbers[-1])) if numbers else (path.stem, 0)

    if not path.is_dir():
        return [path]
    return sorted((each for each in path.iterdir() if each.suffix.lower() in BAND_PICTURES), key=order)


def _pictures(folder: Path) -> list[Path]:
    pictures = files(folder)
    if not pictures:
        raise InputFileError(
            f"{folder} contains no pictures ({', '.join(BAND_PICTURES)}); use a folder with one picture per band"
        )
    return pictures


def _named(names: list[str] | tuple[str, ...]) -> tuple[list[int], NDArray[np.float64] | None]:
    """Return the indices of the bands with a wavelength in their names, and these wavelengths in nm.

    If no name contains a wavelength, return the indices of all bands, and None.
    """
    stated = of_names(names)
    wanted = [index for index, each in enumerate(stated) if each is not None]
    if not wanted:
        return list(range(len(names))), None
    return wanted, np.array([each for each in stated if each is not None])


def _stacked(pictures: list[Path]) -> NDArray:
    """Read the first channel of each picture as a cube, (row, col, band).

    Raises InputFileError if the pictures differ in size or bit depth.
    """
    cube: NDArray | None = None
    for band, picture in enumerate(pictures):
        pixels = read_image(picture)[0][..., 0]
        if cube is None:
            cube = np.empty((*pixels.shape, len(pictures)), pixels.dtype)
        if pixels.shape != cube.shape[:2] or pixels.dtype != cube.dtype:
            raise InputFileError(
                f"{picture} and {pictures[0].name} differ in size or bit depth; "
                "remove all pictures from the folder that are not bands of the cube"
            )
        cube[..., band] = pixels
    assert cube is not None
    return cube


# ------------------------------------------------------------------------------------------------------------ TIFF


def _of_tiff(values: NDArray, names: list[str], stated: dict[str, Any]) -> SpectralCube:
    """Convert the result of `read_tiff` to a cube: apply scales and offsets, and mark pixels without data.

    The wavelengths are taken from the metadata or, if there are none, from the band names.
    """
    if stated["wavelengths"]:
        wanted, wavelength = list(range(values.shape[2])), in_nm(stated["wavelengths"], "")
    else:
        names = stated["DESCRIPTION"] or names
        wanted, wavelength = _named(names) if len(names) == values.shape[2] else (list(range(values.shape[2])), None)
    values = values[..., wanted]
    ignored = None if stated["nodata"] is None else missing(values, stated["nodata"])
    gain = np.array(stated["SCALE"])[wanted] if stated["SCALE"] else 1.0
    offset = np.array(stated["OFFSET"])[wanted] if stated["OFFSET"] else 0.0
    made = scaled(values, gain, offset)
    return SpectralCube(made, wavelength, None if made is values else 1.0, None, ignored)


@isolated("tifffile")
def _tiff_size(path: Path) -> tuple[int, int]:
    """Return the number of rows and columns of the bands in a TIFF file."""
    import tifffile

    with tifffile.TiffFile(path) as file:
        page = _bands_of(path, file).keyframe
        return page.imagelength, page.imagewidth


@isolated("OpenImageIO", "tifffile")
def read_tiff(path: Path) -> tuple[NDArray, list[str], dict[str, Any]]:
    """Read the bands of a TIFF file, (row, col, band), their names, and the metadata in the tags (see `_stated`).

    The list of names is empty if the file contains none. Raises InputFileError if a page is damaged.
    """
    import tifffile

    with tifffile.TiffFile(path) as file:
        series = _bands_of(path, file)
        page = series.keyframe
        bands = int(np.prod(series.shape)) // (page.imagelength * page.imagewidth)
        stated, names = _stated(file, page, bands), _page_names(file, series, bands)
        pages = [each.index for each in series.pages if each is not None]
        # ImageJ may write a single page and append the values of all other bands without page headers.
        has_all_pages = len(pages) * page.samplesperpixel == bands
        values = None if has_all_pages else series.asarray()
        axes = series.axes
    if values is not None:
        order = sorted(range(values.ndim), key=lambda axis: {"Y": 0, "X": 1}.get(axes[axis], 2))
        return values.transpose(order).reshape(page.imagelength, page.imagewidth, bands), names, stated
    source = open_image(path)
    planes = []
    for index in pages:
        if not source.seek_subimage(index, 0):
            raise InputFileError(f"{path}: page {index + 1} is damaged; copy the file again")
        spec = source.spec()
        require_bearable(path, spec)
        pixels = pixels_of(path, source, spec)
        depth = 8 * pixels.dtype.itemsize
        if pixels.dtype.kind == "u":  # OpenImageIO scales, for example, 12-bit values to 16 bits
            pixels = pixels >> pixels.dtype.type(depth - spec.get_int_attribute("oiio:BitsPerSample", depth))
        planes.append(pixels)
        names = names or list(spec.channelnames)
    source.close()
    return np.concatenate(planes, axis=2), names if len(names) == bands else [], stated


def _bands_of(path: Path, file: Any) -> Any:
    """Return the tifffile series (a stack of pages) that contains the bands.

    Raises InputFileError if the file contains several series of the same size, or if the series has axes other than row,
    column and band.
    """
    series = file.series[0]
    page = series.keyframe
    if any(each.shape == series.shape and each is not series for each in file.series[1:]):
        raise InputFileError(f"{path} contains several stacks of pages; save one cube per file")
    further = [axis for axis, length in zip(series.axes, series.shape, strict=True) if axis not in "YX" and length > 1]
    if len(further) > 1 or "Y" not in series.axes or "X" not in series.axes:
        lengths = "×".join(map(str, series.shape))
        raise InputFileError(
            f"{path} has the axes {series.axes} with the lengths {lengths}; save a cube with only rows, columns and bands"
        )
    if page.samplesperpixel > 1 and sum(each is not None for each in series.pages) > 1:
        raise InputFileError(f"{path} has pages with {page.samplesperpixel} channels; save pages with one channel")
    require_values(str(path), series.shape, series.dtype.itemsize)
    return series


def _stated(file: Any, page: Any, bands: int) -> dict[str, Any]:
    """Read the metadata that tifffile or GDAL has stored in the tags of a TIFF page.

    Returns
    -------
    dict
        "wavelengths" (in nm), "SCALE", "OFFSET" and "DESCRIPTION" are lists with one entry per band, or empty lists if they
        are missing. "nodata" is the value of pixels without data, or None.
    """
    stated: dict[str, Any] = {"wavelengths": [], "nodata": None, "SCALE": [], "OFFSET": [], "DESCRIPTION": []}
    for metadata in file.shaped_metadata or ():
        for name, value in metadata.items():
            if name.lower() in NAMES and isinstance(value, list | tuple) and len(value) == bands:
                stated["wavelengths"] = [float(each) for each in value]
    if GDAL_NODATA in page.tags:
        stated["nodata"] = float(str(page.tags[GDAL_NODATA].value).strip("\0 "))
    items: dict[str, dict[int, str]] = {}
    for name, about, text in ITEM.findall(str(page.tags[GDAL_METADATA].value) if GDAL_METADATA in page.tags else ""):
        if sample := re.search(r'sample="(\d+)"', about):
            items.setdefault(name, {})[int(sample[1])] = text
    for name, usual in (("SCALE", 1.0), ("OFFSET", 0.0)):
        if name in items:
            stated[name] = [float(items[name].get(band, usual)) for band in range(bands)]
    for name, nm in (("wavelength", 1.0), ("WAVELENGTH", 1.0), ("CENTRAL_WAVELENGTH_UM", 1e3)):
        if len(items.get(name, ())) == bands:
            stated["wavelengths"] = [float(items[name][band]) * nm for band in range(bands)]
    if "DESCRIPTION" in items:
        stated["DESCRIPTION"] = [items["DESCRIPTION"].get(band, "") for band in range(bands)]
    return stated


def _page_names(file: Any, series: Any, bands: int) -> list[str]:
    """Return each band's name: its ImageJ label, its OME channel name, or the name or description of its page.

    The result is empty if the file does not contain one name per band.
    """
    if file.is_imagej and len(labels := (file.imagej_metadata or {}).get("Labels") or ()) == bands:
        return [str(label) for label in labels]
    if file.is_ome and len(channels := re.findall(r'<Channel [^>]*?Name="([^"]*)"', file.ome_metadata or "")) == bands:
        return channels
    pages = [each for each in series.pages if each is not None]
    if len(pages) != bands or bands == 1:
        return []
    pages = [file.pages[each.index].aspage() for each in pages]
    named = [str(page.tags[PAGE_NAME].value) if PAGE_NAME in page.tags else "" for page in pages]
    return named if all(named) else [page.description[:200] for page in pages]
