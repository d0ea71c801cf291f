//! `Policies.Watch` below the generated code: the frame of a policy is made once and every stream sends the same bytes.
//!
//! tonic encodes a message anew for each stream, which for a hundred subscribers copies a hundred times 0.65 MB at the
//! moment when all of them wait. Every other method goes to the generated code.

use super::Context as Known;
use crate::shelf::Shelf;
use bytes::Bytes;
use herd_common::caps;
use herd_proto::v1;
use http::{HeaderMap, HeaderValue, Request, Response};
use http_body::Frame;
use std::convert::Infallible;
use std::future::Future;
use std::pin::Pin;
use std::sync::Arc;
use std::task::{Context, Poll};
use tokio::sync::{mpsc, watch};
use tokio_util::sync::CancellationToken;
use tonic::body::Body;
use tonic::codec::{Codec, Streaming};
use tonic::server::NamedService;
use tonic::{Code, Status};
use tonic_prost::ProstCodec;
use tower_service::Service;

const METHOD: &str = "/herd.v1.Policies/Watch";

/// The generated service with one method taken out.
#[derive(Clone, Debug)]
pub(super) struct Shared<S> {
    generated: S,
    shelf: watch::Receiver<Arc<Shelf>>,
    shutdown: CancellationToken,
}

impl<S> Shared<S> {
    pub(super) fn new(generated: S, known: &Known) -> Self {
        Self { generated, shelf: known.shelf.clone(), shutdown: known.shutdown.clone() }
    }
}

impl<S: NamedService> NamedService for Shared<S> {
    const NAME: &'static str = S::NAME;
}

impl<S> Service<Request<Body>> for Shared<S>
where
    S: Service<Request<Body>, Response = Response<Body>, Error = Infallible>,
    S::Future: Send + 'static,
{
    type Response = Response<Body>;
    type Error = Infallible;
    type Future = Pin<Box<dyn Future<Output = Result<Response<Body>, Infallible>> + Send>>;

    fn poll_ready(&mut self, context: &mut Context<'_>) -> Poll<Result<(), Infallible>> {
        self.generated.poll_ready(context)
    }

    fn call(&mut self, request: Request<Body>) -> Self::Future {
        if request.uri().path() != METHOD {
            return Box::pin(self.generated.call(request));
        }
        let (shelf, shutdown) = (self.shelf.clone(), self.shutdown.clone());
        Box::pin(async move {
            let have = match have_version(request).await {
                Ok(have) => have,
                Err(status) => return Ok(status.into_http()),
            };
            // One place: a slow reader is given the newest when it has read the last, and holds nothing else back.
            let (sender, frames) = mpsc::channel(1);
            tokio::spawn(send_newest(shelf, have, sender, shutdown));
            let mut response = Response::new(Body::new(Frames { frames, over: false }));
            response.headers_mut().insert("content-type", HeaderValue::from_static("application/grpc"));
            Ok(response)
        })
    }
}

/// What the caller says it has.
async fn have_version(request: Request<Body>) -> Result<Option<u64>, Status> {
    let decoder = ProstCodec::<v1::Policy, v1::WatchPolicyRequest>::default().decoder();
    let mut messages = Streaming::new_request(decoder, request.into_body(), None, Some(caps::MESSAGE_BYTES));
    let message = tokio::time::timeout(caps::CALL_TIMEOUT, messages.message()).await;
    let message = message.map_err(|_| Status::deadline_exceeded("no request arrived in time"))??;
    Ok(message.ok_or_else(|| Status::invalid_argument("the request is missing"))?.have_version)
}

async fn send_newest(
    mut shelf: watch::Receiver<Arc<Shelf>>,
    mut have: Option<u64>,
    sender: mpsc::Sender<Bytes>,
    shutdown: CancellationToken,
) {
    loop {
        let newest = shelf.borrow_and_update().newest().cloned();
        if let Some(published) = newest.filter(|published| Some(published.wire.version) != have) {
            have = Some(published.wire.version);
            if sender.send(published.frame.clone()).await.is_err() {
                return;
            }
        }
        tokio::select! {
            changed = shelf.changed() => if changed.is_err() { return },
            () = sender.closed() => return,
            () = shutdown.cancelled() => return,
        }
    }
}

/// The body of an answer: frames as they come, then the status.
struct Frames {
    frames: mpsc::Receiver<Bytes>,
    over: bool,
}

impl http_body::Body for Frames {
    type Data = Bytes;
    type Error = Status;

    fn poll_frame(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<Option<Result<Frame<Bytes>, Status>>> {
        if self.over {
            return Poll::Ready(None);
        }
        self.frames.poll_recv(context).map(|frame| {
            Some(Ok(frame.map_or_else(
                || {
                    self.over = true;
                    let mut trailers = HeaderMap::new();
                    trailers.insert("grpc-status", HeaderValue::from(Code::Ok as i32));
                    Frame::trailers(trailers)
                },
                Frame::data,
            )))
        })
    }
}
