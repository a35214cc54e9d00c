"""Compiles the kernels of environments, SLAMs and explorers in advance: python -m lidarnaut.compile_kernels."""

import importlib.util
from typing import Any

import gymnasium

from lidarnaut.agents.learned import find_policy, load_policy
from lidarnaut.baselines import EXPLORERS
from lidarnaut.baselines.episode import run_episode
from lidarnaut.envs.progress import Progress
from lidarnaut.envs.slam import SLAM_NAMES


def compile_kernels() -> None:
    """Run the first seconds of episodes with all environments, SLAMs and explorers."""
    explore = "lidarnaut/Explore-v0"
    kinematic: dict[str, Any] = {"physics": "kinematic"}
    others = ("ExploreFrontiers", "ExploreTeam", "Navigate", "ReachCrowd", "Sweep", "Track")
    ids = [explore, *(f"lidarnaut/{name}-v0" for name in others)]
    physics = ["kinematic", *(["bullet"] if importlib.util.find_spec("pybullet") else [])]
    cases: list[tuple[Any, str, Any]] = [(gymnasium.make, id, {"physics": name}) for name in physics for id in ids]
    cases += [(gymnasium.make, explore, kinematic | {"slam": slam}) for slam in SLAM_NAMES]
    cases += [(gymnasium.make, explore, kinematic | {"world": "caves"}), (gymnasium.make_vec, explore, {"num_envs": 2})]
    explorers: list[Any] = [make() for make in EXPLORERS.values()]
    explorers += [load_policy(find_policy(f"pretrained/{name}")) for name in ("frontiers", "twist")]
    with Progress(total=len(cases) + len(explorers), desc="compiling all kernels", unit="episode") as bar:
        for make, id, arguments in cases:
            env = make(id, **arguments)
            env.reset(seed=0)
            for _ in range(30):
                env.step(env.action_space.sample())
            env.close()
            bar.update()
        brief: dict[str, Any] = kinematic | {"world": "turtlebot3_world", "time_limit": 5.0}
        for explorer in explorers:
            env = gymnasium.make(explore, observations=getattr(explorer, "observations", None), **brief)
            run_episode(env, explorer, seed=0)
            bar.update()


if __name__ == "__main__":
    compile_kernels()
