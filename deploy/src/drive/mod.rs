//! `herd drive`: controller and policy for a robot that another program simulates.

mod lines;

use crate::exit::Failure;
use crate::walker::{self, WalkerArgs};
use herd_actor::env::{Env, Observation};
use herd_actor::rollout::run_episode;
use herd_actor::sim::remote;
use herd_common::spaces::Task;
use lines::Lines;
use serde_json::json;

/// Walk a robot that another program simulates: torques out, states in, as JSON lines over stdout and stdin.
#[derive(clap::Args)]
#[command(after_help = "\
Examples:
  herd drive --task constant --set task.constant.velocity_mps=0.6 --set task.constant.stride_m=0.09
  herd drive --run-dir runs/first --episode 3
  herd drive --task gait                        no policy: the other program is asked for actions

herd asks, one JSON line each; the other program answers each but the last with one line:
  {\"reset\":{\"position\":[3],\"quaternion\":[4],\"joints\":[12]}}   start from this pose, at rest
  {\"tick\":{\"torques\":[12],\"push\":[3]}}                        simulate sim.tick_secs; push (N) only if there is one
  {\"add_velocity\":[3]}                                         add to the trunk's velocity, pose and joints stay
  {\"observe\":[56 or 59]}                                       what the policy would see; answer {\"action\":[n]}
  {\"end\":{\"outcome\":{...},\"figures\":{...}}}                    the episode is over
All other answers are the robot as it is then:
  {\"position\":[3],\"quaternion\":[4],\"velocity\":[3],\"angular_velocity\":[3],\"joints\":[12],\"joint_speeds\":[12],
   \"normal\":[4],\"friction\":[4],\"trunk\":false,\"knee\":false}
World frame, z up, ground at z = 0; quaternion w x y z; m, m/s, rad, rad/s, N·m, N; joints FL FR RL RR, each hip roll, hip
pitch, knee; forces are means over the tick. \"feet\":[4] may tell which feet are on the ground at its end; if not, those
with a normal force are. tests/sim2sim/closed_loop.py drives MuJoCo so.")]
pub(crate) struct Args {
    #[command(flatten)]
    walker: WalkerArgs,
}

/// `herd drive`
pub(crate) fn run(args: &Args) -> anyhow::Result<()> {
    let config = args.walker.load()?;
    walker::expect_level(&config)?;
    let policy = args.walker.policy(&config)?;
    let lines = Lines::default();
    let worlds = lines.clone();
    let spawn = remote(Box::new(move || {
        let lines = worlds.clone();
        Box::new(move |ask| lines.state(ask))
    }));
    let mut act = |observation: &Observation| match &policy {
        Some(policy) => policy.act(observation),
        None if config.task.kind == Task::Constant => Vec::new(),
        None => {
            let dim = config.task.kind.action_dim();
            lines.action(observation, dim).unwrap_or_else(|| vec![0.0; dim])
        }
    };
    let mut env = Env::new(&config).with_plant(spawn);
    let outcome = run_episode(&mut env, args.walker.episode(&config).1, &mut act, &mut |_| {});
    if let Some(broken) = lines.broken() {
        return Err(Failure::usage(broken).into());
    }
    let figures = env.figures(config.task.constant.velocity_mps);
    lines.say(&json!({ "end": {
        "outcome": outcome,
        "figures": {
            "mean_speed_mps": figures.mean_speed,
            "cost_of_transport": figures.cost_of_transport,
            "load": figures.load,
        },
    }}))
}
