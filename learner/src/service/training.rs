//! `Training`: how is it going, save, stop.

use super::Context;
use crate::trainer::command::{Command, Gone};
use herd_common::status::Status as Snapshot;
use herd_proto::v1::{self, training_server::Training};
use std::time::Duration;
use tokio::sync::mpsc;
use tokio_stream::wrappers::ReceiverStream;
use tonic::{Request, Response, Status};

/// See the .proto file.
pub(super) struct Service(pub(super) Context);

#[tonic::async_trait]
impl Training for Service {
    type WatchStatusStream = ReceiverStream<Result<v1::Status, Status>>;

    async fn get_status(&self, _: Request<v1::GetStatusRequest>) -> Result<Response<v1::Status>, Status> {
        Ok(Response::new(snapshot(&self.0).await?.into()))
    }

    async fn watch_status(
        &self,
        request: Request<v1::WatchStatusRequest>,
    ) -> Result<Response<Self::WatchStatusStream>, Status> {
        let period = match request.into_inner().period_secs {
            0.0 => Duration::from_secs(1),
            secs if (0.1..=3600.0).contains(&secs) => Duration::from_secs_f64(secs),
            secs => {
                return Err(Status::invalid_argument(format!(
                    "period_secs is {secs}, expected 0.1 to 3600, or 0 for 1"
                )));
            }
        };
        let context = self.0.clone();
        let (sender, receiver) = mpsc::channel(1);
        tokio::spawn(async move {
            while let Ok(status) = snapshot(&context).await {
                let last = status.phase != "training";
                if sender.send(Ok(status.into())).await.is_err() || last {
                    return;
                }
                tokio::select! {
                    () = tokio::time::sleep(period) => {}
                    () = sender.closed() => return,
                    () = context.shutdown.cancelled() => return,
                }
            }
        });
        Ok(Response::new(ReceiverStream::new(receiver)))
    }

    async fn save_checkpoint(
        &self,
        _: Request<v1::SaveCheckpointRequest>,
    ) -> Result<Response<v1::SaveCheckpointResponse>, Status> {
        let (episodes, file) = self.0.trainer.ask(Command::Checkpoint).await?.map_err(Status::internal)?;
        Ok(Response::new(v1::SaveCheckpointResponse { episodes, file }))
    }

    async fn stop(&self, _: Request<v1::StopRequest>) -> Result<Response<v1::StopResponse>, Status> {
        let episodes = self.0.trainer.ask(|reply| Command::Stop(Some(reply))).await?;
        Ok(Response::new(v1::StopResponse { episodes }))
    }
}

/// What the trainer says of itself, and what the wire knows.
async fn snapshot(context: &Context) -> Result<Snapshot, Gone> {
    let status = context.trainer.ask(Command::Status).await?;
    Ok(Snapshot { traffic: context.traffic.so_far(), ..status })
}
