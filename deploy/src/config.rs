//! `herd config`: the configuration, as it is or as it would be.

use crate::args::ConfigArgs;
use crate::{out, table};
use herd_common::config::{Config, DEFAULT};
use herd_common::hash::short;
use herd_common::spaces::Task;
use std::path::PathBuf;

/// Print the commented default configuration, or with options the one that they make.
#[derive(clap::Args)]
#[command(after_help = "\
Examples:
  herd config > my.toml                          a file to edit and give to --config; it may keep only what differs
  herd config --set ddpg.batch_size=128          what a run with this option would use
  herd config --run-dir runs/first               what a run uses
  herd config --observation                      what the policy sees, number by number; of another task with --set")]
pub(crate) struct Args {
    /// Start from the configuration of this run.
    #[arg(long, value_name = "DIR")]
    run_dir: Option<PathBuf>,
    #[command(flatten)]
    config: ConfigArgs,
    /// Print the table of the observation instead.
    #[arg(long)]
    observation: bool,
    /// Print JSON.
    #[arg(long)]
    json: bool,
}

/// `herd config`
pub(crate) fn run(args: &Args) -> anyhow::Result<()> {
    if args.observation {
        return out::print(&observation(args.config.load(args.run_dir.as_deref())?.task.kind));
    }
    if args.run_dir.is_none() && args.config.is_empty() && !args.json {
        return out::print(DEFAULT);
    }
    let config = args.config.load(args.run_dir.as_deref())?;
    if args.json {
        return out::json(&config);
    }
    out::print(&effective(&config))
}

fn effective(config: &Config) -> String {
    let (run, task) = (config.run_name(), config.task_hash());
    format!("# run {}, task {}\n{}", short(&run), short(&task), config.to_toml())
}

fn observation(task: Task) -> String {
    let head = ["index", "meaning", "unit", "scale"].map(str::to_owned).to_vec();
    let rows = task.observation().map(|block| {
        let last = block.start + block.len - 1;
        let index = if block.len == 1 { block.start.to_string() } else { format!("{}–{last}", block.start) };
        vec![index, block.meaning.to_owned(), block.unit.to_owned(), block.scale.to_string()]
    });
    table::columns(&std::iter::once(head).chain(rows).collect::<Vec<_>>())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_printed_can_be_read_back() {
        let config = Config::load(None, &["ddpg.batch_size=32".into()]).expect("valid");
        assert_eq!(Config::from_toml(&effective(&config), "printed").expect("reads"), config);
    }

    #[test]
    fn the_table_ends_at_the_last_number() {
        for (task, last) in [(Task::Gait, "52–55"), (Task::Command, "56–58")] {
            let table = observation(task);
            assert!(table.lines().last().expect("rows").starts_with(last), "{table}");
        }
    }
}
