"""Data of real robots that some tests read: `LIDARNAUT_DATA`, or `shared/data` beside the checkout."""

import os
from pathlib import Path

import pytest

DATA = Path(os.environ.get("LIDARNAUT_DATA", Path(__file__).parents[2] / "shared" / "data"))
INTEL = DATA / "intel"
needs_intel = pytest.mark.skipif(not INTEL.is_dir(), reason=f"the Intel log is not at {INTEL}; set LIDARNAUT_DATA")
