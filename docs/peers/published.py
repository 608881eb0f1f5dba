"""Published results for more pictures, listed next to the results of l3. `make peers` did not measure these results."""

# CPSNR (dB) without a border of 10 pixels, means over all 24 Kodak and all 18 McMaster pictures.
SOURCE = "table 1 of Tan, Zhang, Zuo and Zhang, *Color image demosaicking via deep residual learning*, ICME 2017"
BAYER = {
    "DLMMSE (Zhang and Wu 2005)": {"Kodak": 40.11, "McMaster": 34.47},
    "MLRI (Kiku and others 2014)": {"Kodak": 40.86, "McMaster": 36.77},
    "ARI (Monno and others 2015)": {"Kodak": 39.79, "McMaster": 37.52},
    "CDM-CNN (Tan and others 2017)": {"Kodak": 42.04, "McMaster": 38.98},
}
PICTURES = {"Kodak": "Kodak, all 24", "McMaster": "McMaster, all 18"}
