"""Panels of a picture: ground truth, and the robot's map and pose estimate."""

import math
from functools import lru_cache

import numpy as np
import pygame
from scipy import ndimage

from lidarnaut.envs.estimation.scan_points import ScanGeometry, scan_ends
from lidarnaut.envs.geometry import OccupancyGrid, Pose2D
from lidarnaut.envs.navigation import Markers
from lidarnaut.envs.navigation.frontiers.frontiers import frontier_mask
from lidarnaut.envs.robots import RobotParams
from lidarnaut.envs.worlds import World
from lidarnaut.envs.worlds.map_worlds import left_out

from . import style
from .glyphs import draw_dashes, draw_path, draw_robot
from .scene import Scene, people_in
from .view import View

SUPERSAMPLING = 2
_NO_ALPHA_MASK = (0xFF0000, 0xFF00, 0xFF, 0)
_VISIBLE_SIDE = 4
"""Minimum drawn side of occupied map cells [px]."""
MAX_PARTICLES = 3000
_SOLID_MARK = (255, 255, 255)


def new_surface(size: tuple[int, int]) -> pygame.Surface:
    """Return a 32-bit pygame surface of `size` (width, height) [px] that needs no display."""
    return pygame.Surface(size, 0, 32, _NO_ALPHA_MASK)


def _palette() -> np.ndarray:
    shares = np.linspace(-0.06, 1.06, 101).clip(0.0, 1.0)[:, None]  # full contrast below certainty
    known = np.array(style.FREE) * (1 - shares) + np.array(style.OCCUPIED) * shares
    return (np.vstack([style.UNKNOWN, known.round()]).astype(np.uint32) << (16, 8, 0)).sum(axis=1, dtype=np.uint32)


_PALETTE = _palette()


def draw_truth(surface: pygame.Surface, scene: Scene, view: View) -> None:
    """Draw the ground truth: world, people, goal, robots with beams and paths."""
    surface.blit(_static(scene.world, view.size), (0, 0))
    for person in scene.people:
        _draw_person(surface, view, person, width=0)
    if scene.goal is not None:
        _draw_goal(surface, view, scene.start.compose(scene.goal))
    for one in (scene, *scene.peers):
        _draw_beams(surface, one, view)
    for one in (scene, *scene.peers):
        draw_path(surface, view.pixels(np.vstack([one.trail, one.pose[:2]])), style.TRUE, 4)
        draw_robot(surface, view, one.robot, one.pose, style.TRUE)


def _draw_person(surface: pygame.Surface, view: View, person: np.ndarray, width: int) -> None:
    centre, ahead = view.pixels(np.array([person[:2], person[:2] + person[2:4]]))
    pygame.draw.circle(surface, style.PERSON, centre, max(float(person[4]) * view.scale, 6.0), width)
    pygame.draw.line(surface, style.PERSON, centre, ahead, 3)


def _draw_beams(surface: pygame.Surface, scene: Scene, view: View) -> None:
    sensor, ends = beam_ends(scene.robot, scene.pose, scene.ranges)
    sensor_px, ends_px = view.pixels(sensor)[0], view.pixels(ends)
    outline = ends_px if scene.robot.lidar.fov > 2 * math.pi - 1e-6 else np.vstack([sensor_px, ends_px])
    beams = pygame.Surface(view.size, pygame.SRCALPHA, 32)
    if len(outline) > 2:
        pygame.draw.polygon(beams, (*style.LIDAR, style.SEEN_ALPHA), outline.tolist())
    for end in ends_px[:: max(1, len(ends_px) // 60)]:
        pygame.draw.line(beams, (*style.LIDAR, style.BEAM_ALPHA), sensor_px, end, 2)
    surface.blit(beams, (0, 0))
    for end in ends_px[np.isfinite(scene.ranges)].tolist():
        pygame.draw.circle(surface, style.LIDAR, end, 3.5)


def beam_ends(robot: RobotParams, pose: Pose2D, ranges: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the lidar position, shape (2,), and beam end points, shape (num_beams, 2) [m].

    Both are in the frame of `pose`. Beams without an echo end at the maximum range, invalid beams at the lidar.
    """
    lengths = np.nan_to_num(ranges.astype(np.float64), nan=0.0, posinf=robot.lidar.range_max)
    mount = np.array([(robot.lidar.mount.x, robot.lidar.mount.y)])
    return pose.transform(mount)[0], pose.transform(scan_ends(lengths, ScanGeometry.of(robot.lidar)))


@lru_cache(maxsize=8)
def _static(world: World, size: tuple[int, int]) -> pygame.Surface:
    view, lines = View(shown_bounds(world), size), new_surface(size)
    for a, b in view.pixels(world.segments.reshape(-1, 2)).reshape(-1, 2, 2).tolist():
        pygame.draw.line(lines, _SOLID_MARK, a, b, 4)
    for centre, radius in zip(view.pixels(world.circles[:, :2]).tolist(), world.circles[:, 2] * view.scale):
        pygame.draw.circle(lines, _SOLID_MARK, centre, max(radius, 3.0))
    labels, _ = ndimage.label(pygame.surfarray.array3d(lines)[..., 0] == 0)
    columns, rows = view.pixels(np.array([pose[:2] for pose in world.spawns])).astype(int).T
    floor = (labels > 0) & np.isin(labels, labels[columns, rows])
    solid = ~floor & (labels != labels[0, 0])
    edge = solid & ndimage.binary_dilation(~solid, iterations=4)
    colours = np.full((*labels.shape, 3), style.OUTSIDE, dtype=np.uint8)
    colours[floor], colours[solid], colours[edge] = style.FLOOR, style.SOLID, style.WALL
    if world.map is not None:
        pixels, is_out = np.empty(size[::-1], dtype=np.uint32), np.arange(102, dtype=np.uint32) > 100
        view.paint_grid(left_out(world), Pose2D(0.0, 0.0, 0.0), is_out.astype(np.uint32), pixels)
        colours[(pixels.T > 0) & ~edge] = style.LEFT_OUT
    surface = new_surface(size)
    pygame.surfarray.blit_array(surface, colours)
    if world.map is not None:
        pygame.draw.circle(surface, style.MUTED, (int(columns[0]), int(rows[0])), 10, 3)
    return surface


def shown_bounds(world: World) -> tuple[float, float, float, float]:
    """Return the area that pictures of a world show: x_min, y_min, x_max, y_max [m]."""
    return world.bounds if world.map is None else left_out(world).bounds


def draw_estimate(surface: pygame.Surface, scene: Scene, view: View) -> None:
    """Draw map, frontiers, estimated poses and paths, planned paths, and outlines of robots at true poses."""
    start, grid = scene.start, scene.belief.grid
    view.paint_grid(grid, start, _PALETTE, pygame.surfarray.pixels2d(surface).T)

    def draw_dots(points: np.ndarray, diameter: int, colour: style.Colour) -> None:
        disc = pygame.Surface((diameter, diameter), pygame.SRCALPHA, 32)
        pygame.draw.circle(disc, colour, (diameter / 2, diameter / 2), diameter / 2)
        corners = np.round(view.pixels(start.transform(points)) - diameter / 2).astype(int)
        surface.fblits([(disc, corner) for corner in corners.tolist()])

    side = grid.resolution * view.scale
    if side < _VISIBLE_SIDE:
        draw_dots(_centres(grid, grid.occupied), _VISIBLE_SIDE, style.OCCUPIED)
    if not scene.has_known_map:
        draw_dots(_centres(grid, frontier_mask(grid)), max(6, round(1.4 * side)), style.FRONTIER)
    if scene.particles is not None:
        draw_dots(scene.particles[:: max(1, len(scene.particles) // MAX_PARTICLES), :2], 6, style.ESTIMATED)
    if not (grid.data >= 0).any():  # no map: draw the scan
        draw_dots(beam_ends(scene.robot, scene.belief.pose, scene.ranges)[1][np.isfinite(scene.ranges)], 5, style.LIDAR)
    for person in people_in(scene.tracks, start):
        _draw_person(surface, view, person, width=3)
    if scene.goal is not None:
        _draw_goal(surface, view, start.compose(scene.goal))
    if scene.pose_graph is not None:
        draw_dots(scene.pose_graph.graph.nodes[:, :2], 8, style.NODE)
        ends = view.pixels(start.transform(scene.pose_graph.loops.reshape(-1, 2))).reshape(-1, 2, 2)
        for first, last in ends.tolist():
            pygame.draw.line(surface, style.LOOP, first, last, 2)
    if scene.markers is not None:
        _draw_predicted(surface, view, scene.markers, start)
        for k, edges in enumerate(scene.markers.trees):
            for first, last in view.pixels(start.transform(edges.reshape(-1, 2))).reshape(-1, 2, 2).tolist():
                pygame.draw.line(surface, style.LOCAL_TREE if k else style.GLOBAL_TREE, first, last, 4)
        draw_dots(scene.markers.points, 8, style.LOCAL_TREE)
        draw_dots(scene.markers.clusters, 20, style.FRONTIER)
        draw_dots(scene.markers.clusters, 12, style.PAPER)
        draw_dots(scene.markers.chosen, 24, style.PAPER)
        draw_dots(scene.markers.chosen, 18, style.PLAN)
    for one in (scene, *scene.peers):
        if one.plan is not None:
            draw_dashes(surface, view.pixels(start.transform(one.plan)), style.PLAN, 5)
        if not one.has_known_map:  # on known maps, the estimate jumps before convergence
            trail = np.vstack([one.estimated_trail, one.belief.pose[:2]])
            draw_path(surface, view.pixels(start.transform(trail)), style.ESTIMATED, 4)
        if not (one.has_known_map and one.belief.is_lost):
            draw_robot(surface, view, one.robot, one.estimated_pose, style.ESTIMATED)
        draw_robot(surface, view, one.robot, one.pose, style.TRUE, ghost=True)


def _draw_predicted(surface: pygame.Surface, view: View, markers: Markers, start: Pose2D) -> None:
    """Draw cells predicted to be floor, the more opaque the more probable, and the tour."""
    radius = max(0.5 * markers.side * view.scale, 1.0)
    cells = pygame.Surface(view.size, pygame.SRCALPHA, 32)
    pixels, alphas = view.pixels(start.transform(markers.predicted[:, :2])), 255.0 * markers.predicted[:, 2]
    for centre, alpha in zip(pixels.tolist(), alphas.astype(int).tolist()):
        pygame.draw.circle(cells, (*style.PREDICTED, alpha), centre, radius)
    surface.blit(cells, (0, 0))
    draw_path(surface, view.pixels(start.transform(markers.tour)), style.TOUR, 3)


def _draw_goal(surface: pygame.Surface, view: View, goal: Pose2D) -> None:
    tip = goal.transform(np.array([[30.0 / view.scale, 0.0]]))
    (centre, end) = view.pixels(np.vstack([goal[:2], tip])).tolist()
    pygame.draw.circle(surface, style.FRONTIER, centre, 16, 5)
    pygame.draw.line(surface, style.FRONTIER, centre, end, 5)


def _centres(grid: OccupancyGrid, mask: np.ndarray) -> np.ndarray:
    return grid.centers(np.column_stack(np.divmod(np.flatnonzero(mask), mask.shape[1])))
