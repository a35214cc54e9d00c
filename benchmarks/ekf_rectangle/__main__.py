"""Repeat the experiment of Nguyen et al. (2021) beside their results: `python -m benchmarks.ekf_rectangle`."""

import json
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Literal

import tyro
from tqdm import tqdm

from .drive import DRIVER, Drive, run_drives
from .figures import draw_figures
from .measures import PAPER, Measures, measure, nees_bounds

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
    seeds: int = 20,
    jobs: int = 2,
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
    drives: list[Drive] = list(tqdm(run_drives(physics, seeds, jobs), total=seeds * len(physics), unit="drive"))
    results = {
        fusion: {name: measure([drive for drive in drives if drive.physics == name], fusion) for name in physics}
        for fusion in LABELS
    }
    for name in physics:
        _print_table(name, {fusion: results[fusion][name] for fusion in LABELS}, seeds)
        _print_drives([drive for drive in drives if drive.physics == name])
    draw_figures(drives, LABELS, images)
    print(f"\nfigures 5 to 10 in {images}/ekf_*.png")
    if json_path is not None:
        content = {
            fusion: {f"{name}_{key}": value for name, measures in of.items() for key, value in asdict(measures).items()}
            for fusion, of in results.items()
        }
        json_path.write_text(json.dumps(content, indent=2) + "\n")


def _print_table(physics: str, results: dict[str, Measures], seeds: int) -> None:
    """Print the results of all fusions, median and worst drive, and the paper's."""
    low, high = nees_bounds(seeds)
    print(f"\n{physics} physics, {seeds} drives: median (worst)")
    print(
        f"{'':18}  position RMSE     max |x|          max |y|          heading RMSE      max heading       NEES\n"
        f"{'':18}  [mm]              [mm]             [mm]             [deg]             [deg]             (within)"
    )
    for fusion, measures in results.items():
        values = asdict(measures)
        cells = [
            f"{values[key] * scale:7.3g} ({values[key + '_worst'] * scale:7.3g})" for key, scale in COLUMNS.items()
        ]
        print(f"{LABELS[fusion]:18} {' '.join(cells)}  {measures.nees:6.3g} ({100 * measures.nees_within:.0f} %)")
    print(f"{'paper':18} {' '.join(f'{PAPER[key] * scale:7.3g}          ' for key, scale in COLUMNS.items())}")
    print(f"NEES of a consistent estimate: 3; 95 % of the means over {seeds} drives lie within [{low:.2f}, {high:.2f}]")
    full = asdict(results[DRIVER])
    missed = [key for key, value in PAPER.items() if full[f"{key}_worst"] >= value]
    verdict = f"worst drive beyond the paper's {', '.join(missed)}" if missed else "every drive better in every figure"
    print(f"full fusion against the paper: {verdict}")


def _print_drives(drives: Sequence[Drive]) -> None:
    """Print how the drives ended, and what happened to the measurements."""
    ends = {reason: sum(drive.end_reason == reason for drive in drives) for reason in {d.end_reason for d in drives}}
    away = max(float(abs(drive.deviation).max()) for drive in drives)
    counts: dict[str, int] = {}
    for drive in drives:
        for kind, verdicts in drive.counts.items():
            for verdict, number in verdicts.items():
                counts[f"{kind} {verdict}"] = counts.get(f"{kind} {verdict}", 0) + number
    collisions = sum(drive.collisions for drive in drives)
    print(f"ends: {ends}; collisions: {collisions}; at most {1e3 * away:.0f} mm off the route")
    print("measurements: " + ", ".join(f"{number} {what}" for what, number in sorted(counts.items())))


if __name__ == "__main__":
    tyro.cli(main)
