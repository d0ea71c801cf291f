//! A learner from start to end: open the run, listen, train, serve, leave everything tidy.

use crate::ddpg::{self, Ddpg, Learner};
use crate::export;
use crate::history::epoch::{self, Epoch};
use crate::run_dir::{self, RunDir, write_whole};
use crate::service::{self, Context, Traffic};
use crate::shelf::Shelf;
pub use crate::trainer::Ended;
use crate::trainer::command::{Command, Handle};
use crate::trainer::{self, Trainer};
use herd_common::config::Config;
use herd_common::policy::{Policy, Provenance};
use herd_common::seed::Seed;
use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use tokio::net::TcpListener;
use tokio::sync::watch;
use tokio_util::sync::CancellationToken;

/// What a learner is started with.
#[derive(Clone, Debug)]
pub struct Options {
    /// Where the run lies.
    pub run_dir: PathBuf,
    /// Overrides of the default configuration.
    pub config_file: Option<PathBuf>,
    /// `key=value` overrides on top.
    pub sets: Vec<String>,
    /// Where to listen; port 0 takes a free one.
    pub listen: SocketAddr,
    /// Allow an address that others can reach, without encryption or authentication.
    pub insecure: bool,
}

/// Why a learner could not start or go on.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// Configuration or run directory.
    #[error(transparent)]
    RunDir(#[from] run_dir::Error),
    /// The epoch.
    #[error(transparent)]
    Epoch(#[from] epoch::Error),
    /// The device that the configuration asks for.
    #[error(transparent)]
    Device(ddpg::Error),
    /// The trainer.
    #[error(transparent)]
    Trainer(#[from] trainer::Error),
    /// The trainer thread panicked.
    #[error("the trainer thread panicked; its last words are in the log")]
    Panicked,
    /// The address is taken or not ours.
    #[error("cannot listen on {address}: {source}")]
    Listen {
        /// Which address.
        address: SocketAddr,
        /// Why not.
        source: std::io::Error,
    },
    /// The address can be reached by others.
    #[error(
        "refusing to listen on {0}: other machines can reach it and herd speaks without encryption or password; add --insecure if the network is trusted"
    )]
    Exposed(SocketAddr),
    /// The gRPC server.
    #[error(transparent)]
    Service(#[from] service::Error),
    /// A file in the run directory.
    #[error("{path:?}: {source}")]
    File {
        /// Which.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
}

impl Error {
    /// True when starting again with the same words must fail again.
    pub fn is_config(&self) -> bool {
        matches!(
            self,
            Self::RunDir(run_dir::Error::Config(_) | run_dir::Error::Foreign { .. } | run_dir::Error::OtherRun { .. })
                | Self::Exposed(_)
                | Self::Device(_)
        )
    }

    /// True when starting again later can help.
    pub fn is_retry(&self) -> bool {
        matches!(self, Self::Listen { .. })
    }
}

/// How far a run is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Progress {
    /// Episodes in its newest checkpoint.
    pub episodes: u64,
    /// Episodes it is to have.
    pub target: u64,
}

/// Runs a learner until its run is complete, `shutdown` is cancelled or somebody says stop.
pub async fn run(options: Options, shutdown: CancellationToken) -> Result<Ended, Error> {
    if !options.listen.ip().is_loopback() && !options.insecure {
        return Err(Error::Exposed(options.listen));
    }
    let config = effective_config(Some(&options.run_dir), options.config_file.as_deref(), &options.sets)?;
    Learner::check(&config.ddpg, config.task.kind.dims()).map_err(Error::Device)?;
    let listener =
        TcpListener::bind(options.listen).await.map_err(|source| Error::Listen { address: options.listen, source })?;
    let dir = RunDir::open(&options.run_dir, &config)?;
    let epoch = Epoch::take(dir.root())?;
    let address = Address::announce(&dir, &listener)?;
    tracing::info!(address = address.text, run = config.run_name(), epoch = epoch.number(), "listening");

    let (trainer, inbox) = Handle::new();
    let (shelf, shelves) = watch::channel(Arc::new(Shelf::default()));
    let streams = CancellationToken::new();
    let ready = CancellationToken::new();
    let context = Context {
        trainer: trainer.clone(),
        shelf: shelves,
        config: Arc::new(config.clone()),
        epoch: epoch.number(),
        shutdown: streams.clone(),
        traffic: Arc::new(Traffic::default()),
    };
    let training = {
        let (runtime, ready, over) = (tokio::runtime::Handle::current(), ready.clone(), streams.clone().drop_guard());
        std::thread::Builder::new().name("trainer".into()).spawn(move || {
            // However this thread ends, serving ends with it.
            let _over = over;
            let trainer = Trainer::restore(config, dir, epoch, shelf)?;
            ready.cancel();
            trainer.run(inbox, &runtime)
        })
    };
    let training = training.map_err(|source| Error::File { path: "trainer thread".into(), source })?;
    tokio::spawn(async move {
        shutdown.cancelled().await;
        let _ = trainer.send(Command::Stop(None)).await;
    });
    service::serve(listener, context, ready).await?;
    // Serving ended because the trainer did.
    let ended = training.join().map_err(|_| Error::Panicked)?;
    Ok(ended?)
}

/// The configuration that these words mean: over the run's own when it exists, else over the default.
pub fn effective_config(
    run_dir: Option<&Path>,
    file: Option<&Path>,
    sets: &[String],
) -> Result<Config, run_dir::Error> {
    let stored = run_dir.map(|path| RunDir::at(path).stored_config()).transpose()?.flatten();
    match (stored, file) {
        (Some(stored), None) => Ok(stored.overridden(sets)?),
        _ => Ok(Config::load(file, sets)?),
    }
}

/// How far the run in this directory is; `None` when there is none or it has no checkpoint yet.
pub fn peek(run_dir: &Path) -> Result<Option<Progress>, Error> {
    let dir = RunDir::at(run_dir);
    let Some(config) = dir.stored_config()? else { return Ok(None) };
    let commits = trainer::commits_in_checkpoint(&dir, &config.run_name())?;
    Ok(commits.map(|episodes| Progress { episodes, target: config.episodes }))
}

/// The policy that a run with this configuration starts from; it is the same for every device.
pub fn untrained_policy(config: &Config) -> Result<Policy, Error> {
    let ddpg = Ddpg::new(&config.ddpg, config.task.kind.dims(), seed(config)).map_err(trainer::Error::from)?;
    let provenance = Provenance { version: 0, run: config.run_name(), task_hash: config.task_hash() };
    Ok(export::policy(&Learner::Cpu(Box::new(ddpg)), provenance).map_err(trainer::Error::from)?)
}

/// The learner that a run with this configuration starts from.
pub(crate) fn new_learner(config: &Config) -> Result<Learner, ddpg::Error> {
    Learner::new(&config.ddpg, config.task.kind.dims(), seed(config))
}

fn seed(config: &Config) -> Seed {
    Seed::from_number(config.seed).child("learner", 0)
}

/// The `address` file: there while a learner listens.
struct Address {
    path: PathBuf,
    text: String,
}

impl Address {
    fn announce(dir: &RunDir, listener: &TcpListener) -> Result<Self, Error> {
        let path = dir.address();
        let write = || {
            let text = listener.local_addr()?.to_string();
            write_whole(&path, format!("{text}\n").as_bytes())?;
            Ok(text)
        };
        match write() {
            Ok(text) => Ok(Self { path, text }),
            Err(source) => Err(Error::File { path, source }),
        }
    }
}

impl Drop for Address {
    fn drop(&mut self) {
        // Another learner may have announced itself meanwhile; its address is not ours to remove.
        if std::fs::read_to_string(&self.path).is_ok_and(|text| text.trim_end() == self.text) {
            let _ = std::fs::remove_file(&self.path);
        }
    }
}
