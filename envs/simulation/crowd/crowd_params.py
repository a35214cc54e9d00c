"""Parameters of pedestrian crowds."""

from collections.abc import Mapping
from dataclasses import asdict
from typing import Annotated, Any, Literal

from pydantic import Field
from pydantic.dataclasses import dataclass

from lidarnaut.envs.files import parse_record, resolve, split_parameters
from lidarnaut.envs.files.field_help import Record, document_fields
from lidarnaut.envs.robots.robot_params import CONFIG

from .orca import Orca
from .social_force import Share, SocialForce

Number = Annotated[int, Field(ge=0, le=1000)]
Radius = Annotated[float, Field(ge=0.1, le=1.0)]
Speed = Annotated[float, Field(ge=0.05, le=5.0)]


@dataclass(frozen=True, slots=True, kw_only=True, config=CONFIG)
class Crowd(metaclass=Record):
    """Parameters of a pedestrian crowd. A pair (low, high) is the range of a uniform distribution."""

    number: Number | tuple[Number, Number] = 10
    """Number of people, 0 to 1,000. A pair (low, high) is sampled per episode."""
    model: Literal["social_force", "orca"] = "social_force"
    """Pedestrian model: social force (Helbing and Molnar, 1995) or ORCA (van den Berg et al., 2011)."""
    attentive: Share = 1.0
    """Probability that a person sees and avoids robots."""
    standing: Share = 0.0
    """Probability that a person stands still for the whole episode."""
    radius: tuple[Radius, Radius] = (0.3, 0.3)
    """Radius of a person, range (low, high) [m]."""
    speed: tuple[Speed, Speed] = (1.2, 1.5)
    """Desired walking speed, range (low, high) [m/s]."""
    body: Literal["disc", "legs"] = "disc"
    """Shape of a person in lidar scans: a disc with the person's radius, or two swinging legs."""
    flow: Literal["anywhere", "along", "across"] = "anywhere"
    """Walking directions: between points anywhere in the world, along the world between its ends, or between opposite
    sides."""
    forces: SocialForce = SocialForce()
    """Parameters of the social force model."""
    orca: Orca = Orca()
    """Parameters of the ORCA pedestrian model."""

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
"""Predefined crowds by name; all people avoid robots."""
PeopleLike = int | tuple[int, int] | str | Crowd | Mapping[str, Any] | None
"""Types of the argument `people`: number, range (low, high), `Crowd`, name of a predefined crowd, or mapping.

A mapping changes parameters of the crowd under its key `crowd`, or of the default. The same as text:
`dense?attentive=0.5`, `20?attentive=0.5,model=orca`."""


def crowd_of(people: PeopleLike) -> Crowd | None:
    """Convert the argument `people` to crowd parameters; None for no people. ValueError for invalid arguments."""
    changes: dict[str, Any] = {}
    if isinstance(people, str):
        people, changes = split_parameters(people)
        people = int(people) if people.isdigit() else resolve(people, CROWDS, "crowd")
    if isinstance(people, int) and people < 0:
        raise ValueError(f"people must be 0 or more, got {people}")
    if people is None or (isinstance(people, Crowd) and not changes):
        return people
    if isinstance(people, Mapping):
        changes = dict(people)
        people = crowd_of(changes.pop("crowd", None)) or Crowd()
    base = asdict(people if isinstance(people, Crowd) else Crowd())
    changes |= {} if isinstance(people, Crowd) else {"number": people}
    return parse_record(base | changes, "people", Crowd)


document_fields(__name__)
