//! `Policies` by version; the newest as a stream is answered in `broadcast`.

use super::Context;
use crate::shelf::Shelf;
use herd_common::caps;
use herd_proto::v1::{self, policies_server::Policies};
use std::sync::Arc;
use tokio_stream::wrappers::ReceiverStream;
use tonic::{Request, Response, Status};

/// See the .proto file.
pub(super) struct Service(pub(super) Context);

impl Service {
    /// The shelf, once the run is restored and there is something on it.
    async fn restored_shelf(&self) -> Result<Arc<Shelf>, Status> {
        let mut shelf = self.0.shelf.clone();
        let filled = shelf.wait_for(|shelf| shelf.newest().is_some());
        match tokio::time::timeout(caps::CALL_TIMEOUT, filled).await {
            Ok(Ok(shelf)) => Ok(shelf.clone()),
            _ => Err(Status::unavailable("the run is being restored, there is no policy yet")),
        }
    }
}

#[tonic::async_trait]
impl Policies for Service {
    type WatchStream = ReceiverStream<Result<v1::Policy, Status>>;

    async fn watch(&self, _: Request<v1::WatchPolicyRequest>) -> Result<Response<Self::WatchStream>, Status> {
        // Answered before it comes here, see `broadcast`.
        Err(Status::internal("Policies.Watch has come the wrong way"))
    }

    async fn get(&self, request: Request<v1::GetPolicyRequest>) -> Result<Response<v1::Policy>, Status> {
        let version = request.into_inner().version;
        let shelf = self.restored_shelf().await?;
        let Some(published) = shelf.get(version) else {
            let kept: Vec<u64> = shelf.iter().map(|policy| policy.provenance.version).collect();
            return Err(Status::not_found(format!("policy {version} is not kept, expected one of {kept:?}")));
        };
        Ok(Response::new(published.wire.clone()))
    }
}
