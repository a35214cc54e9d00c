"""Measuring what a parameter of an explorer changes."""

import pytest

from benchmarks.explorer_params import main, make_changed


def test_parameters_of_the_explorer_and_of_its_navigator_are_set_by_name():
    explorer = make_changed("tour", "hysteresis=3,max_stops=8,max_time=9,inflation=0.2")
    params = explorer.rule._params
    assert (params.hysteresis, params.max_stops) == (3.0, 8)
    assert (explorer.max_time, explorer.planning.inflation) == (9.0, 0.2)


@pytest.mark.parametrize(
    ("name", "change", "message"),
    [("tour", "speed=1", "speed is no parameter of the navigator"), ("random", "", "no explorer with parameters")],
)
def test_unknown_names_are_refused(name, change, message):
    with pytest.raises(ValueError, match=message):
        make_changed(name, change)


def test_a_change_is_compared_on_the_same_tasks(capsys):
    main("frontier", ("max_time=inf", "min_goal_distance=0"), tasks=2, seed=1, jobs=1)
    same, _ = (line for line in capsys.readouterr().out.splitlines() if "=" in line and "%" in line)
    assert "+0.0 % ± 0.0" in same
