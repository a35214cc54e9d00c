"""Old name of `python -m baselines.global_localization`."""

import warnings

import tyro

from baselines.global_localization import main

if __name__ == "__main__":
    warnings.simplefilter("default", DeprecationWarning)
    text = "python -m baselines.wake_up is deprecated; use python -m baselines.global_localization"
    warnings.warn(text, DeprecationWarning, stacklevel=1)
    tyro.cli(main)
