"""Illuminants, reflectances and charts in instrument formats: illuminant A has the XYZ of colour-science."""

import re
from pathlib import Path

import colour
import numpy as np
import pytest

from l3cli.artifacts.camera_curves import ResponsivityRecipe, curve_table
from l3cli.artifacts.camera_curves import responsivity as camera_responsivity
from l3cli.errors import InputFileError
from l3cli.simulation.light import read_curve
from l3cli.spectra.file import FORMATS, formats_table, names_file, read_table

NM = np.arange(380.0, 781.0, 5.0)
LIGHT_A = colour.SDS_ILLUMINANTS["A"].copy().align(colour.SpectralShape(380, 780, 5)).values
GREY = 0.25 + 0.5 * (NM - 380) / 400  # a reflectance


def xyz(wavelength: np.ndarray, power: np.ndarray) -> np.ndarray:
    """XYZ of a light, Y = 100."""
    matching = colour.MSDS_CMFS["CIE 1931 2 Degree Standard Observer"].copy().align(colour.SpectralShape(380, 780, 5)).values
    np.testing.assert_array_equal(wavelength, NM)
    values = power @ matching
    return 100 * values / values[1]


def pairs(separator: str, values: np.ndarray = LIGHT_A, point: str = ".", end: str = "\n") -> str:
    lines = [f"{nm:.2f}{separator}{value:.6f}".replace(".", point) for nm, value in zip(NM, values, strict=True)]
    return end.join(lines) + "\n"


def cgats(first: str, values: np.ndarray, norm: float | None, *keywords: str, names: str = "SPEC_{:03.0f}") -> str:
    fields = ["SAMPLE_ID", *(names.format(nm) for nm in NM)]
    grid = [f'SPECTRAL_BANDS "{NM.size}"', 'SPECTRAL_START_NM "380.0"', 'SPECTRAL_END_NM "780.0"']
    stated = grid if norm is not None else []
    stated += [f'KEYWORD "SPECTRAL_NORM"\nSPECTRAL_NORM "{norm}"'] if norm is not None else []
    rows = [
        " ".join([f'"{number}"', *(f"{value:.6f}" for value in row)]) for number, row in enumerate(np.atleast_2d(values), 1)
    ]
    parts = [
        first,
        "",
        'ORIGINATOR "somebody # 1"',
        *keywords,
        *stated,
        f"NUMBER_OF_FIELDS {len(fields)}",
        "BEGIN_DATA_FORMAT",
    ]
    parts += [" ".join(fields), "END_DATA_FORMAT", f"NUMBER_OF_SETS {len(rows)}", "BEGIN_DATA", *rows, "END_DATA"]
    return "\n".join(parts) + "\n"


def jcamp(data: str, *records: str, units: str = "ARBITRARY UNITS") -> str:
    head = ["##TITLE= lamp $$ a comment", "##JCAMP-DX= 4.24", "##DATA TYPE= UV-VIS SPECTRUM", "##XUNITS= NANOMETERS"]
    head += [f"##YUNITS= {units}", "##FIRSTX= 380", "##LASTX= 780", f"##NPOINTS= {NM.size}", *records]
    return "\n".join([*head, data, "##END="]) + "\n"


AFFN = "##XYDATA= (X++(Y..Y))\n" + "\n".join(
    " ".join(f"{number:g}" for number in [NM[at], *np.round(LIGHT_A[at : at + 10] * 1e4)]) for at in range(0, NM.size, 10)
)
COMMA = "##XYPOINTS= (XY..XY)\n" + pairs(", ", point=",")
PROCESSED = jcamp(COMMA).replace("= 380", "= 380,00").replace("##TITLE= lamp", "##TITLE= PROCESSED SPECTRUM")
LINKED = "##TITLE= EXPORTED\n##DATA TYPE= LINK\n##BLOCKS= 2\n" + jcamp(
    "##XYPOINTS= (XY..XY)\n" + pairs(", ", 0 * NM + 7), units="COUNTS"
) + PROCESSED  # fmt: skip
SPECTRASUITE = (
    "SpectraSuite Data File\n++++++++++++++++++++++++++++++++++++\nDate: Mon May 04 10:00:00 CEST 2026\nUser: lab\n"
)
JAZ = "Jaz Data File\n++++++++++++\nIntegration Time (usec): 100000 (JAZA0001)\nNumber of Pixels in Processed Spectrum: 81\n"
BEGIN, END = ">>>>>Begin Processed Spectral Data<<<<<\n", ">>>>>End Processed Spectral Data<<<<<\n"
AVANTES = "M-\nIntegration time: 175 ms\nAverage: 20 scans\nData measured with spectrometer serial number: 0411041S1\n"
FILES: dict[str, str] = {
    "argyll.sp": cgats("SPECT", LIGHT_A, 1.0, 'MEAS_TYPE "EMISSION"'),
    "scaled.sp": cgats("SPECT", LIGHT_A * 100, 100.0),
    "display.ccss": cgats("CCSS", LIGHT_A, 1.0, 'DEVICE_CLASS "DISPLAY"'),
    "CAPITALS.SP": cgats("SPECT", LIGHT_A, 1.0),
    "export.txt": cgats("CGATS.17", LIGHT_A, None, names="SPECTRAL_NM{:.0f}"),
    "affn.jdx": jcamp(AFFN, "##XFACTOR= 1", "##YFACTOR= 1E-04"),
    "comma.dx": PROCESSED,
    "linked.JDX": LINKED,
    "points.jdx": jcamp("##XYPOINTS= (XY..XY)\n" + pairs(",", end="; ")),
    "suite.txt": SPECTRASUITE + BEGIN + pairs("\t") + END,
    "view.txt": "Data from lamp.txt Node\n\nXAxis mode: Wavelengths\n>>>>>Begin Spectral Data<<<<<\n" + pairs("\t"),
    "lamp.JazIrrad": JAZ + BEGIN + "W\tP\n" + pairs("\t") + END,
    "lamp.jaz": JAZ + BEGIN + "W\tD\tR\tS\tP\n" + pairs("\t9.5\t8.5\t7.5\t") + END,
    "lamp.trt": AVANTES + "Wave   ;Irradiance\n[nm]   ;[uW/cm2/nm] \n" + pairs(";", point=","),
    "lamp.ttt": AVANTES
    + "Wave ;Dark ;Sample ;Irradiance\n[nm]   ;[counts] ;[counts] ;[uW/cm2/nm] \n\n"
    + pairs("; 5.1; 7.2;"),
    "lamp.IRR": '"File: lamp"\n"IRR";Time (ms)=100;Avg=5;Sm=0;Device=EPP2000\n' + pairs("   "),
    "cie.csv": pairs(","),
    "excel.csv": "sep=;\nnm;W/m2/nm\n" + pairs(";", point=","),
}


@pytest.mark.parametrize("name", FILES)
def test_a_light_keeps_its_white(name: str, tmp_path: Path) -> None:
    (tmp_path / name).write_text(FILES[name])
    assert names_file(name)
    wavelength, power = read_curve(tmp_path / name, "light")
    np.testing.assert_allclose(wavelength, NM)
    np.testing.assert_allclose(power[0] / power[0].max(), LIGHT_A / LIGHT_A.max(), atol=1e-4)
    np.testing.assert_allclose(xyz(wavelength, power[0]), xyz(NM, LIGHT_A), atol=0.02)
    np.testing.assert_allclose(xyz(wavelength, power[0]), [109.85, 100, 35.58], atol=0.1)  # CIE 15


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("chart.ti3", cgats("CTI3", np.array([100 * GREY, 50 * GREY]), None, 'DEVICE_CLASS "INPUT"')),
        ("chart.cie", cgats("CTI3", np.array([100 * GREY, 50 * GREY]), 100.0, 'DEVICE_CLASS "INPUT"')),
        ("chart.sp", cgats("SPECT", np.array([100 * GREY, 50 * GREY]), 100.0, 'MEAS_TYPE "REFLECTIVE"')),
        ("chart.txt", cgats("CGATS.17", np.array([GREY, 0.5 * GREY]), None, names="nm{:.0f}")),
        ("percent.txt", cgats("CGATS.17", np.array([100 * GREY, 50 * GREY]), None, names="SPECTRAL_{:.0f}")),
        ("nm.txt", cgats("NUMBER_OF_FIELDS 82", np.array([GREY, 0.5 * GREY]), None, names="{:.0f}_NM")),
    ],
)
def test_reflectances_of_a_chart(name: str, content: str, tmp_path: Path) -> None:
    (tmp_path / name).write_text(content)
    table = read_table(tmp_path / name)
    np.testing.assert_allclose(table.wavelength, NM)
    np.testing.assert_allclose(table.shares(), [GREY, 0.5 * GREY], atol=1e-6)
    assert table.names == ("1", "2")


def test_a_reflectance_is_no_light(tmp_path: Path) -> None:
    (tmp_path / "paper.sp").write_text(cgats("SPECT", 100 * GREY, 100.0, 'MEAS_TYPE "REFLECTIVE"'))
    with pytest.raises(InputFileError, match=re.escape("paper.sp")):
        read_curve(tmp_path / "paper.sp", "light")


def test_argyll_states_a_grid_that_its_fields_round(tmp_path: Path) -> None:
    grid = np.linspace(380, 730, 106)
    fields = " ".join(f"SPEC_{int(nm + 0.5):03d}" for nm in grid)
    (tmp_path / "fine.sp").write_text(
        'SPECT\nSPECTRAL_BANDS "106"\nSPECTRAL_START_NM "380.0"\nSPECTRAL_END_NM "730.0"\nSPECTRAL_NORM "1.0"\n'
        f"BEGIN_DATA_FORMAT\n{fields}\nEND_DATA_FORMAT\nBEGIN_DATA\n{' '.join(map(str, grid))}\nEND_DATA\n"
    )
    table = read_table(tmp_path / "fine.sp")
    np.testing.assert_allclose(table.wavelength, grid)
    np.testing.assert_allclose(table.values[0], grid)


PACKED = {
    "FIX": ("1 2 3 3 2 1 0 -1 -2 -3", "500 1 9"),
    "PAC": ("+1+2+3+3+2+1+0-1-2-3", "500+1+9"),
    "SQZ": ("1BCCBA@abc", "500AI"),
    "DIF": ("1JJ%jjjjjj", "490cMQ"),  # the last ordinate again, as a check, then differences of 4 and 8
    "DIFDUP": ("1JJ%jX", "490cMQ"),
}


@pytest.mark.parametrize("form", PACKED)
def test_packed_forms_of_jcamp(form: str, tmp_path: Path) -> None:
    """One series in the forms of JCAMP-DX 4.24."""
    first, second = PACKED[form]
    (tmp_path / "a.jdx").write_text(
        "##TITLE=a\n##JCAMP-DX=4.24\n##XUNITS=NANOMETERS\n##YUNITS=RELATIVE\n##FIRSTX=400\n##LASTX=510\n##NPOINTS=12\n"
        f"##YFACTOR=0.5\n##XYDATA=(X++(Y..Y))\n400 {first}\n{second}\n##END=\n"
    )
    table = read_table(tmp_path / "a.jdx")
    np.testing.assert_allclose(table.wavelength, np.arange(400, 511, 10))
    np.testing.assert_allclose(table.values[0], 0.5 * np.array([1, 2, 3, 3, 2, 1, 0, -1, -2, -3, 1, 9]))


@pytest.mark.parametrize(
    ("units", "factor"), [("TRANSMITTANCE", 1), ("% TRANSMITTANCE", 100), ("Transmission (%)", 100), ("REFLECTANCE", 1)]
)
def test_shares_of_jcamp(units: str, factor: float, tmp_path: Path) -> None:
    (tmp_path / "filter.jdx").write_text(jcamp("##XYPOINTS= (XY..XY)\n" + pairs(", ", factor * GREY), units=units))
    np.testing.assert_allclose(read_curve(tmp_path / "filter.jdx", "transmittance")[1][0], GREY, atol=1e-6)


FEW = "##XYDATA= (X++(Y..Y))\n380 1 2 3"
TWO = 'SPECT\nSPECTRAL_BANDS "3"\nSPECTRAL_START_NM "380"\nSPECTRAL_END_NM "400"\nBEGIN_DATA_FORMAT\nSPEC_380 SPEC_400\n'


@pytest.mark.parametrize(
    ("name", "content", "culprit"),
    [
        ("counts.jdx", jcamp("##XYPOINTS= (XY..XY)\n" + pairs(", "), units="COUNTS"), "COUNTS"),
        ("dense.jdx", jcamp("##XYPOINTS= (XY..XY)\n" + pairs(", "), units="ABSORBANCE"), "ABSORBANCE"),
        ("infrared.jdx", jcamp(AFFN).replace("NANOMETERS", "1/CM"), "1/CM"),
        ("short.jdx", jcamp(FEW), "NPOINTS"),
        ("peaks.jdx", jcamp("##PEAK TABLE= (XY..XY)\n400, 1"), "PEAKTABLE"),
        ("damaged.jdx", jcamp("##XYDATA= (X++(Y..Y))\n380AJ%j\n383ZJ"), "damaged.jdx"),
        ("gone.jdx", jcamp("##XYDATA= (X++(Y..Y))\n380 1 ? 3"), "?"),
        ("xyz.cie", "CTI3\nBEGIN_DATA_FORMAT\nSAMPLE_ID XYZ_X\nEND_DATA_FORMAT\nBEGIN_DATA\n1 2\nEND_DATA\n", "XYZ_X"),
        ("two.sp", TWO + "END_DATA_FORMAT\nBEGIN_DATA\n1 2\nEND_DATA\n", "3 bands"),
        ("m0_m1.txt", 2 * cgats("CGATS.17", LIGHT_A, None), "2 tables"),
        ("row.sp", cgats("SPECT", LIGHT_A, 1.0).replace("END_DATA\n", "1 2\nEND_DATA\n"), "row 2"),
        ("word.sp", cgats("SPECT", LIGHT_A, 1.0).replace("9.795100", "x"), "x"),
        *((f"{unit}.csv", f"wavelength (nm),intensity ({unit})\n{pairs(',')}", unit) for unit in ("counts", "mV", "dBm")),
        *(
            (f"{head}.csv", f"wavelength (nm),{head}\n{pairs(',')}", head.lower()[-6:])
            for head in ("Counts", "sample_counts")
        ),
        ("stated.csv", f"Y axis: counts\nwavelength,sample\n{pairs(',')}", "counts"),
        ("lamp.ttt", f"{AVANTES}Wave ;Sample\n[nm] ;[counts]\n{pairs(';')}", "counts"),
    ],
)
def test_what_is_no_light_is_refused_by_name(name: str, content: str, culprit: str, tmp_path: Path) -> None:
    (tmp_path / name).write_text(content)
    with pytest.raises(InputFileError) as caught:
        read_curve(tmp_path / name, "light")
    assert culprit.lower() in str(caught.value).lower()
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("first", [True, False])
def test_tables_of_colours_around_a_table_of_spectra_are_left_out(first: bool, tmp_path: Path) -> None:
    spectra = cgats("CGATS.17", LIGHT_A, 1.0)
    colours = "CGATS.17\nBEGIN_DATA_FORMAT\nSAMPLE_ID XYZ_X XYZ_Y\nEND_DATA_FORMAT\nBEGIN_DATA\n1 2 3\nEND_DATA\n"
    (tmp_path / "both.ti3").write_text(colours + spectra if first else spectra + colours)
    np.testing.assert_allclose(read_table(tmp_path / "both.ti3").values, [LIGHT_A], atol=1e-6)


@pytest.mark.parametrize("role", ["light", "transmittance"])
def test_dark_noise_below_zero_counts_as_zero(role: str, tmp_path: Path) -> None:
    values = np.where(NM < 400, -0.004, GREY)
    (tmp_path / "noise.csv").write_text(f"nm,a\n{pairs(',', values)}")
    np.testing.assert_allclose(read_curve(tmp_path / "noise.csv", role)[1][0], np.maximum(values, 0))
    (tmp_path / "wrong.csv").write_text(f"nm,a\n{pairs(',', np.where(NM < 400, -0.04, GREY))}")
    with pytest.raises(InputFileError, match=r"wrong\.csv"):
        read_curve(tmp_path / "wrong.csv", role)


def test_noise_and_wide_dark_steps_of_a_cameras_curves(tmp_path: Path) -> None:
    values = np.where((NM < 400) | (NM > 750), -0.003, GREY)
    (tmp_path / "qe.csv").write_text("nm,y (e-/photon)\n250,0\n" + pairs(",", values))
    wavelength, curve = camera_responsivity(ResponsivityRecipe(file="qe.csv"), ["y"], tmp_path)
    assert wavelength[0] == 250
    assert curve.min() == 0
    np.testing.assert_allclose(curve[0, -81:].max(), values.max(), rtol=0.02)
    assert curve_table(ResponsivityRecipe(file="qe.csv"), ["y"], tmp_path).values.min() == 0


def test_a_wide_step_counts_only_where_the_light_shines(tmp_path: Path) -> None:
    lit, dark = "nm,a\n250,0\n300,0.1\n350,0.2\n", "nm,a\n250,0\n300,90\n350,0.2\n"
    (tmp_path / "dark.csv").write_text(lit + pairs(","))
    assert read_curve(tmp_path / "dark.csv", "light")[0][0] == 250
    (tmp_path / "lit.csv").write_text(dark + pairs(","))
    with pytest.raises(InputFileError, match="250 and 300"):
        read_curve(tmp_path / "lit.csv", "light")


BLOCKS = "Red (%)\nX,Y\n400,0\n410,50\n420,0\nGreen (%)\nX,Y\n410,0\n420,25\n430,0\n"


@pytest.mark.parametrize(
    "content",
    [
        "Red (%),,Green (%),\nX,Y,X,Y\n400,0,410,0\n410,50,420,25\n420,0,430,0\n",
        "Red,,Green,\nX (nm),Y (%),X (nm),Y (%)\n400,0,410,0\n410,50,420,25\n420,0,430,0\n",
        "wavelength (nm),Red (%),wavelength (nm),Green (%)\n400,0,410,0\n410,50,420,25\n420,0,430,0\n",
        "Red (%);;Green (%);\nX;Y;X;Y\n400,0;0;410;0\n410;50;420;25,0\n420;0;430;0\n",
        "wavelength (um),Red (%),wavelength (um),Green (%)\n.4,0,.41,0\n.41,50,.42,25\n.42,0,.43,0\n",
        "x,Red (%)\n400,0\n410,50\n420,0\n\nx,Green (%)\n410,0\n420,25\n430,0\n",
        BLOCKS,
    ],
)
def test_digitised_curves(content: str, tmp_path: Path) -> None:
    (tmp_path / "plot.csv").write_text(content)
    table = read_table(tmp_path / "plot.csv").channel_columns(["Green", "Red"])
    np.testing.assert_allclose(table.wavelength, np.arange(400, 431))
    np.testing.assert_allclose(table.responses(False, "per_energy")[:, [10, 20]], [[0, 0.25], [0.5, 0]], atol=1e-12)


def test_all_faults_of_digitised_curves_at_once(tmp_path: Path) -> None:
    (tmp_path / "plot.csv").write_text(
        "Red,,Green,,Blue,\nX,Y,X,Y,X,Y\n400,10,400,0,400,0\n460,10,450,nine,410,5\n480,9,460,1,420,4\n500,0,470,0,,\n"
    )
    with pytest.raises(InputFileError) as caught:
        read_table(tmp_path / "plot.csv")
    for culprit in ("450, nine", '"Red" has a gap from 400 to 460', '"Blue" ends at 420'):
        assert culprit in str(caught.value)


def test_every_suffix_is_of_one_format() -> None:
    suffixes = [suffix for each in FORMATS for suffix in each.suffixes]
    assert len(set(suffixes)) == len(suffixes)


def test_the_page_lists_every_format() -> None:
    assert formats_table() in (Path(__file__).parents[2] / "docs/own-lab.md").read_text(encoding="utf-8")


@pytest.mark.parametrize("separator", [" ", "\t"])
def test_decimal_commas_of_cgats(tmp_path: Path, separator: str) -> None:
    fields = separator.join(["SAMPLE_ID", *(f"nm{nm}" for nm in (380, 480, 580))])
    rows = [separator.join(row) for row in (("A1", "0,05", "0,125", "0,2"), ("A2", "0,1", "0,15", "0,3"))]
    stated = 'SPECTRAL_BANDS "3"\nSPECTRAL_START_NM "380,0"\nSPECTRAL_END_NM "580,0"\nSPECTRAL_NORM "1,0"'
    lines = ["CGATS.17", stated, "BEGIN_DATA_FORMAT", fields, "END_DATA_FORMAT", "BEGIN_DATA", *rows, "END_DATA"]
    (tmp_path / "chart.txt").write_text("\n".join(lines))
    table = read_table(tmp_path / "chart.txt")
    np.testing.assert_allclose(table.wavelength, [380, 480, 580])
    np.testing.assert_allclose(table.values, [[0.05, 0.125, 0.2], [0.1, 0.15, 0.3]])
