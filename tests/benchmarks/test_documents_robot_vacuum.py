import math

from lidarnaut.benchmarks.documents import robot_vacuum


def test_maps_are_measured_saved_and_drawn(tmp_path, monkeypatch):
    drives, record = [], robot_vacuum.record
    monkeypatch.setattr(robot_vacuum, "record", lambda *args: drives.append(args[-1]) or record(*args))
    figures = {figure.item: figure for figure in robot_vacuum.run(tmp_path, None, 1, True)}
    assert len(drives) == len(robot_vacuum.KINDS) == 3
    assert len(figures) == 3 * 5 * len(robot_vacuum.SLAMS)
    assert figures["tour, true poses: position RMSE"].median < 1e-9
    assert {tuple(figure.runs) for item, figure in figures.items() if "saving" in item} == {(0.0,)}
    assert all(math.isfinite(figure.median) for figure in figures.values())
    assert (tmp_path / "robot_vacuum.png").stat().st_size < 200_000
    worse, better = (figures[f"tour, {name}: map IoU"].median for name in ("report", "default"))
    assert 0.4 < worse < better
