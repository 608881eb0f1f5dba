"""Plugin for GStreamer's Python loader, which loads this file if GST_PLUGIN_PATH contains the folder `plugins`.

The loader may run in another Python environment than l3cli. This file therefore puts the folder that contains the package
l3cli at the front of the module search path.
"""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[4]))

from gi.repository import Gst

from l3cli.video_hosts.gstreamer import NAME, L3Render

__gstelementfactory__ = (NAME, Gst.Rank.NONE, L3Render)
