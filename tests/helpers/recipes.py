"""Recipes of scenes and classes that are simulated and learned within seconds."""

SCENES = """
exposure_share = [0.9]
[[scene]]
source = "dead leaves"
size = [96, 96]
count = 10
"""
UNSEEN = """
exposure_share = [0.8]
[[scene]]
source = "composition"
size = [160, 240]
seed = 5
"""
CLASSES = "[classes]\npatch = 5\nlevels = 8\n[learning]\npatches = 5000\n"
FEW_CLASSES = "[classes]\npatch = 5\nlevels = 4\nchromas = 1\n[learning]\npatches = 300\nfirst_draws = 0\n"
SMALL = {
    "scenes": 'exposure_share = [0.9]\n[[scene]]\nsource = "dead leaves"\nsize = [64, 64]\ncount = 4\n',
    "unseen": 'exposure_share = [0.9]\n[[scene]]\nsource = "composition"\nsize = [96, 144]\nseed = 5\n',
    "classes": "[classes]\npatch = 5\nlevels = 6\nlowest_level = 0.02\nchromas = 3\nmax_cases = 4\n"
    "[learning]\npatches = 2000\ndraws = 4\nfirst_draws = 0\n",
}
