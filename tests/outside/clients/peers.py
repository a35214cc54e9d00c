"""Scans of other simulators: angles in the robot's frame [rad] and ranges [m], in the order of the beams.

`walls`: x0, y0, x1, y1 [m], a closed line. `pillar`: x, y, radius [m]. `start`: pose of the robot [m, m, rad].
"""

import json
from pathlib import Path

import numpy as np


def irsim(folder, walls, pillar, start, fov, beams, range_max):
    import irsim

    lidar = {"name": "lidar2d", "range_max": range_max, "angle_range": fov, "number": beams}
    robot = {"kinematics": {"name": "diff"}, "shape": {"name": "circle", "radius": 0.1}, "state": start}
    line = {"name": "linestring", "vertices": [wall[:2] for wall in [*walls, walls[0]]]}
    disc = {"shape": {"name": "circle", "radius": pillar[2]}, "state": [*pillar[:2], 0.0]}
    world = {"world": {"width": 10, "height": 10}, "obstacle": [{"shape": line, "state": [0.0, 0.0, 0.0]}, disc]}
    path = Path(folder) / "world.yaml"
    path.write_text(json.dumps(world | {"robot": [robot | {"goal": [7.0, 5.0, 0.0], "sensors": [lidar]}]}))
    env = irsim.make(str(path), headless=True, log_level="ERROR")
    env.step([0.0, 0.0])
    scan = env.get_lidar_scan()
    return {"angles": scan["angle_min"] + scan["angle_increment"] * np.arange(beams), "ranges": scan["ranges"]}


def navground(folder, walls, pillar, start, fov, beams, range_max):
    from navground import core, sim

    world, state = sim.World(), core.SensingState()
    for wall in walls:
        world.add_wall(sim.Wall(wall[:2], wall[2:]))
    world.add_obstacle(sim.Obstacle(pillar[:2], pillar[2]))
    settings = {"range": range_max, "start_angle": -fov / 2, "field_of_view": fov, "resolution": beams}
    lidar = sim.state_estimations.LidarStateEstimation(**settings)
    agent = sim.Agent(radius=0.1, state_estimations=[lidar])
    agent.pose = core.Pose2(start[:2], start[2])
    world.add_agent(agent)
    lidar.prepare(agent, world)
    lidar.update(agent, world, state)
    return {"angles": lidar.angles, "ranges": lidar.read_ranges(state)}


def vmas(folder, walls, pillar, start, fov, beams, range_max):
    import torch
    from vmas.simulator.core import Agent, Landmark, Line, Sphere, World
    from vmas.simulator.sensors import Lidar

    def place(entity, x, y, turn):
        entity.set_pos(torch.tensor([[x, y]]), batch_index=None)
        entity.set_rot(torch.tensor([[turn]]), batch_index=None)

    world = World(batch_dim=1, device="cpu")
    lidar = Lidar(world, -fov / 2, fov / 2, beams, range_max)
    world.add_agent(robot := Agent("robot", shape=Sphere(0.1), sensors=[lidar]))
    world.add_landmark(disc := Landmark("pillar", shape=Sphere(pillar[2])))
    place(robot, *start)
    place(disc, *pillar[:2], 0.0)
    for k, (x0, y0, x1, y1) in enumerate(walls):
        world.add_landmark(wall := Landmark(f"wall {k}", shape=Line(length=np.hypot(x1 - x0, y1 - y0))))
        place(wall, (x0 + x1) / 2, (y0 + y1) / 2, np.arctan2(y1 - y0, x1 - x0))
    return {"angles": lidar._angles[0].numpy(), "ranges": lidar.measure()[0].numpy()}
