import numpy as np
import pytest
from PIL import Image

from lidarnaut.benchmarks.documents import pi_mouse
from lidarnaut.envs.geometry import FREE, OCCUPIED
from lidarnaut.envs.slam import read_params
from lidarnaut.envs.worlds import load_map


@pytest.mark.parametrize("world", ["turtlebot3_world", pytest.param("pimouse_arena", marks=pytest.mark.slow)])
def test_the_robot_explores_localizes_and_reaches_its_goals(world, tmp_path, monkeypatch):
    slam = pi_mouse.SLAMS[world]
    monkeypatch.setattr(pi_mouse, "SLAMS", {world: slam})
    monkeypatch.setattr("lidarnaut.baselines.global_localization.FRAME_TIMES", {True: 5.0, False: 20.0})
    figures = {figure.item: figure for figure in pi_mouse.run(tmp_path, None, 1, True)}
    assert not read_params(slam).uses_odometry
    here = {item.partition(": ")[2]: figure.median for item, figure in figures.items()}
    assert 3.0 < here["95 % of the floor"] < 25.0
    assert here["map IoU after exploring"] > 0.85
    assert 0.0 < here["localized"] < 60.0
    assert here["error when localized"] < 0.15
    assert (here["goals reached of 2"], here["collisions"]) == (2, 0)
    assert here["map IoU after 0.5 minutes"] > 0.8
    assert here["position RMSE in 0.5 minutes"] < 0.06
    saved = load_map(tmp_path / f"{world}_0" / "map.yaml").data
    assert np.count_nonzero(saved == FREE) > np.count_nonzero(saved == OCCUPIED) > 100
    with Image.open(tmp_path / f"{world}_0" / "map_and_tree.png") as picture:
        assert len(picture.convert("RGB").getcolors(1 << 20)) > 5
    assert (tmp_path / f"{world}_0" / "localization.png").exists()
    document = {item for item, figure in figures.items() if figure.document is not None}
    of_the_report = {f"turtlebot3_world: {share} % of the floor" for share in (95, 99)}
    assert document == (of_the_report if world == "turtlebot3_world" else set())
