"""Pi Mouse with RRT, Hector and AMCL (Nguyen, Tran and Nguyen, 2022); see `docs/documents/pi_mouse.md`."""

import math
from pathlib import Path
from typing import Any

import numpy as np

from lidarnaut.baselines import RrtExplorer, RrtParams
from lidarnaut.baselines.global_localization import Animation, localize_and_drive, map_world
from lidarnaut.benchmarks.documents.figures import Figure, figures_of
from lidarnaut.benchmarks.drives.maps import Panel, draw_maps, wrong_cells
from lidarnaut.benchmarks.drives.recording import RESOLUTION, Setup, record_drive, run_each
from lidarnaut.benchmarks.drives.slams import measure_drive
from lidarnaut.envs.slam import make_slam

SLAMS = {
    "turtlebot3_world": "hector?preset=faithful,min_travel_distance=0.1,min_travel_angle=0.04",
    "pimouse_arena": "hector?preset=faithful",
}
"""SLAM without odometry by world, with the report's distances between map updates."""
EXPLORERS = {
    "turtlebot3_world": RrtParams(min_gain=0.05, view_radius=2.0, turn_cost=1.0, period=0.2, pursuit=True),
    "pimouse_arena": RrtParams(),
}
"""Parameters of the explorer `rrt` by world."""
GOALS: dict[str, Any] = {"goal_tolerance": 0.15, "heading_tolerance": 0.17, "min_distance": 0.5}


def explore_and_return(world: str, seed: int, out: Path, goals: int, minutes: float) -> dict[str, float]:
    """Explore, localize and drive to goals in a world; map it again in a random drive of some minutes.

    Returns measures by name with unit. Seed 0 draws pictures to the folder `out`.
    """
    slam, place = SLAMS[world], {"world": world, "robot": "raspimouse", "physics": "bullet"}
    out = out / f"{world}_{seed}"
    out.mkdir(exist_ok=True)
    explorer: Any = RrtExplorer(EXPLORERS[world])
    mapped, episode = map_world(out, seed, explorer, slam=slam, **place)
    grid, start, area, animation = mapped.belief.grid, mapped.map_pose, mapped.task.area, Animation()
    watch = (lambda _: None) if seed else animation.take
    localized, ends = localize_and_drive(mapped, out / "map.yaml", seed, goals, watch, **place, **GOALS)
    if seed == 0:
        animation.save(out / "localization.gif")
        edges: Any = start.transform(explorer._detector.trees[-1].edges.reshape(-1, 2)).reshape(-1, 2, 2)
        edges = np.insert(edges, 2, np.nan, axis=1).reshape(-1, 2)
        wrong, walls, true_path = wrong_cells(grid, start, area.walls), area.walls, mapped.truths[0].trail.positions
        panels = [
            Panel("Ground truth and path", walls, true_path),
            Panel("Map and estimated path", grid, start.transform(mapped.robots[0].trail.positions), wrong, start),
            Panel("Global tree", grid, edges, wrong, start),
        ]
        draw_maps(out / "map_and_tree.png", panels, walls, f"{world}: RRT, Hector without odometry")
    setup = Setup(mapped.world, mapped.robot_params, area, "bullet")
    estimator = make_slam(
        slam, mapped.robot_params.lidar, RESOLUTION, odometry_noise=mapped.robot_params.odometry.noise
    )
    row, _ = measure_drive(setup, record_drive(setup, seed, 60.0 * minutes), estimator, seed)
    return {
        "95 % of the floor [s]": episode.time_to_95,
        "99 % of the floor [s]": episode.time_to_99,
        "map IoU after exploring": episode.map_iou,
        "localized [s]": localized["time"] if localized else math.inf,
        "error when localized [m]": localized["pose_error"][0] if localized else math.inf,
        f"goals reached of {goals}": sum(info["end_reason"] == "reached" for info in ends),
        "collisions": episode.collisions + ends[-1]["collisions"],
        f"map IoU after {minutes:g} minutes": row["map_iou"],
        f"position RMSE in {minutes:g} minutes [m]": row["translation_m"],
    }


def run(pictures: Path, runs: int | None, jobs: int, quick: bool) -> list[Figure]:
    count, goals, minutes, figures = runs or (1 if quick else 10), 2 if quick else 10, 0.5 if quick else 5.0, []
    tasks = [(world, seed, pictures, goals, minutes) for world in SLAMS for seed in range(count)]
    done = run_each(explore_and_return, tasks, jobs, "runs")
    for k, world in enumerate(SLAMS):
        expected = ("95 % of the floor [s]", "99 % of the floor [s]") if world == "turtlebot3_world" else ()
        figures += figures_of(done[k * count : (k + 1) * count], f"{world}: {{}}", dict.fromkeys(expected, 10.0))
    return figures
