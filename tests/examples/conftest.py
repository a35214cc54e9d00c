import pytest


@pytest.fixture(autouse=True)
def brief(no_curves, no_workers, no_overview):
    """Trainings and evaluations draw no curves and overviews, and start no workers."""
