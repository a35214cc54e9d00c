"""Old name of `python -m baselines.global_localization`."""

import warnings

from baselines.global_localization import main
from envs.command_line import run_command

if __name__ == "__main__":
    warnings.simplefilter("default", DeprecationWarning)
    text = "python -m baselines.wake_up is deprecated; use python -m baselines.global_localization"
    warnings.warn(text, DeprecationWarning, stacklevel=1)
    run_command(main)
