//! The `herd` binary: a contents page of its commands.

mod args;
mod ask;
mod exit;
mod lifeline;
mod out;
mod table;

#[cfg(feature = "actor")]
mod actor;
mod config;
#[cfg(feature = "actor")]
mod drive;
#[cfg(feature = "actor")]
mod eval;
#[cfg(feature = "actor")]
mod export;
#[cfg(feature = "learner")]
mod learner;
#[cfg(feature = "actor")]
mod meter;
mod report;
#[cfg(all(feature = "actor", feature = "learner"))]
mod reproduce;
#[cfg(all(feature = "actor", feature = "learner"))]
mod scale;
mod status;
#[cfg(feature = "actor")]
mod student;
#[cfg(all(feature = "actor", feature = "learner"))]
mod train;
mod version;
#[cfg(feature = "actor")]
mod walker;
#[cfg(feature = "learner")]
mod wing;

use clap::{Parser, Subcommand};
use std::process::ExitCode;

#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

/// Trains quadruped gaits with a herd of simulated robots.
#[derive(Parser)]
#[command(name = "herd", version = version::VERSION, after_help = AFTER_HELP)]
struct Cli {
    /// Write logs as JSON lines. Logs go to stderr; HERD_LOG filters them, such as HERD_LOG=debug.
    #[arg(long, global = true)]
    log_json: bool,
    /// End when the process of this number does.
    #[arg(long, global = true, hide = true, value_name = "PID")]
    die_with_parent: Option<i32>,
    #[command(subcommand)]
    command: Command,
}

const AFTER_HELP: &str = "\
Examples:
  herd train --actors 2 --run-dir runs/first --episodes 200    learn to walk, here
  herd status --run-dir runs/first --watch                     see how it goes
  herd eval --policy runs/first/policy.safetensors             see what was learned
  herd learner --run-dir runs/big --listen 0.0.0.0:7447 --insecure
  herd actor --learner node-1:7447 --robots 8                  the same on many machines

Exit codes: 0 done, 64 wrong usage, 70 internal error, 75 try again later, 78 configuration or task mismatch.";

#[derive(Subcommand)]
enum Command {
    #[cfg(all(feature = "actor", feature = "learner"))]
    Train(train::Args),
    #[cfg(feature = "learner")]
    Learner(learner::Args),
    #[cfg(feature = "actor")]
    Actor(actor::Args),
    Status(status::Args),
    #[cfg(feature = "actor")]
    Eval(eval::Args),
    Report(report::Args),
    #[cfg(feature = "actor")]
    Export(export::Args),
    #[cfg(feature = "actor")]
    Drive(drive::Args),
    #[cfg(all(feature = "actor", feature = "learner"))]
    Reproduce(reproduce::Args),
    #[cfg(all(feature = "actor", feature = "learner"))]
    Scale(scale::Args),
    Config(config::Args),
    Checkpoint(ask::CheckpointArgs),
    Stop(ask::StopArgs),
    WaitReady(ask::WaitReadyArgs),
}

fn main() -> ExitCode {
    let cli = match Cli::try_parse() {
        Ok(cli) => cli,
        Err(told) => return exit::usage(&told),
    };
    if !lifeline::hold(cli.die_with_parent) {
        return ExitCode::SUCCESS;
    }
    match run(cli) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => exit::failure(&error),
    }
}

fn run(cli: Cli) -> anyhow::Result<()> {
    let quiet = !matches!(cli.command.name(), "learner" | "actor");
    herd_common::telemetry::init(if quiet { "warn" } else { "info" }, cli.log_json);
    match cli.command {
        #[cfg(all(feature = "actor", feature = "learner"))]
        Command::Train(args) => train::run(&args),
        #[cfg(feature = "learner")]
        Command::Learner(args) => learner::run(args),
        #[cfg(feature = "actor")]
        Command::Actor(args) => actor::run(args),
        Command::Status(args) => status::run(&args),
        #[cfg(feature = "actor")]
        Command::Eval(args) => eval::run(&args),
        Command::Report(args) => report::run(&args),
        #[cfg(feature = "actor")]
        Command::Export(args) => export::run(&args),
        #[cfg(feature = "actor")]
        Command::Drive(args) => drive::run(&args),
        #[cfg(all(feature = "actor", feature = "learner"))]
        Command::Reproduce(args) => reproduce::run(&args),
        #[cfg(all(feature = "actor", feature = "learner"))]
        Command::Scale(args) => scale::run(&args),
        Command::Config(args) => config::run(&args),
        Command::Checkpoint(args) => ask::checkpoint(&args),
        Command::Stop(args) => ask::stop(&args),
        Command::WaitReady(args) => ask::wait_ready(&args),
    }
}

impl Command {
    fn name(&self) -> &'static str {
        match self {
            #[cfg(feature = "learner")]
            Self::Learner(_) => "learner",
            #[cfg(feature = "actor")]
            Self::Actor(_) => "actor",
            _ => "client",
        }
    }
}
