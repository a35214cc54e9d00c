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
from lidarnaut.envs.tasks.explore import Explore
from lidarnaut.envs.teleop import Teleop, main
from lidarnaut.envs.worlds import load_map


class Driver:
    def __init__(self, path):
        arguments = {"world": "turtlebot3_world", "physics": "kinematic", "start": "spawn", "render_mode": "rgb_array"}
        self.env = LidarEnv(Explore, slam="truth", **arguments)
        self.teleop = Teleop(self.env, path, seed=0)
        pygame.event.clear()

    def tick(self, steps, up=(), down=()):
        for kind, keys in ((pygame.KEYUP, up), (pygame.KEYDOWN, down)):
            for key in keys:
                pygame.event.post(pygame.event.Event(kind, key=key))
        assert all([self.teleop.tick() for _ in range(steps)])

    @property
    def pose(self):
        return self.env.map_pose.compose(self.env.belief.pose)


@pytest.fixture
def driver(tmp_path):
    driver = Driver(tmp_path / "learned.yaml")
    yield driver
    driver.teleop.close()


def test_the_robot_drives_while_keys_are_held(driver):
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
    driver.tick(1)
    np.testing.assert_allclose(driver.pose, stopped, atol=1e-3)


def test_opposite_keys_cancel_and_losing_the_focus_stops(driver):
    start = driver.pose
    driver.tick(5, down=[pygame.K_w, pygame.K_s])
    np.testing.assert_allclose(driver.pose, start, atol=1e-3)
    pygame.event.post(pygame.event.Event(pygame.WINDOWFOCUSLOST))
    driver.tick(5, up=[pygame.K_s])
    np.testing.assert_allclose(driver.pose, start, atol=1e-3)


def test_m_saves_the_map_and_r_starts_again(driver, tmp_path):
    driver.tick(15, down=[pygame.K_UP])
    learned = driver.env.belief.grid
    driver.tick(1, up=[pygame.K_UP], down=[pygame.K_m])
    saved = load_map(tmp_path / "learned.yaml")
    assert saved.data.shape == learned.data.shape
    assert (saved.data == 0).sum() > 1000
    assert (saved.data == 100).sum() > 100

    driver.tick(1, down=[pygame.K_r])
    assert driver.env.reading.time == pytest.approx(driver.env.control_period)
    np.testing.assert_allclose(driver.pose, driver.env.map_pose, atol=1e-3)


def test_a_failed_save_is_said_and_does_no_harm(tmp_path):
    driver = Driver(tmp_path / "missing" / "learned.yaml")
    silent = np.array(pygame.surfarray.array3d(driver.teleop._window.get_surface()))
    driver.tick(1, down=[pygame.K_m])
    said = pygame.surfarray.array3d(driver.teleop._window.get_surface())
    strip = (slice(640, None), slice(720, None))
    assert (said[strip] != silent[strip]).any()
    driver.teleop.close()


@pytest.mark.parametrize(
    ("event", "slam"),
    [((pygame.KEYDOWN, {"key": pygame.K_q}), "graph?preset=cartographer"), ((pygame.QUIT, {}), "gmapping")],
)
def test_q_and_closing_the_window_quit(event, slam):
    pygame.display.init()
    pygame.event.post(pygame.event.Event(*event))
    run_command(main, ["--physics", "kinematic", "--slam", slam, "--map", "learned.yaml"])


@pytest.mark.parametrize(
    ("options", "culprit"),
    [
        ({"world": "atlantis"}, "atlantis"),
        ({"slam": "gmaping"}, "unknown SLAM 'gmaping'.*gmapping"),
        ({"map": Path("/no/such/folder/map.yaml")}, "/no/such/folder"),
        ({"map": Path("map.jpg")}, "saved as .yaml, .pgm or .png, got map.jpg"),
        ({"seed": -1}, "-1"),
    ],
)
def test_bad_options_are_named(options, culprit):
    with pytest.raises((ValueError, OSError, gymnasium.error.Error), match=culprit):
        main(physics="kinematic", **options)


def test_a_missing_display_is_said_in_one_line():
    hidden = {"SDL_VIDEODRIVER", "DISPLAY", "WAYLAND_DISPLAY"}
    result = subprocess.run(
        [sys.executable, "-m", "lidarnaut.envs.teleop", "--physics", "kinematic"],
        env={name: value for name, value in os.environ.items() if name not in hidden},
        cwd=Path(__file__).parents[1],
        capture_output=True,
        text=True,
    )
    assert result.returncode != 0
    assert result.stderr.strip().splitlines()[-1].startswith("lidarnaut.envs.teleop: cannot open a window")
    assert "Traceback" not in result.stderr
