"""herd's robot as text that other simulators read: MJCF for MuJoCo, URDF for PyBullet; numbers from herd's own TOML."""

import math
import tomllib

import numpy as np

from bench import ROOT

TICK_SECS = 0.002
SWING_TICKS = 75
# Of a swing's ticks so many have two feet up; without balance of its own the robot bears no more.
LIFTED_TICKS = 25
STIFFNESS, DAMPING = 120.0, 3.0  # N·m/rad, N·m·s/rad: a robot that stands and trots on the spot; tried out in both
ROD_RADIUS, HIP_EDGE = 0.012, 0.04  # m, as in actor/src/robot/model.rs


def robot():
    """The table `robot` of herd's configuration."""
    with open(ROOT / "common" / "src" / "config" / "robot.toml", "rb") as file:
        return tomllib.load(file)["robot"]


def sim():
    """The table `sim` of herd's configuration."""
    with open(ROOT / "common" / "src" / "config" / "sim.toml", "rb") as file:
        return tomllib.load(file)["sim"]


def legs(r):
    """Name, where the hip is, and the side, for each leg."""
    for name, x, y in (("fl", 1, 1), ("fr", 1, -1), ("rl", -1, 1), ("rr", -1, -1)):
        yield name, (x * r["hip_distance_x_m"] / 2, y * r["hip_distance_y_m"] / 2, 0.0), y


def box(mass, x, y, z):
    """Principal inertia of a box."""
    return [mass / 12 * (y * y + z * z), mass / 12 * (x * x + z * z), mass / 12 * (x * x + y * y)]


def rod(mass, length):
    """Principal inertia of a rod along z."""
    across = mass * (3 * ROD_RADIUS**2 + length**2) / 12
    return [across, across, mass * ROD_RADIUS**2 / 2]


def links(r, side):
    """Of the leg on this side: name, mass, centre of mass, inertia, joint axis."""
    thigh, calf = r["thigh_m"], r["calf_m"]
    hip = box(r["hip_mass_kg"], HIP_EDGE, HIP_EDGE, HIP_EDGE)
    return [
        ("hip", r["hip_mass_kg"], (0, side * r["hip_link_m"] / 2, 0), hip, (1, 0, 0)),
        ("thigh", r["thigh_mass_kg"], (0, 0, -thigh / 2), rod(r["thigh_mass_kg"], thigh), (0, 1, 0)),
        ("calf", r["calf_mass_kg"], (0, 0, -calf / 2), rod(r["calf_mass_kg"], calf), (0, 1, 0)),
    ]


def standing_height(r):
    """Height of the trunk's origin with all feet down."""
    _, hip, knee = r["nominal_joint_rad"]
    return r["thigh_m"] * math.cos(hip) + r["calf_m"] * math.cos(hip + knee) + r["foot_radius_m"]


def phases(r):
    """For each half of a trot on the spot: its phases as ticks and joint targets [12]."""
    nominal = np.array(r["nominal_joint_rad"])
    lifted = nominal + [0.0, 0.25, -0.5]
    down = np.tile(nominal, 4)
    for pair in [(0, 3), (1, 2)]:
        up = np.concatenate([lifted if leg in pair else nominal for leg in range(4)])
        yield [(LIFTED_TICKS, up), (SWING_TICKS - LIFTED_TICKS, down)]


def numbers(values):
    """Numbers as attributes hold them."""
    return " ".join(f"{value:.9g}" for value in values)


def mjcf(actuator):
    """The robot for MuJoCo; `actuator` is `position` (its own PD) or `motor` (torques from outside)."""
    r, friction = robot(), sim()["ground_friction"]
    bodies, actuators = "", ""
    for name, hip, side in legs(r):
        origins = [hip, (0, side * r["hip_link_m"], 0), (0, 0, -r["thigh_m"])]
        for (link, mass, centre, inertia, axis), origin in zip(links(r, side), origins, strict=True):
            bodies += (
                f'<body name="{name}_{link}" pos="{numbers(origin)}">'
                f'<inertial pos="{numbers(centre)}" mass="{mass}" diaginertia="{numbers(inertia)}"/>'
                f'<joint name="{name}_{link}" axis="{numbers(axis)}" damping="{r["joint_damping"]}"'
                f' armature="{r["joint_armature"]}"/>'
            )
            gains = f'kp="{STIFFNESS}" kv="{DAMPING}"' if actuator == "position" else ""
            limit = r["torque_max_nm"]
            actuators += f'<{actuator} joint="{name}_{link}" forcerange="-{limit} {limit}" {gains}/>'
        bodies += f'<geom type="sphere" size="{r["foot_radius_m"]}" pos="0 0 {-r["calf_m"]}"/>' + "</body>" * 3
    trunk = box(r["trunk_mass_kg"], *r["trunk_size_m"])
    half = numbers(np.array(r["trunk_size_m"]) / 2)
    return f"""<mujoco><option timestep="{TICK_SECS}"/>
<default><geom friction="{friction} 0.005 0.0001" contype="1" conaffinity="0" mass="0"/></default>
<worldbody><geom type="plane" size="50 50 1" contype="0" conaffinity="1"/>
<body name="trunk" pos="0 0 {standing_height(r):.9g}"><freejoint/>
<inertial pos="0 0 0" mass="{r["trunk_mass_kg"]}" diaginertia="{numbers(trunk)}"/>
<geom type="box" size="{half}"/>{bodies}</body></worldbody><actuator>{actuators}</actuator></mujoco>"""


def urdf():
    """The robot for PyBullet, which knows no rotor inertia: links get it, about all axes or Bullet rejects it."""
    r = robot()

    def link(name, mass, centre, inertia, shape=""):
        xx, yy, zz = inertia
        return (
            f'<link name="{name}"><inertial><origin xyz="{numbers(centre)}"/><mass value="{mass}"/>'
            f'<inertia ixx="{xx:.9g}" iyy="{yy:.9g}" izz="{zz:.9g}" ixy="0" ixz="0" iyz="0"/></inertial>'
            f"{shape}</link>"
        )

    size = numbers(r["trunk_size_m"])
    trunk = f'<collision><geometry><box size="{size}"/></geometry></collision>'
    text = link("trunk", r["trunk_mass_kg"], (0, 0, 0), box(r["trunk_mass_kg"], *r["trunk_size_m"]), trunk)
    foot = (
        f'<collision><origin xyz="0 0 {-r["calf_m"]}"/><geometry><sphere radius="{r["foot_radius_m"]}"/></geometry>'
        "</collision>"
    )
    for name, hip, side in legs(r):
        origins = [hip, (0, side * r["hip_link_m"], 0), (0, 0, -r["thigh_m"])]
        parent = "trunk"
        for (part, mass, centre, inertia, axis), origin in zip(links(r, side), origins, strict=True):
            child = f"{name}_{part}"
            inertia = [value + r["joint_armature"] for value in inertia]
            text += link(child, mass, centre, inertia, foot if part == "calf" else "")
            text += (
                f'<joint name="{child}" type="revolute"><parent link="{parent}"/><child link="{child}"/>'
                f'<origin xyz="{numbers(origin)}"/><axis xyz="{numbers(axis)}"/>'
                f'<limit lower="-3" upper="3" effort="{r["torque_max_nm"]}" velocity="100"/>'
                f'<dynamics damping="{r["joint_damping"]}"/></joint>'
            )
            parent = child
    return f'<robot name="quadruped">{text}</robot>'
