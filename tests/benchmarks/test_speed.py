import itertools
import json

import numpy as np
import pytest
from scipy import ndimage

from lidarnaut.benchmarks.speed import __main__ as command
from lidarnaut.benchmarks.speed import designs, measuring, parts
from lidarnaut.benchmarks.speed.designs import Design, benchmark_robot
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


def test_a_run_measures_all_and_writes_what_is_documented(tmp_path, monkeypatch):
    compared = (Design("bullet"), Design("kinematic"), Design("vector", 16, 2), Design("subproc", 2))
    monkeypatch.setattr(command, "DESIGNS", compared)
    monkeypatch.setattr(command, "BODIES", (50,))
    command.main(("designs", "kernels", "memory"), tmp_path / "speed.json", quick=True)
    written = json.loads((tmp_path / "speed.json").read_text())
    assert list(written) == ["machine", "designs", "kernels", "memory"]
    rows = written["designs"]
    assert [(row["name"], row["num_envs"], row["cores"]) for row in rows[:4]] == [tuple(d) for d in compared]
    assert all(5 < row["steps_per_second"] < 1e6 for row in rows)
    kernels = {row["kernel"]: row["us"] for row in written["kernels"]}
    assert list(kernels) == ["cast_rays", "match", "integrate_scan", "pool_map", "crop", "advance"]
    assert all(0 < us < 1e4 for us in kernels.values())
    further = written["memory"][0]["MiB of a further sub-environment"]
    assert 0.8 < further < 4.0


def test_trainings_decisions_and_simulators_are_measured(tmp_path, monkeypatch):
    path = tmp_path / "tiny.yaml"
    path.write_text(dump_record(tiny("PPO", "Explore")))
    for module in (measuring, designs):
        monkeypatch.setattr(module, "TRAININGS", (str(path),))
    (row,) = measuring.trainings({1: lambda function, *arguments: function(*arguments)}, 0.0, 1)
    measuring.open_cases([])
    assert (row["training"], row["cores"]) == (str(path), 1)
    assert 10 < row["steps/s"] < 1e6
    monkeypatch.setattr(parts, "NUM_DECIDING", (1, 2))
    rows = parts.decisions(6)
    assert [row["sub-environments"] for row in rows] == [1, 2]
    assert all(row["decisions/s"] > 0 and row["steps/decision"] > 1 for row in rows)
    assert all(0 < row["least us"] <= row["median us"] for row in parts.physics(1))


def test_growth_is_drawn(tmp_path):
    keys = itertools.product(("beams", "num_envs"), ("tinyslam", "truth"), (90, 180))
    rows = [{"grows": key, "slam": slam, "at": at, "us": 0.3 * at} for key, slam, at in keys]
    command.plot_growth(rows, tmp_path / "growth.png")
    assert (tmp_path / "growth.png").read_bytes().startswith(b"\x89PNG")


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
