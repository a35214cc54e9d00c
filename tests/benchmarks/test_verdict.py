import io
import re

import numpy as np
import pytest
from PIL import Image

from lidarnaut.benchmarks.arena.leaderboard import ranking_sections
from lidarnaut.benchmarks.arena.verdict import verdict, verdict_section
from tests.benchmarks.explorations import related, row

STARTS = 8


def episodes(policy, times, area=0.8, **more):
    """Episodes with equal starts; an infinite time means that 95 % was never reached."""
    limits = {"time_limit": 1000.0, "distance_limit": 1000.0}
    return [
        row(policy, seed, area=area, time=time, distance=time, explored=1.0 if np.isfinite(time) else 0.5, **limits)
        | more
        for seed, time in enumerate(times)
    ]


def say(**policies):
    return verdict(related([row for policy, times in policies.items() for row in episodes(policy, times)]))


BASE = np.full(STARTS, 100.0)
SPREAD = np.linspace(-4.0, 4.0, STARTS)


def test_a_clear_winner_stands_beside_the_best_classic_explorer_and_the_bound():
    bound = {"mine (ground truth)": 0.5 * BASE}
    text = say(**bound, nearest=BASE, frontier=90.0 + SPREAD, rrt=95.0 + SPREAD, mine=80.0 + SPREAD)
    share = r"0\.80 \[0\.7\d, 0\.8\d\]"
    assert re.match(rf"mine is fastest: 95 % in {share} of nearest's time over 8 starts; the best classic", text)
    assert "the best classic policy, frontier, needs 0.90 [" in text
    assert "the bound, mine (ground truth), is 0.50." in text
    assert "cannot be distinguished" not in text


def test_what_differs_from_start_to_start_only_is_not_told_apart():
    text = say(nearest=BASE, frontier=81.0 - SPREAD, rrt=95.0 + SPREAD, mine=80.0 + SPREAD)
    assert text.startswith("mine is ahead: 95 % in 0.80 [")
    assert "it cannot be distinguished from frontier (0.81 [" in text
    assert "rrt" not in text
    # The intervals overlap, but one policy is faster from every start.
    paired = say(nearest=BASE, frontier=81.0 + SPREAD, mine=80.0 + SPREAD)
    assert paired.startswith("mine is fastest")


def test_many_that_cannot_be_told_apart_are_counted():
    same = {name: 80.0 - (k + 1) * 0.01 * SPREAD + 0.001 * k for k, name in enumerate("abcde")}
    text = say(nearest=BASE, mine=80.0 + SPREAD, **same)
    assert re.search(r"cannot be distinguished from \w \(.*\), \w \(.*\), \w \(.*\) and 2 more", text)


def test_the_reference_may_win_and_nobody_may():
    text = say(nearest=BASE, frontier=110.0 + SPREAD)
    assert text.startswith("nearest is fastest: no other policy is faster to 95 % over 8 starts; the next")
    never = np.full(STARTS, np.inf)
    nobody = "No policy reached 95 % from any of the 8 starts within the time limit."
    assert say(nearest=never, frontier=never) == nobody
    both = related([*episodes("nearest", never), *episodes("frontier", never)])
    assert len(verdict_section(both).parts) == 1
    assert verdict_section(related(episodes("nearest", BASE))) is None


@pytest.mark.parametrize("number", [1, 2, 4, 5])
def test_few_starts_give_no_verdict_and_tables_say_so(number):
    times = {"nearest": BASE[:number], "mine": 0.5 * BASE[:number], "mine (ground truth)": 0.2 * BASE[:number]}
    explored = related([row for policy, values in times.items() for row in episodes(policy, values)])
    section, (ranking,) = verdict_section(explored), ranking_sections(explored)
    notes = [cell.note for line in ranking.parts[-1].lines for cell in line[1:] if cell.note]
    if number >= 5:
        assert section.parts[0].startswith("mine is fastest")
        assert not [note for note in notes if "only" in note]
        return
    few = f"only {number} start{'s' * (number > 1)}"
    assert section.parts == (f"No verdict: the policies have {few} in common; at least 5 are needed.",)
    assert all(note.endswith(few) for note in notes)
    assert len(notes) > 10


def test_the_policy_with_the_fewest_starts_decides_whether_there_is_a_verdict():
    rows = [*episodes("nearest", BASE), *episodes("mine", 0.5 * BASE), *episodes("late", 0.4 * BASE[:3])]
    assert verdict(related(rows)).startswith("No verdict: the policies have only 3 starts in common;")
    never = related([*episodes("nearest", [np.inf] * 2), *episodes("mine", [np.inf] * 2)])
    assert verdict(never) == "No policy reached 95 % from any of the 2 starts within the time limit."


def test_a_bound_of_few_starts_says_so():
    rows = [*episodes("nearest", BASE), *episodes("mine", 0.5 * BASE), *episodes("o (ground truth)", [20.0, 30.0])]
    assert "the bound, o (ground truth), is 0.25 [0.20, 0.30; only 2 starts]" in verdict(related(rows))


def test_what_no_training_saw_comes_first():
    unseen, seen = "turtlebot3_house", "rrt_house"
    rows = []
    for world, share in ((unseen, 0.9), (seen, 0.5)):
        times = {"nearest": BASE, "gain_over_cost": 0.85 * BASE + SPREAD, "mine": share * BASE + SPREAD}
        for policy, values in times.items():
            rows += episodes(policy, values, world=world, model="ab" if policy == "mine" else "")
    text, figure = verdict_section(related(rows)).parts
    first, pooled = text.split(" Including training worlds: ")
    assert first.startswith("In worlds or with robots not used in training: gain_over_cost is fastest: 95 % in 0.85")
    assert f"over {STARTS} starts" in first
    assert pooled.startswith("mine is fastest: 95 % in 0.70")
    assert f"over {2 * STARTS} starts" in pooled
    assert "not used in training" in figure.caption
    unseen_ranking, ranking = ranking_sections(related(rows))
    assert ranking.title.startswith(f"All {2 * STARTS} starts")
    lines = [[line[1].text for line in section.parts[-1].lines] for section in (unseen_ranking, ranking)]
    assert lines[0] == lines[1]
    assert unseen_ranking.parts[1] != ranking.parts[0]
    # Without learned models, all starts are alike.
    classic = related([row | {"model": ""} for row in rows])
    assert not verdict_section(classic).parts[0].startswith("In worlds")
    assert len(ranking_sections(classic)) == 1


def test_another_order_by_area_is_said():
    rows = [*episodes("nearest", BASE, 0.9), *episodes("frontier", 0.8 * BASE, 0.8)]
    order = "By area under curve, the ranking measure of the leaderboard, nearest is first."
    assert verdict(related(rows)).endswith(order)


@pytest.mark.parametrize("slowest", [120.0, 700.0, np.inf])
def test_the_picture_holds_all_of_its_labels(slowest):
    times = {"nearest": BASE, "mine": 0.8 * BASE, "slow": [slowest] * STARTS}
    text, figure = verdict_section(related([row for item in times.items() for row in episodes(*item)])).parts
    assert text.startswith("mine is fastest")
    pixels = np.asarray(Image.open(io.BytesIO(figure.content)).convert("L"))
    assert pixels[:, [0, -1]].min() > 240
    assert pixels[[0, -1]].min() > 240
