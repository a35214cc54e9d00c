"""Colours and names in pictures, and pictures in both themes."""

import io
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from matplotlib.figure import Figure
from PIL import Image

from benchmarks.arena.policies import is_bound

NUM_COLORS = 128


@dataclass(frozen=True, slots=True)
class Theme:
    """Colours of a picture on light or on dark paper."""

    paper: str
    ink: str
    """Text and walls, and the bound that is no competitor."""
    muted: str
    """Axes, grid, and the policy `random`, which is there for reference."""
    unknown: str
    """Map cells that were never seen."""
    error: str
    """True walls over the map."""
    lines: tuple[str, ...]
    """One per policy, in order, told apart also by readers who do not see all colours: after Okabe and Ito, "Color
    Universal Design" (2008). Where they repeat, the line style differs."""
    times: tuple[str, ...]
    """From the first cells seen to the last."""

    def colors(self, policies: Sequence[str]) -> dict[str, str]:
        """Give every policy its colour."""
        colors = {policy: self.lines[k % len(self.lines)] for k, policy in enumerate(_competitors(policies))}
        return {policy: colors.get(policy, self.ink if is_bound(policy) else self.muted) for policy in policies}

    def dashes(self, policies: Sequence[str]) -> dict[str, tuple[float, Sequence[float]]]:
        """Give every policy its line style: dotted for the bound, for competitors another one when colours repeat."""
        solid, dashed, dash_dot, dotted = (0.0, ()), (0.0, (5.0, 1.2)), (0.0, (6.0, 1.5, 1.5, 1.5)), (0.0, (1.0, 1.2))
        styles = {
            policy: (solid, dashed, dash_dot)[k // len(self.lines) % 3]
            for k, policy in enumerate(_competitors(policies))
        }
        return {policy: styles.get(policy, dotted if is_bound(policy) else solid) for policy in policies}


def _competitors(policies: Sequence[str]) -> list[str]:
    return [policy for policy in policies if policy != "random" and not is_bound(policy)]


LIGHT = Theme(
    paper="#ffffff",
    ink="#1d2129",
    muted="#7c838f",
    unknown="#e7e9ed",
    error="#d43d2a",
    lines=("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#d69400", "#42a5e0"),
    times=("#fdf0c3", "#b9dfb4", "#63b6bd", "#4a7fb8"),
)
DARK = Theme(
    paper="#16191f",
    ink="#e8eaee",
    muted="#8b93a1",
    unknown="#262b34",
    error="#ff7a66",
    lines=("#4aa3e8", "#ff8a4c", "#3fcfa0", "#e79ac4", "#f2c14e", "#a8dcff"),
    times=("#8a7a3a", "#4f8058", "#2f7480", "#2f5487"),
)


def short(policy: str) -> str:
    """Return a policy's name for a legend: of `ppo:a/long/path` the kind and the last part."""
    kind, _, path = policy.partition(":")
    parts = [part for part in path.split("/") if part not in ("", "checkpoints")]
    return f"{kind} {parts[-1]}" if parts and len(path) > 24 else policy


@dataclass(frozen=True, slots=True)
class Picture:
    """A picture on light and on dark paper: contents of PNG files."""

    light: bytes
    dark: bytes

    @classmethod
    def of(cls, draw: Callable[[Theme], Figure]) -> "Picture":
        """Draw twice."""
        return cls(_to_png(draw(LIGHT)), _to_png(draw(DARK)))


def _to_png(figure: Figure) -> bytes:
    """Return a PNG file with a palette: a third of the size of one with true colours, and they look the same."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png")
    image = Image.open(buffer).convert("RGB").quantize(NUM_COLORS, dither=Image.Dither.NONE)
    buffer = io.BytesIO()
    image.save(buffer, format="png", optimize=True)
    return buffer.getvalue()
