"""Exploration of a warehouse: report "Hệ thống AGV tự động khám phá map cho smart warehouse" (2024)."""

from pathlib import Path
from tempfile import TemporaryDirectory

from rich.console import Console

from lidarnaut.benchmarks.arena.plots import draw_bands, draw_growth, render, sample_curves
from lidarnaut.benchmarks.arena.publish import run_with_progress
from lidarnaut.benchmarks.arena.runner import Evaluation
from lidarnaut.benchmarks.arena.settings import Settings
from lidarnaut.benchmarks.arena.trace import Trace, load_curve, slug, trace_path
from lidarnaut.benchmarks.documents.figures import Figure, figures_of
from lidarnaut.envs.files import write_file

SLAMS = {"graph?preset=cartographer": ("frontier:published",), "graph": ("frontier", "nearest")}
"""Explorers by SLAM: the report's values of all parts, and the defaults of this package."""
WORLD, ROBOT, RUNS = "tugbot_warehouse", "tugbot", 12
DOCUMENT_MINUTES = 20.0
"""Expected duration of the exploration in the report, and time limit [min]."""
QUICK_WORLD, QUICK_LIMIT = "aws_small_warehouse", 20.0
"""World of the shortened experiment, and its time limit [s]."""


def run(pictures: Path, runs: int | None, jobs: int, quick: bool) -> list[Figure]:
    """Explore the warehouse from `runs` random starts; write `progress.png` and `map.png`; return the figures.

    Raises RuntimeError if an episode failed.
    """
    figures, curves, traces = [], {}, {}
    with TemporaryDirectory() as folder:
        for slam, policies in SLAMS.items():
            settings = Settings(
                policies=policies,
                worlds=(QUICK_WORLD if quick else WORLD,),
                robots=(ROBOT,),
                slam=(slam,),
                episodes=runs or (1 if quick else RUNS),
                time_limit=QUICK_LIMIT if quick else 60.0 * DOCUMENT_MINUTES,
            )
            evaluation = Evaluation(settings, Path(folder) / slug(slam))
            if failures := run_with_progress(evaluation, jobs, Console(stderr=True)):
                raise RuntimeError(f"{len(failures)} episodes failed, the first one by {failures[0].reason}")
            for policy in policies:
                rows = [row for row in evaluation.rows() if row["policy"] == policy]
                found = [
                    {
                        "time to explore 99 % [min]": row["time_to_99"] / 60.0,
                        "explored share [%]": 100.0 * row["explored_fraction"],
                        "map IoU": row["map_iou"],
                        "position error (RMS) [m]": row["position_rmse"],
                        "collisions": row["collisions"],
                    }
                    for row in rows
                ]
                figures += figures_of(found, f"{policy}: {{}}", {"time to explore 99 % [min]": DOCUMENT_MINUTES})
                curves[policy] = [[load_curve(evaluation.folder, row) for row in rows]]
                traces[policy] = Trace.load(trace_path(evaluation.folder, rows[0]))
    grid, bands = sample_curves(curves, "time")
    write_file(pictures / "progress.png", render(draw_bands, grid, bands, "time [s]", "explored"))
    write_file(pictures / "map.png", render(draw_growth, *next(iter(traces.items()))))
    return figures
