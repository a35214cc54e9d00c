"""Decisions are timed step by step, and none takes longer than a control period."""

import pytest

from benchmarks.decisions import TEAM, WARM_UP, time_decisions


@pytest.mark.parametrize(("name", "num_robots"), [("rrt", 1), (TEAM, 4)])
def test_rrt_never_misses_a_beat_in_the_warehouse(name, num_robots):
    # The first run loads or compiles the kernels.
    for _ in range(2):
        found = time_decisions("tugbot_warehouse", name, max_time=15.0, num_robots=num_robots)
    assert found.count == 150 - WARM_UP
    assert 0.0 < found.mean <= found.p99 <= found.longest
    assert found.missed == 0
    assert 0.01 < found.explored < 0.5
