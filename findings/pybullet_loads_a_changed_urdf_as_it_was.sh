#!/usr/bin/env bash
# pybullet 3.2.7: a URDF file that has changed is loaded as it was, also after `resetSimulation`.
#
# Files are cached by name until the connection ends. A program that writes the robot of each trial to one file (system
# identification, domain randomization, a search for a design) simulates the first robot again and again; nothing is said.
# `setPhysicsEngineParameter(enableFileCaching=0)` before the first load, or a new name for each file, gives the new robot.
#
# Seen: {"first": 5.0, "changed": 5.0, "after resetSimulation": 5.0, "after disconnect": 7.0, "without cache": 9.0}
#       (mass [kg] of the robot; the file says 5, 7 from "changed" on, and 9 at the end)
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3.11 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet pybullet==3.2.7 numpy==2.4.6
"$folder/venv/bin/python" - "$folder/robot.urdf" <<'PYTHON'
import json
import sys
from pathlib import Path

import pybullet

path = sys.argv[1]


def write(mass):
    inertia = '<inertia ixx="0.1" ixy="0" ixz="0" iyy="0.1" iyz="0" izz="0.1"/>'
    link = f'<link name="base"><inertial><mass value="{mass}"/>{inertia}</inertial></link>'
    Path(path).write_text(f'<robot name="robot">{link}</robot>')


def loaded_mass():
    return pybullet.getDynamicsInfo(pybullet.loadURDF(path), -1)[0]


write(5)
pybullet.connect(pybullet.DIRECT)
found = {"first": loaded_mass()}
write(7)
found["changed"] = loaded_mass()
pybullet.resetSimulation()
found["after resetSimulation"] = loaded_mass()
pybullet.disconnect()
pybullet.connect(pybullet.DIRECT)
found["after disconnect"] = loaded_mass()
pybullet.setPhysicsEngineParameter(enableFileCaching=0)
write(9)
found["without cache"] = loaded_mass()
print(json.dumps(found))
expected = {"first": 5.0, "changed": 5.0, "after resetSimulation": 5.0, "after disconnect": 7.0, "without cache": 9.0}
sys.exit(found != expected)
PYTHON
