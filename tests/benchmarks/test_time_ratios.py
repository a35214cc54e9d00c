"""Ratios of times from the same starts."""

import csv

import numpy as np
import pytest

from benchmarks.arena.statistics import paired_ratio
from benchmarks.time_ratios import main, paired_times


def row(policy, world, seed, time, slam="truth"):
    values = {"policy": policy, "world": world, "robot": "r", "physics": "p", "slam": slam, "seed": str(seed)}
    return {**values, "time_to_95": str(time), "time_limit": "400.0"}


ROWS = [
    *(row("slow", "a", seed, 100.0) for seed in range(4)),
    *(row("fast", "a", seed, 50.0) for seed in range(4)),
    row("slow", "b", 0, "inf"),
    row("fast", "b", 0, 100.0),
    row("slow", "b", 1, 0.2),
    row("fast", "b", 1, 0.0),
    row("fast", "b", 1, 7.0, slam="hector"),  # no partner
]


def test_pairs_share_everything_but_the_policy():
    own, other, reached, other_reached = paired_times(ROWS, "fast", "slow")
    assert [len(times) for times in own] == [4, 2]
    np.testing.assert_array_equal(own[1], [100.0, 1.0])
    np.testing.assert_array_equal(other[1], [400.0, 1.0])
    assert reached[1].all()
    np.testing.assert_array_equal(other_reached[1], [False, True])
    with pytest.raises(ValueError, match="no start in common"):
        paired_times(ROWS, "fast", "other")


def test_the_ratio_is_a_geometric_mean():
    own, other, *_ = paired_times(ROWS, "fast", "slow")
    ratio = paired_ratio(own, other)
    assert ratio.iqm == pytest.approx((0.5**4 * 0.25 * 1.0) ** (1 / 6))
    assert ratio.low <= ratio.iqm <= ratio.high
    assert paired_ratio(other, own).iqm == pytest.approx(1.0 / ratio.iqm)


def test_the_table_names_the_others(tmp_path, capsys):
    with open(tmp_path / "episodes.csv", "w", newline="") as file:
        writer = csv.DictWriter(file, ROWS[0].keys())
        writer.writeheader()
        writer.writerows(ROWS)
    main(tmp_path, "slow")
    printed = capsys.readouterr().out
    assert "fast" in printed
    assert "0.500" in printed
    assert "held out" not in printed


def test_groups_tell_what_training_has_seen(tmp_path, capsys):
    times = {"slow": 100.0, "fast": 50.0, "oracle (ground truth)": 25.0}
    worlds = {"turtlebot3_house": 4, "turtlebot3_stage_1": 4, "rooms": 4}
    rows = [row(name, world, seed, t) for name, t in times.items() for world, n in worlds.items() for seed in range(n)]
    with open(tmp_path / "episodes.csv", "w", newline="") as file:
        writer = csv.DictWriter(file, rows[0].keys())
        writer.writeheader()
        writer.writerows(rows)
    main(tmp_path, "slow", groups=True)
    lines = [line for line in capsys.readouterr().out.splitlines() if "│ fast " in line]
    pairs = {line.split("│")[1].strip(): line.split("│")[3].strip() for line in lines}
    assert pairs == {
        "all": "12",
        "library, training": "4",
        "library, held out": "4",
        "families, test seeds": "4",
        "all that is held out": "8",
    }
    assert all("50 % [50, 50]" in line for line in lines)


def test_columns_of_the_evaluation_make_groups(tmp_path, capsys):
    with open(tmp_path / "episodes.csv", "w", newline="") as file:
        writer = csv.DictWriter(file, ROWS[0].keys())
        writer.writeheader()
        writer.writerows(ROWS)
    main(tmp_path, "slow", by=("world", "slam"))
    lines = [line for line in capsys.readouterr().out.splitlines() if " fast " in line]
    assert [line.split()[1] for line in lines] == ["all", "a", "b", "truth"]  # hector: no pairs
    assert "0.500" in lines[1]
