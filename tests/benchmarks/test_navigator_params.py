"""Measuring what a parameter of the navigator changes."""

import pytest

from baselines import make_explorer
from benchmarks.navigator_params import CHANGES, change_explorer, main


def test_parameters_are_set_by_name():
    explorer = make_explorer("nearest")
    for name, value in (("max_time", 9.0), ("stuck_time", 7.0), ("inflation", 0.2)):
        change_explorer(explorer, name, value)
    assert (explorer.max_time, explorer.params.stuck_time, explorer.planning.inflation) == (9.0, 7.0, 0.2)


def test_what_is_tried_has_parameters_of_that_name():
    for change in CHANGES:
        name, _, value = change.partition("=")
        change_explorer(make_explorer("nearest"), name, float(value))


def test_unknown_parameters_are_named():
    with pytest.raises(ValueError, match="speed is no parameter of the navigator; there are max_time, min_time"):
        change_explorer(make_explorer("nearest"), "speed", 1.0)


def test_a_change_is_compared_from_the_same_starts(capsys):
    main(("max_time=4", "max_time=0.2"), worlds=("pimouse_arena",), seeds=2, jobs=1)
    same, other = (line for line in capsys.readouterr().out.splitlines() if "max_time" in line)
    assert "+0.0 % ± 0.0" in same
    assert "+0.0 % ± 0.0" not in other
