import io
import re

import numpy as np
import pytest
from PIL import Image

from lidarnaut.benchmarks.arena.episodes import Episodes
from lidarnaut.benchmarks.arena.leaderboard import ranking_sections
from lidarnaut.benchmarks.arena.measures import Measures
from lidarnaut.benchmarks.arena.page import Table
from lidarnaut.benchmarks.arena.verdict import ranks, verdict, verdict_section
from lidarnaut.envs.measures import GOAL
from tests.benchmarks.explorations import row, table

STARTS = 8
BASE = np.full(STARTS, 100.0)
SPREAD = np.linspace(-4.0, 4.0, STARTS)
NEVER = np.full(STARTS, np.inf)


def episodes(policy, times, area=0.8, late=None, **more):
    """Episodes with equal starts; an infinite time means that 95 % was never reached, `late` are times of success."""
    limits, late = {"time_limit": 1000.0, "distance_limit": 1000.0}, times if late is None else late
    ends = [{"duration": min(last, 1000.0), "explored": 1.0 if np.isfinite(last) else 0.97} for last in late]
    return [
        row(policy, seed, area=area, time=time, distance=time, **limits, **end) | more
        for seed, (time, end) in enumerate(zip(times, ends))
    ]


def rows_of(policies):
    return [row for policy, times in policies.items() for row in episodes(policy, times)]


def say(reference="", **policies):
    return verdict(table(rows_of(policies), reference))


def test_the_best_policy_stands_beside_the_best_classic_explorer_and_the_bound():
    bound = {"mine (ground truth)": 0.5 * BASE}
    text = say(**bound, nearest=BASE, frontier=90.0 + SPREAD, rrt=95.0 + SPREAD, mine=80.0 + SPREAD)
    assert text.startswith("8 starts; success: 99 % is explored. All policies succeed alike often: 100 % [68, 100]. ")
    share = r"0\.80 \[0\.7\d, 0\.8\d\]"
    assert re.search(rf"mine is best: time to success {share} of nearest's; the best classic policy is", text)
    assert "the best classic policy is frontier (0.90 [" in text
    assert "the bound, mine (ground truth), has 0.50." in text
    assert text.endswith("In 8 pairs, the ratio of mine to frontier is 0.89 [0.89, 0.89].")
    assert "not shown to be worse" not in text


def test_success_comes_before_speed():
    late = np.where(np.arange(STARTS) < 3, BASE, np.inf)
    rows = [*rows_of({"nearest": BASE, "frontier": 90.0 + SPREAD}), *episodes("mine", 0.5 * BASE, late=0.5 * late)]
    text = verdict(table(rows))
    assert "nearest (100 % [68, 100]) and frontier (100 % [68, 100]) succeed most often; less: mine (38 %" in text
    assert "Of these, frontier is best: time to success 0.90 [" in text
    alone = verdict(table(rows[STARTS:]))
    assert "frontier (100 % [68, 100]) succeeds most often; less: mine (38 % [14, 69]). In 8 pairs, the diff" in alone
    assert "of frontier to mine is +62 % [+25, +100]. frontier is best: time to success" in alone


def test_what_differs_from_start_to_start_only_is_not_told_apart():
    text = say(nearest=BASE, frontier=81.0 - SPREAD, rrt=95.0 + SPREAD, mine=80.0 + SPREAD)
    assert "mine is first: time to success 0.80 [" in text
    assert "not shown to be worse: frontier (0.81 [" in text
    assert "rrt" not in text.partition("is first")[2]
    assert text.endswith("these starts resolve 5 %.")
    text = say(nearest=BASE, frontier=81.0 - 3.0 * SPREAD, mine=80.0 + 3.0 * SPREAD)
    wanted = int(re.search(r"about (\d+) starts would resolve 5 %", text).group(1))
    ratios = (80.0 + 3.0 * SPREAD) / (81.0 - 3.0 * SPREAD)
    half = 1.96 * np.std(np.log(ratios)) / np.sqrt(STARTS)
    assert wanted == pytest.approx(STARTS * (half / 0.05) ** 2, rel=0.2)
    # The intervals overlap, but one policy is faster from every start.
    assert "mine is best" in say(nearest=BASE, frontier=81.0 + SPREAD, mine=80.0 + SPREAD)


def test_many_that_cannot_be_told_apart_are_counted():
    same = {name: 80.0 - (k + 1) * 0.01 * SPREAD + 0.001 * k for k, name in enumerate("abcde")}
    text = say(nearest=BASE, mine=80.0 + SPREAD, **same)
    assert re.search(r"not shown to be worse: \w \(.*\), \w \(.*\), \w \(.*\) and 2 more", text)


def test_any_policy_may_be_the_reference():
    assert "time to success 1.00 of nearest's; the next is frontier (1.10 [" in say(
        nearest=BASE, frontier=110.0 + SPREAD
    )
    text = say("frontier", nearest=BASE, frontier=110.0 + SPREAD)
    assert re.search(r"nearest is best: time to success 0\.91 \[0\.\d+, 0\.\d+\] of frontier's", text)


def test_nobody_may_succeed():
    rows = [*episodes("nearest", BASE, late=NEVER), *episodes("frontier", 0.5 * BASE, late=NEVER)]
    assert "No policy succeeded. frontier is best: time to 95 % 0.50 of nearest's" in verdict(table(rows))
    rows = [*episodes("nearest", NEVER), *episodes("frontier", NEVER, area=0.7)]
    assert "No policy succeeded. nearest is best: area under curve 80.0 %" in verdict(table(rows))


@pytest.mark.parametrize("number", [1, 2, 4, 5])
def test_few_starts_give_no_verdict_and_tables_say_so(number):
    times = {"nearest": BASE[:number], "mine": 0.5 * BASE[:number], "mine (ground truth)": 0.2 * BASE[:number]}
    explored = table(rows_of(times))
    section, (ranking,) = verdict_section(explored), ranking_sections(explored)
    cells = [cell for line in ranking.parts[1].lines for cell in line[1:]]
    assert any(line[0].text.startswith("1") for line in ranking.parts[1].lines) is (number >= 5)
    notes = [cell.note for cell in cells if cell.note]
    if number >= 5:
        assert "mine is best" in section.parts[0]
        assert any(cell.is_best for cell in cells)
        assert not [note for note in notes if "*" in note]
        assert ranking.parts[1].note == ""
        assert "Bold: better than all others" in ranking.parts[0]
        return
    few = f"only {number} start{'s' * (number > 1)}"
    assert section.parts == (
        f"No verdict: the policies have {few} in common; at least 5 are needed, so policies are not ranked.",
    )
    assert all(note.endswith("*") for note in notes)
    assert len(notes) == 3  # of success: other values are equal
    assert ranking.parts[1].note == f"* {few}: bootstrap intervals of so few values are too narrow."
    assert not any(cell.is_best for cell in cells)
    assert "Bold" not in ranking.parts[0]


def test_the_starts_that_all_share_decide_whether_there_is_a_verdict():
    rows = [*rows_of({"nearest": BASE, "mine": 0.5 * BASE}), *episodes("late", 0.4 * BASE[:3])]
    assert verdict(table(rows)).startswith("No verdict: the policies have only 3 starts in common;")
    disjoint = [*episodes("nearest", BASE), *(one | {"seed": 100} for one in episodes("mine", BASE))]
    assert "only 0 starts" in verdict(table(disjoint))


def test_a_bound_of_few_starts_says_so():
    rows = [*rows_of({"nearest": BASE, "mine": 0.5 * BASE}), *episodes("o (ground truth)", [20.0, 30.0])]
    assert "the bound, o (ground truth), has 0.24 [0.20, 0.30; only 2 starts]" in verdict(table(rows))


def test_what_no_training_saw_comes_first():
    unseen, seen = "turtlebot3_house", "rrt_house"
    rows = []
    for world, share in ((unseen, 0.9), (seen, 0.5)):
        times = {"nearest": BASE, "gain_over_cost": 0.85 * BASE + SPREAD, "mine": share * BASE + SPREAD}
        for policy, values in times.items():
            rows += episodes(policy, values, world=world, model="ab" if policy == "mine" else "")
    text, figure, matrix = verdict_section(table(rows)).parts
    first, pooled = text.split(" Including training worlds: ")
    assert first.startswith(f"In worlds or with robots not used in training: {STARTS} starts;")
    assert "gain_over_cost is best: time to success 0.85" in first
    assert pooled.startswith(f"{2 * STARTS} starts;")
    assert "mine is best: time to success 0.67" in pooled
    assert "not used in training" in figure.caption
    assert f"same {STARTS} starts" in matrix.parts[0]
    unseen_ranking, ranking = ranking_sections(table(rows))
    assert ranking.title.startswith(f"All {2 * STARTS} starts")
    assert unseen_ranking.parts[1] != ranking.parts[0]
    # Without learned models, all starts are alike.
    classic = table([row | {"model": ""} for row in rows])
    assert not verdict_section(classic).parts[0].startswith("In worlds")
    assert len(ranking_sections(classic)) == 1


def test_orders_that_differ_are_told_in_a_sentence_each():
    slow = 120.0 + SPREAD
    rows = [
        *episodes("nearest", BASE, 0.9),
        *episodes("frontier", 0.8 * BASE, 0.8, late=slow),
        *episodes("rrt", slow, 0.7),
    ]
    _, text, orders, _, _ = verdict_section(table(rows)).parts
    assert text == "The best policy depends on the measure:"
    found = {line[0].text: line[1].text for line in orders.lines}
    assert list(found) == ["time to success, ratio", "time to 95 %, ratio", "area under curve"]
    assert [text.partition(" is ")[0] for text in found.values()] == ["nearest", "frontier", "nearest"]
    same = [*episodes("nearest", BASE, 0.9), *episodes("frontier", 0.8 * BASE, 0.95)]
    assert not [part for part in verdict_section(table(same)).parts if isinstance(part, Table)]


def test_any_two_policies_are_compared():
    times = {"nearest": BASE, "b": 80.0 + SPREAD, "c": 81.0 - SPREAD}
    head, lines = verdict_section(table(rows_of(times))).parts[-1].parts[1][:2]
    assert head == ("", "a", "b", "c")
    cells = {line[0].text: line[1:] for line in lines}
    assert list(cells) == ["a: b", "b: c", "c: nearest"]
    assert [cell.text for cell in cells["a: b"]] == ["", "0.99", "0.80"]
    assert [cell.is_best for cell in cells["a: b"]] == [False, False, True]
    assert [cell.text for cell in cells["c: nearest"]] == ["1.25", "1.24", ""]
    assert not any(cell.is_best for cell in cells["c: nearest"])


def test_goals_are_judged_by_their_own_success():
    measures = Measures((*GOAL,), "progress", "the robot is within 0.3 m of its goal")
    rates = {"pursuit": 1.0, "dwb": 1.0, "mine": 0.25}
    rows = [
        {**row(policy, seed), "spl": spl, "success": int(seed < rate * STARTS), "time_to_goal": 10.0, "way_left": 0.0}
        for (policy, rate), spl in zip(rates.items(), (0.9, 0.7, 0.95))
        for seed in range(STARTS)
    ]
    text = verdict(Episodes(rows, measures))
    assert text.startswith("8 starts; success: the robot is within 0.3 m of its goal. ")
    assert "succeed most often; less: mine (25 %" in text
    assert text.endswith(
        "Of these, pursuit is best: success by path length 90.0 %; the next is dwb (70.0 %). "
        "In 8 pairs, the difference of pursuit to dwb is +20.0 %."
    )


@pytest.mark.parametrize("slowest", [120.0, 700.0, np.inf])
def test_the_picture_holds_all_of_its_labels(slowest):
    times = {"nearest": BASE, "a policy with a name of over thirty letters": 0.8 * BASE, "slow": [slowest] * STARTS}
    figure = next(part for part in verdict_section(table(rows_of(times))).parts if hasattr(part, "caption"))
    pixels = np.asarray(Image.open(io.BytesIO(figure.content)).convert("L"))
    assert pixels[:, [0, -1]].min() > 240
    assert pixels[[0, -1]].min() > 240


def test_ranks_are_those_of_the_text():
    times = {"nearest": BASE, "b": 80.0 + SPREAD, "c": 81.0 - SPREAD, "late": 80.0 + SPREAD}
    rows = [
        one | ({"success": 0, "explored_fraction": 0.9} if one["policy"] == "late" else {}) for one in rows_of(times)
    ]
    explored = table([*rows, *episodes("o (ground truth)", 0.2 * BASE)])
    assert ranks(explored) == {"b": "1-2", "c": "1-2", "nearest": "3", "late": "4"}
    (ranking,) = ranking_sections(explored)
    names = ["1-2: b", "1-2: c", "3: nearest", "4: late", "bound: o (ground truth)"]
    assert [line[0].text for line in ranking.parts[1].lines] == names
    assert "b is first: " in verdict(explored)
    assert "not shown to be worse: c (" in verdict(explored)
    undecided = table(rows_of({"b": 80.0 + SPREAD, "c": 81.0 - SPREAD}))
    assert ranks(undecided) == {"b": "", "c": ""}
    assert "No ranks" in ranking_sections(undecided)[0].parts[0]


def test_a_policy_alone_is_compared_with_nothing():
    alone = table(episodes("nearest", BASE))
    (text,) = verdict_section(alone).parts
    assert text.startswith(
        "nearest alone: 100 % [68, 100] of 8 starts succeed (99 % is explored). Nothing shows whether"
    )
    assert text.endswith("other policies are better, or how it does in other worlds.")
    assert "time to success s" in ranking_sections(alone)[0].parts[1].head
    assert verdict_section(table(episodes("o (ground truth)", BASE))).parts[0].startswith("o (ground truth) alone:")
