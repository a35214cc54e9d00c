"""The whole path in two minutes: evolve an explorer, let it and the shipped one explore a house, film and report."""

import importlib.util
import shutil
import sys
import time
from collections.abc import Sequence
from pathlib import Path

from PIL import Image
from rich.console import Console

from agents.config import EvolutionConfig
from benchmarks.arena.pairs import by_start, start_of
from benchmarks.arena.publish import print_case, publish, run_with_progress
from benchmarks.arena.records import Row
from benchmarks.arena.runner import Evaluation
from benchmarks.arena.settings import Settings
from benchmarks.arena.theme import Picture
from benchmarks.arena.trace import Trace, trace_path
from benchmarks.pictures import save_gif
from benchmarks.side_by_side import SideBySide
from envs.files import Lock, read_record

FOLDER = Path("runs/demo")
CONFIG = Path(__file__).parents[1] / "configs" / "demo.yaml"
WORLD = "turtlebot3_house"
"""Where the explorers meet. No training has seen it: `agents/frontiers/held_out.yaml` names it."""
LEARNED, CLASSIC, FRESH = "learned", "gain_over_cost", "fresh"
"""The explorer that comes with the package, the best classic one, and the one that the demo trains."""
NUM_FRAMES = 48
"""Pictures in the film."""
INTRO = (
    "Three explorers meet in a house that no training saw: a score of frontiers that was evolved on other worlds and "
    "comes with the package (learned), the classic rule that its evolution started from (gain_over_cost), and a score "
    "that was evolved just now, for a minute (fresh; the rule itself, if nothing better was validated). None sees "
    "ground truth: map and pose come from Hector SLAM."
)
"""First lines of the report."""


def demo(
    config: EvolutionConfig,
    folder: Path,
    episodes: int = 11,
    physics: str = "bullet",
    time_limit: float | None = None,
    jobs: int = 2,
) -> str:
    """Evolve, evaluate with so many episodes of each explorer, film and report; return the results, in a sentence.

    The results of an earlier demo in the folder are replaced once the new ones are complete. A time limit [s] of None
    lets the environment choose.

    Raises:
        envs.files.LockedError: if another process is at it.
    """
    folder.parent.mkdir(parents=True, exist_ok=True)
    with Lock(folder.parent, f"lock-{folder.name}"):
        return _demo(config, folder, episodes, physics, time_limit, jobs)


def _demo(
    config: EvolutionConfig, folder: Path, episodes: int, physics: str, time_limit: float | None, jobs: int
) -> str:
    from agents.frontiers.evolution import evolve  # torch takes seconds to load: the first line should not wait for it

    console, began = Console(stderr=True), time.monotonic()

    def say(text: str) -> None:
        console.print(f"[bold]{text}[/bold] [dim](after {time.monotonic() - began:.0f} s)[/dim]", highlight=False)

    work = folder.with_name(f"{folder.name}.new")
    shutil.rmtree(work, ignore_errors=True)
    work.mkdir(parents=True)
    say(f"1/3 Evolve an explorer in the abstract simulator: {config.generations} generations")
    run = evolve(config, run=work / "training")
    shutil.copy(run / "learning_curve.png", work)

    say(f"2/3 Explore {WORLD} with it, with the shipped one and with the classic one: {episodes} episodes each")
    policies = (CLASSIC, f"{LEARNED}=learned:pretrained/frontiers", f"{FRESH}=learned:{run}")
    settings = Settings(
        policies=policies, worlds=(WORLD,), episodes=episodes, physics=(physics,), time_limit=time_limit
    )
    evaluation = Evaluation(settings, work)
    run_with_progress(evaluation, jobs, None, console)
    rows = evaluation.rows()

    say("3/3 Draw the median episode, and write the report")
    ratio, pair = median_pair(rows)
    pictures = SideBySide({row["policy"]: Trace.load(trace_path(work, row)) for row in pair})
    frames = pictures.frames(NUM_FRAMES)
    save_gif(frames, work / "exploration.gif", frames[-1].shape[1], Image.fromarray(frames[-1]).quantize())
    (work / "paths.png").write_bytes(Picture.of(lambda _: pictures.draw()).light)
    where = f"seed {pair[0]['seed']}, the median of {episodes} starts by the ratio of times to 95 %, here {ratio:.2f}"
    lead = {
        f"The shipped explorer beside the classic one, in step ({where}).": (work / "exploration.gif").read_bytes(),
        "The same at the end: where each drove longest without seeing anything new.": (work / "paths.png").read_bytes(),
        "What the fresh explorer learned, on validation tasks.": (work / "learning_curve.png").read_bytes(),
    }
    summary = publish(evaluation, title="From an unknown house to a finished map", intro=INTRO, lead=lead)
    print_case(console, summary, WORLD)
    _replace(folder, work)
    say("Done")
    return _sentence(rows, folder)


def time_to_mark(row: Row) -> float:
    """Return the time to 95 % [s]; the time limit where it was not reached."""
    return float(min(row["time_to_95"], row["time_limit"]))


def median_pair(rows: Sequence[Row], policy: str = LEARNED) -> tuple[float, tuple[Row, Row]]:
    """Return the median ratio of the times of a policy and the classic one, and their episodes from that start."""
    classic = by_start(rows, CLASSIC)
    pairs = [(row, classic[start_of(row)]) for row in by_start(rows, policy).values()]
    ratios = sorted(((time_to_mark(a) / time_to_mark(b), k) for k, (a, b) in enumerate(pairs)))
    ratio, k = ratios[len(ratios) // 2]
    return ratio, pairs[k]


def _replace(folder: Path, work: Path) -> None:
    """Put the new results where the old ones are."""
    old = folder.with_name(f"{folder.name}.old")
    shutil.rmtree(old, ignore_errors=True)
    if folder.exists():
        folder.rename(old)
    work.rename(folder)
    shutil.rmtree(old, ignore_errors=True)


def _sentence(rows: Sequence[Row], folder: Path) -> str:
    """Say where the report lies, and how long the explorers took."""
    (shipped, (own, other)), (fresh, _) = (median_pair(rows, policy) for policy in (LEARNED, FRESH))
    return (
        f"{folder / 'report.html'}: to 95 % of {WORLD} the shipped explorer took {shipped:.2f} of {CLASSIC}'s time "
        f"(median start: {time_to_mark(own):.0f} s and {time_to_mark(other):.0f} s), the fresh one {fresh:.2f}."
    )


def main() -> int:
    """Run the demo; return the exit status."""
    try:
        physics = "bullet" if importlib.util.find_spec("pybullet") else "kinematic"
        print(demo(read_record(CONFIG, EvolutionConfig), FOLDER, physics=physics))
    except KeyboardInterrupt:
        print(f"stopped; an earlier demo in {FOLDER} is as it was", file=sys.stderr)
        return 130
    except (ValueError, RuntimeError, OSError) as error:
        print(f"benchmarks.demo: {error}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
