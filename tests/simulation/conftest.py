import importlib.util

import pytest

BULLET = pytest.param(
    "bullet", marks=pytest.mark.skipif(importlib.util.find_spec("pybullet") is None, reason="PyBullet is not installed")
)


@pytest.fixture(params=["kinematic", BULLET])
def physics(request):
    return request.param


@pytest.fixture
def bullet():
    pytest.importorskip("pybullet", reason="PyBullet is not installed")
    return "bullet"
