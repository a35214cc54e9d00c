import math

import numpy as np

from lidarnaut.benchmarks.documents import robot_vacuum
from lidarnaut.benchmarks.drives.recording import Drive
from lidarnaut.envs.robots import load_robot


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


def test_keys_give_the_commands_of_teleoperation(monkeypatch):
    robot = load_robot("create3")
    found = set()

    def keys(*_):
        yield from ((), (robot_vacuum.pygame.K_UP,), (robot_vacuum.pygame.K_DOWN, robot_vacuum.pygame.K_LEFT))

    def replay(setup, start, rng, rng_driver, duration, driver):
        found.update(driver(setup, None, rng))
        return Drive(np.full((200, robot.lidar.num_beams), np.nan, np.float32), *np.zeros((2, 200, 3)), np.zeros(200))

    monkeypatch.setattr(robot_vacuum, "record", replay)
    monkeypatch.setitem(robot_vacuum.KINDS, "keys", (keys, 1.0, "create3"))
    robot_vacuum.run_drive("keys", 0, None, True)
    assert found == {(0.0, 0.0), (robot.max_v, 0.0), (-robot.max_v, 1.0)}
