"""Substitute for the exploration environment: same spaces and info, no simulation.

A point robot uncovers hidden cells around its position. The environment is registered on import.
"""

import multiprocessing
import os
import signal
from functools import partial
from types import SimpleNamespace

import gymnasium
import numpy as np
from gymnasium import spaces

from lidarnaut.envs.core import LidarEnv
from lidarnaut.envs.measures import Measure, when
from lidarnaut.envs.rendering.overlay import Overlay
from lidarnaut.envs.task import Rewards

ID = "tests.agents.fake_env:Fake-v0"
MEASURES = (
    Measure("area", "area", "m²", True, lambda history: history.of("explored_area")[-1], is_headline=True),
    Measure("gained_area", "gain", "m²", True, lambda history: np.ptp(history.of("explored_area"))),
    Measure("time_to_90", "time", "s", False, partial(when, name="explored_fraction", mark=0.9), limit="time_limit"),
)
SIDE = 16
BEAMS = 36


def observation_space(num_beams=BEAMS):
    crop, scan = spaces.Box(0, 255, (3, 40, 40), np.uint8), spaces.Box(0.0, 1.0, (num_beams,), np.float32)
    motion = spaces.Box(-1.0, 1.0, (6,), np.float32)
    return spaces.Dict({"scan": scan, "map_near": crop, "map_far": crop, "motion": motion})


class FakeEnv(LidarEnv):
    metadata = {"render_modes": []}
    belief, time, has_begun = None, 0.0, False

    def __init__(self, *, split="train", world="rooms", control_hz=5.0, time_limit=None, render_mode=None, **_ignored):
        self.observation_space = observation_space()
        self.action_space = spaces.Box(-1.0, 1.0, (2,), np.float32)
        if world == "nowhere":
            raise ValueError("world 'nowhere' is unknown")
        self.world = world if split == "train" else "rooms"
        self.render_mode = render_mode
        self.control_period = 1.0 / control_hz
        self.time_limit = time_limit or 4.0
        self.robot_params = SimpleNamespace(name="fake", lidar=SimpleNamespace(num_beams=BEAMS), max_v=2.0)
        none = dict.fromkeys(("goal", "route", "coverage"))
        self.task = SimpleNamespace(
            measures=MEASURES, progress="explored_fraction", return_home=False, rewards=Rewards({}), **none
        )
        self.overlay, self.steps = Overlay(1), 0

    def close(self):
        """Release nothing."""

    def reset(self, *, seed=None, options=None):
        gymnasium.Env.reset(self, seed=seed)
        self.time = 0.0
        self.seen = np.zeros((SIDE, SIDE), dtype=bool)
        self.position = self.np_random.uniform(2, SIDE - 2, 2)
        self.heading = self.np_random.uniform(-np.pi, np.pi)
        self._look()
        return self._observe(np.zeros(2)), self._info(0.0)

    def step(self, action):
        assert self.action_space.contains(action)
        self.steps += 1
        if self.world == f"broken_{self.steps}":
            raise RuntimeError("the floor gave way")
        if multiprocessing.parent_process() is not None:
            if self.world == f"killed_{self.steps}":
                os.kill(os.getpid(), signal.SIGKILL)
            if self.world == f"failed_{self.steps}":
                raise RuntimeError("no further world")
        if self.world == f"deadly_{self.steps}":
            os.kill(os.getpid(), signal.SIGKILL)
        if self.world == f"interrupted_{self.steps}":
            raise KeyboardInterrupt
        self.time += self.control_period
        self.heading += action[1] * self.control_period
        ahead = np.array([np.cos(self.heading), np.sin(self.heading)])
        self.position = np.clip(self.position + 2.0 * action[0] * ahead * self.control_period, 0, SIDE - 1)
        gained = self._look()
        if self.world == f"priceless_{self.steps}":
            gained = np.nan
        terminated = bool(self.seen.all())
        truncated = not terminated and self.time >= self.time_limit - 1e-6
        return self._observe(action), gained, terminated, truncated, self._info(gained)

    def _look(self):
        before = self.seen.sum()
        rows, cols = np.indices(self.seen.shape)
        self.seen |= (rows - self.position[0]) ** 2 + (cols - self.position[1]) ** 2 < 6.0
        return float(self.seen.sum() - before)

    def _observe(self, action):
        crop = np.zeros((3, 40, 40), dtype=np.uint8)
        crop[1, :SIDE, :SIDE] = 255 * self.seen
        motion = np.array([*action, *action, 0.0, min(self.time / 600.0, 1.0)], dtype=np.float32)
        scan = self.np_random.random(BEAMS, dtype=np.float32)
        return {"scan": scan, "map_near": crop, "map_far": crop.copy(), "motion": motion}

    def _info(self, gained):
        return {
            "explored_fraction": float(self.seen.mean()),
            "explored_area": float(self.seen.sum()),
            "path_length": 0.0,
            "collisions": 0,
            "time": self.time,
            "pose_error": np.zeros(2),
            "rewards": {"explored": gained},
            "is_success": bool(self.seen.all()),
        }


gymnasium.register(id="Fake-v0", entry_point=FakeEnv)
