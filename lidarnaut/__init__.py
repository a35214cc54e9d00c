"""Lidarnaut: Gymnasium environments in which lidar robots explore unknown worlds.

Importing this package registers the environments, as `import envs` does, so that `gymnasium.make` knows their ids; so
does an id with the module before it: `gymnasium.make("lidarnaut:lidarnaut/Explore-v0")`.
"""

from importlib.metadata import PackageNotFoundError, version

from envs import ENVIRONMENTS, register

from .configurations import find_configuration

__all__ = ["ENVIRONMENTS", "__version__", "find_configuration", "register"]

try:
    __version__ = version("lidarnaut")
except PackageNotFoundError:  # a checkout that is on the path, but not installed
    __version__ = "0+unknown"
