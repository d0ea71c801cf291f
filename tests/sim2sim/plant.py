"""herd's robot in MuJoCo, advanced tick by tick and seen as herd's snapshots see it."""

import mujoco
import numpy as np

FEET = ["fl_foot", "fr_foot", "rl_foot", "rr_foot"]


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
            mujoco.mj_step(self.model, data)
            self.add_contacts(1.0 / self.steps)
        # What RK4 leaves behind is of its last stage.
        mujoco.mj_forward(self.model, data)

    def add_contacts(self, share):
        """Adds a share of the contact forces of now to the tick's means."""
        force = np.zeros(6)
        for i in range(self.data.ncon):
            contact = self.data.contact[i]
            geom = contact.geom2 if contact.geom2 in self.foot_of else contact.geom1
            mujoco.mj_contactForce(self.model, self.data, i, force)
            if force[0] <= 0.0:
                continue
            if geom in self.foot_of:
                foot = self.foot_of[geom]
                self.normal[foot] += share * force[0]
                self.tangent[foot] += share * (force[1] * contact.frame[3:6] + force[2] * contact.frame[6:9])
            else:
                pair = {contact.geom1, contact.geom2}
                self.touched["trunk"] |= self.trunk in pair
                self.touched["knee"] |= bool(self.knees & pair)

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
