"""The picture of navigation on a known map: pose estimate, particles, plan and true pose, over the map."""

import math

import numpy as np
import pygame

from envs.geometry import Pose2D
from envs.navigation import crop_to_known

from . import style
from .glyphs import draw_dashes, draw_path, draw_robot
from .panels import SUPERSAMPLING, beam_ends, new_surface, occupancy_palette
from .picture import FOOTER, GAP, HEADER, Typesetter
from .scene import NavigationScene
from .view import View

LEGEND = (
    ("true path", style.TRUE, "line"),
    ("true pose", style.TRUE, "ring"),
    ("estimated pose", style.ESTIMATED, "box"),
    ("particles", style.ESTIMATED, "disc"),
    ("lidar", style.LIDAR, "disc"),
    ("plan", style.PLAN, "dashes"),
    ("goal", style.FRONTIER, "ring"),
)
"""What is drawn, its colour, and the kind of mark in the legend."""
MAX_PARTICLES = 3000
"""Particles that are drawn at most."""


class NavigationPicture:
    """Paints navigation scenes."""

    def __init__(self, size: tuple[int, int]) -> None:
        """Lay out a picture of `size` (width, height) [px]."""
        width, height = size
        self._box = pygame.Rect(GAP, HEADER, width - 2 * GAP, height - HEADER - FOOTER)
        self._surface = new_surface((self._box.width * SUPERSAMPLING, self._box.height * SUPERSAMPLING))
        self._frame = new_surface(size)
        self._text = Typesetter()
        self._palette = occupancy_palette(self._surface)

    def paint(self, scene: NavigationScene) -> pygame.Surface:
        """Draw a scene; the surface is used again for the next one."""
        self._frame.fill(style.PAPER)
        view = View(crop_to_known(scene.grid).bounds, self._surface.get_size())
        self._draw_map(scene, view)
        pygame.transform.smoothscale(self._surface, self._box.size, self._frame.subsurface(self._box))
        pygame.draw.rect(self._frame, style.RULE, self._box.inflate(2, 2), 1)
        error = scene.pose.between(scene.estimated_pose)
        position_error = "position error", f"{100 * math.hypot(error.x, error.y):.0f} cm"
        self._text.header(self._frame, scene, self._box, position_error)
        status = "Not localized" if scene.is_lost else "Localized"
        self._text.write(self._frame, status, "title", topleft=(self._box.left, 70))
        self._text.legend(self._frame, self._box, LEGEND)
        return self._frame

    def _draw_map(self, scene: NavigationScene, view: View) -> None:
        surface = self._surface
        view.paint_grid(scene.grid, Pose2D(0.0, 0.0, 0.0), self._palette, pygame.surfarray.pixels2d(surface).T)
        draw_path(surface, view.pixels(np.vstack([scene.trail, scene.pose[:2]])), style.TRUE, 4)
        step = max(1, len(scene.particles) // MAX_PARTICLES)
        for x, y in view.pixels(scene.particles[::step, :2]).tolist():
            pygame.draw.circle(surface, style.ESTIMATED, (x, y), 3)
        if scene.plan is not None:
            draw_dashes(surface, view.pixels(scene.plan), style.PLAN, 5)
        if scene.goal is not None:
            centre = view.pixels(np.array(scene.goal[:2]))[0]
            tip = view.pixels(scene.goal.transform(np.array([[30.0 / view.scale, 0.0]])))[0]
            pygame.draw.circle(surface, style.FRONTIER, centre, 16, 5)
            pygame.draw.line(surface, style.FRONTIER, centre, tip, 5)
        _, ends = beam_ends(scene.robot, scene.pose, scene.ranges)
        for end in view.pixels(ends)[np.isfinite(scene.ranges)].tolist():
            pygame.draw.circle(surface, style.LIDAR, end, 4)
        if not scene.is_lost:
            draw_robot(surface, view, scene.robot, scene.estimated_pose, style.ESTIMATED)
        draw_robot(surface, view, scene.robot, scene.pose, style.TRUE, ghost=True)
