"""A task with three methods: alone, in vector environments, and in both physics."""

import math

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AutoresetMode

from lidarnaut import register
from lidarnaut.envs.core import LidarEnv
from lidarnaut.envs.geometry import Pose2D
from lidarnaut.envs.task import Task
from lidarnaut.envs.tasks.starts import UnknownWorldTask
from tests.rollouts import step_both
from tests.rooms import BURGER, make_room
from tests.vector.pairs import both

AWAY = 0.25


class Leave(UnknownWorldTask):
    """Drive away from the start. Each call of `quantities` must be the only one of its control period."""

    weights = {"gained": 1.0, "time": -0.5, "collision": -2.0, "left": 10.0}

    def reset(self, simulator, robots, rng, options):
        assert (self.simulator, self.robots) == (simulator, robots)
        self.away = self.calls = 0
        return 3.0

    def quantities(self):
        self.calls += 1
        before, self.away = self.away, math.dist(self.simulator.states[0].pose[:2], self.starts[0][:2])
        return {"gained": self.away - before, "left": float(self.away > AWAY)}

    @property
    def end_reason(self):
        return "away" if self.away > AWAY else None


class LeaveByMethod(Leave):
    def end_reason(self):
        return "away" if self.away > AWAY else None


class LeaveByAttribute(Leave):
    end_reason = None

    def quantities(self):
        found = super().quantities()
        self.end_reason = "away" if self.away > AWAY else None
        return found


ARGUMENTS = {"world": "rooms", "world_size": (6.0, 6.0), "slam": "odometry"}
TASKS = [Leave, LeaveByMethod, LeaveByAttribute]


@pytest.mark.parametrize(("task", "physics"), [*zip(TASKS, ("kinematic", "kinematic", "bullet"), strict=True)])
def test_three_methods_make_a_task(task, physics):
    env = LidarEnv(task, physics=physics, **ARGUMENTS)
    for _ in range(2):  # the end of an episode does not end the next one
        env.reset(seed=4)
        sums, terminated, steps = dict.fromkeys(task.weights, 0.0), False, 0
        while not terminated:
            _, reward, terminated, truncated, info = env.step(np.array([1.0, 0.0], dtype=np.float32))
            steps, sums = steps + 1, {name: sums[name] + term for name, term in info["rewards"].items()}
            assert reward == pytest.approx(sum(info["rewards"].values()))
            assert info["is_success"] is terminated
            assert not truncated
        assert info["end_reason"] == "away"
        assert env.task.calls == steps > 5
        assert sums["gained"] == pytest.approx(env.task.away)
        assert AWAY < env.task.away < AWAY + 0.1
        assert (sums["time"], sums["left"]) == (pytest.approx(-0.05 * steps), 10.0)
        assert sums["collision"] == 0.0
    env.close()


@pytest.mark.filterwarnings("error")
def test_the_checker_of_gymnasium_accepts_a_task_with_three_methods():
    check_env(LidarEnv(Leave, physics="kinematic", **ARGUMENTS), skip_render_check=True)


class Stay(UnknownWorldTask):
    weights = {"time": -1.0, "collision": -3.0, "forward_speed": 2.0}

    def reset(self, *arguments):
        """Return no time limit."""


def test_time_contact_and_speed_are_rewarded_without_a_method_for_300_s():
    room = make_room(0.0, 0.0, 3.0, 2.0, spawn=Pose2D(2.8, 1.0, 0.0))
    env = LidarEnv(Stay, physics="kinematic", world=room, start="spawn", robot=BURGER)
    env.reset(seed=0)
    assert env.time_limit == Task.reset(env.task, env.simulator, env.robots, env.np_random, {}) == 300.0
    touched = 0
    for _ in range(20):
        *_, info = env.step(np.array([1.0, 0.0], dtype=np.float32))
        contact = env.reading.bumper
        touched += contact
        speed = env.simulator.states[0].twist.v
        assert info["rewards"] == pytest.approx(
            {"time": -0.1, "collision": -0.3 * contact, "forward_speed": 0.2 * speed}
        )
    assert 0 < touched < 20


@pytest.mark.parametrize(
    ("task", "mode", "physics"),
    [
        (Leave, "SAME_STEP", "kinematic"),
        (LeaveByMethod, "NEXT_STEP", "bullet"),
        (LeaveByAttribute, "NEXT_STEP", "kinematic"),
    ],
)
def test_a_vector_environment_steps_a_task_with_three_methods_as_alone(task, mode, physics):
    id, arguments = f"tests/{task.__name__}-v0", {"physics": physics, "observations": ("scan", "motion"), **ARGUMENTS}
    register(id, task)
    try:
        with both(id, AutoresetMode[mode], 0, arguments) as (ours, theirs):
            rng, ends = np.random.default_rng(0), 0
            actions = rng.uniform((0.3, -0.3), (1.0, 0.3), (35, 3, 2)).astype(np.float32)
            for (_, terminated, _), _ in step_both(ours, theirs, actions, seed=4):
                calls = [[each.calls for each in env.get_attr("task")] for env in (ours, theirs)]
                assert calls[0] == calls[1]
                ends += int(terminated.sum())
            assert ends >= 3
    finally:
        gymnasium.registry.pop(id)
