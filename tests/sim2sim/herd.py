"""Calls the `herd` binary: exports, traces, and an episode in which MuJoCo is the robot."""

import json
import os
import pathlib
import subprocess
import sys
import tempfile

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
        """The trace with `change(state)` in place of every state but the first."""
        ticks = [tick | {"after": change(tick["after"])} for tick in self.ticks]
        return Trace(self.header, self.start, ticks)

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
