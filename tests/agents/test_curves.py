"""Learning curves of several trainings."""

from agents.curves import mean_over_seeds


def rows(*shares, references=()):
    """Rows as in `evaluations.csv`."""
    measures = {"episodes": 4.0, "time_spl_q25": 0.0, "time_spl_q75": 1.0}
    classic = [{"policy": name, "steps": 0, "success": 0.5, "time_spl": 0.2, **measures} for name in references]
    return classic + [
        {"policy": "learned", "steps": 10 * k, "success": share, "time_spl": share / 2, **measures, "scores": "0 1"}
        for k, share in enumerate(shares)
    ]


def test_seeds_are_one_line_with_their_range_as_far_as_all_got_beside_the_references_of_one():
    rival, first, second = mean_over_seeds([rows(0.0, 0.4, 0.9), rows(0.2, 0.8, references=["dwb"])])
    assert (rival["policy"], rival["success"]) == ("dwb", 0.5)
    assert (first["steps"], first["success"]) == (0, 0.1)
    assert second["steps"] == 10
    assert abs(second["success"] - 0.6) < 1e-12
    assert (second["success_q25"], second["success_q75"], second["time_spl_q75"]) == (0.4, 0.8, 0.4)
