"""Conditions of an evaluation, as a paper has to state them, and the report's access to finished evaluations."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

from pydantic import BaseModel, model_validator

from lidarnaut.benchmarks.arena.evaluation_folder import Key, Row, columns_of, read_table
from lidarnaut.benchmarks.arena.measures import Measures
from lidarnaut.benchmarks.arena.workers import Result
from lidarnaut.envs.core import LidarEnv
from lidarnaut.envs.files import parse_record, read_json, write_file
from lidarnaut.envs.measures import Measure
from lidarnaut.envs.robots import RobotParams

FILE = "conditions.json"


class Conditions(BaseModel):
    """Measures, settings and conditions of an evaluation, kept in its folder for reports."""

    task: dict[str, str]
    """`progress`, a key of `info`, and `success`, the condition in words."""
    measures: list[Measure]
    """Measures of the task, besides those of all tasks."""
    settings: dict[str, Any]
    """Settings of the last command, as in a configuration file."""
    facts: dict[str, str]
    """Conditions by name: environment, robots, lidars, people and so on."""
    policies: dict[str, str]
    """Environment arguments that each policy requires, by its name."""

    @property
    def grouped(self) -> Measures:
        return Measures(self.measures, self.task["progress"], self.task["success"])

    def save(self, folder: Path) -> None:
        """Write the conditions to a folder, beside those of earlier commands there."""
        if (folder / FILE).exists():
            earlier = Conditions.load(folder)
            self.facts = earlier.facts | self.facts
            self.policies = earlier.policies | self.policies
        write_file(folder / FILE, self.model_dump_json(indent=1, exclude={"measures": {"__all__": {"compute"}}}) + "\n")

    @classmethod
    def load(cls, folder: Path) -> "Conditions":
        """Read the conditions of a folder; ValueError if they are missing or damaged."""
        path = folder / FILE
        if not path.exists():
            raise ValueError(f"{folder} holds no {FILE}: run the evaluation's command, without --report alone")
        try:
            return parse_record(read_json(path), str(path), cls)
        except ValueError as error:
            raise ValueError(f"{str(error).splitlines()[0]}; run the evaluation's command again") from error

    @model_validator(mode="after")
    def _check(self) -> "Conditions":
        if self.task.keys() != {"progress", "success"} or not isinstance(self.settings.get("arguments"), dict):
            raise ValueError("task must hold progress and success, settings must hold arguments, a mapping")
        limits = "", *columns_of(self.grouped)
        for one in self.measures:
            if not (math.isfinite(one.scale) and one.digits >= 0 and one.limit in limits):
                raise ValueError(f"measure {one.name} has an invalid scale, digits or limit")
        return self


class FinishedEvaluation:
    """Results in the folder of an evaluation, to report them without its policies and environments."""

    def __init__(self, folder: Path) -> None:
        """Open a folder; ValueError if it holds no evaluation, or one that is damaged."""
        self.folder, self.conditions = folder, Conditions.load(folder)
        self.measures = self.conditions.grouped
        tables = sorted({*folder.glob("episodes.csv"), *folder.glob("episodes-*.csv")})
        rows = (row for path in tables for row in read_table(path, columns_of(self.measures)))
        self._rows: Mapping[Key, Row] = {Key.of(row): row for row in rows}

    def rows(self) -> list[Row]:
        return list(self._rows.values())

    def missing(self) -> list[Result]:
        """Return the failed episodes."""
        columns = {**Key.__annotations__, "reason": str}
        failures = [row for path in sorted(self.folder.glob("failures*.csv")) for row in read_table(path, columns)]
        reasons = {Key.of(row): row["reason"] for row in failures}
        return [Result(key, reason=reason) for key, reason in reasons.items() if key not in self._rows]


def describe(env: LidarEnv, people: str, estimator: str) -> dict[str, str]:
    """Return the conditions of an environment by name; `people` and `estimator` are their displayed names."""
    robot, crowd = env.robot_params, env.simulator.crowd.params
    facts = {"Task": plain(env.task, skipped=("world", "slam", "localizer")), "Success": env.task.success_condition}
    facts["Control"] = f"{1.0 / env.control_period:g} Hz, one scan per control period"
    facts |= describe_robot(robot)
    if crowd is not None:
        facts[f"People ({people})"] = plain(crowd)
    if parameters := plain(getattr(env.robots[0].estimator, "params", None)):
        facts[f"Estimator {estimator}"] = parameters
    return facts


def describe_robot(robot: RobotParams) -> dict[str, str]:
    lidar, drive, odometry, imu = robot.lidar, robot.drive, robot.odometry, robot.imu
    error = 100.0 * (odometry.wheel_radius / drive.wheel_radius - 1.0), 100.0 * (odometry.track / drive.track - 1.0)
    gyroscope = f"gyroscope, noise {imu.gyro_std:g} rad/s, bias {imu.gyro_bias_std:g} rad/s"
    return {
        f"Robot {robot.name}": f"radius {robot.radius:g} m, at most {robot.max_v:g} m/s and {robot.max_w:g} rad/s, "
        f"{robot.max_acc_v:g} m/s2 and {robot.max_acc_w:g} rad/s2",
        f"Lidar of {robot.name}": f"{lidar.num_beams} beams over {math.degrees(lidar.fov):.0f} degrees, "
        f"{lidar.range_min:g} to {lidar.range_max:g} m, noise {lidar.noise_std:g} m, dropout {lidar.dropout:g}, at "
        f"{plain(lidar.mount)}",
        f"Odometry of {robot.name}": f"distances {error[0]:+.1f} %, track {error[1]:+.1f} %, wheel slip "
        f"{drive.slip_std:g} m per root metre, turns by {gyroscope if odometry.uses_gyro else 'wheels'}",
        f"Odometry noise that SLAMs of {robot.name} assume": plain(odometry.noise),
    }


def arguments_text(arguments: Mapping[str, Any]) -> str:
    """Return environment arguments as text: observations by the names of their parts."""
    joined = {name for name, value in arguments.items() if name == "observations" or isinstance(value, list)}
    texts = {name: ", ".join(map(str, value)) if name in joined else str(value) for name, value in arguments.items()}
    return "; ".join(f"{name} {text}" for name, text in texts.items())


def plain(record: Any, skipped: Sequence[str] = ()) -> str:
    """Return the fields of a dataclass that hold plain values, as text."""
    if not is_dataclass(record):
        return ""
    values = {each.name: getattr(record, each.name) for each in fields(record) if each.name not in skipped}
    texts = {name: plain_text(value) for name, value in values.items()}
    return ", ".join(f"{name} {text}" for name, text in texts.items() if text)


def plain_text(value: Any) -> str:
    """Return a number, name or range as text; empty for other values."""
    if type(value) is tuple:
        texts = [plain_text(one) for one in value]
        return f"({', '.join(texts)})" if all(texts) else ""
    return f"{value:.4g}" if isinstance(value, float) else str(value) if isinstance(value, str | int) else ""
