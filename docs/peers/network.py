"""The network of Gharbi, Chaurasia, Paris and Durand (Deep Joint Demosaicking and Denoising, 2016), from demosaicnet."""

import functools
import warnings
from typing import Any

import numpy as np
from rivals import CFA, PLAIN, Array, NotInstalled, Rival, installed

from l3cli.evaluation.demosaic import tiled
from l3cli.frames.frame import pad_mosaic
from l3cli.physics.display import srgb_curve, srgb_decoded

MARGIN = 48  # margin in pixels: whole periods, at least one period more than the networks cut off on each side
NETWORKS = {(2, 2): "BayerDemosaick", (6, 6): "XTransDemosaick"}


def rivals(period: tuple[int, int], noisy: bool) -> list[Rival]:
    """Return the network for the array with this period, which begins at the same pixel as the array of l3.

    If `noisy`, mosaics are linear, and the network is also run on sRGB values, on which it was trained. Raises NotInstalled
    if demosaicnet or torch is missing.
    """
    program = installed("demosaicnet")
    model = _model(NETWORKS[period])
    settings = {PLAIN: functools.partial(_shown, model)}
    if noisy:
        settings["as sRGB codes"] = functools.partial(_encoded, model)
    return [Rival("network", program, settings)]


def _model(name: str) -> Any:
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            import demosaicnet
    except ImportError as error:
        raise NotInstalled(f"demosaicnet ({error.name} is missing)") from error
    return getattr(demosaicnet, name)(pretrained=True).eval()


def _shown(model: Any, mosaic: Array, cfa: CFA) -> Array:
    """Demosaic a mosaic (see `rivals.Demosaic`)."""
    import torch

    padded = pad_mosaic(mosaic, MARGIN, cfa.shape).astype(np.float32)
    padded = padded[tuple(slice(length - length % by) for length, by in zip(padded.shape, cfa.shape, strict=True))]
    channel = tiled(cfa, padded.shape)
    planes = np.where(channel == np.arange(3)[:, None, None], padded, np.float32(0.0))
    with torch.no_grad():
        made = model(torch.from_numpy(planes[None]))[0].numpy().astype(np.float64)
    first = MARGIN - (padded.shape[0] - made.shape[1]) // 2
    return made[:, first : first + mosaic.shape[0], first : first + mosaic.shape[1]]


def _encoded(model: Any, mosaic: Array, cfa: CFA) -> Array:
    return srgb_decoded(_shown(model, srgb_curve(np.clip(mosaic, 0.0, 1.0)), cfa))
