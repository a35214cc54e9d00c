import re

import numpy as np
import pytest
from PIL import Image

from lidarnaut.baselines.global_localization import main
from lidarnaut.envs.rendering.style import ESTIMATED
from lidarnaut.envs.worlds import load_map


def test_a_robot_maps_a_world_and_localizes_on_its_map(tmp_path, capsys):
    main("turtlebot3_world", tmp_path / "run", goals=1, physics="kinematic")
    said = dict(re.split(r"  +", line, maxsplit=1) for line in capsys.readouterr().out.splitlines())
    assert float(said["explored"].partition(" %")[0]) > 98
    assert {-1, 0, 100} == set(np.unique(load_map(tmp_path / "run" / "map.yaml").data))
    assert (said["goal 1"], said["collisions"]) == ("reached", "0")
    time, error = re.match(r"after (.+) s, (\d+) cm", said["localized"]).groups()
    assert 0.0 < float(time) < 60.0
    assert int(error) < 30
    assert (tmp_path / "run" / "global_localization.png").exists()
    with Image.open(said["animation"]) as animation:
        assert animation.n_frames > 10
        # The particles cover the map at first, and a spot at the end.
        assert _area(animation, 0) > 5.0 * _area(animation, animation.n_frames - 1)


def _area(animation, k):
    """Number of pixels with the colours of particles and of the estimated pose, without the legend."""
    animation.seek(k)
    picture = np.asarray(animation.convert("RGB"))[120:660].astype(int)
    return np.count_nonzero(np.abs(picture - np.array(ESTIMATED)).sum(axis=-1) < 100)


@pytest.mark.parametrize(("option", "name"), [("world", "atlantis"), ("explorer", "rrrt"), ("slam", "hector?preset=f")])
def test_an_unknown_name_is_named(option, name, tmp_path):
    with pytest.raises(ValueError, match=name.partition("=")[2] or name):
        main(out=tmp_path, **{option: name})
