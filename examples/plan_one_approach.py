"""Plan how the Panda moves its suction cup to a point, without touching anything else.

    python examples/plan_one_approach.py --contact 0.5 0.0 0.4 --outward -1 0 0

`--outward` points from the surface towards the robot: the cup arrives against it. Nothing moves
here; the trajectory is what a driver would execute.
"""

import argparse

import numpy as np

from flowbothd_common.motion import MotionGoal, MotionKind, RobotObservation
from franka_suction_driver.arm.kinematics import make_kinematics
from franka_suction_driver.execution.executor import MotionExecutor
from franka_suction_driver.simulated import sim_motion_params


def wall(contact: np.ndarray, outward: np.ndarray, size: float = 0.3) -> np.ndarray:
    """Return (N, 3) points of a square wall with the contact in its middle."""
    across = np.cross(outward, [0.0, 0.0, 1.0])
    up = np.cross(across, outward)
    side = np.linspace(-size / 2, size / 2, 31)
    u, v = np.meshgrid(side, side)
    return contact + u.reshape(-1, 1) * across + v.reshape(-1, 1) * up


def main() -> None:
    """Plan and print the trajectory."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--contact", type=float, nargs=3, default=[0.5, 0.0, 0.4], help="[m]")
    parser.add_argument("--outward", type=float, nargs=3, default=[-1.0, 0.0, 0.0])
    parser.add_argument("--seed", type=int, default=0, help="of the search for a path")
    given = parser.parse_args()
    contact = np.array(given.contact)
    outward = np.array(given.outward) / np.linalg.norm(given.outward)

    params = sim_motion_params()
    robot = make_kinematics(params)
    executor = MotionExecutor(robot, params, seed=given.seed)
    executor.set_obstacles(wall(contact, outward))

    start = np.array(params.robot.start_positions)
    rest = RobotObservation(0.0, start, np.zeros_like(start), wrench=np.zeros(6))
    executor.start(MotionGoal(MotionKind.APPROACH, contact, outward), rest)
    update = executor.tick(rest)
    if update.trajectory is None:
        raise SystemExit(f"no approach: {update.result.message}")

    trajectory = update.trajectory
    tip = robot.tip(trajectory.positions[-1]).position
    print(f"{len(trajectory.times)} points, {trajectory.times[-1]:.2f} s")
    print("fastest joint:", f"{np.abs(trajectory.velocities).max():.2f} rad/s")
    print(f"the cup stops at {tip.round(3)}, {np.linalg.norm(tip - contact):.3f} m before the wall")


if __name__ == "__main__":
    main()
