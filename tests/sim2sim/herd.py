"""Calls the `herd` binary: exports, traces, and an episode in which MuJoCo is the robot."""

import functools
import json
import os
import pathlib
import subprocess
import sys
import tempfile

import numpy as np

ROOT = pathlib.Path(__file__).resolve().parent.parent.parent
BINARY = os.environ.get("HERD", str(ROOT / "target" / "release" / "herd"))


def call(*words):
    """What `herd <words>` prints; ends the script with herd's own words where it refuses."""
    done = subprocess.run([BINARY, *map(str, words)], check=False, capture_output=True, text=True)
    if done.returncode:
        sys.exit(f"herd {words[0]}: {done.stderr.strip()}")
    return done.stdout


def sets(**values):
    """`--set key=value` for each; `__` in a name stands for a dot."""
    return [word for key, value in values.items() for word in ("--set", f"{key.replace('__', '.')}={value}")]


class Trace:
    """Header, start, ticks and outcome of `herd export trace`."""

    def __init__(self, header, start, ticks, outcome=None):
        self.header, self.start, self.ticks, self.outcome = header, start, ticks, outcome

    @classmethod
    def read(cls, text):
        """The trace that this text holds."""
        named = [next(iter(json.loads(line).items())) for line in text.splitlines()]
        found = dict(item for item in named if item[0] != "tick")
        return cls(found["header"], found["start"], [tick for key, tick in named if key == "tick"], found.get("outcome"))

    def text(self):
        """The trace as text again, without its outcome."""
        lines = [{"header": self.header}, {"start": self.start}, *({"tick": tick} for tick in self.ticks)]
        return "\n".join(map(json.dumps, lines))

    def state(self, tick):
        """The robot after so many ticks."""
        return self.start if tick == 0 else self.ticks[tick - 1]["after"]

    def changed(self, change):
        """The trace with `change(state before, state)` in place of every state but the first, which has none before."""
        states = [change(self.state(i), self.state(i + 1)) for i in range(len(self.ticks))]
        ticks = [tick | {"after": state} for tick, state in zip(self.ticks, states, strict=True)]
        return Trace(self.header, self.start, ticks)

    @property
    def step_secs(self):
        """The step of the solver that made it."""
        return self.header["sim_tick_secs"] / self.header["sim_substeps"]

    def moved_back(self, secs):
        """The trace with positions and angles this much earlier, velocities and torques where they were."""
        share = secs / self.header["tick_secs"]

        def between(before, after):
            def mixed(key):
                return (1 - share) * np.array(after[key]) + share * np.array(before[key])

            turned = mixed("quaternion")
            moved = {"position": mixed("position"), "joints": mixed("joints")}
            moved["quaternion"] = turned / np.linalg.norm(turned)
            return after | {key: value.tolist() for key, value in moved.items()}

        return self.changed(between)

    @functools.cached_property
    def at_once(self):
        """The trace with positions of the moment of their velocities.

        herd's solver steps as q' = q + h v': its velocities are those of half a step before its positions, and what acts
        over a step acts from half a step before its start to half a step before its end.
        """
        return self.moved_back(self.step_secs / 2)

    def replayed(self, at, secs, *words):
        """Its torques from `at` (s) on, replayed by herd's own simulator with these options."""
        with tempfile.NamedTemporaryFile("w", suffix=".jsonl") as file:
            file.write(self.text())
            file.flush()
            return Trace.read(call("export", "trace", "--replay", file.name, "--at", at, "--secs", secs, *words))


def drive(plant, words, act=None, watch=lambda torques, snapshot: None):
    """Runs an episode of `herd drive <words>` in which `plant` is the robot; gives what herd says at its end.

    `act` answers observations if herd has no policy; `watch` sees every tick of the episode and of the settling before.
    """
    command = [BINARY, "drive", *map(str, words)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as herd:
        for line in herd.stdout:
            (question, asked), *_ = json.loads(line).items()
            if question == "end":
                return asked
            answer = None
            if question == "reset":
                plant.set(asked)
            elif question == "add_velocity":
                plant.data.qvel[:3] += asked
                watch(None, None)
            elif question == "tick":
                plant.tick(asked["torques"], asked.get("push"))
                watch(asked["torques"], plant.snapshot())
            else:
                answer = {"action": act(asked)}
            print(json.dumps(answer or plant.snapshot()), file=herd.stdin, flush=True)
    raise RuntimeError(f"herd drive ended with code {herd.returncode}")
