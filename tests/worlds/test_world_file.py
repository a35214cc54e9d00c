import math
import os
from dataclasses import replace

import numpy as np
import pytest

from lidarnaut.envs.worlds import FixedRoute, load_world
from lidarnaut.envs.worlds.raster import check_world

GOOD = """
source: here
licence: CC0-1.0
height: 5e-1
spawns: [[0.5, 0.5, 1.57]]
goals: [[3.5, 0.5, 0.0]]
docks: [[4.0, 1.5, 0.0]]
polylines: [[[0, 0], [4, 0], [4, 3]]]
segments: [[4, 3, 0, 3], [2.0, 0.0, 2.0, 1.0, 0.2]]
boxes: [[3, 2, 1.0, 0.4, 0.785398163]]
polygons: [[[1, 2], [1.5, 2], [1, 2.5]]]
cylinders: [[3.0, 1.0, 0.25]]
people: [{radius: 0.1, speed: 0.5, waypoints: [[0.5, 1.5], [1.5, 1.5]]}]
magnets: [[3.5, 2.5, 0.2], [1.0, 0.5, -0.1, 2]]
closures: [[0, 3, 0, 0]]
"""


def load(tmp_path, text):
    path = tmp_path / "hall.yaml"
    path.write_text(text)
    return load_world(path)


def test_every_kind_of_body(tmp_path):
    world = load(tmp_path, GOOD)
    assert world.name == "hall"
    assert world.height == 0.5
    assert len(world.segments) == 2 + 1 + 4 + 4 + 3 + 1
    assert world.segments.dtype == np.float64
    assert world.bounds == pytest.approx((0.0, -0.1, 4.0, 3.0))
    assert tuple(world.spawns[0]) == (0.5, 0.5, 1.57)
    assert tuple(world.goals[0]) == (3.5, 0.5, 0.0)
    assert tuple(world.scaled(2.0).goals[0]) == (7.0, 1.0, 0.0)
    assert tuple(world.scaled(2.0).docks[0]) == (8.0, 3.0, 0.0)
    box = world.segments[:4, :2]
    assert np.hypot(*(box - (3, 2)).T) == pytest.approx([math.hypot(0.5, 0.2)] * 4)
    assert np.abs((box - (3, 2)) @ (math.sqrt(0.5), math.sqrt(0.5))) == pytest.approx([0.5] * 4)
    # After the box and the triangle, the thick wall: half its thickness longer at both ends.
    wall = world.segments[7:11, :2]
    assert (*wall.min(axis=0), *wall.max(axis=0)) == pytest.approx((1.9, -0.1, 2.1, 1.1))
    assert world.magnets.tolist() == [[3.5, 2.5, 0.2, 3.0], [1.0, 0.5, -0.1, 2.0]]
    assert world.scaled(2.0).magnets[0].tolist() == [7.0, 5.0, 0.2, 3.0]
    assert world.circles.tolist() == [[3.0, 1.0, 0.25]]
    assert world.circles_at_start.tolist() == [[3.0, 1.0, 0.25], [0.5, 1.5, 0.1]]


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("cylinders:", "cylindres:", r"unknown key 'cylindres' \(did you mean 'cylinders'\?\); allowed are .*closures"),
        ("-0.1, 2]", "-0.1, 0]", "magnets: row 1: decay must be positive, got 0"),
        ("licence: CC0-1.0", "", "key 'licence' is missing"),
        ("1.0, 0.4, 0.785398163", "1.0, -0.4", r"boxes: row 0: width must be positive, got -0\.4"),
        ("3.0, 1.0, 0.25", "3.0, 1.0", r"cylinders: row 0 must be \[x, y, radius\]"),
        ("[[1, 2], [1.5, 2], [1, 2.5]]", "[[1, 2], [1.5, 2]]", "polygons: item 0 must be .* at least 3"),
        ("[[3.5, 0.5, 0.0]]", "[[3.5, 0.5, 0.0], [3.0, 0.5, 0.0]]", "2 goals and 1 spawns; give one for each or none"),
        ("[[3.5, 0.5, 0.0]]", "[[3.0, 2.0, 0.0]]", r"goal \(3\.0, 2\.0\) lies inside a solid body"),
        ("[[3.5, 0.5, 0.0]]", "[[9.0, 0.5, 0.0]]", r"goal \(9\.0, 0\.5, 0\.0\) lies outside its bounds"),
        ("speed: 0.5", "speeed: 0.5", "unknown key 'people.0.speeed'"),
        *(
            ("[[0.5, 1.5], [1.5, 1.5]]", points, r"people\.0\.waypoints: .*two different points")
            for points in ("[[0.5, 1.5]]", "[[0.5, 1.5], [0.5, 1.5]]", "[[0.5, 1.5], [0.5, 1.5000000001]]", "[]")
        ),
        ("[[0.5, 1.5], [1.5, 1.5]]", "[[0.5, 1.5], [.nan, 1.5]]", r"people\.0\.waypoints"),
        ("[[0.5, 0.5, 1.57]]", "[]", "spawns"),
        ("[[0.5, 0.5, 1.57]]", "[[3.1, 1.1, 0]]", r"spawn \(3\.1, 1\.1\) lies inside a solid body"),
        ("[[0.5, 0.5, 1.57]]", "[[2.0, 0.5, 0]]", "inside a solid body"),
        ("[[0.5, 0.5, 1.57]]", "[[4.0, 0.5, 0]]", "on or within"),
        ("closures: [[0, 3, 0, 0]]", "", "leaks"),
        ("[4, 0], [4, 3]", "[4e5, 0], [4, 3]", r"spans 400000 x 3\.1 m, which is .* cells .*at most 100,000,000"),
        ("3.0, 1.0, 0.25", "3.0, 1.0, 1e308", r"cylinders\.0\.2: .*less than or equal to 10000000, got 1e\+308"),
        ("speed: 0.5", "speed: 1e9", r"people\.0\.speed: .*less than or equal to 100"),
        ("height: 5e-1", "height: 1e99", "height: "),
        ("source: here", "source: [", "not readable as YAML"),
        (GOOD, "", "mapping of keys to values"),
        (GOOD, "source: a\nlicence: b\nspawns: [[0, 0, 0]]\n", "empty"),
    ],
)
def test_errors_name_the_file_and_the_key(tmp_path, old, new, message):
    assert old in GOOD
    with pytest.raises(ValueError, match=rf"hall\.yaml: (.|\n)*{message}"):
        load(tmp_path, GOOD.replace(old, new))
    with pytest.raises(FileNotFoundError, match=r"nowhere\.yaml"):
        load_world(tmp_path / "nowhere.yaml")


def test_a_changed_file_is_read_again(tmp_path):
    first = load(tmp_path, GOOD)
    assert load_world(tmp_path / "hall.yaml") is first
    (tmp_path / "hall.yaml").write_text(GOOD.replace("0.25]]", "0.35]]"))
    os.utime(tmp_path / "hall.yaml", ns=(1, 1))
    assert load_world(tmp_path / "hall.yaml").circles[0, 2] == 0.35


@pytest.mark.parametrize(
    ("changes", "culprit"),
    [
        *(
            ({"waypoints": points}, "two different points")
            for points in (
                *([], [[1.0, 1.0]], [[1.0, 1.0], [1.0, 1.0]], [[0.1 + 0.2, 1.0], [0.3, 1.0]], [1.0, 1.0, 2.0]),
                *([[1.0, 1.0], [math.nan, 1.0]], [[1.0, 1.0], [math.inf, 1.0]], [[1.0, 1.0, 0.0], [2.0, 1.0, 0.0]]),
                [[1.0, 1.0], [1e8, 1.0]],
            )
        ),
        *(({"speed": speed}, "speed of a person") for speed in (0.0, -0.5, math.nan, math.inf, 101.0)),
        *(({"radius": radius}, "radius of a person") for radius in (0.0, -0.1, math.nan, math.inf, 11.0)),
    ],
)
def test_people_without_a_route_are_refused(changes, culprit):
    with pytest.raises(ValueError, match=culprit):
        FixedRoute(**{"radius": 0.2, "waypoints": [[1.0, 1.0], [2.0, 1.0]], "speed": 0.5, **changes})


@pytest.mark.parametrize("what", ["segments", "circles", "bounds", "spawns", "goals", "docks"])
@pytest.mark.parametrize("number", [math.nan, math.inf, 2e7])
def test_worlds_in_memory_have_finite_coordinates(what, number):
    world = load_world("turtlebot3_world")
    values = np.array(getattr(world, what) or [(0.0, 0.0, 0.0)] if what in ("goals", "docks") else getattr(world, what))
    values.flat[0] = number
    with pytest.raises(ValueError, match=f"{what} contain"):
        replace(world, **{what: values})


@pytest.mark.parametrize(
    "magnets",
    [
        *(np.array(rows) for rows in ([[1.0, 1.0, math.nan, 3.0]], [[1.0, 1.0, 0.1, 0.0]], [[1.0, 1.0, 0.1]])),
        *(np.array([1.0, 1.0, 0.1, 3.0]), [(1.0, 1.0, 0.1, 3.0)]),
    ],
)
def test_magnets_of_worlds_in_memory_are_checked(magnets):
    world = load_world("turtlebot3_world")
    assert check_world(replace(world, magnets=np.array([[1.0, 1.0, 0.1, 3.0]])))
    with pytest.raises(ValueError, match=r"magnets must be an array of shape \(k, 4\)"):
        check_world(replace(world, magnets=magnets))
