import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from lidarnaut.envs.robots import Caster, Mount, export_urdf, load_robot


@pytest.fixture
def load(tmp_path):
    """Return a function that loads a robot in PyBullet: its root's position, joints by name, and a client."""
    pybullet = pytest.importorskip("pybullet", reason="pybullet is not installed")
    client = pybullet.connect(pybullet.DIRECT)

    def load_exported(robot):
        path = str(export_urdf(robot, tmp_path / "robot.urdf"))
        body = pybullet.loadURDF(path, flags=pybullet.URDF_USE_INERTIA_FROM_FILE, physicsClientId=client)
        infos = [pybullet.getJointInfo(body, k, client) for k in range(pybullet.getNumJoints(body, client))]
        states = [pybullet.getLinkState(body, k, physicsClientId=client) for k in range(len(infos))]
        root, _ = pybullet.getBasePositionAndOrientation(body, client)
        found = {info[1].decode(): (info, np.subtract(state[4], root), state[5]) for info, state in zip(infos, states)}
        mass = sum(pybullet.getDynamicsInfo(body, k, client)[0] for k in range(-1, len(infos)))
        return found, mass

    yield load_exported
    pybullet.disconnect(client)


@pytest.mark.parametrize("name", ["turtlebot3_burger", "jackal"])
def test_an_exported_robot_has_the_wheels_casters_and_mass_of_the_robot(name, load):
    robot = load_robot(name)
    joints, mass = load(name)
    drive = robot.drive
    rate = (robot.max_v + 0.5 * robot.odometry.track * robot.max_w) / robot.odometry.wheel_radius
    for side, y in (("left", 0.5 * drive.track), ("right", -0.5 * drive.track)):
        info, position, _ = joints[f"wheel_{side}_joint"]
        np.testing.assert_allclose(position, [0.0, y, drive.wheel_radius], atol=1e-7)
        assert info[10:12] == pytest.approx((drive.max_torque, rate))
        assert info[13] == (0.0, 1.0, 0.0)
    for k, caster in enumerate(robot.casters):
        expected = [caster.x, caster.y, caster.radius + caster.clearance]
        np.testing.assert_allclose(joints[f"caster_{k}_joint"][1], expected, atol=1e-7)
    # A thousandth of the body's mass for the footprint, the lidar and each caster.
    assert mass == pytest.approx(robot.body.mass * (1.002 + 1e-3 * len(robot.casters)) + 2.0 * drive.wheel_mass)


def test_the_lidar_of_an_exported_robot_is_mounted_and_turned_as_in_the_simulation(load):
    robot = load_robot("turtlebot3_burger")
    mount = Mount(0.1, -0.05, 0.2, yaw=0.7, pitch=0.1, roll=-0.2)
    joints, _ = load(
        replace(robot, lidar=replace(robot.lidar, mount=mount), casters=(Caster(-0.08, 0.0, 0.01, 0.002),))
    )
    _, position, orientation = joints["laser_joint"]
    np.testing.assert_allclose(position, [0.1, -0.05, 0.2], atol=1e-7)
    expected = Rotation.from_euler("xyz", [-0.2, 0.1, 0.7])
    assert (Rotation.from_quat(orientation) * expected.inv()).magnitude() < 1e-6


def test_an_export_has_the_suffix_urdf_and_escapes_names(tmp_path):
    with pytest.raises(ValueError, match=r"exported as \.urdf, got .*robot\.xml"):
        export_urdf("jackal", tmp_path / "robot.xml")
    robot = replace(load_robot("jackal"), name='<"a" & b>')
    assert 'name="&lt;&quot;a&quot; &amp; b&gt;"' in export_urdf(robot, tmp_path / "a.urdf").read_text()
    assert math.isclose(sum(load_robot("jackal").body.inertia), 16.5 * (0.333**2 + 0.2**2 / 6))
