import importlib.util

import numpy as np
import pytest

from envs.geometry import Pose2D
from envs.worlds import World

HAS_BULLET = importlib.util.find_spec("pybullet") is not None


@pytest.fixture(
    params=[
        "kinematic",
        pytest.param("bullet", marks=pytest.mark.skipif(not HAS_BULLET, reason="PyBullet is not installed")),
    ]
)
def physics(request):
    return request.param


@pytest.fixture
def bullet():
    pytest.importorskip("pybullet", reason="PyBullet is not installed")
    return "bullet"


def make_world(size, segments=(), circles=(), movers=()):
    """A square room of side 2 `size` around the origin with something in it."""
    s = size
    walls = [[-s, -s, s, -s], [s, -s, s, s], [s, s, -s, s], [-s, s, -s, -s]]
    return World(
        name="test",
        segments=np.array([*walls, *segments], dtype=float),
        circles=np.array(circles, dtype=float).reshape(-1, 3),
        spawns=(Pose2D(0.0, 0.0, 0.0),),
        bounds=(-s, -s, s, s),
        movers=tuple(movers),
    )


@pytest.fixture
def room():
    """Builds rooms: `room(size, segments, circles, movers)`."""
    return make_world


@pytest.fixture
def plain():
    """Flat ground with nothing near."""
    return make_world(60.0)
