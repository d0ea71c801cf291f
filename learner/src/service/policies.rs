//! `Policies`: the newest policy as a stream, or one by version.

use super::Context;
use crate::shelf::Shelf;
use herd_common::caps;
use herd_proto::v1::{self, policies_server::Policies};
use std::sync::Arc;
use tokio::sync::mpsc;
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

    async fn watch(&self, request: Request<v1::WatchPolicyRequest>) -> Result<Response<Self::WatchStream>, Status> {
        let mut have = request.into_inner().have_version;
        let Context { mut shelf, shutdown, .. } = self.0.clone();
        // One place: a slow reader is given the newest when it has read the last, and holds nothing else back.
        let (sender, receiver) = mpsc::channel(1);
        tokio::spawn(async move {
            loop {
                let newest = shelf.borrow_and_update().newest().cloned();
                if let Some(published) = newest.filter(|p| Some(p.wire.version) != have) {
                    have = Some(published.wire.version);
                    if sender.send(Ok(published.wire.clone())).await.is_err() {
                        return;
                    }
                }
                tokio::select! {
                    changed = shelf.changed() => if changed.is_err() { return },
                    () = sender.closed() => return,
                    () = shutdown.cancelled() => return,
                }
            }
        });
        Ok(Response::new(ReceiverStream::new(receiver)))
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
