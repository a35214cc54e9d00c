"""What is measured of explorations, and the columns of their rows."""

from benchmarks.arena.measures import Measures
from benchmarks.arena.records import columns_of
from envs.tasks.explore import Explore

MEASURES = Measures(Explore.measures, Explore.progress)
COLUMNS = columns_of(MEASURES)
BY_NAME = {measure.name: measure for measure in (*MEASURES.all, *MEASURES.relative, *MEASURES.reached)}
