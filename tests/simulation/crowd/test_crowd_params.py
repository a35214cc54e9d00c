import pytest

from lidarnaut.envs.simulation.crowd import CROWDS, Crowd, crowd_of


@pytest.mark.parametrize(
    ("people", "crowd"),
    [
        (None, None),
        (6, Crowd(number=6)),
        ((2, 5), Crowd(number=(2, 5))),
        ("6", Crowd(number=6)),
        ("dense", CROWDS["dense"]),
        (CROWDS["doorway"], CROWDS["doorway"]),
        ("9?attentive=0.5,speed=[0.8, 1],model=orca", Crowd(number=9, attentive=0.5, speed=(0.8, 1.0), model="orca")),
        ("corridor?number=3", Crowd(number=3, flow="along")),
        ({"crowd": "corridor", "body": "legs"}, Crowd(number=8, flow="along", body="legs")),
        ({"number": 4, "standing": 1.0}, Crowd(number=4, standing=1.0)),
    ],
)
def test_people_are_said_as_numbers_names_text_or_parameters(people, crowd):
    assert crowd_of(people) == crowd


@pytest.mark.parametrize(
    ("people", "complaint"),
    [
        (-1, "people must be 0 or more, got -1"),
        ((5, 2), r"number of a crowd must be \(low, high\), got \(5, 2\)"),
        ("dens", "unknown crowd 'dens' .*did you mean 'dense'"),
        ("6?atentive=1", "people: unknown key 'atentive' .*did you mean 'attentive'"),
        ({"speed": (0.0, 1.0)}, r"people: speed.*got 0\.0"),
        ({"attentive": 1.5}, r"people: attentive.*less than or equal to 1, got 1\.5"),
        ({"model": "magnets"}, "people: model.*'social_force' or 'orca'"),
        (2.5, "people: number"),
    ],
)
def test_people_that_cannot_be_are_refused(people, complaint):
    with pytest.raises(ValueError, match=complaint):
        crowd_of(people)
