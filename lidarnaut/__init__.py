"""Lidarnaut: Gymnasium environments in which lidar robots explore unknown worlds.

Importing this package, or any of it, registers the environments, so that `gymnasium.make` knows their ids; so does an
id with the module before it: `gymnasium.make("lidarnaut:lidarnaut/Explore-v0")`.
"""

from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from lidarnaut.envs import ENVIRONMENTS, register
from lidarnaut.envs.files import explain_unknown

__all__ = ["ENVIRONMENTS", "__version__", "find_configuration", "register"]

try:
    __version__ = version("lidarnaut")
except PackageNotFoundError:  # a checkout that is on the path, but not installed
    __version__ = "0+unknown"
CONFIGURATIONS = Path(__file__).with_name("configs").resolve()
"""Folder of the configurations, in a checkout and where the package is installed."""


def find_configuration(name: str) -> Path:
    """Return the file that `name` means: a path of a YAML file, or `explore_frontiers` for one that is packaged.

    Raises:
        ValueError: if no configuration has that name; lists those there are.
    """
    if name.endswith((".yaml", ".yml")) or Path(name).is_file():
        return Path(name)
    known = {path.stem: path for path in sorted(CONFIGURATIONS.rglob("*.yaml"))}
    if name not in known:
        raise ValueError(f"unknown configuration {explain_unknown(name, known)}, and paths of YAML files")
    return known[name]
