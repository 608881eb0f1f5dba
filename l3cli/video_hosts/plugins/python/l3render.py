"""Plugin that GStreamer's Python loader finds if GST_PLUGIN_PATH is the parent folder of this file's folder.

The loader may use a Python of another environment. Packages that are installed beside l3cli then take precedence.
"""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[4]))

from gi.repository import Gst

from l3cli.video_hosts.gstreamer import NAME, L3Render

__gstelementfactory__ = (NAME, Gst.Rank.NONE, L3Render)
