import itertools
import os
from functools import partial

import numpy as np
import pytest
from scipy import ndimage

from lidarnaut.benchmarks.speed import __main__ as command
from lidarnaut.benchmarks.speed import designs
from lidarnaut.benchmarks.speed.designs import Case, benchmark_robot
from lidarnaut.benchmarks.speed.halls import GAP, make_hall
from lidarnaut.benchmarks.speed.peers import compare as peers
from lidarnaut.envs.files import dump_record
from lidarnaut.envs.geometry.clearance import clearance
from lidarnaut.envs.worlds import rasterize
from tests.agents.tiny import tiny


@pytest.mark.parametrize("num_bodies", [50, 300])
def test_a_hall_is_closed_passable_and_the_same_each_time(num_bodies):
    hall = make_hall(num_bodies)
    crates = hall.segments[4:].reshape(-1, 4, 4)
    assert len(crates) + len(hall.circles) == num_bodies
    np.testing.assert_array_equal(hall.segments, make_hall.__wrapped__(num_bodies).segments)
    # Every collision-free position outside of crates and pillars is reachable.
    raster = rasterize(hall, 0.05)
    distances = ndimage.distance_transform_edt(raster.data == 0) * 0.05
    pieces, _ = ndimage.label(distances > benchmark_robot().radius)
    cells = np.argwhere(pieces > 0)
    points = raster.centers(cells)
    solid = np.zeros(len(points), dtype=bool)
    for crate in crates:
        along, beside = crate[:, 2:] - crate[:, :2], points[:, None] - crate[:, :2]
        turns = along[:, 0] * beside[..., 1] - along[:, 1] * beside[..., 0]
        solid |= (turns > 0.0).all(axis=1) | (turns < 0.0).all(axis=1)
    for x, y, radius in hall.circles:
        solid |= np.hypot(*(points - (x, y)).T) < radius
    assert len(np.unique(pieces[tuple(cells[~solid].T)])) == 1
    assert np.count_nonzero(~solid) * 0.05**2 > 100.0
    assert clearance(0.0, 0.0, hall.segments, hall.circles) > GAP


def test_environments_of_all_designs_are_rows_and_halls_are_columns(monkeypatch, capsys):
    monkeypatch.setattr(designs, "DESIGNS", [("bullet", 1, 1), ("kinematic", 16, 1), ("SubprocVecEnv", 2, 1)])
    monkeypatch.setattr(designs, "designs", partial(itertools.islice, designs.designs(), 1))
    command.main(("designs",), 0.05, 1)
    *_, bullet, vector, subproc, _ = (line.split("│") for line in capsys.readouterr().out.splitlines())
    labels = ["bullet x 1, cores: 1", "kinematic x 16, cores: 1", "SubprocVecEnv x 2, cores: 1"]
    assert [line[1].strip() for line in (bullet, vector, subproc)] == labels
    assert all(5 < float(line[2].replace(",", "")) < 1e6 for line in (bullet, vector, subproc))


def test_rates_count_the_steps_of_a_drive_and_the_warm_up_counts_not(monkeypatch):
    clock = itertools.count(0.0, 0.25)
    monkeypatch.setattr(command.time, "perf_counter", lambda: next(clock))
    closed = []

    def drive(number):
        try:
            yield 1000
            yield from itertools.repeat(number)
        finally:
            closed.append(number)

    available = os.sched_getaffinity(0)
    cases = [Case("row", f"{n}", 1, partial(drive, n)) for n in (3, 8)]
    rows = command.compare([[*cases, Case("many cores", "3", len(available) + 1, partial(drive, 3))]], 1.0, 2)
    # Three steps begin before 1 s is over; the next look at the clock is at 1 s.
    assert rows == [{"": "row", "3": "9", "8": "24"}]
    assert (closed, os.sched_getaffinity(0)) == ([3, 8], available)


def test_trainings_and_decisions_are_measured(tmp_path, monkeypatch):
    path = tmp_path / "tiny.yaml"
    path.write_text(dump_record(tiny("PPO", "Explore")))
    monkeypatch.setattr(designs, "TRAININGS", (str(path),))
    (cases,) = designs.trainings()
    assert [(case.row, case.column, case.cores) for case in cases] == [(str(path), f"cores: {n}", n) for n in (1, 2)]
    training = cases[0].drive()
    assert [next(training) for _ in range(3)] == [8, 8, 8]
    training.close()
    (cases,) = designs.decisions()
    for case, num_envs in zip(cases[:2], (1, 16)):
        deciding = case.drive()
        assert next(deciding) == num_envs
        deciding.close()
    (cases,) = designs.people()
    assert next(cases[2].drive()) == 64


FAKE = """
import json, sys
name, seconds, *cases = sys.argv[1:]
if name == "broken":
    sys.exit("no such module")
for case in cases:
    num_envs, people = map(int, case.split("x"))
    steps = {"ours": 300, "peer": 30 * num_envs, "odd": "many"}[name]
    print(json.dumps({"num_envs": num_envs, "people": people, "steps": steps, "seconds": float(seconds)}))
"""


def test_peers_become_rows_or_say_why_they_are_skipped(tmp_path, monkeypatch):
    monkeypatch.setattr(peers, "HOME", tmp_path)
    (tmp_path / "fake.py").write_text(FAKE)
    names = "ours", "peer", "odd", "broken", "missing"
    table = {name: {"simulates": f"world of {name}", "cases": ["1x0", "4x2"]} for name in names}
    (tmp_path / "missing" / "bin").mkdir(parents=True)
    for program in ("pip", "python"):
        (tmp_path / "missing" / "bin" / program).write_text("#!/bin/sh\necho 'no matching distribution' >&2\nexit 1\n")
        (tmp_path / "missing" / "bin" / program).chmod(0o700)
    table["missing"]["packages"] = ["missing==1.0", "torch=={torch}"]
    rows = peers.compare({**table, "named": {"skipped": "not in a registry"}}, 0.1, 2, tmp_path / "fake.py")
    measured = [[row[key] for key in ("simulator", "sub-environments", "people", "steps/s")] for row in rows[:4]]
    assert measured == [["ours", 1, 0, 3000], ["peer", 1, 0, 300], ["ours", 4, 2, 3000], ["peer", 4, 2, 1200]]
    assert [row["ratio"] for row in rows[:4]] == pytest.approx([1.0, 0.1, 1.0, 0.4])
    reasons = {row["simulator"]: row["simulates"] for row in rows[4:]}
    assert reasons.pop("odd").startswith('skipped: unreadable output \'{"num_envs": 1,')
    assert reasons.pop("named") == "skipped: not in a registry"
    assert reasons == {"broken": "skipped: no such module", "missing": "skipped: no matching distribution"}
