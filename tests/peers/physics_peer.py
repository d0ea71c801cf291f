"""herd's robot trots on the spot in another simulator, 2 ms a tick; answers with microseconds of swings of 75 ticks.

`alone` leaves the joints to the simulator's own position control and steps from C where it can; `pd` computes torques
in numpy at every tick, as a controller in Python would.
"""

import argparse
import itertools
import json
import os
import tempfile

import bench
import numpy as np
import quadruped


def mujoco(control):
    """One swing in MuJoCo, and the trunk's height."""
    import mujoco as library

    model = library.MjModel.from_xml_string(quadruped.mjcf("position" if control == "alone" else "motor"))
    data = library.MjData(model)
    r = quadruped.robot()
    data.qpos[7:] = np.tile(r["nominal_joint_rad"], 4)
    limit, halves = r["torque_max_nm"], itertools.cycle(list(quadruped.phases(r)))

    def alone():
        for ticks, target in next(halves):
            data.ctrl[:] = target
            library.mj_step(model, data, ticks)

    def pd():
        for target in (target for ticks, target in next(halves) for _ in range(ticks)):
            torques = quadruped.STIFFNESS * (target - data.qpos[7:]) - quadruped.DAMPING * data.qvel[6:]
            data.ctrl[:] = np.clip(torques, -limit, limit)
            library.mj_step(model, data)

    return {"alone": alone, "pd": pd}[control], lambda: float(data.qpos[2]), bench.version("mujoco")


def pybullet(control):
    """One swing in PyBullet, and the trunk's height."""
    import pybullet as library

    library.connect(library.DIRECT)
    library.setGravity(0, 0, -9.81)
    library.setTimeStep(quadruped.TICK_SECS)
    friction = quadruped.sim()["ground_friction"]
    plane = library.createCollisionShape(library.GEOM_PLANE)
    library.changeDynamics(library.createMultiBody(0, plane), -1, lateralFriction=1.0)
    r = quadruped.robot()
    with tempfile.TemporaryDirectory() as directory:
        path = os.path.join(directory, "quadruped.urdf")
        with open(path, "w", encoding="utf-8") as file:
            file.write(quadruped.urdf())
        height = quadruped.standing_height(r)
        body = library.loadURDF(path, [0, 0, height], flags=library.URDF_USE_INERTIA_FROM_FILE)
    joints = list(range(library.getNumJoints(body)))
    for joint, angle in zip(joints, np.tile(r["nominal_joint_rad"], 4), strict=True):
        library.resetJointState(body, joint, angle)
        library.changeDynamics(body, joint, lateralFriction=friction)
    limit, halves = r["torque_max_nm"], itertools.cycle(list(quadruped.phases(r)))
    limits = [limit] * len(joints)

    def alone():
        for ticks, target in next(halves):
            library.setJointMotorControlArray(
                body, joints, library.POSITION_CONTROL, targetPositions=target, forces=limits
            )
            for _ in range(ticks):
                library.stepSimulation()

    def pd():
        for target in (target for ticks, target in next(halves) for _ in range(ticks)):
            states = library.getJointStates(body, joints)
            angles, speeds = np.array([s[0] for s in states]), np.array([s[1] for s in states])
            torques = quadruped.STIFFNESS * (target - angles) - quadruped.DAMPING * speeds
            torques = np.clip(torques, -limit, limit)
            library.setJointMotorControlArray(body, joints, library.TORQUE_CONTROL, forces=torques)
            library.stepSimulation()

    if control == "pd":
        # Velocity motors are on until they are told not to be.
        library.setJointMotorControlArray(body, joints, library.VELOCITY_CONTROL, forces=[0.0] * len(joints))
    where = library.getBasePositionAndOrientation
    return {"alone": alone, "pd": pd}[control], lambda: where(body)[0][2], bench.version("pybullet")


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("simulator", choices=["mujoco", "pybullet"])
    parser.add_argument("control", choices=["alone", "pd"])
    options = parser.parse_args()
    swing, height, how = {"mujoco": mujoco, "pybullet": pybullet}[options.simulator](options.control)
    heights = []
    for _ in range(100):
        swing()
        heights.append(height())
    if min(heights) < 0.15 or max(heights) > 0.25:
        # Lying on the ground is other work than trotting.
        print(json.dumps({"failed": f"the robot fell: heights {min(heights):.2f} to {max(heights):.2f} m"}), flush=True)
        return
    bench.serve(swing, how=how, height=sum(heights) / len(heights))


if __name__ == "__main__":
    main()
