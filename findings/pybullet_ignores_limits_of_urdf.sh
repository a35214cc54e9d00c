#!/usr/bin/env bash
# pybullet 3.2.7: a motor exceeds the velocity and the effort that the joint's `limit` element allows.
#
# `getJointInfo` returns both limits (2 rad/s, 0.5 N m), but a wheel of 0.01 kg m2 reaches a commanded 50 rad/s in the first
# step of 1/240 s, with 120 N m. MuJoCo reads the effort of the same file as a limit of the joint's force, Pinocchio both as
# limits of the model. A program passes `force=` and clips its commands itself.
#
# Seen: {"limits": [0.5, 2.0], "rate": 50.0, "torque": 120.0, "mujoco": 0.5, "pinocchio": [0.5, 2.0]}
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3.11 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet pybullet==3.2.7 mujoco==4.0.0 pin==4.1.0 numpy==2.4.6
cat > "$folder/robot.urdf" <<'URDF'
<robot name="robot">
  <link name="base"><inertial><mass value="5"/><inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial></link>
  <link name="wheel">
    <inertial><mass value="0.5"/><inertia ixx="0.01" ixy="0" ixz="0" iyy="0.01" iyz="0" izz="0.01"/></inertial>
  </link>
  <joint name="axle" type="continuous">
    <parent link="base"/><child link="wheel"/><axis xyz="0 1 0"/><limit effort="0.5" velocity="2"/>
  </joint>
</robot>
URDF
"$folder/venv/bin/python" - "$folder/robot.urdf" <<'PYTHON'
import json
import sys

import mujoco
import pinocchio
import pybullet

path = sys.argv[1]
pybullet.connect(pybullet.DIRECT)
body = pybullet.loadURDF(path, useFixedBase=True, flags=pybullet.URDF_USE_INERTIA_FROM_FILE)
found = {"limits": list(pybullet.getJointInfo(body, 0)[10:12])}
pybullet.setJointMotorControl2(body, 0, pybullet.VELOCITY_CONTROL, targetVelocity=50)
pybullet.stepSimulation()
_, rate, _, torque = pybullet.getJointState(body, 0)
found |= {"rate": round(rate, 3), "torque": round(torque, 3)}
found["mujoco"] = float(mujoco.MjModel.from_xml_path(path).jnt_actfrcrange[0, 1])
model = pinocchio.buildModelFromUrdf(path)
found["pinocchio"] = [float(model.effortLimit[0]), float(model.velocityLimit[0])]
print(json.dumps(found))
expected = {"limits": [0.5, 2.0], "rate": 50.0, "torque": 120.0, "mujoco": 0.5, "pinocchio": [0.5, 2.0]}
sys.exit(found != expected)
PYTHON
