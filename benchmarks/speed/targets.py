"""The project's targets, compared with what was measured."""

from typing import NamedTuple

from benchmarks.speed.designs import Design
from benchmarks.speed.results import BODIES, FEW, MANY, Results

NAIVE, BULLET, KINEMATIC = Design("naive"), Design("bullet"), Design("kinematic")
VECTOR, TWO_CORES = Design("vector", MANY), Design("vector", MANY, 2)
BULLETS = Design("bullet_vector", FEW, 2)
TRAINING = Design("ppo", MANY, 2)
SPEEDS = (
    (f"vector, {MANY} sub-environments, one core, tinyslam [steps/s]", 10_000, "tinyslam", VECTOR),
    (f"vector, {MANY} sub-environments, one core, truth [steps/s]", 18_000, "truth", VECTOR),
    ("bullet, tinyslam [steps/s]", 4_000, "tinyslam", BULLET),
    ("bullet over naive, tinyslam", 10.0, "tinyslam", BULLET, NAIVE),
    ("vector on two cores over one, tinyslam", 1.8, "tinyslam", TWO_CORES, VECTOR),
    ("vector over kinematic, tinyslam", 0.9, "tinyslam", VECTOR, KINEMATIC),
    ("bullet vector on two cores over bullet, tinyslam", 1.7, "tinyslam", BULLETS, BULLET),
    ("ppo on two cores, tinyslam [steps/s]", 8_000, "tinyslam", TRAINING),
    ("ppo on two cores, truth [steps/s]", 12_000, "truth", TRAINING),
)
"""Name, least speed that is wanted, SLAM, and the design; with two designs, the least ratio of the first's speed."""


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
    found = []
    for name, wanted, slam, *designs in SPEEDS:
        measured = []
        for bodies in BODIES:
            speeds = [results.speed(design, f"hall_{bodies}", slam) for design in designs]
            if None not in speeds:
                measured.append(speeds[0] / speeds[1] if len(speeds) > 1 else speeds[0])
        if measured:
            found.append(Target(name, wanted, min(measured)))
    memory = "state of a sub-environment, 400 x 400 cells [MiB]"
    return [*found, Target(memory, 1.0, results.state_bytes_per_env / 2**20, at_most=True)]
