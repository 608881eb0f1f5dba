"""GStreamer for tests. It uses the Python of the system, with the packages of this environment."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.helpers.paths import ROOT

PYTHON = "/usr/bin/python3"  # the Python for which GStreamer's bindings are built
PROBE = """
import gi, h5py
for name in ("Gst", "GstBase", "GstVideo"):
    gi.require_version(name, "1.0")
from gi.repository import Gst, GstBase, GstVideo
Gst.init(None)
assert Gst.ElementFactory.find("rawvideoparse")
"""


def environment() -> dict[str, str]:
    """Return environment variables with which the system's Python finds the packages of this environment."""
    packages = [path for path in sys.path if path.endswith("-packages")]
    left = {name: value for name, value in os.environ.items() if not name.startswith(("VIRTUAL_ENV", "GST_"))}
    plugins = {"GST_PLUGIN_PATH": str(ROOT / "l3cli/video_hosts/plugins")}
    return {**left, **plugins, "PATH": "/usr/bin:/bin", "PYTHONPATH": os.pathsep.join([str(ROOT), *packages])}


def require_gstreamer() -> None:
    """Skip the test if there is no GStreamer that can use this environment."""
    if not Path(PYTHON).exists():
        pytest.skip(f"no {PYTHON}, for which GStreamer's Python is made")
    probe = subprocess.run([PYTHON, "-c", PROBE], env=environment(), capture_output=True, text=True)
    if probe.returncode:
        pytest.skip(f"no GStreamer, or {PYTHON} cannot use this environment: {probe.stderr.strip().splitlines()[-1]}")
