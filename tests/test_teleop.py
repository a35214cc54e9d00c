import math
import os
import subprocess
import sys
from pathlib import Path

import gymnasium
import numpy as np
import pygame
import pytest

from lidarnaut.envs.command_line import run_command
from lidarnaut.envs.core import LidarEnv
from lidarnaut.envs.geometry import OccupancyGrid
from lidarnaut.envs.rendering import style
from lidarnaut.envs.tasks.explore import Explore
from lidarnaut.envs.tasks.navigate import Navigate
from lidarnaut.envs.teleop import Teleop, main
from lidarnaut.envs.worlds import load_map, save_map

QUICK = {"world": "turtlebot3_world", "physics": "kinematic", "start": "spawn"}
INSET = np.s_[656:816, 116:276]
"""Part of the picture with the tested poses."""


class Driver:
    def __init__(self, path, task=Explore, **arguments):
        self.env = LidarEnv(task, **QUICK, **arguments)
        self.teleop = Teleop(self.env, path, seed=0)
        self.teleop.renderer.fps = 0  # as fast as possible
        pygame.event.clear()

    def shows_tested_poses(self):
        picture = np.array(pygame.surfarray.array3d(self.teleop.renderer._window.get_surface())).astype(int)
        return all((np.abs(picture[INSET] - colour).max(axis=-1) < 5).any() for colour in style.COSTS)

    def tick(self, steps, up=(), down=()):
        for kind, keys in ((pygame.KEYUP, up), (pygame.KEYDOWN, down)):
            for key in keys:
                pygame.event.post(pygame.event.Event(kind, key=key))
        assert all([self.teleop.tick() for _ in range(steps)])
        return self.env.map_pose.compose(self.env.belief.pose)


@pytest.fixture
def start(tmp_path):
    """Return a function that opens a window, which is closed after the test."""
    drivers = []

    def begin(*args, path=tmp_path / "learned.yaml", **arguments):
        drivers.append(Driver(path, *args, **arguments))
        return drivers[-1]

    yield begin
    for driver in drivers:
        driver.teleop.renderer.close()
        driver.env.close()


def test_the_robot_drives_while_keys_are_held_unless_they_are_opposite(start):
    driver = start(slam="truth")
    begin = driver.tick(0)
    before = driver.tick(15, down=[pygame.K_UP])
    ahead = begin.between(before)
    assert ahead.x > 0.1
    assert abs(ahead.y) < 0.02

    turned = before.between(driver.tick(15, up=[pygame.K_UP], down=[pygame.K_a]))
    assert 0.5 < turned.theta < 1.6
    assert math.hypot(turned.x, turned.y) < 0.05

    stopped = driver.tick(5, down=[pygame.K_SPACE])
    now = driver.tick(5, up=[pygame.K_a, pygame.K_SPACE], down=[pygame.K_w, pygame.K_s])
    np.testing.assert_allclose(now, stopped, atol=1e-3)


def test_m_saves_the_map_or_says_why_not_and_r_starts_again(start, tmp_path):
    driver = start(slam="truth")
    driver.tick(15, down=[pygame.K_UP])
    driver.tick(1, up=[pygame.K_UP], down=[pygame.K_m])
    assert f"saved {tmp_path / 'learned.yaml'}" in driver.teleop.renderer._window.title
    saved = load_map(tmp_path / "learned.yaml")
    assert saved.data.shape == driver.env.belief.grid.data.shape
    assert (saved.data == 0).sum() > 1000
    assert (saved.data == 100).sum() > 100

    np.testing.assert_allclose(driver.tick(1, down=[pygame.K_r]), driver.env.map_pose, atol=1e-3)
    assert driver.env.reading.time == pytest.approx(driver.env.control_period)
    unsaved = start(slam="truth", path=tmp_path / "missing" / "learned.yaml")
    unsaved.tick(1, down=[pygame.K_m])
    assert "not saved: " in unsaved.teleop.renderer._window.title


def test_c_shows_the_poses_that_the_matcher_tests(start):
    driver = start(slam="tinyslam")
    for shown in (True, False):
        driver.tick(20, up=[pygame.K_c], down=[pygame.K_c, pygame.K_UP])
        assert driver.shows_tested_poses() == shown


def test_l_localizes_globally_on_a_known_map(start):
    driver = start(Navigate)
    assert not driver.env.belief.is_lost
    driver.tick(1, down=[pygame.K_l])
    assert driver.env.belief.is_lost
    assert np.ptp(driver.env.robots[0].estimator.particles[:, :2], axis=0).min() > 1.0


QUIT = [((pygame.KEYDOWN, {"key": pygame.K_q}), ["--slam", "graph?preset=cartographer"])]
QUIT += [((pygame.QUIT, {}), ["--people", "3", "--map-pose", "-2", "-0.5", "0", "--map", "known.yaml"])]


@pytest.mark.parametrize(("event", "options"), QUIT)
def test_q_and_closing_the_window_quit(event, options, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    save_map(OccupancyGrid(np.zeros((200, 200), dtype=np.int8), 0.05, (-3.0, -4.5)), Path("known.yaml"))
    pygame.display.init()
    pygame.event.post(pygame.event.Event(*event))
    run_command(main, ["--physics", "kinematic", "--save", "learned.yaml", *options])


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


def test_a_missing_display_is_said_in_one_line():
    hidden = {"SDL_VIDEODRIVER", "DISPLAY", "WAYLAND_DISPLAY"}
    visible = {name: value for name, value in os.environ.items() if name not in hidden}
    command, root = [sys.executable, "-m", "lidarnaut.envs.teleop", "--physics", "kinematic"], Path(__file__).parents[1]
    result = subprocess.run(command, env=visible, cwd=root, capture_output=True, text=True)
    assert result.returncode != 0
    assert result.stderr.strip().splitlines()[-1].startswith("lidarnaut.envs.teleop: cannot open a window")
    assert "Traceback" not in result.stderr
