"""Torques of a trot replayed without feedback: herd's recording against MuJoCo, and what sets them apart."""

import re

import herd
import numpy as np
from plant import Plant

TICK_SECS = 0.002
SWING_TICKS = 75
TICKS = 250  # half a second
LIMIT = 0.05  # rad
FIRST_SWING = 7  # the trot is steady from here on
SWINGS = 10
FINE_SECS = 0.0001
FINE = herd.sets(sim__tick_secs=FINE_SECS)
# How fast the damper of rapier's numbers (120 Hz, damping ratio 10) stops a foot at an impedance of 0.9.
DAMPER_STOP_SECS = 0.9 / (0.1 * 2 * 10.0 * 2 * np.pi * 120.0)
# How herd's physics is stepped while it records; the controller acts every 2 ms in both.
RECORDINGS = {"1 step of 2 ms": [], "20 steps of 0.1 ms": herd.sets(sim__substeps=20)}


def starts():
    """Kind and tick of every start: where a pair lifts off, and half a swing later."""
    for swing in range(FIRST_SWING, FIRST_SWING + SWINGS):
        yield "lift-off", swing * SWING_TICKS
        yield "mid stance", swing * SWING_TICKS + SWING_TICKS // 2


def recording(*words):
    """A trace of the default constant gait."""
    secs = (FIRST_SWING + SWINGS) * SWING_TICKS * TICK_SECS + TICKS * TICK_SECS
    words = ["--task", "constant", *herd.sets(task__episode_secs=secs), *words]
    return herd.Trace.read(herd.call("export", "trace", *words))


def in_mujoco(xml, trace, first, ticks=TICKS, nudge=None):
    """Snapshots of MuJoCo under the trace's torques from tick `first` on; `nudge` changes the plant before."""
    plant = Plant(xml, trace.header["tick_secs"])
    plant.set(trace.state(first))
    if nudge:
        nudge(plant)
    snapshots = []
    for tick in trace.ticks[first : first + ticks]:
        plant.tick(tick["torques"])
        snapshots.append(plant.snapshot())
    return snapshots


def recorded(trace, first=0, ticks=TICKS):
    """Snapshots of the trace itself."""
    return [tick["after"] for tick in trace.ticks[first : first + ticks]]


def in_fine_herd(trace, first, ticks=TICKS):
    """Snapshots of herd's own simulator at 0.1 ms under the same torques without feedback."""
    return recorded(trace.replayed(first * TICK_SECS, ticks * TICK_SECS, *FINE))


def errors(a, b):
    """Largest joint difference at each tick, rad."""
    joints = [np.array([snapshot["joints"] for snapshot in snapshots]) for snapshots in (a, b)]
    return np.abs(joints[0] - joints[1])


def figures(a, b):
    """How far two runs are apart: largest and rms joint error, rad, and how long they stay within the limit, s."""
    apart = errors(a, b)
    beyond = apart.max(axis=1) > LIMIT
    held = (np.argmax(beyond) if beyond.any() else len(beyond)) * TICK_SECS
    return {"max_rad": float(apart.max()), "rms_rad": float(np.sqrt((apart**2).mean())), "within_secs": float(held)}


def summary(rows):
    """Median and worst of rows of `figures`, and the share that stays within the limit."""
    largest = np.array([row["max_rad"] for row in rows])
    return {
        "starts": len(rows),
        "median_max_rad": float(np.median(largest)),
        "worst_max_rad": float(largest.max()),
        "median_rms_rad": float(np.median([row["rms_rad"] for row in rows])),
        "share_within": float((largest <= LIMIT).mean()),
        "shortest_within_secs": min(row["within_secs"] for row in rows),
    }


def work(trace, first, snapshots):
    """Work of the motors over a run, J: the torques are the trace's, the speeds the run's."""
    before = [trace.state(first), *snapshots[:-1]]
    speeds = [(np.array(a["joint_speeds"]) + b["joint_speeds"]) / 2 for a, b in zip(before, snapshots, strict=True)]
    torques = [tick["torques"] for tick in trace.ticks[first : first + len(snapshots)]]
    return float(sum(np.dot(t, s) for t, s in zip(torques, speeds, strict=True)) * TICK_SECS)


def load(snapshots, weight):
    """Mean vertical force of the ground over two swings, per weight."""
    return float(np.mean([sum(s["normal"]) for s in snapshots[: 2 * SWING_TICKS]]) / weight)


def contact(xml, impedance=0.99, hz=120.0, stop_secs=0.0002, **options):
    """The model with another contact law, or other options."""
    stiffness, damping = (2 * np.pi * hz) ** 2 * (1 - impedance), impedance / stop_secs
    xml = re.sub(r'solref="[^"]*"', f'solref="{-stiffness} {-damping}"', xml)
    xml = re.sub(r'solimp="[^"]*"', f'solimp="{impedance} {impedance} 0.001 0.5 2"', xml)
    for name, value in options.items():
        xml = re.sub(rf'{name}="[^"]*"', f'{name}="{value}"', xml, count=1)
    return xml


def variants(xml):
    """MuJoCo with something else about it, to see what matters."""
    return {
        "as exported": xml,
        "steps of 0.05 ms": contact(xml, timestep=5e-5),
        "steps of 0.05 ms, stopped in 0.1 ms": contact(xml, stop_secs=1e-4, timestep=5e-5),
        "stopped in 0.4 ms": contact(xml, stop_secs=4e-4),
        "stopped in 0.7 ms": contact(xml, stop_secs=7e-4),
        "impedance 0.9": contact(xml, impedance=0.9),
        "impedance 0.97": contact(xml, impedance=0.97),
        "impedance 0.999": contact(xml, impedance=0.999),
        "spring of 60 Hz": contact(xml, hz=60.0),
        "spring of 240 Hz": contact(xml, hz=240.0),
        "friction 1.5": contact(xml, friction="1.5 0 0"),
        "spring and damper of rapier's numbers": contact(xml, impedance=0.9, stop_secs=DAMPER_STOP_SECS),
        "MuJoCo's default contact": re.sub(r'\s+solref="[^"]*" solimp="[^"]*"', "", xml),
    }


def in_the_air(xml, trace, secs=0.1, height=2.0):
    """The same torques two metres up, where no contact decides: only bodies, joints and integrators are compared."""

    def lifted(state):
        x, y, z = state["position"]
        return state | {"position": [x, y, z + height]}

    air = trace.changed(lifted)
    rows = {"MuJoCo and herd, steps of 0.1 ms": [], "herd, steps of 2 and of 0.1 ms": []}
    ticks = round(secs / TICK_SECS)
    for _, first in starts():
        there, fine = in_mujoco(xml, air, first, ticks), in_fine_herd(air, first, ticks)
        coarse = recorded(air.replayed(first * TICK_SECS, secs))
        rows["MuJoCo and herd, steps of 0.1 ms"].append(figures(there, fine))
        rows["herd, steps of 2 and of 0.1 ms"].append(figures(coarse, fine))
    return {"secs": secs} | {name: summary(of) for name, of in rows.items()}


def growth(xml, trace):
    """Joint difference after half a second, rad, for each unit of difference at the start: MuJoCo against itself."""
    nudges = {"trunk x, m/s": 0, "trunk z, m/s": 2, "roll rate, rad/s": 3, "pitch rate, rad/s": 4}
    size, found = 1e-5, {}
    for name, dof in nudges.items():
        ratios = []
        for _, first in starts():

            def nudge(plant, dof=dof):
                plant.data.qvel[dof] += size

            apart = errors(in_mujoco(xml, trace, first, nudge=nudge), in_mujoco(xml, trace, first))
            ratios.append(float(apart[-1].max() / size))
        found[name] = float(np.median(ratios))
    return found


def over_a_stride(xml, trace, every=5):
    """Largest joint difference, rad, from every so many ticks of one stride on."""
    ticks = range(FIRST_SWING * SWING_TICKS, (FIRST_SWING + 2) * SWING_TICKS, every)
    largest = [figures(in_mujoco(xml, trace, first), recorded(trace, first))["max_rad"] for first in ticks]
    return {
        "at_secs": [first * TICK_SECS for first in ticks],
        "max_rad": largest,
        "median_max_rad": float(np.median(largest)),
        "share_within": float(np.mean(np.array(largest) <= LIMIT)),
    }


def one(xml, trace, first, kind):
    """Everything about one start, and the curves."""
    curves = {
        "herd, recorded": recorded(trace, first),
        "MuJoCo, RK4, 0.1 ms": in_mujoco(xml, trace, first),
        "herd, replayed at 0.1 ms": in_fine_herd(trace, first),
    }
    ours, theirs, fine = curves.values()
    weight, judge = trace.header["weight_n"], Plant(xml, TICK_SECS)
    row = {
        "kind": kind,
        "at_secs": first * TICK_SECS,
        "mujoco_and_herd": figures(theirs, ours),
        "mujoco_and_herd_fine": figures(theirs, fine),
        "herd_fine_and_herd": figures(fine, ours),
        "load": {"herd": load(ours, weight), "mujoco": load(theirs, weight)},
        "work_j": {"herd": work(trace, first, ours), "mujoco": work(trace, first, theirs)},
        "energy_j": {
            "start": judge.energy(trace.state(first)),
            "herd": judge.energy(ours[-1]),
            "mujoco": judge.energy(theirs[-1]),
        },
    }
    return row, curves


def spread(rows, key):
    """Mean over the rows of a figure of both simulators, and their mean absolute difference."""
    pairs = np.array([[row[key]["herd"], row[key]["mujoco"]] for row in rows])
    herds, mujocos = pairs.mean(axis=0)
    apart = np.abs(pairs @ [1, -1]).mean()
    return {"herd": float(herds), "mujoco": float(mujocos), "mean_abs_difference": float(apart)}


def measure(xml):
    """All figures, and the curves of every start of the default recording."""
    found, curves = {}, {}
    for name, words in RECORDINGS.items():
        trace = recording(*words)
        rows = []
        for kind, first in starts():
            row, drawn = one(xml, trace, first, kind)
            rows.append(row)
            if not words:
                curves[kind, first] = drawn
        kinds = {kind: [row for row in rows if row["kind"] == kind] for kind in ("lift-off", "mid stance")}
        found[name] = {
            pair: {kind: summary([row[pair] for row in of]) for kind, of in (kinds | {"all": rows}).items()}
            for pair in ("mujoco_and_herd", "mujoco_and_herd_fine", "herd_fine_and_herd")
        }
        found[name] |= {key: spread(rows, key) for key in ("load", "work_j", "energy_j")} | {"rows": rows}
    trace = recording()
    found["over_a_stride"] = over_a_stride(xml, trace)
    found["in_the_air"] = in_the_air(xml, trace)
    found["growth_rad_per_unit"] = growth(xml, trace)
    found["variants"] = {
        name: summary([figures(in_mujoco(other, trace, f), recorded(trace, f)) for _, f in list(starts())[:4]])
        for name, other in variants(xml).items()
    }
    return found, curves
