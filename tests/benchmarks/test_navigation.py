"""The costs of planning: the command runs, and writes what it measured."""

import json

from benchmarks.navigation import main


def test_the_command_writes_what_it_measured(tmp_path):
    path = tmp_path / "navigation.json"
    main(worlds=("turtlebot3_dqn_stage1",), json=path)
    costs = json.loads(path.read_text())["turtlebot3_dqn_stage1"]
    for cost in ("astar_across_us", "smooth_across_us", "is_path_valid_us", "take_a_scan_us"):
        assert costs[cost] > 0.0
