"""The two halves of the picture: the ground truth, and the robot's map and pose estimate."""

import math

import numpy as np
import pygame
from scipy import ndimage

from envs.geometry import OccupancyGrid, Pose2D
from envs.navigation.frontiers import frontier_mask
from envs.robots import RobotParams
from envs.slam import PoseGraphView
from envs.worlds import World

from . import style
from .glyphs import draw_dashes, draw_path, draw_robot
from .scene import Scene
from .view import View

SUPERSAMPLING = 2
"""Panels are drawn this many times as large as they are shown; scaling down smooths every edge."""
_NO_ALPHA_MASK = (0xFF0000, 0xFF00, 0xFF, 0)
_VISIBLE_SIDE = 4
"""Occupied cells are drawn at least this large, so that walls do not fade in large worlds [px]."""
MAX_PARTICLES = 3000
"""Particles of a localizer that are drawn at most."""
_SOLID_MARK = (255, 255, 255)


def new_surface(size: tuple[int, int]) -> pygame.Surface:
    """Return a surface of 32-bit pixels that needs no display."""
    return pygame.Surface(size, 0, 32, _NO_ALPHA_MASK)


def occupancy_palette(surface: pygame.Surface) -> np.ndarray:
    """Return the pixel of a surface for every occupancy value, shape (102,), uint32; see `View.paint_grid`."""
    shares = np.linspace(-0.06, 1.06, 101).clip(0.0, 1.0)[:, None]  # maps are never quite sure of anything
    known = np.array(style.FREE) * (1 - shares) + np.array(style.OCCUPIED) * shares
    colours = [style.UNKNOWN, *known.round().astype(int).tolist()]
    return np.array([surface.map_rgb(tuple(colour)) for colour in colours], dtype=np.uint32)


class TruthPanel:
    """The ground truth: walls and bodies, the robot at its true pose, its beams, and its true path."""

    def __init__(self, size: tuple[int, int]) -> None:
        """Prepare surfaces for a panel of `size` (width, height) [px], supersampled."""
        self._surface = new_surface(size)
        self._beams = pygame.Surface(size, pygame.SRCALPHA, 32)
        self._static: tuple[World, pygame.Surface] | None = None

    def draw(self, scene: Scene, view: View) -> pygame.Surface:
        """Draw the ground truth of a scene."""
        if self._static is None or self._static[0] is not scene.world:
            self._static = scene.world, _draw_static(scene.world, view)
        self._surface.blit(self._static[1], (0, 0))
        for mover in scene.world.movers:
            centre = view.pixels(np.array(mover.position(scene.time)))[0]
            pygame.draw.circle(self._surface, style.MOVER, centre, max(mover.radius * view.scale, 6.0))
        if scene.goal is not None:
            draw_goal(self._surface, view, scene.start.compose(scene.goal))
        for one in (scene, *scene.peers):
            self._draw_beams(one, view)
        for one in (scene, *scene.peers):
            draw_path(self._surface, view.pixels(np.vstack([one.trail, one.pose[:2]])), style.TRUE, 4)
            draw_robot(self._surface, view, one.robot, one.pose, style.TRUE)
        return self._surface

    def _draw_beams(self, scene: Scene, view: View) -> None:
        """Lay the area that the last scan saw over the picture, with a dot where a beam hit."""
        sensor, ends = beam_ends(scene.robot, scene.pose, scene.ranges)
        hits = np.isfinite(scene.ranges)
        sensor_px, ends_px = view.pixels(sensor)[0], view.pixels(ends)
        outline = ends_px if scene.robot.lidar.fov > 2 * math.pi - 1e-6 else np.vstack([sensor_px, ends_px])
        self._beams.fill((0, 0, 0, 0))
        if len(outline) > 2:
            pygame.draw.polygon(self._beams, (*style.LIDAR, style.SEEN_ALPHA), outline.tolist())
        for end in ends_px[:: max(1, len(ends_px) // 60)]:
            pygame.draw.line(self._beams, (*style.LIDAR, style.BEAM_ALPHA), sensor_px, end, 2)
        self._surface.blit(self._beams, (0, 0))
        for end in ends_px[hits].tolist():
            pygame.draw.circle(self._surface, style.LIDAR, end, 3.5)


def beam_ends(robot: RobotParams, pose: Pose2D, ranges: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return where the lidar is, shape (2,), and where its beams end, shape (num_beams, 2) [m].

    In the frame in which the pose is given. Beams without a return end at the greatest range; beams that were lost end
    in the lidar.
    """
    lidar, mount = robot.lidar, (robot.lidar.mount.x, robot.lidar.mount.y)
    lengths = np.nan_to_num(ranges.astype(np.float64), nan=0.0, posinf=lidar.range_max)
    return pose.transform(np.array([mount]))[0], pose.transform(mount + (lengths * lidar.directions).T)


def _draw_static(world: World, view: View) -> pygame.Surface:
    """Draw what does not move: the floor that can be reached from the spawns, the outside, and solid between them."""
    lines = new_surface(view.size)
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
    surface = new_surface(view.size)
    pygame.surfarray.blit_array(surface, colours)
    return surface


class EstimatePanel:
    """The map with its frontiers, the estimated pose and path, the plan, and the true pose as an outline."""

    def __init__(self, size: tuple[int, int]) -> None:
        """Prepare surfaces for a panel of `size` (width, height) [px], supersampled."""
        self._surface = new_surface(size)
        self._palette = occupancy_palette(self._surface)

    def draw(self, scene: Scene, view: View) -> pygame.Surface:
        """Draw the map and the estimates of a scene, carried into the world frame."""
        surface, start, grid = self._surface, scene.start, scene.belief.grid
        view.paint_grid(grid, start, self._palette, pygame.surfarray.pixels2d(surface).T)
        side = grid.resolution * view.scale
        if side < _VISIBLE_SIDE:
            walls = view.pixels(start.transform(_centres(grid, grid.data >= 65)))
            _draw_dots(surface, walls, _VISIBLE_SIDE, style.OCCUPIED)
        if not scene.has_known_map:
            frontiers = view.pixels(start.transform(_centres(grid, frontier_mask(grid))))
            _draw_dots(surface, frontiers, max(6, round(1.4 * side)), style.FRONTIER)
        if scene.particles is not None:
            step = max(1, len(scene.particles) // MAX_PARTICLES)
            _draw_dots(surface, view.pixels(start.transform(scene.particles[::step, :2])), 6, style.ESTIMATED)
        if scene.goal is not None:
            draw_goal(surface, view, start.compose(scene.goal))
        if scene.pose_graph is not None:
            self._draw_graph(scene.pose_graph, start, view)
        for one in (scene, *scene.peers):
            if one.plan is not None:
                draw_dashes(surface, view.pixels(start.transform(one.plan)), style.PLAN, 5)
            if not one.has_known_map:  # on one, the estimate jumps until it has converged
                trail = np.vstack([one.estimated_trail, one.belief.pose[:2]])
                draw_path(surface, view.pixels(start.transform(trail)), style.ESTIMATED, 4)
            if not (one.has_known_map and one.belief.is_lost):
                draw_robot(surface, view, one.robot, one.estimated_pose, style.ESTIMATED)
            draw_robot(surface, view, one.robot, one.pose, style.TRUE, ghost=True)
        return surface

    def _draw_graph(self, graph: PoseGraphView, start: Pose2D, view: View) -> None:
        """Draw nodes, and lines from the nodes of loop closures to their submaps."""
        _draw_dots(self._surface, view.pixels(start.transform(graph.graph.nodes[:, :2])), 8, style.NODE)
        ends = view.pixels(start.transform(graph.loops.reshape(-1, 2))).reshape(-1, 2, 2)
        for first, last in ends.tolist():
            pygame.draw.line(self._surface, style.LOOP, first, last, 2)


def draw_goal(surface: pygame.Surface, view: View, goal: Pose2D) -> None:
    """Draw a goal, world frame, as a ring with a line along its heading."""
    tip = goal.transform(np.array([[30.0 / view.scale, 0.0]]))
    (centre, end) = view.pixels(np.vstack([goal[:2], tip])).tolist()
    pygame.draw.circle(surface, style.FRONTIER, centre, 16, 5)
    pygame.draw.line(surface, style.FRONTIER, centre, end, 5)


def _centres(grid: OccupancyGrid, mask: np.ndarray) -> np.ndarray:
    """Return the centres of the cells set in `mask`, shape (n, 2) [m]; `argwhere` is slow where few of many are."""
    return grid.centers(np.column_stack(np.divmod(np.flatnonzero(mask), mask.shape[1])))


def _draw_dots(surface: pygame.Surface, pixels: np.ndarray, diameter: int, colour: style.Colour) -> None:
    """Draw a disc at each of the positions, shape (n, 2) [px]."""
    disc = pygame.Surface((diameter, diameter), pygame.SRCALPHA, 32)
    pygame.draw.circle(disc, colour, (diameter / 2, diameter / 2), diameter / 2)
    surface.fblits([(disc, corner) for corner in np.round(pixels - diameter / 2).astype(int).tolist()])
