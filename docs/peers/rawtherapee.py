"""The demosaicing methods of RawTherapee, called with its command line (Debian package rawtherapee)."""

import functools
import re
import shutil
import subprocess
from pathlib import Path

import numpy as np
import tifffile
from raw_file import through_file
from rivals import CFA, PLAIN, Array, NotInstalled, Rival

from l3cli.physics.display import srgb_decoded

COMMAND = "rawtherapee-cli"
SECONDS = 600  # time limit for a picture
BAYER = {
    "amaze": "AMaZE", "rcd": "RCD", "lmmse": "LMMSE", "igv": "IGV", "dcb": "DCB", "vng4": "VNG4", "ahd": "AHD",
    "eahd": "EAHD", "hphd": "HPHD",
}  # fmt: skip
XTRANS = {"4-pass": "4 passes", "3-pass (best)": "3 passes", "1-pass (medium)": "1 pass"}
# Strengths for luminance and for colour, and median filter. On two of the noisy pictures, automatic strengths (CMethod=AUT)
# and larger strengths are worse than no noise reduction.
DENOISED = {
    "colour 5": (0, 5, ""),
    "5, colour 5, soft medians": (5, 5, "soft"),
    "5, colour 5, medians 3×3": (5, 5, "33"),
}
NOISY = ("amaze", "rcd", "lmmse", "igv", "dcb", "vng4")  # methods that are run on frames with noise
# Only the white balance of the file, demosaicing, and the sRGB curve, which is removed afterwards.
PROFILE = """[Version]
AppVersion=5.9
Version=349
[Exposure]
Auto=false
HistogramMatching=false
ClampOOG=false
[HLRecovery]
Enabled=false
[White Balance]
Enabled=true
Setting=Camera
[RAW]
CA=false
HotPixelFilter=false
DeadPixelFilter=false
[RAW Bayer]
Method={method}
Border=4
CcSteps=0
LMMSEIterations=2
DCBIterations=2
DCBEnhance=true
[RAW X-Trans]
Method={method}
CcSteps=0
[Color Management]
InputProfile=(cameraICC)
ToneCurve=false
WorkingProfile=sRGB
OutputProfile=RTv4_sRGB
"""
DENOISING = """[Directional Pyramid Denoising]
Enabled=true
Enhance=false
Median={medians}
MedMethod={median}
MethodMed=Lab
Luma={luma}
Chroma={chroma}
Ldetail=50
Method=Lab
LMethod=SLI
CMethod=MAN
C2Method=MANU
SMethod=shal
Gamma=1.7
Passes=1
"""


def bayer(noisy: bool) -> list[Rival]:
    """Return the methods for Bayer arrays, with noise reduction if `noisy`. Raise NotInstalled if the program is missing."""
    program = _program()
    profiles = {PLAIN: PROFILE}
    if noisy:
        profiles |= {name: PROFILE + _denoising(*strengths) for name, strengths in DENOISED.items()}
    return [
        Rival(shown, program, _settings(method, profiles)) for method, shown in BAYER.items() if not noisy or method in NOISY
    ]


def xtrans() -> list[Rival]:
    """Return the methods for X-Trans arrays. Raise NotInstalled if the program is missing."""
    program = _program()
    return [Rival(shown, program, _settings(method, {PLAIN: PROFILE})) for method, shown in XTRANS.items()]


def _program() -> str:
    if shutil.which(COMMAND) is None:
        raise NotInstalled("RawTherapee")
    answer = subprocess.run([COMMAND, "-v"], capture_output=True, text=True, timeout=SECONDS).stdout
    number = re.search(r"version ([\d.]+\d)", answer)
    return f"RawTherapee {number[1]}" if number else "RawTherapee"


def _denoising(luma: int, chroma: int, median: str) -> str:
    return DENOISING.format(luma=luma, chroma=chroma, medians=str(bool(median)).lower(), median=median or "33")


def _settings(method: str, profiles: dict[str, str]) -> dict[str, functools.partial[Array]]:
    return {name: functools.partial(_developed, text.replace("{method}", method)) for name, text in profiles.items()}


def _developed(profile: str, mosaic: Array, cfa: CFA) -> Array:
    """Demosaic a mosaic (see `rivals.Demosaic`)."""
    return through_file(functools.partial(_planes, profile), mosaic, cfa)


def _planes(profile: str, path: Path) -> Array:
    recipe, output = path.with_suffix(".pp3"), path.with_suffix(".tif")
    recipe.write_text(profile, encoding="utf-8")
    command = [COMMAND, "-q", "-o", str(output), "-p", str(recipe), "-t", "-b32", "-Y", "-c", str(path)]
    answer = subprocess.run(command, capture_output=True, text=True, timeout=SECONDS)
    if not output.exists():
        raise ValueError(f"RawTherapee made no picture: {(answer.stderr or answer.stdout).strip()[-300:]}")
    picture = tifffile.imread(output).astype(np.float64)
    return srgb_decoded(np.moveaxis(picture, -1, 0))
