"""Robots as URDF files, for ROS, Gazebo and other simulators."""

import math
from collections.abc import Iterable
from xml.etree import ElementTree

from lidarnaut.envs.files import printable

from .robot_params import Mount, RobotParams

_LIGHT = 1e-3
"""Mass of links without a mass of their own, divided by the mass of the body; PyBullet would assume 1 kg."""
_ACROSS = (0.5 * math.pi, 0.0, 0.0)
"""Roll, pitch and yaw of a cylinder along the y axis [rad]."""


def urdf_text(robot: RobotParams) -> str:
    """Return a robot as the text of a URDF file, see `lidarnaut.export_urdf`."""
    root = ElementTree.Element("robot", name=printable(robot.name))
    body, drive = robot.body, robot.drive
    light = _LIGHT * body.mass
    _link(root, "base_footprint", light, [light * drive.wheel_radius**2] * 3)
    shape = _box(body.size) if body.size else _cylinder(body.radius or 0.0, body.height or 0.0)
    center_of_mass = body.center_of_mass or body.center
    link = _link(root, "base_link", body.mass, body.inertia, center_of_mass)
    _shape(link, shape, body.center)
    _friction(root, link, body.friction)
    _joint(root, "base_link", "base_footprint", "fixed", Mount())

    m, r, width = drive.wheel_mass, drive.wheel_radius, drive.wheel_width
    across = m * (3.0 * r**2 + width**2) / 12.0
    # The fastest wheel turns at the maximum of both speeds, by the parameters of the controller.
    fastest = (robot.max_v + 0.5 * robot.odometry.track * robot.max_w) / robot.odometry.wheel_radius
    for side, y in (("left", 0.5 * drive.track), ("right", -0.5 * drive.track)):
        link = _link(root, f"wheel_{side}_link", m, [across, 0.5 * m * r**2, across])
        _shape(link, _cylinder(r, width), rpy=_ACROSS)
        _friction(root, link, drive.friction)
        joint = _joint(root, f"wheel_{side}_link", "base_link", "continuous", Mount(y=y, z=r))
        ElementTree.SubElement(joint, "axis", xyz="0 1 0")
        ElementTree.SubElement(joint, "limit", effort=_text([drive.max_torque]), velocity=_text([fastest]))

    for k, caster in enumerate(robot.casters):
        link = _link(root, f"caster_{k}_link", light, [0.4 * light * caster.radius**2] * 3)
        _shape(link, ("sphere", {"radius": _text([caster.radius])}))
        _friction(root, link, 0.0)
        mount = Mount(x=caster.x, y=caster.y, z=caster.radius + caster.clearance)
        _joint(root, f"caster_{k}_link", "base_link", "fixed", mount)

    _link(root, "laser", light, [light * r**2] * 3)
    _joint(root, "laser", "base_link", "fixed", robot.lidar.mount)
    ElementTree.indent(root)
    return f'<?xml version="1.0"?>\n{ElementTree.tostring(root, encoding="unicode")}\n'


def _text(values: Iterable[float]) -> str:
    return " ".join(repr(float(value)) for value in values)


def _box(size: Iterable[float]) -> tuple[str, dict[str, str]]:
    return "box", {"size": _text(size)}


def _cylinder(radius: float, length: float) -> tuple[str, dict[str, str]]:
    return "cylinder", {"radius": _text([radius]), "length": _text([length])}


def _link(
    root: ElementTree.Element, name: str, mass: float, inertia: Iterable[float], center: Iterable[float] = (0, 0, 0)
) -> ElementTree.Element:
    link = ElementTree.SubElement(root, "link", name=name)
    inertial = ElementTree.SubElement(link, "inertial")
    ElementTree.SubElement(inertial, "origin", xyz=_text(center), rpy="0 0 0")
    ElementTree.SubElement(inertial, "mass", value=_text([mass]))
    moments = {f"i{axis}{axis}": _text([value]) for axis, value in zip("xyz", inertia)}
    ElementTree.SubElement(inertial, "inertia", moments | {"ixy": "0", "ixz": "0", "iyz": "0"})
    return link


def _shape(
    link: ElementTree.Element,
    shape: tuple[str, dict[str, str]],
    xyz: Iterable[float] = (0, 0, 0),
    rpy: Iterable[float] = (0, 0, 0),
) -> None:
    for kind in ("visual", "collision"):
        part = ElementTree.SubElement(link, kind)
        ElementTree.SubElement(part, "origin", xyz=_text(xyz), rpy=_text(rpy))
        ElementTree.SubElement(ElementTree.SubElement(part, "geometry"), *shape)


def _friction(root: ElementTree.Element, link: ElementTree.Element, value: float) -> None:
    contact = ElementTree.SubElement(link, "contact")
    ElementTree.SubElement(contact, "lateral_friction", value=_text([value]))
    gazebo = ElementTree.SubElement(root, "gazebo", reference=link.attrib["name"])
    for name in ("mu1", "mu2"):
        ElementTree.SubElement(gazebo, name).text = _text([value])


def _joint(root: ElementTree.Element, child: str, parent: str, kind: str, mount: Mount) -> ElementTree.Element:
    joint = ElementTree.SubElement(root, "joint", name=f"{child.removesuffix('_link')}_joint", type=kind)
    ElementTree.SubElement(joint, "parent", link=parent)
    ElementTree.SubElement(joint, "child", link=child)
    rpy = _text([mount.roll, mount.pitch, mount.yaw])
    ElementTree.SubElement(joint, "origin", xyz=_text([mount.x, mount.y, mount.z]), rpy=rpy)
    return joint
