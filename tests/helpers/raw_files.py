"""A table of a small camera that matches the mosaics in the raw test files."""

import dataclasses

from tests.helpers.cameras import BAYER
from tests.helpers.tables import random_table

RGGB = dataclasses.replace(random_table(BAYER, bits=12, black_level=64.0), camera_name="RGGB", rows=32, cols=40)
