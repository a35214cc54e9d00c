"""Repeat the experiment of Nguyen et al. (2021) beside their results: `python -m benchmarks.ekf_rectangle`."""

import json
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Literal

import tyro

from envs.command_line import Count, run_command

from .drive import DRIVER, PAPER, Drive, measure, nees_bounds, run_drives
from .figures import draw_figures

LABELS = {
    "encoder": "encoder alone",
    "amcl": "AMCL alone",
    "encoder_compass": "encoder + compass",
    "full": "full fusion",
}
"""Fusions, in the order of the table."""
COLUMNS = {"position_rmse": 1e3, "max_x": 1e3, "max_y": 1e3, "heading_rmse": 1.0, "max_heading": 1.0}
"""Columns of the table, and their factors: positions are printed in millimetres."""


def main(
    seeds: Count = 20,
    jobs: Count = 2,
    physics: tuple[Literal["kinematic", "bullet"], ...] = ("kinematic", "bullet"),
    json_path: Annotated[Path | None, tyro.conf.arg(name="json")] = None,
    images: Path = Path("docs/images"),
) -> None:
    """Drive the rectangle and measure four estimates of the pose.

    Args:
        seeds: drives per physics; each has its own noise and its own map.
        jobs: number of processes.
        physics: simulators.
        json_path: also write `{fusion: {physics_measure: value}}` to this file.
        images: folder for the figures.
    """
    drives = run_drives(physics, seeds, jobs)
    by_physics = {name: [drive for drive in drives if drive.physics == name] for name in physics}
    results = {name: {fusion: measure(some, fusion) for fusion in LABELS} for name, some in by_physics.items()}
    for name, some in by_physics.items():
        _print_table(name, results[name], seeds)
        _print_drives(some)
    draw_figures(drives, LABELS, images)
    print(f"\nfigures 5 to 10 in {images}/ekf_*.png")
    if json_path is not None:
        content = {
            fusion: {f"{name}_{key}": value for name in physics for key, value in results[name][fusion].items()}
            for fusion in LABELS
        }
        json_path.write_text(json.dumps(content, indent=2) + "\n")


def _print_table(physics: str, results: dict[str, dict[str, float]], seeds: int) -> None:
    """Print the results of all fusions, median and worst drive, and the paper's."""
    low, high = nees_bounds(seeds)
    print(f"\n{physics} physics, {seeds} drives: median (worst)")
    print(
        f"{'':18}  position RMSE     max |x|          max |y|          heading RMSE      max heading       NEES\n"
        f"{'':18}  [mm]              [mm]             [mm]             [deg]             [deg]             (within)"
    )
    for fusion, values in results.items():
        cells = [
            f"{values[key] * scale:7.3g} ({values[key + '_worst'] * scale:7.3g})" for key, scale in COLUMNS.items()
        ]
        print(f"{LABELS[fusion]:18} {' '.join(cells)}  {values['nees']:6.3g} ({100 * values['nees_within']:.0f} %)")
    print(f"{'paper':18} {' '.join(f'{PAPER[key] * scale:7.3g}          ' for key, scale in COLUMNS.items())}")
    print(f"NEES of a consistent estimate: 3; 95 % of the means over {seeds} drives lie within [{low:.2f}, {high:.2f}]")
    full = results[DRIVER]
    missed = [key for key, value in PAPER.items() if full[f"{key}_worst"] >= value]
    verdict = f"worst drive beyond the paper's {', '.join(missed)}" if missed else "every drive better in every figure"
    print(f"full fusion against the paper: {verdict}")


def _print_drives(drives: Sequence[Drive]) -> None:
    """Print how the drives ended, and what happened to the measurements."""
    ends = dict(Counter(drive.end_reason for drive in drives))
    away = max(float(abs(drive.deviation).max()) for drive in drives)
    counts: Counter[str] = Counter()
    for drive in drives:
        for kind, verdicts in drive.counts.items():
            counts.update({f"{kind} {verdict}": number for verdict, number in verdicts.items()})
    collisions = sum(drive.collisions for drive in drives)
    print(f"ends: {ends}; collisions: {collisions}; at most {1e3 * away:.0f} mm off the route")
    print("measurements: " + ", ".join(f"{number} {what}" for what, number in sorted(counts.items())))


if __name__ == "__main__":
    run_command(main)
