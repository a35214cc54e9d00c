import math

import pytest

from benchmarks.parallel import run_each


@pytest.mark.parametrize("jobs", [1, 2])
def test_results_come_in_the_order_of_the_tasks_and_each_as_it_ends(jobs):
    seen = []
    assert run_each(math.hypot, [(3.0, 4.0), (6.0, 8.0)], jobs, seen.append) == [5.0, 10.0]
    assert sorted(seen) == [5.0, 10.0]


def test_an_error_ends_the_others():
    with pytest.raises(ValueError, match="math domain"):
        run_each(math.sqrt, [(-1.0,), (1.0,)], 2)
