//! The wire contract of herd: generated code, checked conversions to domain types, a typed client.
//!
//! Wire types stop here and in the learner's service. What comes from outside is checked once, in `convert`; behind it
//! everybody works with the domain types of `herd_common`.

pub mod address;
pub mod client;
pub mod convert;
mod error;
pub mod link;
pub mod packed;
pub mod watch;

pub use error::WireError;

/// Version of the protocol in `Hello`; raised when old peers can no longer talk to new ones.
pub const PROTOCOL: u32 = 2;

/// Version of this build, named when two of them do not agree.
pub const BUILD: &str = env!("CARGO_PKG_VERSION");

/// Generated from `proto/herd/v1/herd.proto`.
pub mod v1 {
    #![allow(
        missing_docs,
        unreachable_pub,
        clippy::pedantic,
        clippy::allow_attributes_without_reason,
        reason = "generated code"
    )]
    tonic::include_proto!("herd.v1");
}

/// The compiled .proto files, for reflection.
pub const FILE_DESCRIPTOR_SET: &[u8] = include_bytes!(concat!(env!("OUT_DIR"), "/herd.v1.bin"));
