//! Measures one point: a learner process, its actors, a warm-up, a window, a tidy end.

use super::cpu;
use super::figures::{Figures, Setting, Sight};
use super::load::{Load, Plan};
use super::meter::{Meter, Totals};
use super::payload::Payload;
use crate::exit::Failure;
use crate::train::child::Child;
use anyhow::Context;
use herd_common::config::Config;
use herd_proto::address::Address;
use herd_proto::client::Client;
use std::ffi::OsString;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;
use tokio::process;
use tokio::time::{sleep, timeout};

/// How every point is measured.
pub(crate) struct Method {
    /// Where each point's run lies while it is measured.
    pub(crate) run_dir: PathBuf,
    /// `key=value` for the learner.
    pub(crate) sets: Vec<String>,
    /// The configuration that they come to.
    pub(crate) config: Config,
    /// A file below the sets.
    pub(crate) config_file: Option<PathBuf>,
    /// Robots of each actor.
    pub(crate) robots: u32,
    /// Length of the window.
    pub(crate) window: Duration,
    /// Time before it.
    pub(crate) warmup: Duration,
    /// Synthetic actors, if any.
    pub(crate) synthetic: Option<Synthetic>,
    /// The run of a point is kept.
    pub(crate) keep: bool,
}

/// How synthetic actors behave.
#[derive(Clone, Copy)]
pub(crate) struct Synthetic {
    /// Transitions of an episode.
    pub(crate) decisions: usize,
    /// Transitions of a message.
    pub(crate) piece: usize,
    /// They do not follow policies.
    pub(crate) deaf: bool,
    /// Episodes per second of all of them together; as many as go without.
    pub(crate) pace: Option<f64>,
}

/// Patience with a learner that starts, with actors that join, and with episodes that wait for acknowledgement.
const PATIENCE: Duration = Duration::from_mins(1);
const BETWEEN_LOOKS: Duration = Duration::from_millis(50);

/// Whoever acts.
enum Actors {
    /// Processes, and a probe that follows the policies.
    Real(Vec<process::Child>, Load),
    Synthetic(Load),
}

/// Measures with this many actors, for the first, second … time.
pub(crate) async fn measure(method: &Method, actors: u32, round: u32) -> anyhow::Result<Figures> {
    let again = if round > 1 { format!("-{round}") } else { String::new() };
    let dir = method.run_dir.join(format!("actors-{actors}{again}"));
    if dir.exists() {
        let text = format!("{} is there already; remove it or choose another --run-dir", dir.display());
        return Err(Failure::usage(text).into());
    }
    std::fs::create_dir_all(dir.join("logs")).with_context(|| format!("make {}", dir.display()))?;
    let program = learner(method, &dir)?;
    let mut learner = program.start()?;
    let pid = learner.id().context("the learner is gone")?;
    let measured = tokio::select! {
        measured = with_learner(method, actors, &dir, pid) => measured,
        ended = learner.wait() => Err(anyhow::anyhow!("the learner ended ({ended:?}): {}", program.last_words())),
    };
    crate::train::child::end(&program, learner).await?;
    let mut figures = measured?;
    figures.setting.round = round;
    if !method.keep {
        std::fs::remove_dir_all(&dir).with_context(|| format!("remove {}", dir.display()))?;
    }
    Ok(figures)
}

async fn with_learner(method: &Method, actors: u32, dir: &Path, learner: u32) -> anyhow::Result<Figures> {
    let (client, address) = timeout(PATIENCE, connect(dir)).await.context("the learner does not answer")?;
    let mut acting = start_actors(method, actors, dir, &address)?;
    let (pids, meter) = (acting.pids(), acting.meter());
    let look = || sight(&client, learner, &pids);
    let window = async {
        let joined = all_joined(&client, actors);
        timeout(PATIENCE, joined).await.context("not all actors have joined")??;
        sleep(method.warmup).await;
        meter.take_latencies();
        let from = look().await?;
        sleep(method.window).await;
        let to = look().await?;
        let (commit, broadcast) = meter.take_latencies();
        let figures = Figures::between(setting(method, actors), &from, &to);
        let (policy_bytes, lost) = (meter.policy_bytes(), meter.all_lost());
        anyhow::Ok(Figures { commit, broadcast, policy_bytes, lost, ..figures })
    };
    let mut figures = tokio::select! {
        figures = window => figures?,
        error = acting.failed() => return Err(error),
    };
    figures.acknowledged = acting.finish().await?;
    let last = client.status().await?;
    figures.committed = Totals { episodes: last.episodes, transitions: last.transitions, refused: 0 };
    figures.learner_peak_bytes = cpu::peak_bytes(learner);
    Ok(figures)
}

fn setting(method: &Method, actors: u32) -> Setting {
    Setting {
        actors,
        round: 1,
        robots: method.robots,
        synthetic: method.synthetic.is_some(),
        paced: method.synthetic.is_some_and(|synthetic| synthetic.pace.is_some()),
        allowed: method.config.schedule.lag + 1,
        cores: std::thread::available_parallelism().map_or(1, |cores| cores.get() as u32),
    }
}

fn learner(method: &Method, dir: &Path) -> anyhow::Result<Child> {
    let mut words: Vec<OsString> = vec!["learner".into(), "--listen".into(), "127.0.0.1:0".into()];
    words.extend(["--run-dir".into(), dir.into()]);
    if let Some(file) = &method.config_file {
        words.extend(["--config".into(), file.into()]);
    }
    for set in &method.sets {
        words.extend(["--set".into(), set.into()]);
    }
    Child::new("learner", words, dir)
}

fn start_actors(method: &Method, actors: u32, dir: &Path, address: &str) -> anyhow::Result<Actors> {
    if let Some(synthetic) = method.synthetic {
        let Synthetic { decisions, piece, deaf, pace } = synthetic;
        let pause = pace.map_or(Duration::ZERO, |pace| Duration::from_secs_f64(f64::from(actors) / pace));
        let payload = Payload::new(decisions, piece, method.config.task.kind.dims());
        let plan = Plan { payload, robots: method.robots, deaf, pause };
        return Ok(Actors::Synthetic(Load::start(actors, address, plan)?));
    }
    let start = |index: u32| {
        let words = ["actor", "--learner", address, "--robots", &method.robots.to_string()].map(OsString::from);
        Child::new(&format!("actor-{index}"), words.to_vec(), dir)?.start()
    };
    Ok(Actors::Real((0..actors).map(start).collect::<anyhow::Result<_>>()?, Load::probe(address)?))
}

/// The learner in this directory, as soon as it answers.
async fn connect(dir: &Path) -> (Client, String) {
    loop {
        if let Ok(address) = Address::of_run(dir).resolve()
            && let Ok(client) = Client::connect(&address).await
            && client.status().await.is_ok()
        {
            return (client, address);
        }
        sleep(BETWEEN_LOOKS).await;
    }
}

async fn all_joined(client: &Client, actors: u32) -> anyhow::Result<()> {
    while client.status().await?.actors.len() < actors as usize {
        sleep(BETWEEN_LOOKS).await;
    }
    Ok(())
}

async fn sight(client: &Client, learner: u32, actors: &[u32]) -> anyhow::Result<Sight> {
    let status = client.status().await?;
    Ok(Sight {
        at: status.uptime_secs,
        status,
        machine_cpu_secs: cpu::machine_secs(),
        learner_cpu_secs: cpu::used_secs(learner),
        actors_cpu_secs: actors.iter().map(|pid| cpu::used_secs(*pid)).sum(),
    })
}

impl Actors {
    fn pids(&self) -> Vec<u32> {
        match self {
            Self::Real(children, _) => children.iter().filter_map(process::Child::id).collect(),
            Self::Synthetic(_) => vec![std::process::id()],
        }
    }

    /// What is counted and timed in this process.
    fn meter(&self) -> Arc<Meter> {
        let (Self::Real(_, load) | Self::Synthetic(load)) = self;
        load.meter.clone()
    }

    /// The first failure of one; waits for as long as there is none.
    async fn failed(&mut self) -> anyhow::Error {
        match self {
            Self::Synthetic(load) => load.failed().await,
            Self::Real(children, probe) => tokio::select! {
                error = probe.failed() => error,
                error = one_ended(children) => error,
            },
        }
    }

    /// Ends them; what synthetic ones counted, when all they had begun is acknowledged.
    async fn finish(self) -> anyhow::Result<Option<Totals>> {
        match self {
            // They end with their handles.
            Self::Real(..) => Ok(None),
            Self::Synthetic(load) => Ok(Some(load.finish(PATIENCE).await?.totals())),
        }
    }
}

/// The first actor process to end: all of them are to live as long as the measurement.
async fn one_ended(children: &mut [process::Child]) -> anyhow::Error {
    loop {
        for (index, child) in children.iter_mut().enumerate() {
            match child.try_wait() {
                Ok(None) => {}
                Ok(Some(status)) => return anyhow::anyhow!("actor {index} ended while it was measured: {status}"),
                Err(error) => return anyhow::Error::new(error).context(format!("watch actor {index}")),
            }
        }
        sleep(BETWEEN_LOOKS).await;
    }
}
