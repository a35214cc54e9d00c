"""How many steps per second each design of the environment makes: `python -m benchmarks.throughput`.

All designs are measured in turn, in one run, pinned to one core unless said; every figure is a median. They explore
the same two halls with the same robot (360 beams of 10 m, ten steps per second, cells of 0.05 m) and the same actions,
under TinySLAM (100 candidates) and at the true pose. `naive` is what one writes with PyBullet and NumPy, see
`speed/naive.py`; its map crop has 64 x 64 pixels, the two crops of the other designs 40 x 40 each. `ppo` is a
whole training, rollouts and updates. Run it on a machine that does nothing else.
"""

import dataclasses
import json
from pathlib import Path
from typing import Annotated

import tyro
from rich.console import Console

from benchmarks.speed.report import plot_growth, print_results, targets
from benchmarks.speed.results import FULL, QUICK, run
from envs.command_line import make_console, run_command

PLOT = Path(__file__).parents[1] / "docs" / "images" / "throughput.png"


def main(
    json_file: Annotated[Path | None, tyro.conf.arg(name="json")] = None, quick: bool = False, plot: Path = PLOT
) -> None:
    """Measure, print tables, and draw how cost grows with beams, cells and sub-environments.

    Args:
        json_file: also write everything measured to this file.
        quick: take less than a minute: shorter measurements, no plot.
        plot: where to draw how cost grows.
    """
    progress = Console(stderr=True)
    results = run(QUICK if quick else FULL, lambda what: progress.print(f"measuring {what}", style="dim"))
    print_results(results, make_console())
    if json_file is not None:
        met = [{**target._asdict(), "met": target.met} for target in targets(results)]
        json_file.write_text(json.dumps({**dataclasses.asdict(results), "targets": met}, indent=1) + "\n")
    if results.growth:
        plot_growth(results, plot)


if __name__ == "__main__":
    run_command(main)
