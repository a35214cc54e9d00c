"""Training, evaluation and loading of learned policies."""

import os

# Idle OpenMP threads of torch would spin and take cores from the environments. torch reads this variable on import.
os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")
