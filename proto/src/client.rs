//! A typed client: connects with bounded waits and speaks domain types.

use crate::v1::policies_client::PoliciesClient;
use crate::v1::training_client::TrainingClient;
use crate::v1::work_client::WorkClient;
use crate::{WireError, convert, v1};
use herd_common::caps;
use herd_common::policy::Policy;
use herd_common::status::Status;
use tonic::transport::{Channel, Endpoint};

/// Why a call to a learner failed.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// The address is not one.
    #[error("learner address {address:?}: {reason}, expected http://HOST:PORT or HOST:PORT")]
    Address {
        /// What was given.
        address: String,
        /// What is wrong with it.
        reason: String,
    },
    /// Nobody answered.
    #[error("cannot reach the learner at {address}: {reason}")]
    Unreachable {
        /// Where.
        address: String,
        /// Why not.
        reason: String,
    },
    /// The learner refused.
    #[error("the learner answers {code:?}: {message}")]
    Refused {
        /// gRPC code.
        code: tonic::Code,
        /// Its words.
        message: String,
    },
    /// The learner's answer breaks the contract.
    #[error("the learner's answer: {0}")]
    Wire(#[from] WireError),
}

impl From<tonic::Status> for Error {
    fn from(status: tonic::Status) -> Self {
        Self::Refused { code: status.code(), message: status.message().to_owned() }
    }
}

impl Error {
    /// True when trying again later can help.
    pub fn is_transient(&self) -> bool {
        use tonic::Code;
        match self {
            Self::Unreachable { .. } => true,
            Self::Refused { code, .. } => !matches!(
                code,
                Code::FailedPrecondition | Code::InvalidArgument | Code::Unimplemented | Code::PermissionDenied
            ),
            Self::Address { .. } | Self::Wire(_) => false,
        }
    }
}

/// A connection to a learner; clones share it.
#[derive(Clone, Debug)]
pub struct Client {
    channel: Channel,
}

impl Client {
    /// Connects to `HOST:PORT` or `http://HOST:PORT`.
    pub async fn connect(address: &str) -> Result<Self, Error> {
        let url = if address.contains("://") { address.to_owned() } else { format!("http://{address}") };
        let endpoint = Endpoint::from_shared(url)
            .map_err(|e| Error::Address { address: address.into(), reason: e.to_string() })?
            .connect_timeout(caps::CALL_TIMEOUT)
            .tcp_nodelay(true)
            .http2_keep_alive_interval(caps::KEEPALIVE_INTERVAL)
            .keep_alive_timeout(caps::KEEPALIVE_TIMEOUT)
            .keep_alive_while_idle(true)
            .max_frame_size(caps::FRAME_BYTES)
            .initial_stream_window_size(4 << 20)
            .initial_connection_window_size(16 << 20);
        let channel = endpoint
            .connect()
            .await
            .map_err(|e| Error::Unreachable { address: address.into(), reason: root_cause(&e) })?;
        Ok(Self { channel })
    }

    /// What calls go through.
    pub(crate) fn channel(&self) -> Channel {
        self.channel.clone()
    }

    /// The `Work` service.
    pub fn work(&self) -> WorkClient<Channel> {
        WorkClient::new(self.channel.clone()).max_decoding_message_size(caps::MESSAGE_BYTES)
    }

    /// The `Policies` service.
    pub fn policies(&self) -> PoliciesClient<Channel> {
        PoliciesClient::new(self.channel.clone()).max_decoding_message_size(caps::MESSAGE_BYTES)
    }

    /// The `Training` service.
    pub fn training(&self) -> TrainingClient<Channel> {
        TrainingClient::new(self.channel.clone()).max_decoding_message_size(caps::MESSAGE_BYTES)
    }

    /// One policy.
    pub async fn policy(&self, version: u64) -> Result<Policy, Error> {
        let answer = self.policies().get(bounded(v1::GetPolicyRequest { version })).await?;
        Ok(convert::policy_from_wire(answer.into_inner())?)
    }

    /// A snapshot of the run.
    pub async fn status(&self) -> Result<Status, Error> {
        Ok(self.training().get_status(bounded(v1::GetStatusRequest {})).await?.into_inner().into())
    }

    /// Has a checkpoint written; gives its episodes and its file.
    pub async fn checkpoint(&self) -> Result<(u64, String), Error> {
        let answer = self.training().save_checkpoint(bounded(v1::SaveCheckpointRequest {})).await?.into_inner();
        Ok((answer.episodes, answer.file))
    }

    /// Stops the learner; gives the episodes committed.
    pub async fn stop(&self) -> Result<u64, Error> {
        Ok(self.training().stop(bounded(v1::StopRequest {})).await?.into_inner().episodes)
    }
}

/// A unary request with a deadline.
fn bounded<T>(message: T) -> tonic::Request<T> {
    let mut request = tonic::Request::new(message);
    request.set_timeout(caps::CALL_TIMEOUT);
    request
}

/// The innermost reason of an error: "connection refused" rather than "transport error".
fn root_cause(error: &dyn std::error::Error) -> String {
    let mut cause = error;
    while let Some(inner) = cause.source() {
        cause = inner;
    }
    cause.to_string()
}
