"""All pictures of an evaluation."""

import io
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial

from matplotlib.figure import Figure
from PIL import Image

from benchmarks.arena.curve_plots import draw_curves, sample_curves
from benchmarks.arena.map_plots import draw_growth, draw_map
from benchmarks.arena.theme import DARK, LIGHT, Theme
from benchmarks.arena.trace import Trace

NUM_COLORS = 128
"""Colours of a picture's palette."""


@dataclass(frozen=True, slots=True)
class Picture:
    """A picture on light and on dark paper."""

    light: bytes
    """Content of a PNG file."""
    dark: bytes
    """Content of a PNG file."""

    @classmethod
    def of(cls, draw: Callable[[Theme], Figure]) -> "Picture":
        """Draw twice."""
        return cls(_to_png(draw(LIGHT)), _to_png(draw(DARK)))


@dataclass(frozen=True, slots=True)
class WorldPictures:
    """What there is to see of an evaluation in one world."""

    over_time: Picture
    """The explored fraction over time."""
    over_distance: Picture
    """The explored fraction over the distance driven."""
    growth: Picture
    """How the maps of each policy's first episode grew."""
    maps: Mapping[str, Picture]
    """The final map of each policy's first episode."""


def draw_world(traces: Mapping[str, Sequence[Trace]]) -> WorldPictures:
    """Draw all pictures of the episodes in one world, given by policy."""
    curves = {policy: [[trace.curve for trace in episodes]] for policy, episodes in traces.items()}
    over_time, over_distance = sample_curves(curves, "time"), sample_curves(curves, "path_length")
    firsts = {policy: episodes[0] for policy, episodes in traces.items()}
    return WorldPictures(
        Picture.of(partial(draw_curves, over_time, "time [s]")),
        Picture.of(partial(draw_curves, over_distance, "distance driven [m]")),
        Picture.of(partial(draw_growth, firsts)),
        {policy: Picture.of(partial(draw_map, trace)) for policy, trace in firsts.items()},
    )


def _to_png(figure: Figure) -> bytes:
    """Return a PNG file with a palette: a third of the size of one with true colours, and they look the same."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png")
    image = Image.open(buffer).convert("RGB").quantize(NUM_COLORS, dither=Image.Dither.NONE)
    buffer = io.BytesIO()
    image.save(buffer, format="png", optimize=True)
    return buffer.getvalue()
