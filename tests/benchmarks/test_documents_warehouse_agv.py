import math
from dataclasses import replace

import pytest

from lidarnaut.benchmarks.documents.__main__ import main
from lidarnaut.benchmarks.documents.figures import Figure


def test_the_short_experiment_measures_and_draws(tmp_path, capsys):
    by_item = {figure.item: figure for figure in main("warehouse_agv", pictures=tmp_path, jobs=1, quick=True)}
    assert len(by_item) == 15
    for policy in ("frontier:published", "frontier", "nearest"):
        assert 10.0 < by_item[f"{policy}: explored share"].median < 99.0
        assert 0.1 < by_item[f"{policy}: map IoU"].median < 0.9
        assert by_item[f"{policy}: position error (RMS)"].median < 0.1
    assert "not reached" in capsys.readouterr().out
    first = by_item["frontier:published: time to explore 99 %"]
    assert (first.unit, first.runs, first.document, first.best) == ("min", [math.inf], 20.0, "least")
    for name in ("map.png", "progress.png"):
        assert 5_000 < (tmp_path / name).stat().st_size < 200_000


@pytest.mark.parametrize(("best", "worst"), [("least", float("inf")), ("most", -float("inf"))])
def test_runs_without_a_value_count_as_the_worst(best, worst):
    figure = Figure("time", "s", [1.0, float("nan"), 3.0], best=best)
    assert (figure.median, figure.worst) == (3.0 if best == "least" else 1.0, worst)
    for document, better in ((0.5, "most"), (4.0, "least")):
        assert replace(figure, document=document).row()["better"] == ("yes" if best == better else "no")
