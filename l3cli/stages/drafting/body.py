"""The camera of a draft: what is known of it, what its frames show, and what only the user knows."""

import numpy as np

from l3cli.artifacts.camera import CameraModel
from l3cli.calibration.draft.sorting import guess_array
from l3cli.calibration.draft.text import DraftText
from l3cli.io.photos import F_NUMBER, FOCAL_MM, PITCH_UM, array_of
from l3cli.stages.drafting.survey import Survey

PITCH = "µm between pixels, from the sensor's data sheet"


def describe_camera(out: DraftText, seen: Survey, camera: CameraModel | None, photo: bool) -> None:
    """Add [sensor], [cfa] and [optics]; `photo`: whether only charts in photographs are there, for which pitch and optics
    do not count."""
    if camera is not None:
        known_body(out, camera)
        return
    out.table("[sensor]")
    out.key("rows", seen.shape[0])
    out.key("cols", seen.shape[1])
    if photo:
        out.assume("pixel_pitch_um", PITCH_UM, "µm; curves of photos do not depend on it")
    else:
        out.todo("pixel_pitch_um", 3.45, PITCH, "[sensor]")
    _bits(out, seen)
    _array(out, seen)
    if not photo:
        unknown_optics(out)
        return
    out.table("[optics]")
    out.assume("focal_length_mm", FOCAL_MM, "mm; curves of photos do not depend on it", said=False)
    out.assume("f_number", F_NUMBER, "as above", said=False)


def known_body(out: DraftText, camera: CameraModel) -> None:
    """Add [sensor], [cfa] and [optics] of a known camera."""
    out.table("[sensor]")
    out.key("rows", camera.rows)
    out.key("cols", camera.cols)
    out.key("pixel_pitch_um", round(camera.pixel_pitch * 1e6, 9))
    out.key("bits", camera.bits)
    out.table("[cfa]")
    out.key("channels", list(camera.channels))
    out.key("pattern", [" ".join(camera.channels[site] for site in row) for row in camera.cfa])
    out.table("[optics]")
    out.key("focal_length_mm", round(camera.optics.focal_length * 1e3, 9))
    out.key("f_number", camera.optics.f_number)
    out.key("object_distance_m", camera.optics.object_distance)


def unknown_optics(out: DraftText) -> None:
    """Add [optics], which only the user knows."""
    out.table("[optics]")
    out.todo("focal_length_mm", 25.0, "mm, of the lens", "[optics]")
    out.todo("f_number", 4.0, "the aperture, as set on the lens", "[optics]")


def _bits(out: DraftText, seen: Survey) -> None:
    white, top = seen.white_level, seen.top
    bits = max(1, int(np.ceil(np.log2(max(top, white or 0) + 1))))
    why = f"the files state a white level of {white:g} DN" if white else f"the largest value of all frames is {top} DN"
    out.assume("bits", bits, why)


def _array(out: DraftText, seen: Survey) -> None:
    rows, cols = seen.period
    out.table("[cfa]")
    if seen.pattern is not None:
        array = array_of(seen.pattern)
        out.key("channels", array.channels)
        out.key("pattern", array.pattern, "as the files state it")
    elif guessed := guess_array(seen.groups_of("mono"), seen.scale, seen.period):
        why = f"sites of the {rows}×{cols} array that answer alike, named by the light they see"
        out.assume("channels", guessed.channels, why)
        out.assume("pattern", guessed.pattern, why, said=False)
    else:
        what = f"rows of names; values repeat every {rows}×{cols} pixels" if rows * cols > 1 else "rows of names"
        out.todo("channels", ["r", "g", "b"], "names of the channels of the colour filter array", "[cfa]")
        out.todo("pattern", ["r g", "g b"], what, "[cfa]")
