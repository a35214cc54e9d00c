"""Accuracy and speed of AMCL: `python -m benchmarks.localization`.

In each of three known worlds robots drive to random goals from random starts. With every seed one is tracked from a
known pose, one is localized globally, and one is kidnapped; `docs/localization.md` says how each is judged. On the log
of a real robot, filters are compared with ROS's AMCL and Beluga. Times are those of whole updates on one core.
"""

import json
import math
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import tyro

from benchmarks.localization import intel
from benchmarks.localization.maps import load_known_world, symmetries
from benchmarks.localization.pictures import draw
from benchmarks.localization.runs import Run, run
from benchmarks.localization.timing import cost_by_size, update_times
from benchmarks.parallel import run_each
from envs.command_line import Count, run_command
from envs.logs import rms

WORLDS = ("turtlebot3_world", "turtlebot3_house", "tugbot_warehouse")
DATA = Path(os.environ.get("LIDARNAUT_DATA", Path(__file__).parents[3] / "shared" / "data")) / "intel"
INTEL_SEEDS = range(100, 105)


def main(
    json_file: Annotated[Path | None, tyro.conf.arg(name="json")] = None,
    runs: Count = 100,
    jobs: Count = 2,
    worlds: tuple[str, ...] = WORLDS,
    physics: Literal["kinematic", "bullet"] = "kinematic",
    preset: str = "default",
    first_seed: int = 0,
    picture: Path | None = None,
    only_runs: bool = False,
) -> dict[str, dict[str, Any]]:
    """Measure, and print.

    Args:
        json_file: also write the results to this file; times never reached are null.
        runs: seeds per world.
        jobs: number of processes.
        worlds: library worlds.
        physics: simulator.
        preset: of AMCL.
        first_seed: seed of the first run.
        picture: also draw particles, errors and cost to this file.
        only_runs: leave out times and the Intel log.
    """
    results: dict[str, dict[str, Any]] = {}
    for world in worlds:
        results[world] = _measure(world, preset, range(first_seed, first_seed + runs), physics, jobs)
        _print(f"{world}, {runs} runs, {physics} physics, {preset}", results[world])
    if not only_runs:
        house = load_known_world("turtlebot3_house")
        when, sizes, spent = cost = cost_by_size(house, 1)
        results["timing"] = {
            **update_times(house),
            "kld_seconds": when.tolist(),
            "kld_particles": sizes.tolist(),
            "kld_update_us": spent.tolist(),
        }
        _print("time of a whole update", {key: v for key, v in results["timing"].items() if key.endswith("[us]")})
        for k in sorted({0, 1, 2, 4, 8, 16, len(sizes) - 1} & set(range(len(sizes)))):
            print(f"  update {k + 1:3d} at {when[k]:5.1f} s: {sizes[k]:7.0f} particles {spent[k]:9.0f} us")
        if picture is not None:
            draw(house, 1, cost, picture)
        if (DATA / "scans_2725.npz").is_file():
            results["intel"] = intel.measure(DATA / "scans_2725.npz", INTEL_SEEDS)
            for name, measures in results["intel"].items():
                _print(f"Intel log, {name}", measures)
        else:
            print(f"the Intel log is not at {DATA}; set LIDARNAUT_DATA")
    if json_file is not None:
        json_file.write_text(json.dumps(results, indent=1) + "\n", encoding="utf-8")
    return results


def _measure(world: str, preset: str, seeds: range, physics: str, jobs: int) -> dict[str, Any]:
    """Run all seeds in one world, and summarise the runs."""
    tasks = [(world, preset, physics, seed) for seed in seeds]
    done = Run(*map(np.array, zip(*run_each(run, tasks, jobs, desc=world, leave=False))))
    return {
        "tracking_rmse_m": rms(done.position),
        "tracking_rmse_deg": rms(done.heading),
        "tracking_worst_run_m": float(done.position.max()),
        "tracking_worst_run_deg": float(done.heading.max()),
        "symmetries": len(symmetries(load_known_world(world, physics).grid)),
        "global_success": float(done.found.mean()),
        "global_success_up_to_symmetry": float(done.found_up_to_symmetry.mean()),
        "global_median_s": time_quantile(done.found_after, 0.5),
        "global_p90_s": time_quantile(done.found_after, 0.9),
        "kidnapped_recovery": float(done.recovered.mean()),
        "kidnapped_median_s": time_quantile(done.recovered_after, 0.5),
        "kidnapped_p90_s": time_quantile(done.recovered_after, 0.9),
        "kidnapped_noticed_median_s": time_quantile(done.noticed_after, 0.5),
        "confident_and_wrong_share": float(done.confident_and_wrong.mean()),
        "lost_while_right_share": float(done.lost_while_right.mean()),
    }


def time_quantile(times: Sequence[float], share: float) -> float | None:
    """Return a quantile of times of which some, never reached, are inf; None if that quantile was never reached."""
    if math.isinf(np.quantile(times, share, method="higher")):
        return None
    return float(np.quantile(np.nan_to_num(times), share))


def _print(title: str, measures: dict[str, Any]) -> None:
    print(title)
    for name, value in measures.items():
        print(f"  {name:52s} " + ("     never" if value is None else f"{value:10.4g}"))


if __name__ == "__main__":
    run_command(main)
