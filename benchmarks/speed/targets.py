"""The project's targets, compared with what was measured."""

from typing import NamedTuple

from benchmarks.speed.designs import Design
from benchmarks.speed.results import BODIES, FEW, MANY, Results

NAIVE, BULLET, KINEMATIC = Design("naive"), Design("bullet"), Design("kinematic")
VECTOR, TWO_CORES = Design("vector", MANY), Design("vector", MANY, 2)
BULLETS = Design("bullet_vector", FEW, 2)
TRAINING = Design("ppo", MANY, 2)


class Target(NamedTuple):
    """A figure, and the least (or, where `at_most`, the greatest) that it should be."""

    name: str
    wanted: float
    measured: float
    at_most: bool = False

    @property
    def met(self) -> bool:
        """Whether it was reached."""
        return self.measured <= self.wanted if self.at_most else self.measured >= self.wanted


def targets(results: Results) -> list[Target]:
    """Return all targets whose designs were measured, the worse of the two halls each."""
    wanted = [
        _speed(results, f"vector, {MANY} sub-environments, one core, tinyslam [steps/s]", VECTOR, "tinyslam", 10_000),
        _speed(results, f"vector, {MANY} sub-environments, one core, truth [steps/s]", VECTOR, "truth", 18_000),
        _speed(results, "bullet, tinyslam [steps/s]", BULLET, "tinyslam", 4_000),
        _ratio(results, "bullet over naive, tinyslam", BULLET, NAIVE, 10.0),
        _ratio(results, "vector on two cores over one, tinyslam", TWO_CORES, VECTOR, 1.8),
        _ratio(results, "vector over kinematic, tinyslam", VECTOR, KINEMATIC, 0.9),
        _ratio(results, "bullet vector on two cores over bullet, tinyslam", BULLETS, BULLET, 1.7),
        _speed(results, "ppo on two cores, tinyslam [steps/s]", TRAINING, "tinyslam", 8_000),
        _speed(results, "ppo on two cores, truth [steps/s]", TRAINING, "truth", 12_000),
        Target(
            "state of a sub-environment, 400 x 400 cells [MiB]", 1.0, results.state_bytes_per_env / 2**20, at_most=True
        ),
    ]
    return [target for target in wanted if target is not None]


def _speed(results: Results, name: str, design: Design, slam: str, wanted: float) -> Target | None:
    speeds = [results.speed(design, f"hall_{bodies}", slam) for bodies in BODIES]
    measured = [speed for speed in speeds if speed is not None]
    return Target(name, wanted, min(measured)) if measured else None


def _ratio(results: Results, name: str, over: Design, under: Design, wanted: float) -> Target | None:
    halls = [f"hall_{bodies}" for bodies in BODIES]
    pairs = [[results.speed(design, hall, "tinyslam") for design in (over, under)] for hall in halls]
    ratios = [above / below for above, below in pairs if above is not None and below is not None]
    return Target(name, wanted, min(ratios)) if ratios else None
