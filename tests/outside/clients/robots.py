"""Robots (URDF) by PyBullet, yourdfpy, Pinocchio and MuJoCo."""

import mujoco
import numpy as np
import pinocchio
import pybullet
from yourdfpy import URDF

WHEELS = ("wheel_left_joint", "wheel_right_joint")


def load(library, path):
    """Return mass [kg], wheels (x, y, z [m], effort [N m], rate [rad/s]), axes, and pose of `laser`."""
    if library == "pybullet":
        pybullet.connect(pybullet.DIRECT)
        body = pybullet.loadURDF(path, flags=pybullet.URDF_USE_INERTIA_FROM_FILE)
        infos = [pybullet.getJointInfo(body, k) for k in range(pybullet.getNumJoints(body))]
        named = {info[1].decode(): info for info in infos}
        root = np.array(pybullet.getBasePositionAndOrientation(body)[0])
        states = {name: pybullet.getLinkState(body, info[0]) for name, info in named.items()}
        wheels = {name: [*(np.array(states[name][4]) - root), *named[name][10:12]] for name in WHEELS}
        axes, turn = [named[name][13] for name in WHEELS], states["laser_joint"][5]
        laser = states["laser_joint"][4] - root, np.reshape(pybullet.getMatrixFromQuaternion(turn), (3, 3))
        mass = sum(pybullet.getDynamicsInfo(body, k)[0] for k in range(-1, len(infos)))
    elif library == "yourdfpy":
        robot = URDF.load(path)
        joints = [robot.joint_map[name] for name in WHEELS]
        places = [robot.get_transform(joint.child)[:3, 3] for joint in joints]
        wheels = {j.name: [*place, j.limit.effort, j.limit.velocity] for j, place in zip(joints, places)}
        axes, at = [joint.axis for joint in joints], robot.get_transform("laser")
        laser, mass = (at[:3, 3], at[:3, :3]), sum(link.inertial.mass for link in robot.robot.links)
    elif library == "pin":
        model = pinocchio.buildModelFromUrdf(path)
        data = model.createData()
        pinocchio.framesForwardKinematics(model, data, pinocchio.neutral(model))
        joints = [model.getJointId(name) for name in WHEELS]
        limits = [(model.effortLimit[model.idx_vs[j]], model.velocityLimit[model.idx_vs[j]]) for j in joints]
        wheels = {name: [*data.oMi[j].translation, *limit] for name, j, limit in zip(WHEELS, joints, limits)}
        axes = [[0, 1, 0] if model.joints[j].shortname() == "JointModelRUBY" else [0, 0, 0] for j in joints]
        at = data.oMf[model.getFrameId("laser")]
        laser, mass = (at.translation, at.rotation), sum(one.mass for one in model.inertias)
    else:
        model = mujoco.MjModel.from_xml_path(path)
        return {"mass": model.body_mass.sum()}
    return {"wheels": wheels, "axes": axes, "laser": laser, "mass": mass}


def write(source, folder):
    """Write a URDF file by yourdfpy, and as MJCF by MuJoCo; return the paths."""
    found = {"URDF of yourdfpy": f"{folder}/robot.urdf", "MJCF of MuJoCo": f"{folder}/robot.xml"}
    URDF.load(source).write_xml_file(found["URDF of yourdfpy"])
    mujoco.mj_saveLastXML(found["MJCF of MuJoCo"], mujoco.MjModel.from_xml_path(source))
    return found
