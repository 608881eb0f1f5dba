"""Drafts of measurement files: information in common names of captures, and numbers and arrays found in frames."""

import numpy as np
import pytest

from l3cli.calibration.draft import names
from l3cli.calibration.draft.names import Name, altered, drawn, period_of, read_name, summarise, with_bare_wavelengths


@pytest.mark.parametrize(
    ("path", "kind", "nm", "seconds", "light"),
    [
        ("mono_450nm_03.tif", "mono", 450.0, None, None),
        ("mono/Step 07 (612.5 nm) 12ms.TIF", "mono", 612.5, 0.012, None),
        ("white_1-60s_2.tif", "white", None, 1 / 60, None),
        ("flat_D65_0.5s_1.tif", "white", None, 0.5, "D65"),
        ("d1_dark_3916ms_2019-02-08-171307-0003.tif", "dark", None, 3.916, None),
        ("Darks/250us/0001.tif", "dark", None, 2.5e-4, None),
        ("450nm/12ms/0001.tif", None, 450.0, 0.012, None),
        ("dark_250us_1.tif", "dark", None, 2.5e-4, None),
        ("d2_colorChecker30cm_550nm_100ms_2019-02-18-113629-0004.tif", "chart", 550.0, 0.1, None),
        ("015_A.tif", None, None, None, "A"),
        ("chart_3200K_12,5ms.dng", "chart", None, 0.0125, "3200K"),
        ("whiteboard_darkroom.tif", None, None, None, None),
        ("white/dark_1s.tif", "dark", None, 1.0, None),
        ("IMG_0412.CR2", None, None, None, None),
        ("lens_50mm.tif", None, None, None, None),
        ("9999nm.tif", None, None, None, None),
    ],
)
def test_a_name_states(path: str, kind: str | None, nm: float | None, seconds: float | None, light: str | None) -> None:
    name = read_name(path)
    assert (name.kind, name.nm, name.light) == (kind, nm, light)
    assert name.seconds == pytest.approx(seconds)


def test_angles_of_a_rotating_polariser() -> None:
    for path, angle in (("polariser/045deg_1.tif", 45.0), ("polarizer 22.5° 3.tif", 22.5), ("polarizer/0 deg/7.tif", 0.0)):
        assert (read_name(path).kind, read_name(path).angle) == ("polariser", angle)
    assert read_name("polariser_3.tif").angle is None
    assert read_name("white_45degrees.tif").kind == "white"


def test_wavelengths_without_unit_are_no_counters() -> None:
    def read(*paths: str) -> list[float | None]:
        return [name.nm for name in with_bare_wavelengths([read_name(path) for path in paths])]

    assert read(*(f"mono_{nm}_1.tif" for nm in range(400, 460, 10))) == [400, 410, 420, 430, 440, 450]
    assert read(*(f"mono_{number}.tif" for number in range(400, 406))) == [None] * 6
    assert read(*(f"mono_0{number}.tif" for number in range(400, 460, 10))) == [None] * 6
    assert read(*(f"white_{number}.tif" for number in range(400, 460, 10))) == [None] * 6
    assert sorted(["b10", "b9", "a"], key=names.natural) == ["a", "b9", "b10"]
    assert Name("x_too-long.tif").words == {"x", "too", "long"}


def test_an_array_is_seen_by_its_period() -> None:
    rng = np.random.default_rng(0)
    y, x = np.mgrid[:240, :300]
    light = 2000 - 3 * np.abs(x - 150) - 2 * np.abs(y - 120)
    for cfa in (
        [[1]],
        [[1, 2]],
        [[1, 2], [2, 3]],
        [[1, 2, 3]] * 3,
        [[2, 1, 4, 1], [1, 3, 1, 5], [4, 1, 2, 1], [1, 5, 1, 3]],
    ):
        array = np.array(cfa)
        site = array[y % array.shape[0], x % array.shape[1]]
        frame = rng.poisson(light * site / 3).astype(np.uint16)
        wanted = (1, 3) if array.shape == (3, 3) else array.shape  # its rows are alike
        assert period_of([frame]) == wanted
        seen = summarise(frame, wanted)
        assert seen.level.shape == (wanted[0] * wanted[1],)
        assert seen.unevenness(0.0) < 0.05


def test_what_was_done_to_the_values_is_seen() -> None:
    rng = np.random.default_rng(0)
    frame = rng.normal(1800, 60, (200, 300)).astype(np.uint16)
    assert altered(frame) is None
    assert altered(np.minimum(frame, 1850)) is None  # clipped, as converters do
    assert "multiples of 4" in str(altered(frame * np.uint16(4)))
    assert "stretched" in str(altered(np.rint(frame * 16.0037).astype(np.uint16)))
    assert "stretched" in str(altered(np.rint(4 * np.rint(frame / 16.0) ** 1.2).astype(np.uint16)))
    assert not drawn(frame)
    assert drawn(np.repeat(np.repeat(np.arange(24, dtype=np.uint16).reshape(4, 6) + 1, 40, 0), 40, 1))
