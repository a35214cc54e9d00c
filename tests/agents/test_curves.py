import warnings

import numpy as np
import pytest

from lidarnaut.agents.curves import draw_learning_curve, draw_seeds, read_evaluations

ROW = {"policy": "learned", "steps": 0, "progress": 0.5, "success": 0.5}
ROW |= {"spl": 0.2, "spl_q25": 0.1, "scores": "0.1 0.3"}


def write(run, rows):
    lines = [",".join(ROW), *(",".join(map(str, (ROW | row).values())) for row in rows)]
    (run / "evaluations.csv").write_text("\n".join(lines) + "\n")


@pytest.mark.parametrize(
    ("rows", "message"),
    [
        ([], "holds no evaluations"),
        ([{"steps": "1e400"}], "invalid literal"),
        ([{"scores": "0.1 x"}], "damaged row: .*'x'"),
        ([{"scores": ""}], "damaged row: .*finite"),
        ([{"success": "nan"}], "damaged row: .*finite"),
        ([{"scores": "1" * 200_000}], "field larger"),
    ],
)
def test_a_damaged_table_is_named(tmp_path, rows, message):
    write(tmp_path, rows)
    with pytest.raises(ValueError, match=rf"evaluations\.csv: .*{message}"):
        read_evaluations(tmp_path)


@pytest.mark.parametrize("name", ROW)
def test_a_table_without_a_column_is_named(tmp_path, name):
    write(tmp_path, [{}])
    path = tmp_path / "evaluations.csv"
    header, line = path.read_text().splitlines()
    columns = ["x" if column == name else column for column in header.split(",")]
    path.write_text(f"{','.join(columns)}\n{line.replace('learned', '1').replace('0.1 0.3', '1')}\n")
    with pytest.raises(ValueError, match=r"evaluations\.csv: .*damaged row"):
        read_evaluations(tmp_path)


def test_names_of_others_are_drawn_as_they_are(tmp_path):
    rows = [ROW, ROW | {"policy": "$\\frac{$"}, ROW | {"policy": "\x1b[2J"}]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        draw_learning_curve(rows, "$\\frac{$", tmp_path / "a.png")
        draw_seeds(np.zeros((1, 4)), "$\\x$", "$\\x$", tmp_path / "b.png")


def test_one_validation_and_equal_references_are_visible(tmp_path, monkeypatch):
    figures = []
    monkeypatch.setattr("lidarnaut.agents.curves._save", lambda figure, path: figures.append(figure))
    rows = [ROW | {"policy": name, "split": "test"} for name in ("dwb", "mppi")]
    draw_learning_curve([*rows, ROW | {"steps": 60_000, "split": "validation"}], "title", tmp_path / "a.png")
    for axes in figures[0].axes:
        assert axes.get_xlim()[0] == 0.0
        learned, *references = axes.lines
        assert learned.get_marker() == "o"
        assert axes.collections[0].get_linewidth() > 0.0  # the interval
        assert len({line.get_color() for line in (learned, *references)}) == 3
        (start, (dash, gap)), (next_start, _) = (line._unscaled_dash_pattern for line in references)
        assert abs(next_start - start) == dash <= gap
