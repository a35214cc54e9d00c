"""Navigation on a known map: the classic policy of `lidarnaut/Navigate-v0`, and reactive driving while it is lost."""

from .map_navigator import MapNavigator
from .params import MapNavigatorParams

__all__ = ["MapNavigator", "MapNavigatorParams"]
