import itertools
import os
from functools import partial

import numpy as np
import pytest

from lidarnaut.benchmarks.speed import __main__ as command
from lidarnaut.benchmarks.speed import cases
from lidarnaut.benchmarks.speed.cases import GAP, Case, make_hall
from lidarnaut.benchmarks.speed.peers import compare as peers
from lidarnaut.envs.files import dump_record
from lidarnaut.envs.geometry.clearance import clearance
from tests.agents.tiny import tiny


@pytest.mark.parametrize("num_bodies", [50, 300])
def test_a_hall_has_all_its_bodies_away_from_the_start_and_is_the_same_each_time(num_bodies):
    hall = make_hall(num_bodies)
    crates = hall.segments[4:].reshape(-1, 4, 4)
    assert len(crates) + len(hall.circles) == num_bodies
    np.testing.assert_array_equal(hall.segments, make_hall.__wrapped__(num_bodies).segments)
    assert clearance(0.0, 0.0, hall.segments, hall.circles) > GAP


def test_environments_of_all_designs_are_rows_and_halls_are_columns(monkeypatch, capsys):
    monkeypatch.setattr(cases, "DESIGNS", [("bullet", 1, 1), ("kinematic", 16, 1), ("SubprocVecEnv", 2, 1)])
    monkeypatch.setattr(cases, "designs", partial(itertools.islice, cases.designs(), 1))
    monkeypatch.setattr(command, "REPEATS", 1)
    monkeypatch.setitem(command.SECONDS, "designs", 0.05)
    command.main(("designs",))
    *_, bullet, vector, subproc, _ = (line.split("│") for line in capsys.readouterr().out.splitlines())
    labels = ["bullet x 1, cores: 1", "kinematic x 16, cores: 1", "SubprocVecEnv x 2, cores: 1"]
    assert [line[1].strip() for line in (bullet, vector, subproc)] == labels
    assert all(5 < float(line[2].replace(",", "")) < 1e6 for line in (bullet, vector, subproc))


def test_rates_count_the_steps_of_a_drive_and_the_warm_up_counts_not(monkeypatch):
    clock = itertools.count(0.0, 0.25)
    monkeypatch.setattr(command, "REPEATS", 2)
    monkeypatch.setattr(command.time, "perf_counter", lambda: next(clock))
    closed = []

    def drive(number):
        try:
            yield 1000
            yield from itertools.repeat(number)
        finally:
            closed.append(number)

    available = os.sched_getaffinity(0)
    some = [Case("row", f"{n}", 1, partial(drive, n)) for n in (3, 8)]
    rows = command.compare([[*some, Case("many cores", "3", len(available) + 1, partial(drive, 3))]], 1.0)
    # Three steps begin before 1 s is over; the next look at the clock is at 1 s.
    assert rows == [{"": "row", "3": "9", "8": "24"}]
    assert (closed, os.sched_getaffinity(0)) == ([3, 8], available)


def test_trainings_and_decisions_are_measured(tmp_path, monkeypatch):
    path = tmp_path / "tiny.yaml"
    path.write_text(dump_record(tiny("PPO", "Explore")))
    monkeypatch.setattr(cases, "TRAININGS", (str(path),))
    (some,) = cases.trainings()
    assert [(case.row, case.column, case.cores) for case in some] == [(str(path), f"cores: {n}", n) for n in (1, 2)]
    training = some[0].drive()
    assert [next(training) for _ in range(3)] == [8, 8, 8]
    training.close()
    (deciding,), (reaching,) = cases.decisions(), cases.people()
    for case, num_envs in ((deciding[0], 1), (deciding[1], 16), (reaching[2], 64)):
        drive = case.drive()
        assert next(drive) == num_envs
        drive.close()


def test_trainings_by_other_libraries_are_measured(monkeypatch):
    monkeypatch.setattr(cases, "ROLLOUT", 64)
    monkeypatch.setattr(cases, "BATCH", 32)
    (some,) = cases.libraries()
    assert [case.row for case in some][:2] == ["lidarnaut", "DummyVecEnv x 8, stable_baselines3"]
    training = some[1].drive()
    assert [next(training), next(training)] == [64, 64]
    training.close()


FAKE = """
import json, sys
name, seconds, *cases = sys.argv[1:]
if name == "broken":
    sys.exit("no such module")
for case in cases:
    num_envs, people = map(int, case.split("x"))
    steps = {"ours": 300, "peer": 30 * num_envs}[name]
    print(json.dumps({"num_envs": num_envs, "people": people, "steps": steps, "seconds": float(seconds)}))
"""


def test_peers_become_rows_or_say_why_they_are_skipped(tmp_path, monkeypatch):
    monkeypatch.setattr(peers, "HOME", tmp_path)
    (tmp_path / "fake.py").write_text(FAKE)
    monkeypatch.setattr(peers, "STEP", tmp_path / "fake.py")
    names = "ours", "peer", "broken", "missing"
    table = {name: {"simulates": f"world of {name}", "cases": ["1x0", "4x2"]} for name in names}
    (tmp_path / "missing" / "bin").mkdir(parents=True)
    for program in ("pip", "python"):
        (tmp_path / "missing" / "bin" / program).write_text("#!/bin/sh\necho 'no matching distribution' >&2\nexit 1\n")
        (tmp_path / "missing" / "bin" / program).chmod(0o700)
    table["missing"]["packages"] = ["missing==1.0", "torch=={torch}"]
    rows = peers.compare(table, 0.1, 2)
    measured = [[row[key] for key in ("simulator", "sub-environments", "people", "steps/s")] for row in rows[:4]]
    assert measured == [["ours", 1, 0, 3000], ["peer", 1, 0, 300], ["ours", 4, 2, 3000], ["peer", 4, 2, 1200]]
    assert [row["ratio"] for row in rows[:4]] == pytest.approx([1.0, 0.1, 1.0, 0.4])
    reasons = {row["simulator"]: row["simulates"] for row in rows[4:]}
    assert reasons == {"broken": "skipped: no such module", "missing": "skipped: no matching distribution"}
