"""Briefs of environments' tasks, for a real robot."""

from dataclasses import fields

from lidarnaut.envs.files import resolve
from lidarnaut.envs.ids import find_spec
from lidarnaut.envs.task import Brief, Task
from lidarnaut.envs.tasks.navigate import KnownMapBrief
from lidarnaut.envs.tasks.starts import UnknownWorldBrief

MEMBERS = {"default_observations", "make_estimator", "observation_parts", "prior", "tell_goal"}
"""Methods of tasks that a real robot needs."""


def brief_of(id: str) -> type[Brief]:
    """Return the brief of an environment's task: its first base class that is no `Task`.

    Raises:
        ValueError: the id is unknown, its task is not for one robot that explores or drives to goals, or a class of
            the user defines parts of the brief in the task.
    """
    spec = find_spec(id)
    kind = resolve(spec.kwargs.get("task", "lidarnaut.envs.tasks.explore:Explore"), {}, "task")
    brief = next(base for base in kind.__mro__ if not issubclass(base, Task))
    if kind.is_team or not issubclass(brief, UnknownWorldBrief | KnownMapBrief):
        raise ValueError(f"{id} is not for a single robot: choose a policy of Explore, ReachGoal or Navigate")
    names = MEMBERS | {field.name for field in fields(brief)}
    of_user = [base for base in kind.__mro__[: kind.__mro__.index(brief)] if base.__module__[:10] != "lidarnaut."]
    if own := {name for base in of_user for name in names & vars(base).keys()}:
        hint = f"define them in a subclass of {brief.__name__}, and begin the bases of {kind.__name__} with it"
        raise ValueError(f"a robot has no task, and the task of {id} defines {sorted(own)}: {hint}")
    return brief


def check_brief(brief: Brief) -> None:
    """Raise ValueError if a brief needs the true pose, or the map of a simulated world."""
    if isinstance(brief, KnownMapBrief):
        if brief.map is None or brief.localizer != "amcl":
            raise ValueError("a task on a known map needs the argument map, and localizer 'amcl'")
    elif brief.uses_true_motion:
        raise ValueError("slam must not be 'truth' on a robot")
