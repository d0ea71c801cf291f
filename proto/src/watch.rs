//! The subscriber's end of `Policies.Watch`, below the generated code: a policy is copied once, into its layers.
//!
//! tonic gathers the frames of a message in a buffer of its own before anybody may read it. A policy of the default
//! networks comes in one HTTP/2 frame, and is decoded in the place where it was received; a larger one, or one that a
//! proxy has cut into pieces, is put together first.

use crate::client::{Client, Error};
use crate::{convert, v1};
use bytes::{Bytes, BytesMut};
use herd_common::caps;
use herd_common::policy::Policy;
use http::{HeaderValue, Request, header};
use http_body_util::{BodyExt, Full};
use prost::Message;
use std::future::poll_fn;
use tonic::body::Body;
use tonic::{Code, Status};
use tower_service::Service;

const METHOD: &str = "/herd.v1.Policies/Watch";

/// A policy as it came.
#[derive(Debug)]
pub struct Received {
    /// The policy, checked.
    pub policy: Policy,
    /// The learner's clock when it published it, ns since 1970.
    pub published_unix_nanos: Option<u64>,
    /// Length of its gRPC message with the five bytes in front; HTTP/2 adds nine a frame.
    pub bytes: usize,
}

/// Policies as they are published.
#[derive(Debug)]
pub struct PolicyStream {
    body: Body,
    held: Held,
    unused: Option<Policy>,
}

impl Client {
    /// The newest policy (unless `have_version` is it), then each newer one.
    pub async fn watch_policies(&self, have_version: Option<u64>) -> Result<PolicyStream, Error> {
        let message = convert::grpc_frame(&v1::WatchPolicyRequest { have_version });
        let mut request = Request::post(METHOD).body(Body::new(Full::new(message))).expect("a path is a URI");
        request.headers_mut().insert(header::CONTENT_TYPE, HeaderValue::from_static("application/grpc"));
        request.headers_mut().insert(header::TE, HeaderValue::from_static("trailers"));
        let mut channel = self.channel();
        let failed = |error: tonic::transport::Error| Status::from_error(error.into());
        poll_fn(|context| channel.poll_ready(context)).await.map_err(failed)?;
        let (head, body) = channel.call(request).await.map_err(failed)?.into_parts();
        if let Some(status) = Status::from_header_map(&head.headers).filter(|status| status.code() != Code::Ok) {
            return Err(status.into());
        }
        if !head.status.is_success() {
            return Err(Status::unavailable(format!("HTTP status {}", head.status)).into());
        }
        Ok(PolicyStream { body, held: Held::default(), unused: None })
    }
}

impl PolicyStream {
    /// The next policy, checked; `None` at the end of the stream. Safe to drop while it waits.
    pub async fn next(&mut self) -> Result<Option<Policy>, Error> {
        Ok(self.next_received().await?.map(|received| received.policy))
    }

    /// The same with what is known of its way.
    pub async fn next_received(&mut self) -> Result<Option<Received>, Error> {
        let Some(message) = self.message().await? else { return Ok(None) };
        let bytes = HEAD_BYTES + message.len();
        let broken = |error: prost::DecodeError| Status::internal(format!("a policy cannot be decoded: {error}"));
        let wire = v1::Policy::decode(message).map_err(broken)?;
        let published_unix_nanos = wire.published_unix_nanos;
        let policy = convert::policy_from_wire_into(wire, self.unused.take())?;
        Ok(Some(Received { policy, published_unix_nanos, bytes }))
    }

    /// Takes a policy that is no longer used, for the next to be written in its memory.
    pub fn give_back(&mut self, unused: Policy) {
        self.unused = Some(unused);
    }

    async fn message(&mut self) -> Result<Option<Bytes>, Status> {
        loop {
            if let Some(message) = self.held.take()? {
                return Ok(Some(message));
            }
            let Some(frame) = self.body.frame().await.transpose()? else {
                return Err(Status::unavailable("the stream of policies broke off"));
            };
            match frame.into_data() {
                Ok(piece) => self.held.add(piece),
                Err(frame) => return self.end(frame.trailers_ref().and_then(Status::from_header_map)),
            }
        }
    }

    fn end(&self, status: Option<Status>) -> Result<Option<Bytes>, Status> {
        match status {
            Some(status) if status.code() != Code::Ok => Err(status),
            None => Err(Status::unknown("the stream of policies ends without a status")),
            _ if self.held.bytes > 0 => Err(Status::internal("the stream of policies ends within one")),
            _ => Ok(None),
        }
    }
}

/// What of a body is received and not yet taken.
#[derive(Debug, Default)]
struct Held {
    pieces: Vec<Bytes>,
    bytes: usize,
}

/// Compressed or not, and the length.
const HEAD_BYTES: usize = 5;

impl Held {
    fn add(&mut self, piece: Bytes) {
        if !piece.is_empty() {
            self.bytes += piece.len();
            self.pieces.push(piece);
        }
    }

    /// The next message, when all of it is here.
    fn take(&mut self) -> Result<Option<Bytes>, Status> {
        let mut head = [0; HEAD_BYTES];
        let mut bytes = self.pieces.iter().flat_map(|piece| piece.iter());
        for place in &mut head {
            let Some(byte) = bytes.next() else { return Ok(None) };
            *place = *byte;
        }
        let [compressed, length @ ..] = head;
        let length = u32::from_be_bytes(length) as usize;
        if compressed != 0 || length > caps::MESSAGE_BYTES {
            let expected = format!("expected 0 and at most {}", caps::MESSAGE_BYTES);
            return Err(Status::internal(format!("a policy's head is {compressed} and {length}, {expected}")));
        }
        if self.bytes < HEAD_BYTES + length {
            return Ok(None);
        }
        let mut message = self.joined();
        self.add(message.split_off(HEAD_BYTES + length));
        Ok(Some(message.slice(HEAD_BYTES..)))
    }

    /// All that is held, as one.
    fn joined(&mut self) -> Bytes {
        let (pieces, bytes) = (std::mem::take(&mut self.pieces), std::mem::take(&mut self.bytes));
        match <[Bytes; 1]>::try_from(pieces) {
            Ok([only]) => only,
            Err(pieces) => {
                let mut whole = BytesMut::with_capacity(bytes);
                for piece in &pieces {
                    whole.extend_from_slice(piece);
                }
                whole.freeze()
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Messages taken from `bytes` that come in pieces of `piece`.
    #[track_caller]
    fn taken(bytes: &Bytes, piece: usize) -> Vec<Bytes> {
        let (mut held, mut messages) = (Held::default(), Vec::new());
        for from in (0..bytes.len()).step_by(piece) {
            held.add(bytes.slice(from..bytes.len().min(from + piece)));
            while let Some(message) = held.take().expect("well-formed") {
                messages.push(message);
            }
        }
        assert_eq!(held.bytes, 0, "all is taken");
        messages
    }

    #[test]
    fn messages_come_whole_however_they_are_cut() {
        let framed = |text: &'static str| [&[0, 0, 0, 0, text.len() as u8], text.as_bytes()].concat();
        let bytes = Bytes::from([framed("one"), framed(""), framed("three")].concat());
        for piece in 1..=bytes.len() {
            assert_eq!(taken(&bytes, piece), ["one", "", "three"], "pieces of {piece}");
        }
    }

    #[test]
    fn messages_in_one_piece_each_are_not_copied() {
        let bytes = Bytes::from_static(&[0, 0, 0, 0, 2, 7, 8, 0, 0, 0, 0, 2, 7, 8]);
        let places: Vec<_> = taken(&bytes, 7).iter().map(|message| message.as_ptr()).collect();
        assert_eq!(places, [bytes[5..].as_ptr(), bytes[12..].as_ptr()]);
    }

    #[test]
    fn a_head_beyond_the_contract_is_refused() {
        for head in [&[1, 0, 0, 0, 0][..], &[0, 255, 0, 0, 0]] {
            let mut held = Held::default();
            held.add(Bytes::copy_from_slice(head));
            assert!(held.take().is_err(), "{head:?}");
        }
    }
}
