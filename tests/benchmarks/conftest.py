import pytest


@pytest.fixture(autouse=True)
def brief(no_curves, no_workers):
    """Trainings draw no curves and start no workers."""
