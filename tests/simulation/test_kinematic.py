import math
import sys
from dataclasses import replace

import gymnasium
import numpy as np
import pytest

from lidarnaut.envs.geometry import Pose2D
from lidarnaut.envs.geometry.clearance import clearance
from lidarnaut.envs.robots import load_robot
from lidarnaut.envs.simulation import PHYSICS, KinematicSimulator, Twist, make_simulator
from lidarnaut.envs.simulation.crowd.person_row import BLOCKED
from lidarnaut.envs.worlds import FixedRoute
from tests.kernel_references import advance_in_numpy
from tests.rooms import BURGER, ORIGIN, PLAIN, begin, square_room

SUBSTEPS = 6


def test_equals_the_plain_physics():
    """Among walls, posts and a person, with slip; the reference checks every obstacle in every substep."""
    walls = [[0.4, -0.5, 0.4, 0.5], [-0.3, 0.3, 0.3, 0.5], [-0.5, -0.4, 0.2, -0.45]]
    person = FixedRoute(radius=0.1, waypoints=np.array([[-0.5, 0.9], [-0.5, -0.9]]), speed=0.3)
    world = square_room(0.8, walls, circles=[[-0.2, 0.2, 0.05]], people=[person])
    simulator, pose = KinematicSimulator(BURGER, 0.1), Pose2D(0.0, 0.0, 0.3)
    rng, copy = np.random.default_rng(3), np.random.default_rng(3)
    simulator.reset(world, [pose], [rng])
    size = 4 + BURGER.lidar.num_beams
    copy.standard_normal(size)
    state, contacts = np.array([*pose, *np.zeros(8)]), 0
    commands = np.random.default_rng(8)
    for step in range(200):
        if step % 10 == 0:
            command = Twist(*commands.uniform([-0.3, -2.0], [0.3, 2.0]))
        reading = simulator.step([command])[0]
        around = np.vstack([world.circles, simulator.people[:, [0, 1, 4]]])
        normals, touched = copy.standard_normal(size)[:2] / math.sqrt(SUBSTEPS), False
        for _ in range(SUBSTEPS):
            arguments = state, command, normals, 0.1 / SUBSTEPS, 1, BURGER
            state = advance_in_numpy(*arguments, world.segments, around)
            touched |= (state[:2] != advance_in_numpy(*arguments, PLAIN.segments, PLAIN.circles)[:2]).any()
        contacts += touched
        pose, twist = simulator.states[0][:2]
        np.testing.assert_allclose([*pose, *twist], state[[0, 1, 2, 7, 8]], atol=1e-9)
        has_run_in = simulator.crowd.rows[0, BLOCKED] > 0.0
        assert reading.bumper == (touched or has_run_in)
        np.testing.assert_array_equal(reading.ticks, np.floor(state[5:7] * 4096 / (2 * math.pi) + 1e-9))
    assert 20 < contacts < 180


def test_a_robot_too_fast_for_its_size_tunnels_nowhere():
    robot = replace(load_robot("raspimouse"), max_v=20.0, max_acc_v=1000.0)
    world = square_room(30.0, segments=[[2.0, -30.0, 2.0, 30.0]])
    simulator = begin("kinematic", robot, world, Pose2D(0.0, 0.0, 0.3), period=0.5)
    for _ in range(6):
        simulator.step([Twist(20.0, 0.0)])
        assert simulator.states[0].pose.x <= 2.0 - robot.radius + 1e-5


def test_a_wedged_robot_stays_where_it_is():
    world = square_room(5.0, segments=[[0.0, -0.3, 2.0, 0.0], [0.0, 0.3, 2.0, 0.0]])
    simulator = begin("kinematic", BURGER, world, Pose2D(0.3, 0.0, 0.0))
    for _ in range(100):
        simulator.step([Twist(0.2, 0.0)])
        assert clearance(*simulator.states[0].pose[:2], world.segments, world.circles) > BURGER.radius - 1e-5
    assert simulator.states[0].pose.x < 2.0 - BURGER.radius / math.sin(math.atan2(0.3, 2.0)) + 1e-3


@pytest.mark.parametrize("command", [(math.nan, 0.0), (0.1, math.inf)])
def test_commands_that_are_no_numbers_are_refused(command):
    simulator = begin("kinematic", BURGER, PLAIN, ORIGIN)
    before = simulator.states[0]
    with pytest.raises(ValueError, match=r"command must be finite, got v = .* w = (inf|0\.0)"):
        simulator.step([Twist(*command)])
    assert simulator.states[0] == before


def test_bad_use_is_refused(physics):
    simulator = make_simulator(physics, BURGER, 0.1)
    with pytest.raises(gymnasium.error.ResetNeeded, match="reset"):
        simulator.step([Twist(0.0, 0.0)])
    world = square_room(2.0, circles=[[1.0, 0.0, 0.3]])
    misfit = r"does not fit at x = 1\..* world 'test'.* 0\.125 m"
    for pose, complaint in (((1.95, 0.0, 0.0), misfit), ((1.0, 0.1, 0.0), misfit), ((math.nan, 0.0, 0.0), "finite")):
        with pytest.raises(ValueError, match=complaint):
            simulator.reset(world, [Pose2D(*pose)], [np.random.default_rng(0)])


@pytest.mark.parametrize(
    ("physics", "max_v", "period", "complaint"),
    [
        ("newton", 0.2, 0.1, "'newton'.*" + ", ".join(PHYSICS)),
        ("kinematic", 0.2, 0.0, "control_period must be positive"),
        ("kinematic", 40.0, 1e3, r"'turtlebot3_burger' .*40 m/s\) needs more than 10,000 physics steps in a control"),
    ],
)
def test_simulators_that_cannot_be_made_are_refused(physics, max_v, period, complaint):
    with pytest.raises(ValueError, match=complaint):
        make_simulator(physics, replace(BURGER, max_v=max_v), period)


@pytest.mark.parametrize("cause", ["ModuleNotFoundError('no pybullet')", "SystemError('built for NumPy 1')"])
def test_a_pybullet_that_does_not_import_is_reported_with_its_cause_and_a_remedy(cause, monkeypatch, tmp_path):
    (tmp_path / "pybullet.py").write_text(f"raise {cause}")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(sys.modules, "pybullet", raising=False)
    said = r"cannot be imported \((no pybullet|built for NumPy 1).*pip install pybullet-arm64.*g\+\+, .*'kinematic'"
    with pytest.raises(ImportError, match=said):
        make_simulator("bullet", BURGER, 0.1)
    make_simulator("kinematic", BURGER, 0.1)
