"""Learned explorers: PPO on stable-baselines3."""

import os

# Idle threads of torch spin by default, and take the cores from the environments and from every other program; has to
# be said before torch is imported.
os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")
