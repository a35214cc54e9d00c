import pytest


@pytest.fixture(autouse=True)
def brief(no_curves, references_here, no_overview):
    """Trainings and evaluations draw no curves and overviews, and start no workers for references."""
