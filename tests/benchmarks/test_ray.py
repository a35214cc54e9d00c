import pytest

from benchmarks.arena.runner import Evaluation
from benchmarks.arena.settings import Settings

ray = pytest.importorskip("ray", reason="needs the extra `ray`")

SETTINGS = Settings(
    policies=("nearest", "random"), worlds=("pimouse_arena",), episodes=2, physics=("kinematic",), time_limit=3.0
)


@pytest.fixture(scope="module")
def address():
    from ray.cluster_utils import Cluster

    cluster = Cluster(initialize_head=True, head_node_args={"num_cpus": 1, "include_dashboard": False})
    yield cluster.address
    cluster.shutdown()


def test_a_cluster_gives_the_episodes_that_this_process_gives(address, tmp_path):
    here, there = (Evaluation(SETTINGS, tmp_path / name) for name in ("here", "there"))
    assert here.run() == there.run(ray=address) == []
    assert not ray.is_initialized()
    by_key = [sorted(map(deterministic, evaluation.rows()), key=str) for evaluation in (here, there)]
    assert by_key[0] == by_key[1]
    assert len(by_key[0]) == 4
    traces = [{path.name for path in (tmp_path / name / "episodes").iterdir()} for name in ("here", "there")]
    assert traces[0] == traces[1]
    assert len(traces[0]) == 4


def deterministic(row):
    return {name: value for name, value in row.items() if name != "decision_ms"}
