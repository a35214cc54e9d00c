"""Picture of an episode: two panels at equal scale, a header and legends."""

import math
from collections.abc import Iterable
from pathlib import Path

import matplotlib
import numpy as np
import pygame

from . import style
from .glyphs import draw_mark
from .panels import SUPERSAMPLING, draw_estimate, draw_truth, new_surface, shown_bounds
from .scene import Scene
from .view import View

GAP = 16
HEADER = 108
FOOTER = 40
INSET = 160
TITLES = ("Ground truth", "Map and pose estimate")
LEGENDS = (
    (
        ("robot and its path", style.TRUE, "line"),
        ("lidar", style.LIDAR, "box"),
        ("solid", style.SOLID, "box"),
        ("people", style.PERSON, "disc"),
    ),
    (
        ("estimate", style.ESTIMATED, "line"),
        ("true pose", style.TRUE, "ring"),
        ("plan", style.PLAN, "dashes"),
        ("frontier, goal", style.FRONTIER, "disc"),
        ("free", style.FREE, "box"),
        ("occupied", style.OCCUPIED, "box"),
        ("unknown", style.UNKNOWN, "box"),
    ),
)
"""Legend entries of each panel: text, color and kind of symbol."""
FURTHER_LEGENDS = {
    "markers": (
        ("candidate", style.FRONTIER, "ring"),
        ("chosen", style.PLAN, "disc"),
        ("global tree", style.GLOBAL_TREE, "line"),
        ("local tree", style.LOCAL_TREE, "line"),
    ),
    "pose_graph": (("node", style.NODE, "disc"), ("loop closure", style.LOOP, "line")),
    "tested": (("best tested pose", style.COSTS[0], "disc"), ("worst", style.COSTS[-1], "disc")),
}
"""Legend entries of the map panel by the attribute of scenes that has them."""
TOUR_LEGEND = (
    *FURTHER_LEGENDS["markers"][:2],
    ("predicted floor", style.PREDICTED, "disc"),
    ("tour", style.TOUR, "line"),
)
"""Legend entries of markers with predicted floor, which have no trees."""


class Picture:
    """Painter of pictures of an episode; titles and legends are painted once."""

    def __init__(self, size: tuple[int, int]) -> None:
        """Lay out a picture of `size` (width, height) [px]."""
        width, height = size
        panel = ((width - 3 * GAP) // 2, height - HEADER - FOOTER)
        self._boxes = [pygame.Rect((GAP + i * (panel[0] + GAP), HEADER), panel) for i in (0, 1)]
        self._panel = new_surface((panel[0] * SUPERSAMPLING, panel[1] * SUPERSAMPLING))
        pygame.font.init()
        folder = Path(matplotlib.get_data_path()) / "fonts" / "ttf"
        plain, bold = folder / "DejaVuSans.ttf", folder / "DejaVuSans-Bold.ttf"
        self._fonts = {
            "label": (pygame.font.Font(plain, style.SMALL), style.MUTED),
            "title": (pygame.font.Font(bold, style.BODY), style.INK),
            "number": (pygame.font.Font(bold, style.LARGE), style.INK),
        }
        self._background, self._frame = new_surface(size), new_surface(size)
        self._background.fill(style.PAPER)
        for box, title, legend in zip(self._boxes, TITLES, LEGENDS):
            self._write(self._background, title, "title", bottomleft=(box.left, box.top - 8))
            self._legend(self._background, box, legend)

    def _write(self, surface: pygame.Surface, text: str, kind: str = "label", **anchor: tuple[int, int]) -> pygame.Rect:
        font, colour = self._fonts[kind]
        rendered = font.render(text, True, colour)
        return surface.blit(rendered, rendered.get_rect(**anchor))

    def _legend(
        self, surface: pygame.Surface, box: pygame.Rect, items: Iterable[tuple[str, style.Colour, str]]
    ) -> None:
        x, y = box.left, box.bottom + FOOTER // 2
        for text, colour, mark in items:
            draw_mark(surface, x, y, colour, mark)
            x = self._write(surface, text, midleft=(x + 22, y)).right + 14

    def paint(self, scene: Scene) -> pygame.Surface:
        """Return the picture of a scene (moment of an episode). The next call overwrites it."""
        self._frame.blit(self._background, (0, 0))
        view = View(shown_bounds(scene.world), self._panel.get_size())
        for box, draw in zip(self._boxes, (draw_truth, draw_estimate)):
            draw(self._panel, scene, view)
            pygame.transform.smoothscale(self._panel, box.size, self._frame.subsurface(box))
            pygame.draw.rect(self._frame, style.RULE, box.inflate(2, 2), 1)
        if scene.world.map is not None:
            beside = pygame.Rect(self._boxes[0].left + 366, 0, 0, self._boxes[0].bottom)
            self._legend(self._frame, beside, (("left out", style.LEFT_OUT, "box"),))
        left, top = self._boxes[1].left + 200, self._boxes[1].top - FOOTER // 2
        for name in (name for name in FURTHER_LEGENDS if getattr(scene, name) is not None):
            top -= 16
            has_tour = scene.markers is not None and name == "markers" and len(scene.markers.predicted)
            entries = TOUR_LEGEND if has_tour else FURTHER_LEGENDS[name]
            self._legend(self._frame, pygame.Rect(left, 0, 0, top), entries)
        if scene.tested is not None and len(scene.tested):
            self._draw_tested(scene.start.transform(scene.tested[:, :2]), scene.tested[:, 3])
        self._draw_scale(view.scale / SUPERSAMPLING)
        self._draw_header(scene)
        return self._frame

    def _draw_header(self, scene: Scene) -> None:
        frame, middle, right = self._frame, self._boxes[1].left, self._boxes[1].right
        name = scene.world.name
        self._write(frame, name if len(name) < 27 else f"{name[:25]}…", "number", topleft=(GAP, 14))
        self._write(frame, scene.robot.name, topleft=(GAP, 46))
        position, heading = scene.pose_error
        numbers = {
            "collisions": f"{scene.collisions}",
            "heading error": f"{math.degrees(heading):.1f}°",
            "position error": f"{100 * position:.1f} cm",
            "time": f"{int(scene.time) // 60}:{int(scene.time) % 60:02d}",
        }
        for k, (label, value) in enumerate(numbers.items()):
            self._write(frame, value, "number", topright=(right - 124 * k, 14))
            self._write(frame, label, topright=(right - 124 * k, 46))
        share = min(max(scene.progress, 0.0), 1.0)
        bar = pygame.Rect(middle - 200, 50, 300, 10)
        # Round down: 100 % means complete.
        number = self._write(frame, f"{math.floor(1000 * share) / 10:.1f} %", "number", topleft=(bar.left, 14))
        label = f"{scene.progress_label}, not localized" if scene.belief.is_lost else scene.progress_label
        self._write(frame, label, bottomleft=(number.right + 10, number.bottom - 2))
        pygame.draw.rect(frame, style.RULE, bar, border_radius=5)
        if share > 0:
            pygame.draw.rect(frame, style.TRUE, (*bar.topleft, round(bar.width * share), bar.height), border_radius=5)

    def _draw_tested(self, points: np.ndarray, costs: np.ndarray) -> None:
        away = points - points[costs.argmin()]
        reach = max(float(np.abs(away).max()), 1e-3)
        inset = pygame.Rect(self._boxes[1].topleft, (INSET, INSET)).move(8, 8)
        pygame.draw.rect(self._frame, style.PAPER, inset)
        pixels = inset.center + away * (1, -1) * (0.4 * INSET / reach)
        best_first = np.array_split(pixels[np.argsort(costs, kind="stable")], len(style.COSTS))
        for colour, some in reversed(list(zip(style.COSTS, best_first, strict=True))):
            for pixel in some.tolist():
                pygame.draw.circle(self._frame, colour, pixel, 2.5)
        self._write(self._frame, f"{250 * reach:.3g} cm wide", bottomleft=(inset.left + 6, inset.bottom - 3))

    def _draw_scale(self, pixels_per_metre: float) -> None:
        lengths = [n * 10.0**k for k in (2, 1, 0, -1, -2) for n in (5, 2, 1)]
        length = next((length for length in lengths if length * pixels_per_metre <= 120), lengths[-1])
        x, y = self._boxes[0].right, self._boxes[0].bottom + FOOTER // 2
        left = self._write(self._frame, f"{length:g} m", midright=(x, y)).left - 8
        pygame.draw.line(self._frame, style.MUTED, (left - round(length * pixels_per_metre), y), (left, y), 3)
