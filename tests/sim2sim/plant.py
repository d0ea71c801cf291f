"""herd's robot in MuJoCo, advanced tick by tick and seen as herd's snapshots see it."""

import mujoco
import numpy as np

FEET = ["fl_foot", "fr_foot", "rl_foot", "rr_foot"]
# Of RK4: weight of a stage, and how far ahead of the step's start the next one lies, in steps.
STAGES = [(1 / 6, 0.5), (1 / 3, 0.5), (1 / 3, 1.0), (1 / 6, None)]


class Plant:
    """One robot. `xml` is what `herd export mjcf` writes; `tick_secs` is how long a torque is held."""

    def __init__(self, xml, tick_secs):
        self.model = mujoco.MjModel.from_xml_string(xml)
        self.model.opt.enableflags |= mujoco.mjtEnableBit.mjENBL_ENERGY
        self.data = mujoco.MjData(self.model)
        self.steps = round(tick_secs / self.model.opt.timestep)
        self.foot_of = {self.model.geom(name).id: i for i, name in enumerate(FEET)}
        self.knees = {self.model.geom(name.replace("foot", "knee")).id for name in FEET}
        self.trunk = self.model.geom("trunk").id
        self.body = self.model.body("trunk").id
        self.clear()

    def clear(self):
        """Forgets the contact of the last tick."""
        self.normal, self.tangent = np.zeros(4), np.zeros((4, 3))
        self.touched = {"trunk": False, "knee": False}

    def set(self, snapshot):
        """Puts the robot into this state; velocities that it lacks are zero."""
        data, zeros = self.data, [0.0] * 12
        mujoco.mj_resetData(self.model, data)
        data.qpos[:] = [*snapshot["position"], *snapshot["quaternion"], *snapshot["joints"]]
        spin = self.into_body(snapshot.get("angular_velocity", zeros[:3]))
        data.qvel[:] = [*snapshot.get("velocity", zeros[:3]), *spin, *snapshot.get("joint_speeds", zeros)]
        mujoco.mj_forward(self.model, data)
        self.clear()

    def into_body(self, vector):
        """A world vector in the trunk's frame: MuJoCo keeps a free body's spin there."""
        rotation = np.zeros(9)
        mujoco.mju_quat2Mat(rotation, self.data.qpos[3:7])
        return rotation.reshape(3, 3).T @ np.asarray(vector)

    def tick(self, torques, push=None):
        """Holds these torques (N·m), and a force on the trunk (N), for one tick."""
        data = self.data
        data.ctrl[:] = torques
        data.xfrc_applied[self.body, :3] = push or [0.0, 0.0, 0.0]
        self.clear()
        for _ in range(self.steps):
            self.step()
        mujoco.mj_forward(self.model, data)

    def step(self):
        """One step of RK4, as `mj_step` takes it, which shows the contact forces of its last stage alone."""
        model, data, secs = self.model, self.data, self.model.opt.timestep
        position, velocity = data.qpos.copy(), data.qvel.copy()
        mean_velocity, mean_acceleration = np.zeros(model.nv), np.zeros(model.nv)
        for weight, ahead in STAGES:
            mujoco.mj_forwardSkip(model, data, mujoco.mjtStage.mjSTAGE_NONE, 1)
            self.add_contacts(weight / self.steps)
            speed, acceleration = data.qvel.copy(), data.qacc.copy()
            mean_velocity += weight * speed
            mean_acceleration += weight * acceleration
            if ahead:
                self.move(position, velocity, speed, acceleration, ahead * secs)
        self.move(position, velocity, mean_velocity, mean_acceleration, secs)
        data.time += secs

    def move(self, position, velocity, speed, acceleration, secs):
        """Goes on from a position and velocity with this speed and acceleration."""
        place = position.copy()
        mujoco.mj_integratePos(self.model, place, speed, secs)
        self.data.qpos[:], self.data.qvel[:] = place, velocity + secs * acceleration

    def add_contacts(self, share):
        """Adds a share of the contact forces of now to the tick's means."""
        data, contacts = self.data, self.data.contact
        for (geom1, geom2), row, frame in zip(contacts.geom, contacts.efc_address, contacts.frame, strict=True):
            # Of an elliptic cone: normal, and two tangents in the contact's frame.
            normal, *tangents = data.efc_force[row : row + 3]
            if normal <= 0.0:
                continue
            foot = self.foot_of.get(geom2, self.foot_of.get(geom1))
            if foot is not None:
                self.normal[foot] += share * normal
                self.tangent[foot] += share * (tangents[0] * frame[3:6] + tangents[1] * frame[6:9])
            else:
                self.touched["trunk"] |= self.trunk in (geom1, geom2)
                self.touched["knee"] |= bool(self.knees & {geom1, geom2})

    def snapshot(self):
        """The robot as herd sees one."""
        data, rotation = self.data, np.zeros(9)
        mujoco.mju_quat2Mat(rotation, data.qpos[3:7])
        return {
            "position": data.qpos[:3].tolist(),
            "quaternion": data.qpos[3:7].tolist(),
            "velocity": data.qvel[:3].tolist(),
            "angular_velocity": (rotation.reshape(3, 3) @ data.qvel[3:6]).tolist(),
            "joints": data.qpos[7:].tolist(),
            "joint_speeds": data.qvel[6:].tolist(),
            "normal": self.normal.tolist(),
            "friction": np.linalg.norm(self.tangent, axis=1).tolist(),
            **self.touched,
        }

    def energy(self, snapshot=None):
        """Kinetic and potential energy, J, of now or of a snapshot."""
        if snapshot is not None:
            self.set(snapshot)
        return float(self.data.energy.sum())
