"""Element that GStreamer's loader of Python plugins finds if GST_PLUGIN_PATH names the folder above this one's.

The environment that holds this file need not be that of the loader's Python: what is installed beside l3cli comes first.
"""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[4]))

from gi.repository import Gst

from l3cli.video_hosts.gstreamer import NAME, L3Render

__gstelementfactory__ = (NAME, Gst.Rank.NONE, L3Render)
