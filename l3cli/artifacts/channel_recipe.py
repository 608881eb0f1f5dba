"""[channel.NAME] of a recipe: channels that are exposed or amplified apart, and those that share a filter."""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np

from l3cli.artifacts.readout import MOST_GAIN, SHORTEST, Readout
from l3cli.errors import suggestion
from l3cli.recipes.faults import Fault, fault, refuse_first
from l3cli.recipes.toml import Recipe

MOST_NOISE = 1e4  # e-


class ChannelRecipe(Recipe):
    """Readout of a channel where it differs from that of the others."""

    like: str | None = None  # the channel with the same filter, whose responsivity it has
    exposure: float = 1.0  # its exposure time over that of the frame, which is the longest
    gain: float = 1.0  # its conversion gain over sensor.gain_dn_per_e, which is the lowest
    read_noise_e: float | None = None  # at that gain; default: noise.read_noise_e


def channel_faults(channel: Mapping[str, ChannelRecipe], channels: Sequence[str]) -> Iterator[Fault]:
    """Yield the faults of a channel that does not exist or cannot be read in this way."""
    for name, one in channel.items():
        if name not in channels:
            yield fault(f'"{name}" is no channel of cfa.channels; {suggestion(name, channels)}', ("channel", name))
        numbers = (
            ("exposure", one.exposure, SHORTEST, 1.0, "a share of the frame's exposure time"),
            ("gain", one.gain, 1.0, MOST_GAIN, "a multiple of sensor.gain_dn_per_e"),
            ("read_noise_e", one.read_noise_e, 0.0, MOST_NOISE, "electrons"),
        )
        for key, value, least, most, what in numbers:
            if value is not None and not least <= value <= most:
                message = f"channel.{name}.{key} is {value:g}, and must lie in {least:g}…{most:g}: {what}"
                yield fault(message, ("channel", name, key))
        if one.like is None:
            continue
        like = ("channel", name, "like")
        if one.like not in channels:
            message = f'channel.{name}.like: "{one.like}" is no channel of cfa.channels; {suggestion(one.like, channels)}'
            yield fault(message, like)
        elif one.like == name or (one.like in channel and channel[one.like].like is not None):
            yield fault(f'channel.{name}.like: "{one.like}" has no responsivity of its own; name one that has', like)
        elif channels.index(one.like) > (channels.index(name) if name in channels else len(channels)):
            yield fault(f"channel.{name}.like: list {one.like} before {name} in cfa.channels", like, "cfa.channels")
    if channel and channels and max(channel.get(name, ChannelRecipe()).exposure for name in channels) < 1:
        message = "no channel has the exposure 1; give exposures relative to the longest, which is the frame's"
        yield fault(message, *(("channel", name, "exposure") for name in channel))


def filters_of(channel: Mapping[str, ChannelRecipe], channels: Sequence[str]) -> list[str]:
    """Return, for each channel, the one whose responsivity it has."""
    return [(channel[name].like if name in channel else None) or name for name in channels]


def settings_of(readout: Readout | None, channels: Sequence[str]) -> dict[str, ChannelRecipe]:
    """Return the recipe of a readout without its read noise, of channels that differ from the others."""
    if readout is None:
        return {}
    rows = zip(channels, readout.same_filter, readout.channel_exposure, readout.channel_gain, strict=True)
    each = {
        name: ChannelRecipe(None if channels[first] == name else channels[first], float(exposure), float(gain))
        for name, first, exposure, gain in rows
    }
    return {name: one for name, one in each.items() if one != ChannelRecipe()}


def settings_from(channel: Mapping[str, ChannelRecipe], channels: Sequence[str], path: Path) -> Readout | None:
    """Return the readout of a measurement file, of which the read noise is not yet known; RecipeError if there is no
    such."""
    refuse_first(channel_faults(channel, channels), path)
    return readout_of(channel, channels, 0.0)


def readout_of(channel: Mapping[str, ChannelRecipe], channels: Sequence[str], read_noise: float) -> Readout | None:
    """Return the readout of channels without `channel_faults`, `read_noise` (e-) being that of those that name none; None if
    all are read alike."""
    if not channel:
        return None
    each = [channel.get(name, ChannelRecipe()) for name in channels]
    return Readout(
        channel_exposure=np.array([one.exposure for one in each]),
        channel_gain=np.array([one.gain for one in each]),
        channel_read_noise=np.array([read_noise if one.read_noise_e is None else one.read_noise_e for one in each]),
        same_filter=np.array([channels.index(name) for name in filters_of(channel, channels)]),
    )
