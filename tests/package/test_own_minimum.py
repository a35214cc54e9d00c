"""Names that a SLAM, a task and an explorer of one's own need at least."""

import ast
import builtins

import gymnasium
import numpy as np
import pytest

from lidarnaut.baselines.episode import run_episode
from lidarnaut.envs.core import LidarEnv

SLAM = """
import numpy as np
from lidarnaut.envs.slam.key_scans import KeyScanSlam

class Mine(KeyScanSlam):
    def match(self, ranges, predicted):
        return predicted, 1.0
"""
ESTIMATOR = """
from lidarnaut.envs.estimation import Estimator

class Mine(Estimator):
    def update(self, reading, motion):
        self.belief.pose = self.belief.pose.compose(motion)
        return self.belief
"""
TASK = """
from lidarnaut.envs.tasks.starts import UnknownWorldTask

class Mine(UnknownWorldTask):
    weights = {"reached": 1.0, "collision": -1.0}

    def reset(self, simulator, robots, rng, options):
        self.goal = rng.uniform(100.0, 200.0)
        return 30.0

    def quantities(self):
        return {"reached": float(self.end_reason is not None)}

    @property
    def end_reason(self):
        return "far" if self.simulator.states[0].pose.x > self.goal else None
"""
EXPLORER = """
from lidarnaut.baselines import Explorer
from lidarnaut.envs.simulation import Twist

class Mine(Explorer):
    def act(self, reading, belief):
        return Twist(0.5 * self.robot.max_v, 0.1)
"""


def made(source):
    exec(source, namespace := {"__name__": "mine"})
    return namespace


def names_in(source):
    """Return the names of the package that a source text uses: imported, defined by a base class, or read."""
    found = set()
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.ImportFrom):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.Attribute):
            found.add(node.attr)
        elif isinstance(node, ast.ClassDef):
            found |= {one.name for one in node.body if isinstance(one, ast.FunctionDef)}
            found |= {target.id for one in node.body if isinstance(one, ast.Assign) for target in one.targets}
    return found - {*dir(builtins)}


@pytest.mark.parametrize(
    ("source", "most"),
    [(SLAM, 10), (ESTIMATOR, 10), (TASK, 11), (EXPLORER, 6)],
    ids=["slam", "estimator", "task", "explorer"],
)
def test_few_names_make_a_part_that_works_in_an_episode(source, most):
    assert len(names_in(source)) <= most
    own, arguments, id = made(source)["Mine"], {}, "lidarnaut/Explore-v0"
    if source in (SLAM, ESTIMATOR):
        arguments["slam"] = own if source is SLAM else lambda lidar, resolution: own()
    if source is TASK:
        id = gymnasium.envs.registration.EnvSpec("Mine-v0", "lidarnaut.envs.core:LidarEnv", kwargs={"task": own})
    env = gymnasium.make(id, physics="kinematic", time_limit=2.0, **arguments)
    episode = run_episode(env, made(EXPLORER)["Mine"](), seed=0)
    assert (episode.end_reason, episode.duration) == ("time_limit", 2.0)
    assert episode.path_length > 0.1
    assert episode.position_rmse < 0.1


def test_a_task_without_methods_is_an_environment():
    class Fast(made(TASK)["UnknownWorldTask"]):
        weights = {"forward_speed": 1.0}

    env = LidarEnv(Fast, physics="kinematic")
    env.reset(seed=0)
    assert env.time_limit == 300.0
    *_, info = env.step(np.array([1.0, 0.0], dtype=np.float32))
    assert info["rewards"].keys() == {"forward_speed"}
    assert info["is_success"] is False
