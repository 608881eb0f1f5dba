"""Plugin for GStreamer's Python loader, which finds it if GST_PLUGIN_PATH contains the folder plugins.

The loader may use the Python of another environment. The packages in the environment of l3cli then take precedence.
"""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[4]))

from gi.repository import Gst

from l3cli.video_hosts.gstreamer import NAME, L3Render

__gstelementfactory__ = (NAME, Gst.Rank.NONE, L3Render)
