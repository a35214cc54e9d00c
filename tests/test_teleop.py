import math
import os
import subprocess
import sys
from pathlib import Path

import gymnasium
import numpy as np
import pygame
import pytest

from lidarnaut import make_policy
from lidarnaut.baselines.episode import run_episode
from lidarnaut.envs.command_line import run_command
from lidarnaut.envs.core import LidarEnv
from lidarnaut.envs.geometry import Pose2D
from lidarnaut.envs.rendering import style
from lidarnaut.envs.rendering.view import View
from lidarnaut.envs.tasks.explore import Explore
from lidarnaut.envs.tasks.navigate import Navigate
from lidarnaut.envs.teleop import Teleop, main
from lidarnaut.envs.worlds import load_map, save_map

QUICK = {"world": "turtlebot3_world", "physics": "kinematic", "start": "spawn"}
MAP_PANEL, INSET = np.s_[648:1264, 108:680], np.s_[656:816, 116:276]
"""Parts of the picture: the map, and the tested poses."""


class Driver:
    def __init__(self, path, task=Explore, **arguments):
        self.env = LidarEnv(task, **QUICK, **arguments or {"slam": "truth"})
        self.teleop = Teleop(self.env, path, seed=0)
        self.teleop.renderer.fps = 0  # as fast as possible
        pygame.event.clear()

    def shows(self, part, colour):
        """Return whether a color is in a part of the picture."""
        surface = self.teleop.renderer._window.get_surface()
        picture = np.array(pygame.surfarray.array3d(surface)).astype(int)
        return bool((np.abs(picture[part] - colour).max(axis=-1) < 5).any())

    @property
    def title(self):
        return self.teleop.renderer._window.title

    def pixel(self, x, y):
        """Return the pixel of a point in the world on the map panel."""
        view = View(self.env.world.bounds, (616, 572))
        return tuple(np.rint(view.pixels(np.array([(x, y)]))[0] + (648, 108)).astype(int).tolist())

    def drag(self, key, start, end):
        """Press the key of a tool, and drag between two pixels; return the shown path before the release."""
        self.tick(1, up=[key], down=[key])
        pygame.event.post(pygame.event.Event(pygame.MOUSEBUTTONDOWN, button=1, pos=start))
        pygame.event.post(pygame.event.Event(pygame.MOUSEMOTION, pos=end))
        self.tick(1)
        middle = np.s_[start[0] - 2 : end[0] + 3, min(start[1], end[1]) - 2 : max(start[1], end[1]) + 3]
        during = self.shows(middle, style.PLAN)
        pygame.event.post(pygame.event.Event(pygame.MOUSEBUTTONUP, button=1, pos=end))
        self.tick(1)
        return during

    def tick(self, steps, up=(), down=()):
        for kind, keys in ((pygame.KEYUP, up), (pygame.KEYDOWN, down)):
            for key in keys:
                pygame.event.post(pygame.event.Event(kind, key=key))
        assert all([self.teleop.tick() for _ in range(steps)])

    def close(self):
        self.teleop.renderer.close()
        self.env.close()

    @property
    def pose(self):
        return self.env.map_pose.compose(self.env.belief.pose)


@pytest.fixture
def driver(tmp_path):
    driver = Driver(tmp_path / "learned.yaml")
    yield driver
    driver.close()


def test_the_robot_drives_while_keys_are_held_unless_they_are_opposite(driver):
    start = driver.pose
    driver.tick(15, down=[pygame.K_UP])
    ahead = start.between(driver.pose)
    assert ahead.x > 0.1
    assert abs(ahead.y) < 0.02

    before = driver.pose
    driver.tick(15, up=[pygame.K_UP], down=[pygame.K_a])
    turned = before.between(driver.pose)
    assert 0.5 < turned.theta < 1.6
    assert math.hypot(turned.x, turned.y) < 0.05

    driver.tick(5, down=[pygame.K_SPACE])
    stopped = driver.pose
    driver.tick(5, up=[pygame.K_a, pygame.K_SPACE], down=[pygame.K_w, pygame.K_s])
    np.testing.assert_allclose(driver.pose, stopped, atol=1e-3)


def test_m_saves_the_map_and_r_starts_again(driver, tmp_path):
    driver.tick(15, down=[pygame.K_UP])
    learned = driver.env.belief.grid
    driver.tick(1, up=[pygame.K_UP], down=[pygame.K_m])
    assert f"saved {tmp_path / 'learned.yaml'}" in driver.title
    saved = load_map(tmp_path / "learned.yaml")
    assert saved.data.shape == learned.data.shape
    assert (saved.data == 0).sum() > 1000
    assert (saved.data == 100).sum() > 100

    driver.tick(1, down=[pygame.K_r])
    assert driver.env.reading.time == pytest.approx(driver.env.control_period)
    np.testing.assert_allclose(driver.pose, driver.env.map_pose, atol=1e-3)


def test_a_failed_save_is_said_and_does_no_harm(tmp_path):
    driver = Driver(tmp_path / "missing" / "learned.yaml")
    driver.tick(1, down=[pygame.K_m])
    assert "not saved: " in driver.title
    driver.close()


@pytest.mark.parametrize(
    ("event", "slam"),
    [((pygame.KEYDOWN, {"key": pygame.K_q}), "graph?preset=cartographer"), ((pygame.QUIT, {}), "gmapping")],
)
def test_q_and_closing_the_window_quit(event, slam):
    pygame.display.init()
    pygame.event.post(pygame.event.Event(*event))
    run_command(main, ["--physics", "kinematic", "--slam", slam, "--save", "learned.yaml"])


@pytest.mark.parametrize(
    ("options", "culprit"),
    [
        ({"world": "atlantis"}, "atlantis"),
        ({"slam": "gmaping"}, "unknown SLAM 'gmaping'.*gmapping"),
        ({"save": Path("/no/such/folder/map.yaml")}, "/no/such/folder"),
        ({"save": Path("map.jpg")}, "saved as .yaml, .pgm or .png, got map.jpg"),
        ({"map": Path("/no/such/map.yaml")}, "/no/such/map.yaml"),
        ({"map": Path("map.yaml"), "slam": "graph"}, "excludes --slam"),
        ({"map_pose": (0.0, 0.0, 0.0)}, "--map-pose needs --map"),
        ({"seed": -1}, "-1"),
    ],
)
def test_bad_options_are_named(options, culprit):
    with pytest.raises((ValueError, OSError, gymnasium.error.Error), match=culprit):
        main(physics="kinematic", **options)


def test_c_shows_the_poses_that_the_matcher_tests(tmp_path):
    matching = Driver(tmp_path / "learned.yaml", slam="tinyslam")
    matching.tick(20, down=[pygame.K_c, pygame.K_UP])
    assert all(matching.shows(INSET, colour) for colour in style.COSTS)
    matching.tick(1, up=[pygame.K_c], down=[pygame.K_c])
    assert not matching.shows(INSET, style.COSTS[0])
    matching.close()


@pytest.fixture(scope="module")
def known_map(tmp_path_factory):
    """Return the file of a map from an exploration that began at the spawn."""
    env = LidarEnv(Explore, **QUICK)
    run_episode(env, make_policy("nearest"), 0)
    return save_map(env.belief.grid, tmp_path_factory.mktemp("maps") / "known.yaml")


@pytest.fixture
def navigating(known_map, tmp_path):
    driver = Driver(tmp_path / "copy.yaml", Navigate, map=known_map, map_pose="spawn", time_limit=math.inf)
    yield driver
    driver.close()


def test_a_drag_gives_the_pose_estimate_and_l_spreads_the_particles(navigating):
    env = navigating.env
    x, y, _ = env.truths[0].state.pose
    start, given = navigating.pixel(x + 0.4, y + 0.3), []
    env.set_initial_pose = given.append
    assert navigating.drag(pygame.K_p, start, (start[0] + 40, start[1] - 40))
    assert env.map_pose.compose(given[0]) == pytest.approx((x + 0.4, y + 0.3, math.pi / 4), abs=0.02)
    del env.set_initial_pose
    navigating.drag(pygame.K_p, start, (start[0] + 40, start[1] - 40))
    navigating.tick(20, down=[pygame.K_a])
    assert env.scene().pose_error[0] < 0.1
    navigating.tick(1, up=[pygame.K_a], down=[pygame.K_l])
    assert env.belief.is_lost
    assert np.ptp(env.robots[0].estimator.particles[:, :2], axis=0).min() > 1.0


def test_a_drag_gives_a_goal_with_a_heading_and_keys_cancel_it(navigating):
    env, wanted, navigator = navigating.env, Pose2D(-0.55, 1.3, math.pi / 2), navigating.teleop._navigator
    assert not navigating.shows(MAP_PANEL, style.FRONTIER), "no goal is shown before one is given"
    start = navigating.pixel(*wanted[:2])
    navigating.drag(pygame.K_g, start, (start[0], start[1] - 50))
    assert env.map_pose.compose(env.task.goal) == pytest.approx(wanted, abs=0.02)
    assert navigating.shows(MAP_PANEL, style.FRONTIER)
    navigating.tick(20)
    assert navigating.shows(MAP_PANEL, style.PLAN)
    assert math.dist(env.truths[0].state.pose[:2], (-2.0, -0.5)) > 0.1
    for key in (pygame.K_SPACE, pygame.K_s, pygame.K_r):
        navigating.drag(pygame.K_g, start, (start[0], start[1] - 50))
        assert navigator.is_driving
        navigating.tick(1, down=[key])
        assert not navigator.is_driving
        navigating.tick(1, up=[key])
    assert env.reading.time == pytest.approx(2 * env.control_period)
    navigating.drag(pygame.K_g, start, (start[0], start[1] - 50))
    for _ in range(300):
        navigating.tick(1)
        if not navigator.is_driving:
            break
    assert navigating.title.startswith("arrived ")
    error = wanted.between(env.truths[0].state.pose)
    assert math.hypot(error.x, error.y) < 0.25
    assert abs(error.theta) < 0.25
    assert env.robots[0].collisions == 0


def test_goals_in_walls_and_drags_beside_the_map_change_nothing(navigating):
    env, goal = navigating.env, navigating.env.task.goal
    for start in (navigating.pixel(0.0, 0.0), (300, 400), navigating.pixel(-3.2, 0.0), (900, 710)):
        navigating.drag(pygame.K_g, start, (start[0] + 30, start[1]))
        assert env.task.goal == goal
        assert not navigating.teleop._navigator.is_driving
        assert navigating.title.startswith("goal ")
    # Without a tool, the mouse does nothing.
    for kind, x in ((pygame.MOUSEBUTTONDOWN, 900), (pygame.MOUSEBUTTONUP, 950)):
        pygame.event.post(pygame.event.Event(kind, button=1, pos=(x, 400)))
    navigating.tick(1)
    assert env.task.goal == goal


def test_a_known_map_and_people_by_options(known_map):
    pygame.display.init()
    for key in (pygame.K_l, pygame.K_q):
        pygame.event.post(pygame.event.Event(pygame.KEYDOWN, key=key))
    options = ["--physics", "kinematic", "--people", "3", "--map-pose", "-2", "-0.5", "0"]
    run_command(main, [*options, "--map", str(known_map)])


def test_a_missing_display_is_said_in_one_line():
    hidden = {"SDL_VIDEODRIVER", "DISPLAY", "WAYLAND_DISPLAY"}
    visible = {name: value for name, value in os.environ.items() if name not in hidden}
    command, root = [sys.executable, "-m", "lidarnaut.envs.teleop", "--physics", "kinematic"], Path(__file__).parents[1]
    result = subprocess.run(command, env=visible, cwd=root, capture_output=True, text=True)
    assert result.returncode != 0
    assert result.stderr.strip().splitlines()[-1].startswith("lidarnaut.envs.teleop: cannot open a window")
    assert "Traceback" not in result.stderr
