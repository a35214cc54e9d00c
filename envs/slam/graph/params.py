"""Parameters of graph SLAM, and the presets that come with it."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from pydantic import ConfigDict

from envs.slam.hector_params import HectorParams
from envs.slam.matching.score_surface import SurfaceParams
from envs.slam.preset_files import find_presets, load_preset

from .loop_closure import LoopClosureParams

GRAPH_PRESETS = find_presets("graph")
"""Files of the presets by name."""


@dataclass(frozen=True, slots=True, kw_only=True)
class GraphSlamParams(HectorParams):
    """All params of `GraphSlam`: those of Hector, which match scans with submaps, and those of the graph.

    A scan that is integrated is a node; `min_travel_distance` and `min_travel_angle` lie between two of them.
    """

    __pydantic_config__ = ConfigDict(extra="forbid", allow_inf_nan=False)

    min_travel_angle: float = 0.3
    """See `HectorParams`, also the next two: submaps are smaller than maps, and less of a scan falls in known cells."""
    retry_below: float = 0.4
    min_known_score: float = 0.25
    submap_spacing: int = 20
    """A submap starts every so many nodes, and takes twice as many."""
    correlation: float = 5.0
    """Factor of the covariance of a node in its submap: errors of neighbours are correlated."""
    node_sigma_xy: float = 0.03
    """Least standard deviation of a node in its submap [m]."""
    node_sigma_theta: float = 0.008
    """The same of the heading [rad]."""
    loops: LoopClosureParams = field(default_factory=LoopClosureParams)
    """Where loop closures are searched and when they are accepted."""
    surface: SurfaceParams = field(default_factory=SurfaceParams)
    """How the covariance of a loop closure is found."""
    loop_every: int = 2
    """Loop closures are searched at every so many nodes."""
    submap_every: int = 6
    """Nodes between two searches of the same submap."""
    max_candidates: int = 2
    """Most submaps that are searched at one node."""
    loop_scans: int = 5
    """Scans that are matched together."""
    max_evaluations: int = 20_000
    """Most poses and groups of poses that a search scores."""
    max_rendered: int = 8
    """Finished submaps whose fields are kept; others are rendered when they are searched."""
    phi: float = 9.0
    """Chi^2 above which loop constraints weigh less."""
    max_chi2: float = 54.0
    """Chi^2 above which loop constraints are dropped."""
    optimise_every: int = 10
    """Nodes with loop closures before the graph is optimised."""
    urgent_correction: float = 0.1
    """Correction that starts the optimisation at once [m]."""
    max_iterations: int = 5
    """Most iterations of one optimisation; one is done per key scan."""
    tolerance: float = 1e-4
    """Largest change that ends an optimisation [m or rad]."""
    redraw_distance: float = 0.1
    """The map is rendered anew once an optimisation has moved a node by more than this in it [m]"""
    redraw_angle: float = 0.02
    """... or turned one by more than this [rad]."""
    cells_per_scan: int = 1_000_000
    """Cells along the beams of nodes that are rendered into a corrected map at each key scan, and those of one node."""
    final_passes: int = 1
    """How often `finish` matches all nodes with the map that is rendered from them."""

    def __post_init__(self) -> None:
        HectorParams.__post_init__(self)
        for name in ("correlation", "node_sigma_xy", "node_sigma_theta", "phi", "max_chi2", "tolerance"):
            if not 0.0 < getattr(self, name) < math.inf:
                raise ValueError(f"{name} must be positive, got {getattr(self, name)!r}")
        for name in (
            "submap_spacing",
            "loop_every",
            "submap_every",
            "loop_scans",
            "max_rendered",
            "optimise_every",
            "max_iterations",
            "cells_per_scan",
        ):
            if getattr(self, name) < 1:
                raise ValueError(f"{name} must be at least 1, got {getattr(self, name)!r}")
        if self.final_passes < 0:
            raise ValueError(f"final_passes must not be negative, got {self.final_passes!r}")


def load_graph_params(
    preset: str | Path | GraphSlamParams, changes: Mapping[str, Any] | None = None
) -> GraphSlamParams:
    """Return params by the name of a preset or what else stands for them; see `load_preset`."""
    return load_preset(GraphSlamParams, preset, GRAPH_PRESETS, "preset of graph", changes)
