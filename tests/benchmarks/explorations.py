import csv

from lidarnaut.benchmarks.arena.episodes import Episodes
from lidarnaut.benchmarks.arena.evaluation_folder import columns_of
from lidarnaut.benchmarks.arena.measures import Measures
from lidarnaut.envs.tasks.explore import Explore

MEASURES = Measures(Explore.measures, Explore.progress, "99 % is explored")
COLUMNS = columns_of(MEASURES)
BY_NAME = {measure.name: measure for measure in (*MEASURES.all, *MEASURES.ratios)}
DEFAULTS = {str: ""}


def row(policy, seed=0, world="maze", area=0.8, time=100.0, distance=50.0, explored=1.0, **more):
    """Episode that explores 95 % in `time`, and 99 % in as much, unless it `explored` less."""
    values = {name: DEFAULTS.get(read, 0) for name, read in COLUMNS.items()}
    values |= {"robot": "tugbot", "physics": "bullet", "slam": "tinyslam", "end_reason": "covered", "duration": time}
    values |= {"time_limit": 4000.0, "distance_limit": 9000.0}
    values |= {"policy": policy, "seed": seed, "world": world, "area_under_curve": area, "time_to_95": time}
    return values | {"distance_to_95": distance, "explored_fraction": explored, "success": int(explored >= 0.99)} | more


def read_rows(folder):
    return list(csv.DictReader((folder / "episodes.csv").read_text().splitlines()))


def deterministic(rows):
    """Drop the column that depends on the clock."""
    return [{name: value for name, value in row.items() if name != "decision_ms"} for row in rows]


def table(rows, reference=""):
    return Episodes(rows, MEASURES, reference)
