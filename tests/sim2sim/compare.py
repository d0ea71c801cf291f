"""herd against MuJoCo: open loop, closed loop, ONNX. Writes sim2sim.json and sim2sim.svg and prints tables."""

import argparse
import functools
import json
import pathlib
import platform
import sys
from importlib import metadata

import closed_loop
import herd
import open_loop


def xml_of(run_dir=None):
    """The model of a run, or of the default configuration."""
    return herd.call("export", "mjcf", *(["--run-dir", run_dir] if run_dir else []))


def table(head, rows):
    """A Markdown table."""
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join("| " + " | ".join(map(str, line)) + " |" for line in lines) + "\n"


def open_loop_tables(found):
    """What was found without feedback."""
    names = {
        "mujoco_and_herd": "MuJoCo − recording",
        "mujoco_and_herd_fine": "MuJoCo − herd at 0.1 ms",
        "herd_fine_and_herd": "herd at 0.1 ms − recording",
    }
    rows = []
    for recording in open_loop.RECORDINGS:
        for pair, name in names.items():
            for kind in ("lift-off", "mid stance"):
                s = found[recording][pair][kind]
                rows.append(
                    [recording, name, kind, f"{s['median_max_rad']:.3f}", f"{s['worst_max_rad']:.3f}"]
                    + [f"{s['median_rms_rad']:.3f}", f"{s['shortest_within_secs']:.2f}"]
                )
    head = ["herd recorded with", "difference", "start", "median of max, rad", "worst, rad", "median rms, rad"]
    text = table([*head, "within 0.05 rad for, s"], rows)
    rows = [
        [recording, key, *(f"{found[recording][key][who]:.4f}" for who in ("herd", "mujoco", "mean_abs_difference"))]
        for recording in open_loop.RECORDINGS
        for key in ("load", "work_j", "energy_j")
    ]
    text += "\n" + table(["herd recorded with", "mean of", "herd", "MuJoCo", "mean |difference|"], rows)
    rows = [[name, f"{s['median_max_rad']:.4f}", f"{s['worst_max_rad']:.4f}"] for name, s in found["variants"].items()]
    text += "\n" + table(["MuJoCo with (4 starts)", "median of max, rad", "worst, rad"], rows)
    rows = [[name, f"{value:.3f}"] for name, value in found["growth_rad_per_unit"].items()]
    text += "\n" + table(["difference at the start", "becomes after 0.5 s, rad per unit"], rows)
    stride = found["over_a_stride"]
    text += f"\nfrom every 10 ms of a stride: median {stride['median_max_rad']:.3f} rad, {max(stride['max_rad']):.3f} at most, "
    text += f"within 0.05 rad from {stride['share_within']:.0%}\n\n"
    air = found["in_the_air"]
    rows = [[n, f"{s['median_max_rad']:.5f}", f"{s['worst_max_rad']:.5f}"] for n, s in air.items() if n != "secs"]
    return text + "\n" + table([f"in the air, {air['secs']} s", "median of max, rad", "worst, rad"], rows)


def closed_loop_table(found):
    """What was found with feedback."""
    rows = []
    for name, both in found.items():
        for who in ("herd", "mujoco"):
            s = both[who]
            rows.append(
                [name, who, f"{s['falls']} of {s['episodes']}", f"{s['return']:.1f}", f"{s['mean_speed_mps']:.3f}"]
                + [f"{s['load']:.4f}", f"{s['roll_variance']:.1e}", f"{s['pitch_variance']:.1e}"]
                + [f"{s['cost_of_transport']:.3f}"]
            )
    head = ["who walks", "simulator", "falls", "return", "speed, m/s", "vertical force / weight", "roll², rad²"]
    return table([*head, "pitch², rad²", "cost of transport"], rows)


def quick(xml):
    """A few seconds that show that everything works together, with a start of each kind; for the tests."""
    trace = open_loop.recording()
    first_two = list(open_loop.starts())[:2]
    rows = [open_loop.figures(open_loop.in_mujoco(xml, trace, at), open_loop.recorded(trace, at)) for _, at in first_two]
    words = ["--task", "constant", *herd.sets(task__episode_secs=2)]
    ours, header = closed_loop.in_herd(words)
    theirs = closed_loop.in_mujoco(xml, words, header)
    print(json.dumps({"open_loop": open_loop.summary(rows), "herd": ours, "mujoco": theirs}))


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--run-dir", type=pathlib.Path, help="a run whose policy walks in both, also as ONNX")
    parser.add_argument("--out", type=pathlib.Path, default=pathlib.Path("."), help="directory for the two files")
    parser.add_argument("--episodes", type=int, default=3, help="episodes of 10 s of each case (default 3)")
    parser.add_argument("--quick", action="store_true", help="seconds instead of minutes: two starts, one short episode")
    options = parser.parse_args()
    if options.quick:
        return quick(xml_of())
    models = functools.cache(xml_of)
    found = {"versions": {name: metadata.version(name) for name in ("mujoco", "numpy")}}
    found["versions"]["python"] = platform.python_version()
    found["open_loop"], curves = open_loop.measure(models())
    policy = None
    if options.run_dir:
        from onnx_policy import Policy

        policy = Policy(options.run_dir)
        found["versions"]["onnxruntime"] = metadata.version("onnxruntime")
        found["onnx"] = policy.parity()
    act = policy.act if policy else None
    found["closed_loop"] = closed_loop.measure(models, options.run_dir, act, options.episodes)
    from plot import draw

    options.out.mkdir(parents=True, exist_ok=True)
    draw(curves, options.out / "sim2sim.svg")
    (options.out / "sim2sim.json").write_text(json.dumps(found, indent=1) + "\n")
    print(open_loop_tables(found["open_loop"]), closed_loop_table(found["closed_loop"]), sep="\n")
    if policy:
        print(f"ONNX: {json.dumps(found['onnx'])}")
        return 0 if found["onnx"]["holds"] else 1


if __name__ == "__main__":
    sys.exit(main())
