"""The numbers that all lanes share, taken from the environment of one of them."""

from envs.explore import ExploreEnv
from envs.lanes import Numbers
from envs.map_pyramid import block_size
from envs.robots import robot_record
from envs.simulation import KinematicSimulator
from envs.slam import GivenPoseSlam, TinySlam


def numbers_of(env: ExploreEnv, simulator: KinematicSimulator, slam: TinySlam | GivenPoseSlam) -> Numbers:
    """Collect the numbers that the kernels need."""
    robot, params = env.robot, slam.params
    if params.odometry != "robot_frame":
        raise ValueError(f"lanes compose odometry in the robot's frame, not in {params.odometry!r}")
    return Numbers(
        drive=robot_record(robot).drive,
        lidar=robot_record(robot).lidar,
        period=env.control_period,
        substeps=simulator.timing.substeps,
        ticks_per_radian=robot.odometry.ticks_per_radian,
        metres_per_tick=robot.odometry.metres_per_tick,
        odometry_track=float(robot.odometry.track),
        told_pose=isinstance(slam, GivenPoseSlam),
        told_truth=env.slam_is_told_the_truth,
        resolution=float(params.resolution),
        block=block_size(params.resolution),
        sigma_xy=params.sigma_xy / params.resolution,
        sigma_theta=float(params.sigma_theta),
        max_failed=params.max_failed,
        max_tries=params.max_tries,
        unvisited=slam.map.unvisited,
        cell=slam.map.kind,
        by_area=params.estimator == "area",
        occupied_prob=float(params.occupied_prob),
        empty_prob=float(params.empty_prob),
        quality=float(params.quality),
        raw_quality=float(params.raw_quality),
        hole=params.hole_width / params.resolution,
        add_blur=params.blur == "add",
        skip_exceeding=params.skip_exceeding,
        draw_distance=float(params.draw_distance),
        draw_angle=float(params.draw_angle),
    )
