"""The former name of the command `python -m envs.logs.replay`."""

import runpy

if __name__ == "__main__":
    runpy.run_module("envs.logs.replay", run_name="__main__")
