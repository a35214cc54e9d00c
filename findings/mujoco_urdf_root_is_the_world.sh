#!/usr/bin/env bash
# mujoco 4.0.0: the root link of a URDF file becomes the world, so that a mobile robot cannot move and loses its mass.
#
# Links with fixed joints are merged into their parents, and the root into the world body: of a robot with a base of 5 kg,
# a wheel and a lidar, the wheel remains, on an axle that is fixed in the world. The base has no body, no mass and no
# frame, and the lidar has no frame. All links remain with a root link named `world`, a joint of the type `floating` from
# there to the base, and `fusestatic="false"` in a `mujoco` element.
#
# Seen: {"as it is": {"bodies": ["wheel"], "mass": 0.5, "dof": 1},
#        "floating": {"bodies": ["base", "wheel", "laser"], "mass": 5.6, "dof": 7}}
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3.11 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet mujoco==4.0.0 numpy==2.4.6
"$folder/venv/bin/python" - <<'PYTHON'
import json
import sys

import mujoco


def link(name, mass):
    inertia = '<inertia ixx="0.01" ixy="0" ixz="0" iyy="0.01" iyz="0" izz="0.01"/>'
    return f'<link name="{name}"><inertial><mass value="{mass}"/>{inertia}</inertial></link>'


def joint(kind, parent, child, rest=""):
    return f'<joint name="{child}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>{rest}</joint>'


robot = link("base", 5) + link("wheel", 0.5) + link("laser", 0.1)
robot += joint("continuous", "base", "wheel", '<axis xyz="0 1 0"/>') + joint("fixed", "base", "laser")
own = '<mujoco><compiler fusestatic="false"/></mujoco><link name="world"/>' + joint("floating", "world", "base")
found = {}
for name, start in (("as it is", ""), ("floating", own)):
    model = mujoco.MjModel.from_xml_string(f'<robot name="robot">{start}{robot}</robot>')
    names = [model.body(k).name for k in range(1, model.nbody)]
    names = [one for one in names if one != "world"]
    found[name] = {"bodies": names, "mass": round(float(model.body_mass.sum()), 3), "dof": model.nv}
print(json.dumps(found))
expected = {
    "as it is": {"bodies": ["wheel"], "mass": 0.5, "dof": 1},
    "floating": {"bodies": ["base", "wheel", "laser"], "mass": 5.6, "dof": 7},
}
sys.exit(found != expected)
PYTHON
