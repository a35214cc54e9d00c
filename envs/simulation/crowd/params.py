"""How many people are in a world, and how they walk."""

import re
from collections.abc import Mapping
from dataclasses import asdict
from typing import Annotated, Any, Literal

import yaml
from pydantic import ConfigDict, Field
from pydantic.dataclasses import dataclass

from lidarnaut.envs.files import parse_record, resolve

from .orca import Orca
from .social_force import SocialForce

Number = Annotated[int, Field(ge=0, le=1000)]
Share = Annotated[float, Field(ge=0.0, le=1.0)]
Radius = Annotated[float, Field(ge=0.1, le=1.0)]
Speed = Annotated[float, Field(ge=0.05, le=5.0)]


@dataclass(frozen=True, slots=True, kw_only=True, config=ConfigDict(extra="forbid", allow_inf_nan=False))
class Crowd:
    """The people of a world. Of pairs (low, high), numbers are drawn uniformly."""

    number: Number | tuple[Number, Number] = 10
    """How many people there are, at most 1,000; of a pair, drawn for each episode."""
    model: Literal["social_force", "orca"] = "social_force"
    """Pedestrian model: Helbing and Molnar (1995), or van den Berg et al. (2011)."""
    attentive: Share = 1.0
    """Probability that a person sees robots and gives way to them; the others are blind to robots."""
    standing: Share = 0.0
    """Probability that a person stands still."""
    radius: tuple[Radius, Radius] = (0.3, 0.3)
    """Radius of a person [m], drawn for each."""
    speed: tuple[Speed, Speed] = (1.2, 1.5)
    """Desired speed of a person [m/s], drawn for each."""
    body: Literal["disc", "legs"] = "disc"
    """What lidars see of a person: a disc of its radius, or two legs that swing."""
    flow: Literal["anywhere", "along", "across"] = "anywhere"
    """Where people walk: between points all over the world, between its two ends, or between its four sides."""
    forces: SocialForce = SocialForce()
    """Parameters of the social force model."""
    orca: Orca = Orca()
    """Parameters of ORCA."""

    def __post_init__(self) -> None:
        for name in ("number", "radius", "speed"):
            value = getattr(self, name)
            if isinstance(value, tuple) and value[0] > value[1]:
                raise ValueError(f"{name} of a crowd must be (low, high), got {value}")


CROWDS = {
    "sparse": Crowd(number=5),
    "dense": Crowd(number=20),
    "corridor": Crowd(number=8, flow="along"),
    "doorway": Crowd(number=6, flow="along"),
    "crossing": Crowd(number=12, flow="across"),
}
"""Crowds by name. All people give way to robots."""
PeopleLike = int | tuple[int, int] | str | Crowd | Mapping[str, Any] | None
"""What stands for people: how many, (low, high), a crowd or the name of one, or parameters that differ from those of
the crowd under the key `crowd`, such as `{"crowd": "dense", "attentive": 0.5}`; as text, `dense?attentive=0.5` and
`20?attentive=0.5,model=orca`."""


def crowd_of(people: PeopleLike) -> Crowd | None:
    """Return the crowd that an argument stands for; None where there are no people.

    Raises:
        ValueError: there is no such crowd, it has no such parameter, or a value is not allowed.
    """
    changes: dict[str, Any] = {}
    if isinstance(people, str):
        people, _, text = people.partition("?")
        parts = (part.partition("=") for part in re.split(r",(?=\w+=)", text))
        changes = {name: yaml.safe_load(value) for name, _, value in parts if name}
        people = int(people) if people.isdigit() else resolve(people, CROWDS, "crowd")
    if people is None or (isinstance(people, Crowd) and not changes):
        return people
    if isinstance(people, Mapping):
        changes = dict(people)
        people = crowd_of(changes.pop("crowd", None)) or Crowd()
    base = asdict(people if isinstance(people, Crowd) else Crowd())
    changes |= {} if isinstance(people, Crowd) else {"number": people}
    return parse_record(base | changes, "people", Crowd)
