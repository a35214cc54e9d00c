"""Drawing of robots, paths and legend marks, on supersampled surfaces."""

import math

import numpy as np
import pygame

from lidarnaut.envs.geometry import Pose2D
from lidarnaut.envs.geometry.lines import lengths_along, points_at
from lidarnaut.envs.robots import RobotParams

from .style import PAPER, RULE, Colour
from .view import View

MIN_ROBOT_RADIUS = 25.0
"""Minimum drawn radius of a robot [px]."""


def draw_path(surface: pygame.Surface, pixels: np.ndarray, colour: Colour, width: int) -> None:
    """Draw a line through points, shape (n, 2) [px]."""
    moved = np.any(np.diff(np.round(pixels / 2), axis=0), axis=1)
    pixels = pixels[np.concatenate([[True], moved])] if len(pixels) else pixels
    if len(pixels) > 1:
        pygame.draw.lines(surface, colour, False, pixels.tolist(), width)


def draw_dashes(surface: pygame.Surface, pixels: np.ndarray, colour: Colour, width: int) -> None:
    """Draw a dashed line through points, shape (n, 2) [px], ending in a disc."""
    if len(pixels) == 0:
        return
    travelled = lengths_along(pixels)
    ends = np.arange(0.0, travelled[-1], 7.0)
    x, y = points_at(pixels, travelled, ends).T
    for i in range(0, len(ends) - 1, 2):
        pygame.draw.line(surface, colour, (x[i], y[i]), (x[i + 1], y[i + 1]), width)
    pygame.draw.circle(surface, colour, pixels[-1], 1.5 * width)


def draw_robot(
    surface: pygame.Surface, view: View, robot: RobotParams, pose: Pose2D, colour: Colour, ghost: bool = False
) -> None:
    """Draw a robot with a heading arrow at a world pose; with `ghost`, only the outline."""
    if robot.body.size is not None:
        body = np.array([(1, 1), (-1, 1), (-1, -1), (1, -1)]) * (np.array(robot.body.size[:2]) / 2)
    else:
        angles = np.linspace(0.0, 2 * math.pi, 32, endpoint=False)
        body = np.column_stack([np.cos(angles), np.sin(angles)]) * float(robot.body.radius or robot.radius)
    body = body + robot.body.center[:2]
    centre = body.mean(axis=0)
    radius = np.hypot(*(body - centre).T).max()
    enlarged = max(1.0, MIN_ROBOT_RADIUS / (radius * view.scale))
    arrow = np.array([(0.55, 0.0), (-0.4, 0.4), (-0.2, 0.0), (-0.4, -0.4)]) * radius + centre

    def on_surface(outline: np.ndarray) -> list[list[float]]:
        return view.pixels(pose.transform(enlarged * outline)).tolist()

    if ghost:
        pygame.draw.polygon(surface, colour, on_surface(body), 4)
        pygame.draw.lines(surface, colour, False, on_surface(np.array([centre, centre + (1.7 * radius, 0.0)])), 4)
        return
    pygame.draw.polygon(surface, colour, on_surface(body))
    pygame.draw.polygon(surface, PAPER, on_surface(body), 2)
    pygame.draw.polygon(surface, PAPER, on_surface(arrow))


def draw_mark(surface: pygame.Surface, x: int, y: int, colour: Colour, mark: str) -> None:
    """Draw the symbol of a legend entry, 16 px wide from `x`, vertically centered at `y` [px]."""
    if mark == "line":
        pygame.draw.line(surface, colour, (x, y), (x + 16, y), 3)
    elif mark == "dashes":
        for offset in (0, 6, 12):
            pygame.draw.line(surface, colour, (x + offset, y), (x + offset + 4, y), 3)
    elif mark == "box":
        pygame.draw.rect(surface, colour, (x, y - 6, 16, 12))
        pygame.draw.rect(surface, RULE, (x, y - 6, 16, 12), 1)
    else:
        pygame.draw.aacircle(surface, colour, (x + 8, y), 6, 2 if mark == "ring" else 0)
