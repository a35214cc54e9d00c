#!/usr/bin/env bash
# yourdfpy 0.0.60: damping and friction of a joint are text, where every other number of a URDF file is a float.
#
# The fields are declared as `Optional[float]`. A sum with a number raises TypeError, but a product with an integer repeats
# the text, and `max` over joints compares alphabetically: the largest of 10 and 9 is 9. A program converts the two fields.
#
# Seen: {"damping": "'10.0'", "friction": "'0.2'", "effort": "0.5", "largest damping": "9.0"}
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3.11 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet yourdfpy==0.0.60 numpy==2.4.6
cat > "$folder/robot.urdf" <<'URDF'
<robot name="robot">
  <link name="base"/><link name="left"/><link name="right"/>
  <joint name="left_axle" type="continuous">
    <parent link="base"/><child link="left"/><axis xyz="0 1 0"/><limit effort="0.5" velocity="2"/>
    <dynamics damping="10.0" friction="0.2"/>
  </joint>
  <joint name="right_axle" type="continuous">
    <parent link="base"/><child link="right"/><axis xyz="0 1 0"/><dynamics damping="9.0"/>
  </joint>
</robot>
URDF
"$folder/venv/bin/python" - "$folder/robot.urdf" <<'PYTHON'
import json
import sys

from yourdfpy import URDF

joints = URDF.load(sys.argv[1]).joint_map
left = joints["left_axle"]
found = {"damping": repr(left.dynamics.damping), "friction": repr(left.dynamics.friction)}
found |= {"effort": repr(left.limit.effort), "largest damping": max(one.dynamics.damping for one in joints.values())}
print(json.dumps(found))
sys.exit(found != {"damping": "'10.0'", "friction": "'0.2'", "effort": "0.5", "largest damping": "9.0"})
PYTHON
