#!/usr/bin/env bash
# pybullet 3.2.7: each link without an inertial element weighs 1 kg, where Pinocchio and yourdfpy give it no mass.
#
# Frames such as `base_footprint` and `laser` have no mass in URDF files for ROS. A robot of 0.9 kg with both weighs 2.9 kg
# in PyBullet, which says so in a warning, with a moment of inertia of 1 kg m2 each: the robot accelerates and turns many
# times more slowly. A URDF file for both worlds gives its frames a small mass.
#
# Seen: {"pybullet": 2.9, "pinocchio": 0.9, "yourdfpy": 0.9, "pybullet, frames of 1 g": 0.902} (mass of the robot [kg])
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3.11 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet pybullet==3.2.7 pin==4.1.0 yourdfpy==0.0.60 numpy==2.4.6
"$folder/venv/bin/python" - "$folder" <<'PYTHON'
import json
import sys
from pathlib import Path

import pinocchio
import pybullet
from yourdfpy import URDF


def write(name, frame):
    def inertial(mass):
        return f'<inertial><mass value="{mass}"/><inertia ixx="1e-3" ixy="0" ixz="0" iyy="1e-3" iyz="0" izz="1e-3"/></inertial>'

    links = {"base_footprint": frame, "base_link": 0.8, "wheel": 0.1, "laser": frame}
    text = "".join(f'<link name="{name}">{inertial(mass) if mass else ""}</link>' for name, mass in links.items())
    for child, parent, kind in (("base_link", "base_footprint", "fixed"), ("wheel", "base_link", "continuous"),
                                ("laser", "base_link", "fixed")):
        text += f'<joint name="to_{child}" type="{kind}"><parent link="{parent}"/><child link="{child}"/></joint>'
    path = Path(sys.argv[1], name)
    path.write_text(f'<robot name="robot">{text}</robot>')
    return str(path)


def mass_in_pybullet(path):
    body = pybullet.loadURDF(path)
    return round(sum(pybullet.getDynamicsInfo(body, k)[0] for k in range(-1, pybullet.getNumJoints(body))), 3)


pybullet.connect(pybullet.DIRECT)
path = write("frames.urdf", None)
model = pinocchio.buildModelFromUrdf(path)
links = URDF.load(path).robot.links
found = {
    "pybullet": mass_in_pybullet(path),
    "pinocchio": round(sum(one.mass for one in model.inertias), 3),
    "yourdfpy": round(sum(link.inertial.mass for link in links if link.inertial), 3),
}
found["pybullet, frames of 1 g"] = mass_in_pybullet(write("light.urdf", 0.001))
print(json.dumps(found))
sys.exit(found != {"pybullet": 2.9, "pinocchio": 0.9, "yourdfpy": 0.9, "pybullet, frames of 1 g": 0.902})
PYTHON
