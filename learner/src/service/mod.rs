//! The gRPC side of the learner: checks what comes in, hands it to the trainer, sends out what the trainer says.
//!
//! Nothing here decides anything about the run. Streams end on the shutdown token, so that a graceful shutdown does
//! not wait for peers that never hang up.

mod broadcast;
mod incoming;
mod policies;
mod traffic;
mod training;
mod work;

use crate::shelf::Shelf;
use crate::trainer::command::Handle;
use herd_common::caps;
use herd_common::config::Config;
use herd_proto::FILE_DESCRIPTOR_SET;
use herd_proto::v1::policies_server::PoliciesServer;
use herd_proto::v1::training_server::TrainingServer;
use herd_proto::v1::work_server::WorkServer;
use std::sync::Arc;
use tokio::net::TcpListener;
use tokio::sync::watch;
use tokio_util::sync::CancellationToken;
use tonic::transport::Server;
pub use traffic::Traffic;

/// What every service needs to know.
#[derive(Clone, Debug)]
pub struct Context {
    /// The trainer.
    pub trainer: Handle,
    /// The published policies.
    pub shelf: watch::Receiver<Arc<Shelf>>,
    /// The run's configuration.
    pub config: Arc<Config>,
    /// How often a learner has been started on this run directory.
    pub epoch: u64,
    /// Ends every stream.
    pub shutdown: CancellationToken,
    /// Bytes over all connections.
    pub traffic: Arc<Traffic>,
}

/// Serves until `shutdown`; health answers SERVING from the moment `ready` is cancelled.
pub async fn serve(listener: TcpListener, context: Context, ready: CancellationToken) -> Result<(), Error> {
    let (health, health_service) = tonic_health::server::health_reporter();
    health.set_not_serving::<WorkServer<work::Service>>().await;
    health.set_service_status("", tonic_health::ServingStatus::NotServing).await;
    tokio::spawn(async move {
        ready.cancelled().await;
        health.set_serving::<WorkServer<work::Service>>().await;
        health.set_service_status("", tonic_health::ServingStatus::Serving).await;
    });
    let reflection = || {
        tonic_reflection::server::Builder::configure()
            .register_encoded_file_descriptor_set(FILE_DESCRIPTOR_SET)
            .register_encoded_file_descriptor_set(tonic_health::pb::FILE_DESCRIPTOR_SET)
    };
    let (shutdown, traffic) = (context.shutdown.clone(), context.traffic.clone());
    let server = Server::builder()
        .max_concurrent_streams(Some(caps::STREAMS_PER_CONNECTION))
        .http2_keepalive_interval(Some(caps::KEEPALIVE_INTERVAL))
        .http2_keepalive_timeout(Some(caps::KEEPALIVE_TIMEOUT))
        .max_frame_size(Some(caps::FRAME_BYTES))
        .initial_stream_window_size(Some(4 << 20))
        .initial_connection_window_size(Some(16 << 20))
        .add_service(health_service)
        .add_service(reflection().build_v1()?)
        .add_service(reflection().build_v1alpha()?)
        .add_service(sized!(WorkServer::new(work::Service(context.clone()))))
        .add_service(broadcast::Shared::new(sized!(PoliciesServer::new(policies::Service(context.clone()))), &context))
        .add_service(sized!(TrainingServer::new(training::Service(context))))
        .serve_with_incoming_shutdown(incoming::guarded(listener, traffic), shutdown.clone().cancelled_owned());
    tokio::select! {
        served = server => Ok(served?),
        // A peer that holds its connection open must not hold the process open.
        () = async { shutdown.cancelled().await; tokio::time::sleep(caps::DRAIN_TIMEOUT).await } => Ok(()),
    }
}

/// Sets the message limit on a generated server.
macro_rules! sized {
    ($server:expr) => {
        $server.max_decoding_message_size(caps::MESSAGE_BYTES).max_encoding_message_size(caps::MESSAGE_BYTES)
    };
}
use sized;

/// Why serving ended.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// The transport failed.
    #[error("gRPC server: {0}")]
    Transport(#[from] tonic::transport::Error),
    /// The descriptors do not describe a service.
    #[error("gRPC reflection: {0}")]
    Reflection(#[from] tonic_reflection::server::Error),
}

/// The answer to any call once the trainer has ended.
impl From<crate::trainer::command::Gone> for tonic::Status {
    fn from(gone: crate::trainer::command::Gone) -> Self {
        Self::unavailable(gone.to_string())
    }
}
