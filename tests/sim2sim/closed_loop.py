"""The same controller and policy drive herd's own simulator and MuJoCo for ten seconds each."""

import herd
import numpy as np
from plant import Plant

GAITS = [0.2, 0.4, 0.6, 1.0]  # m/s
STEP_SECS = 0.15
HEAT = 0.3  # W/(N·m)², as herd's own cost of transport has it
STEADY_SECS = 1.0


def angles(snapshot):
    """Roll and pitch, rad."""
    w, x, y, z = snapshot["quaternion"]
    return np.arctan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y)), np.arcsin(np.clip(2 * (w * y - z * x), -1, 1))


def figures(ticks, outcome, weight, tick_secs):
    """What an episode came to, from its ticks as (torques, snapshot): the same reckoning for both simulators."""
    steady = ticks[round(STEADY_SECS / tick_secs) :]
    x = [snapshot["position"][0] for _, snapshot in ticks]
    roll, pitch = np.array([angles(snapshot) for _, snapshot in steady]).T
    torques, speeds = np.array([t for t, _ in steady[1:]]), np.array([s["joint_speeds"] for _, s in steady])
    mean_speeds = (speeds[:-1] + speeds[1:]) / 2
    power = np.maximum(torques * mean_speeds + HEAT * torques**2, 0.0).sum(axis=1)
    distance = abs(steady[-1][1]["position"][0] - steady[0][1]["position"][0])
    return {
        "ending": outcome["ending"],
        "seconds": outcome["seconds"],
        "return": sum(outcome["reward"].values()),
        "mean_speed_mps": (x[-1] - x[0]) / ((len(x) - 1) * tick_secs),
        "load": float(np.mean([sum(snapshot["normal"]) for _, snapshot in steady]) / weight),
        "roll_variance": float(roll.var()),
        "pitch_variance": float(pitch.var()),
        "cost_of_transport": float(power.sum() * tick_secs / (weight * distance)),
    }


def in_herd(words):
    """The episode in herd's own simulator."""
    trace = herd.Trace.read(herd.call("export", "trace", *words))
    ticks = [(tick["torques"], tick["after"]) for tick in trace.ticks]
    return figures(ticks, trace.outcome, trace.header["weight_n"], trace.header["tick_secs"]), trace.header


def in_mujoco(xml, words, header, act=None):
    """The same episode with MuJoCo as the robot."""
    ticks = []

    def watch(torques, snapshot):
        # The last thing before t = 0 is the robot's first speed.
        if torques is None:
            ticks.clear()
        else:
            ticks.append((torques, snapshot))

    plant = Plant(xml, header["tick_secs"])
    end = herd.drive(plant, words, act, watch)
    return figures(ticks, end["outcome"], header["weight_n"], header["tick_secs"])


def cases(run_dir, act):
    """Name, words for herd, words for `herd drive` and who acts there, for each case."""
    for speed in GAITS:
        gait = herd.sets(task__constant__velocity_mps=speed, task__constant__stride_m=speed * STEP_SECS)
        yield f"trot, {speed} m/s", ["--task", "constant", *gait], ["--task", "constant", *gait], None
    if run_dir:
        own = ["--run-dir", run_dir]
        yield "policy", own, own, None
        if act:
            # Without its policy herd asks for actions: ONNX Runtime gives them.
            yield "policy as ONNX", own, ["--config", run_dir / "config.toml"], act


def mean(rows):
    """Means of the figures over episodes, and how many fell."""
    numbers = {key: float(np.mean([row[key] for row in rows])) for key in rows[0] if key != "ending"}
    return {"episodes": len(rows), "falls": sum(row["ending"] != "timed_out" for row in rows)} | numbers


def measure(xml_of, run_dir=None, act=None, episodes=3):
    """Figures of both simulators for every case; `xml_of` gives the model for the words of a case."""
    found = {}
    for name, ours, theirs, actor in cases(run_dir, act):
        xml, rows = xml_of(run_dir if "policy" in name else None), {"herd": [], "mujoco": []}
        for episode in range(episodes):
            which = ["--episode", str(episode)]
            row, header = in_herd(ours + which)
            rows["herd"].append(row)
            rows["mujoco"].append(in_mujoco(xml, theirs + which, header, actor))
        found[name] = {who: mean(of) | {"each": of} for who, of in rows.items()}
    return found
