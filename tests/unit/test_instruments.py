"""Spectra exported by instruments and their programs: the same values in any layout."""

import re
from pathlib import Path

import numpy as np
import pytest

from l3cli.errors import InputFileError
from l3cli.physics.spectra import photons_from_energy
from l3cli.spectra.file import read_table

NM = np.array([400.0, 410.0, 420.0, 430.0])
WATTS = np.array([0.001, 0.0125, 0.02, 0.003])  # W/(sr m² nm)
ROWS = list(zip(NM, WATTS, strict=True))


def rows(separator: str, point: str = ".", reverse: bool = False, factor: float = 1.0) -> str:
    lines = [f"{nm:g}{separator}{value * factor:.6g}".replace(".", point) for nm, value in ROWS]
    return "\n".join(reversed(lines) if reverse else lines) + "\n"


PREAMBLE = "Instrument;CS-2000\nSerial no.;12345\nOperator;Müller\nIntegration time [s];0,5\n\n"
OCEAN = (
    "Data from lamp_00012.txt Node\n\nDate: Tue Mar 03 10:00:00 CET 2026\nUser: lab\nSpectrometer: QEP01234\n"
    "Integration Time (sec): 1.000000E-1\nScans to average: 10\nXAxis mode: Wavelengths\nNumber of Pixels in Spectrum: 4\n"
)
BEGIN, END = ">>>>>Begin Spectral Data<<<<<\n", ">>>>>End Spectral Data<<<<<\n"
PHOTO_RESEARCH = "00000,0,0.000e+000,1.827e-01,5.147e+01\n"  # quality, unit, peak, integral, photons
SIDEWAYS_NM = np.arange(400.0, 520.0, 10.0)
SIDEWAYS = "Name;Date;" + ";".join(f"{nm:g} nm" for nm in SIDEWAYS_NM) + "\nlamp;today;" + ";".join(
    f"{nm / 1e5:g}".replace(".", ",") for nm in SIDEWAYS_NM
)  # fmt: skip


@pytest.mark.parametrize(
    "content",
    [
        "Wavelength [nm],Radiance [W/(sr m² nm)]\n" + rows(","),
        "lambda;L / W/(m²·sr·nm)\n" + rows(";", ","),
        "nm\tW/sr/m2/nm\n" + rows("\t"),
        PREAMBLE + "Wavelength [nm];Spectral radiance [W/(sr·m2·nm)]\n" + rows(";", ","),
        PREAMBLE + "Wavelength;Spectral radiance\n[nm];[mW/(sr m² nm)]\n" + rows(";", ",", factor=1e3),
        "Wavelength,Radiance (uW/cm^2/sr/nm)\n" + rows(",", factor=1e2),
        "Unit: µW/cm²/sr/nm\nWavelength\tSample\n" + rows("\t", ",", factor=1e2),
        "Wellenlänge;Strahldichte (W/m2-sr-nm)\n" + rows(";", ",", reverse=True),
        "Wavelength (nm);Radiance (W/sr·m²/nm);\n" + rows(";", ",").replace("\n", ";\n"),
        '"Wavelength, air [nm]","Radiance, mean [W/(sr m² nm)]"\n' + rows(","),
        OCEAN + BEGIN + rows("\t"),
        OCEAN + BEGIN + rows("\t", ",") + END,
        PHOTO_RESEARCH + rows(","),
        "PR-655\n" + PHOTO_RESEARCH + rows(","),
        rows("   ", ","),
        "CRI Ra;95\nu';0,2\n" + rows(";", ","),
    ],
)
@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16", "utf-16-le", "cp1252"])
def test_an_export_gives_the_radiance_that_was_measured(content: str, encoding: str, tmp_path: Path) -> None:
    path = tmp_path / "export.txt"
    path.write_bytes(content.replace("\n", "\r\n").encode(encoding))
    table = read_table(path)
    np.testing.assert_array_equal(table.wavelength, NM)
    unit = None if any(table.units) else "W/(sr m² nm)"
    np.testing.assert_allclose(table.photons(unit)[0], photons_from_energy(NM, WATTS), rtol=1e-6)


def test_a_table_on_its_side(tmp_path: Path) -> None:
    (tmp_path / "side.csv").write_text(SIDEWAYS)
    table = read_table(tmp_path / "side.csv")
    np.testing.assert_array_equal(table.wavelength, SIDEWAYS_NM)
    np.testing.assert_allclose(table.column("lamp today").values[0], SIDEWAYS_NM / 1e5)


def test_columns_called_by_wavelengths_do_not_lie_on_their_side(tmp_path: Path) -> None:
    """A sweep whose columns are its steps."""
    steps = np.arange(400, 520, 10)
    lines = ["wavelength," + ",".join(f"{step}" for step in steps)]
    lines += [f"{nm}," + ",".join(f"{abs(nm - step)}" for step in steps) for nm in (390, 400, 410)]
    (tmp_path / "steps.csv").write_text("\n".join(lines))
    table = read_table(tmp_path / "steps.csv")
    np.testing.assert_array_equal(table.wavelength, [390, 400, 410])
    np.testing.assert_array_equal(table.column("430").values[0], [40, 30, 20])


@pytest.mark.parametrize(("quantity", "unit"), [("radiance", "W/(sr m² nm)"), ("irradiance", "W/(m² nm)"), ("other", None)])
def test_ies_tm_27(quantity: str, unit: str | None, tmp_path: Path) -> None:
    spectrum = "\n".join(f'<SpectralData wavelength="{nm:g}">{value:g}</SpectralData>' for nm, value in ROWS)
    (tmp_path / "lamp.spdx").write_text(
        '<?xml version="1.0" encoding="UTF-8"?>\n<IESTM2714 xmlns="iestm2714" version="1.0"><Header><Comments>a</Comments>'
        f"</Header><SpectralDistribution><SpectralQuantity>{quantity}</SpectralQuantity>{spectrum}</SpectralDistribution>"
        "</IESTM2714>"
    )
    table = read_table(tmp_path / "lamp.spdx")
    assert (table.names, table.units) == (("lamp",), (unit,))
    np.testing.assert_array_equal(table.wavelength, NM)
    np.testing.assert_allclose(table.values[0], WATTS)


def test_percent_become_shares(tmp_path: Path) -> None:
    for name in ("QE (%)", "QE [%]", "QE / %", "QE %", "QE [percent]"):
        (tmp_path / "qe.csv").write_text(f"Wavelength (nm);{name}\n400;12,5\n500;50\n600;40\n")
        np.testing.assert_allclose(read_table(tmp_path / "qe.csv").responses(False, "per_energy")[0], [0.125, 0.5, 0.4])


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (OCEAN + BEGIN + "400\t1\n410\tx\n420\t2\n", "not a row of numbers"),
        (OCEAN + BEGIN + "400\tx\n410\t1\n420\t2\n", "not a row of numbers"),
        (PREAMBLE + "Wavelength;a;b\n400;1\n410;2\n", "the heading has 3 columns, but the rows have 2"),
        (OCEAN + BEGIN + END, "is not a table with a wavelength"),
        ("Operator: me\nx;a;b\n400;1;2\n410;1;2\n", 'no column of "x, a, b" contains wavelengths'),
        ("Wavelength;a\n400;1,5\n410;2.5\n", "commas and points"),
        (
            "Wavelength (nm);a (W/m²/nm)\n400;1\n410;2\n",
            "not of spectral radiance; measure the radiance that the camera records",
        ),
        ("\x00\x01\x02", "not a text file"),
    ],
)
def test_a_wrong_export_is_one_line(content: str, message: str, tmp_path: Path) -> None:
    (tmp_path / "export.csv").write_bytes(content.encode("utf-8") if "\0" not in content else b"\xff\x00\x01\x02")
    with pytest.raises(InputFileError, match=re.escape(message)) as caught:
        read_table(tmp_path / "export.csv").photons(None)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    "content", ["", "<a>", '<?xml version="1.0"?><IESTM2714/>', '<IESTM2714 xmlns="iestm2714"/>', "\0\0"]
)
def test_a_wrong_spdx_is_one_line(content: str, tmp_path: Path) -> None:
    (tmp_path / "lamp.spdx").write_text(content)
    with pytest.raises(InputFileError, match=r"lamp\.spdx"):
        read_table(tmp_path / "lamp.spdx")
