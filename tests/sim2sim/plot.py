"""Draws joint angles of both simulators, and how their difference grows."""

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from open_loop import LIMIT, TICK_SECS, errors

COLOURS = {"herd, recorded": "#1b6ca8", "MuJoCo, RK4, 0.1 ms": "#d1495b", "herd, replayed at 0.1 ms": "#8a8d91"}
JOINTS = {"hip roll": 0, "hip pitch": 1, "knee": 2}
LEGS = {"front left": 0, "rear right": 3}
STYLE = {"font.size": 9, "axes.spines.top": False, "axes.spines.right": False, "svg.hashsalt": "herd"}


def draw(curves, file):
    """One picture: joint angles from one start, and errors from all."""
    starts = {kind: next(key for key in curves if key[0] == kind) for kind in ("lift-off", "mid stance")}
    with plt.rc_context(STYLE):
        figure, axes = plt.subplots(4, 2, figsize=(9, 9), constrained_layout=True)
        for column, (kind, key) in enumerate(starts.items()):
            angles(axes[:3, column], curves[key], kind)
            growth(axes[3, column], {k: v for k, v in curves.items() if k[0] == kind})
        figure.align_ylabels()
        handles, labels = axes[0, 0].get_legend_handles_labels()
        first = len(COLOURS)
        figure.legend(handles[:first], labels[:first], loc="outside upper center", ncols=first, frameon=False)
        figure.savefig(file, metadata={"Date": None} if str(file).endswith("svg") else {}, dpi=150)
        plt.close(figure)


def angles(axes, curves, kind):
    """Three joints of two legs over half a second."""
    for axis, (joint, index) in zip(axes, JOINTS.items(), strict=True):
        for leg, number in LEGS.items():
            for name, snapshots in reversed(curves.items()):
                time = TICK_SECS * np.arange(1, len(snapshots) + 1)
                values = [snapshot["joints"][3 * number + index] for snapshot in snapshots]
                style = "-" if number == 0 else "--"
                axis.plot(time, values, style, color=COLOURS[name], lw=1.3, label=name if number == 0 else None)
        axis.set_ylabel(f"{joint}, rad")
        axis.set_xlim(0, 0.5)
    axes[0].set_title(f"start at {kind} (solid: front left, dashed: rear right)", fontsize=9)


def growth(axis, curves):
    """Largest joint difference between MuJoCo and the recording, over time, from every start."""
    for drawn in curves.values():
        ours, theirs, _ = drawn.values()
        apart = errors(theirs, ours).max(axis=1)
        axis.semilogy(TICK_SECS * np.arange(1, len(apart) + 1), apart, color="#d1495b", lw=0.8, alpha=0.6)
    axis.axhline(LIMIT, color="black", lw=0.8, ls=":")
    axis.text(0.01, LIMIT * 1.15, "0.05 rad", va="bottom")
    axis.set(xlim=(0, 0.5), ylim=(1e-4, 0.3), xlabel="time without feedback, s", ylabel="largest difference, rad")
