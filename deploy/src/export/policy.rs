//! `herd export policy`: a policy as ONNX, with golden vectors beside it.

use crate::exit::Failure;
use crate::walker::WalkerArgs;
use herd_learner::export::{golden, onnx};
use std::path::PathBuf;

/// Write a policy as ONNX, and beside it observations with its actions to check a runtime by.
#[derive(clap::Args)]
#[command(after_help = "\
Examples:
  herd export policy --run-dir runs/first --out policy.onnx
  herd export policy --policy runs/first/policy.safetensors --out policy.onnx
Input `observation` [batch, 56, or 59 for commands], scaled as `herd config --observation` says and clipped to [-1, 1]; output `action`
[batch, n] in [-1, 1]. The golden vectors go to policy.golden.json.")]
pub(crate) struct Args {
    #[command(flatten)]
    walker: WalkerArgs,
    /// File to write.
    #[arg(long, value_name = "FILE", default_value = "policy.onnx")]
    out: PathBuf,
}

pub(super) fn run(args: &Args) -> anyhow::Result<()> {
    let config = args.walker.load()?;
    let Some(policy) = args.walker.policy(&config)? else {
        return Err(Failure::usage("there is no policy: give --run-dir or --policy of a task that learns").into());
    };
    super::write_bytes(&args.out, &onnx(&policy, &config))?;
    super::write_bytes(&args.out.with_extension("golden.json"), &serde_json::to_vec(&golden(&policy))?)
}
