"""Control steps by one kernel call: kinematic physics and a SLAM that matches key scans."""

from .drive import UNCHECKED, FusedDrive
from .robots import FusedRobots, is_fusible

__all__ = ["UNCHECKED", "FusedDrive", "FusedRobots", "is_fusible"]
