import signal

import pytest

from lidarnaut.driver.program import SIGNALS


@pytest.fixture(autouse=True)
def signals():
    """Restore the signals that a program has changed, which processes of later tests would inherit."""
    kept = {each: signal.getsignal(each) for each in SIGNALS}
    yield
    for each, handler in kept.items():
        signal.signal(each, handler)
