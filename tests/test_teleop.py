import math
import os
import subprocess
import sys
from pathlib import Path

import gymnasium
import numpy as np
import pygame
import pytest

from envs.command_line import run_command
from envs.core import LidarEnv
from envs.slam import SLAM_NAMES
from envs.tasks.explore import Explore
from envs.teleop import Teleop, main
from envs.worlds import load_map


@pytest.fixture
def env():
    return LidarEnv(
        Explore, world="turtlebot3_world", physics="kinematic", slam="truth", start="spawn", render_mode="rgb_array"
    )


@pytest.fixture
def teleop(env, tmp_path):
    teleop = Teleop(env, tmp_path / "learned.yaml", seed=0)
    pygame.event.clear()
    yield teleop
    teleop.close()


def key(kind, code):
    pygame.event.post(pygame.event.Event(kind, key=code))


def pose(env):
    return env.map_pose.compose(env.belief.pose)


def test_the_robot_drives_while_keys_are_held(env, teleop):
    start = pose(env)
    key(pygame.KEYDOWN, pygame.K_UP)
    assert all([teleop.tick() for _ in range(15)])
    ahead = start.between(pose(env))
    assert ahead.x > 0.1
    assert abs(ahead.y) < 0.02

    key(pygame.KEYUP, pygame.K_UP)
    key(pygame.KEYDOWN, pygame.K_a)
    before = pose(env)
    for _ in range(15):
        teleop.tick()
    turned = before.between(pose(env))
    assert 0.5 < turned.theta < 1.6
    assert math.hypot(turned.x, turned.y) < 0.05

    key(pygame.KEYDOWN, pygame.K_SPACE)
    for _ in range(5):
        teleop.tick()
    stopped = pose(env)
    teleop.tick()
    np.testing.assert_allclose(pose(env), stopped, atol=1e-3)


def test_opposite_keys_cancel_and_losing_the_focus_stops(env, teleop):
    start = pose(env)
    key(pygame.KEYDOWN, pygame.K_w)
    key(pygame.KEYDOWN, pygame.K_s)
    for _ in range(5):
        teleop.tick()
    np.testing.assert_allclose(pose(env), start, atol=1e-3)
    key(pygame.KEYUP, pygame.K_s)
    pygame.event.post(pygame.event.Event(pygame.WINDOWFOCUSLOST))
    for _ in range(5):
        teleop.tick()
    np.testing.assert_allclose(pose(env), start, atol=1e-3)


def test_m_saves_the_map_and_r_starts_again(env, teleop, tmp_path):
    key(pygame.KEYDOWN, pygame.K_UP)
    for _ in range(15):
        teleop.tick()
    learned = env.belief.grid
    key(pygame.KEYDOWN, pygame.K_m)
    key(pygame.KEYUP, pygame.K_UP)
    teleop.tick()
    saved = load_map(tmp_path / "learned.yaml")
    assert saved.data.shape == learned.data.shape
    assert (saved.data == 0).sum() > 1000
    assert (saved.data == 100).sum() > 100

    key(pygame.KEYDOWN, pygame.K_r)
    teleop.tick()
    assert env.reading.time == pytest.approx(env.control_period)
    np.testing.assert_allclose(pose(env), env.map_pose, atol=1e-3)


def test_a_failed_save_is_said_and_does_no_harm(env, tmp_path):
    teleop = Teleop(env, tmp_path / "missing" / "learned.yaml")
    silent = np.array(pygame.surfarray.array3d(teleop._window.get_surface()))
    key(pygame.KEYDOWN, pygame.K_m)
    assert teleop.tick()
    said = pygame.surfarray.array3d(teleop._window.get_surface())
    strip = (slice(640, None), slice(720, None))
    assert (said[strip] != silent[strip]).any()
    teleop.close()


@pytest.mark.parametrize("event", [(pygame.KEYDOWN, {"key": pygame.K_q}), (pygame.QUIT, {})])
def test_q_and_closing_the_window_quit(event):
    pygame.display.init()
    pygame.event.post(pygame.event.Event(*event))
    main(physics="kinematic", slam="truth")


@pytest.mark.parametrize("slam", SLAM_NAMES)
def test_every_slam_drives(slam, tmp_path):
    env = LidarEnv(Explore, physics="kinematic", slam=slam, start="spawn", render_mode="rgb_array")
    teleop = Teleop(env, tmp_path / "learned.yaml", seed=0)
    key(pygame.KEYDOWN, pygame.K_UP)
    assert all([teleop.tick() for _ in range(15)])
    assert env.belief.pose.x > 0.1
    assert ((env.belief.grid.data >= 0) & (env.belief.grid.data < 50)).sum() > 1000
    teleop.close()


@pytest.mark.parametrize("slam", ["graph", "gmapping"])
def test_a_slam_by_name_is_an_option(slam):
    pygame.display.init()
    pygame.event.post(pygame.event.Event(pygame.QUIT))
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
        [sys.executable, "-m", "envs.teleop", "--physics", "kinematic"],
        env={name: value for name, value in os.environ.items() if name not in hidden},
        cwd=Path(__file__).parents[1],
        capture_output=True,
        text=True,
    )
    assert result.returncode != 0
    assert result.stderr.strip().splitlines()[-1].startswith("envs.teleop: cannot open a window")
    assert "Traceback" not in result.stderr
