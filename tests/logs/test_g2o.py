import numpy as np
import pytest

from envs.logs.g2o import Edge, load_g2o, save_g2o

INFORMATION = np.array([[4.0, 1.0, 2.0], [1.0, 5.0, 3.0], [2.0, 3.0, 6.0]])


def test_a_pose_graph_comes_back(tmp_path):
    nodes = np.array([[0.0, 0.0, 0.0], [1.0, 1 / 3, -3.0], [2.0, 0.0, 1e-7]])
    edges = [Edge(0, 1, np.array([1.0, 0.1, -3.0]), INFORMATION), Edge(2, 0, np.zeros(3), np.eye(3))]
    save_g2o(tmp_path / "graph.g2o", nodes, edges)
    text = (tmp_path / "graph.g2o").read_text().splitlines()
    assert text[3] == "FIX 0"
    assert text[4] == "EDGE_SE2 0 1 1.0 0.1 -3.0 4.0 1.0 2.0 5.0 3.0 6.0"
    graph = load_g2o(tmp_path / "graph.g2o")
    np.testing.assert_array_equal(graph.nodes, nodes)
    for found, edge in zip(graph.edges, edges, strict=True):
        assert found[:2] == edge[:2]
        np.testing.assert_array_equal(found.motion, edge.motion)
        np.testing.assert_array_equal(found.information, edge.information)


def test_ids_of_other_programs_become_rows(tmp_path):
    path = tmp_path / "graph.g2o"
    path.write_text("EDGE_SE2 7 5 1 0 0 1 0 0 1 0 1\nVERTEX_SE2 5 0 0 0\nVERTEX_SE2 7 1 0 0\n")
    graph = load_g2o(path)
    np.testing.assert_array_equal(graph.nodes, [[0, 0, 0], [1, 0, 0]])
    assert graph.edges[0][:2] == (1, 0)


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("VERTEX_SE2 0 0 0", "line 1: bad VERTEX_SE2 line: 3 finite numbers"),
        ("VERTEX_SE2 0 0 nan 0", "line 1: bad VERTEX_SE2 line"),
        ("VERTEX_SE2 0 0 0 0\nVERTEX_SE2 0 0 0 0", "line 2: .*second node 0"),
        ("VERTEX_SE3:QUAT 0 0 0 0 0 0 0 1", "only VERTEX_SE2, EDGE_SE2 and FIX are known"),
        ("VERTEX_SE2 0 0 0 0\nEDGE_SE2 0 1 0 0 0 1 0 0 1 0 1", "line 2: there is no node 1"),
    ],
)
def test_bad_files_are_named(tmp_path, text, complaint):
    path = tmp_path / "graph.g2o"
    path.write_text(text)
    with pytest.raises(ValueError, match=f"graph.g2o, .*{complaint}"):
        load_g2o(path)


def test_bad_graphs_are_not_written(tmp_path):
    with pytest.raises(ValueError, match="edge from 0 to 1 in a graph of 1 nodes"):
        save_g2o(tmp_path / "graph.g2o", np.zeros((1, 3)), [Edge(0, 1, np.zeros(3), np.eye(3))])
    with pytest.raises(ValueError, match="finite"):
        save_g2o(tmp_path / "graph.g2o", np.full((1, 3), np.nan), [])
    assert list(tmp_path.iterdir()) == []
