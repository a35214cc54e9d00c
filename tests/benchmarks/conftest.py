import pytest


@pytest.fixture(autouse=True)
def brief(no_curves, references_here):
    """Trainings draw no curves and start no workers for references."""
