//! The published policies: an immutable shelf that is replaced as a whole, so readers never wait for the trainer.

use bytes::Bytes;
use herd_common::policy::Policy;
use herd_proto::{convert, v1};
use std::collections::BTreeMap;
use std::sync::Arc;

/// One published policy, encoded once for every subscriber.
#[derive(Debug)]
pub struct Published {
    /// The policy itself.
    pub policy: Policy,
    /// The same for the wire; cloning it clones handles, not weights.
    pub wire: v1::Policy,
    /// The same as a gRPC message with its five bytes in front: every stream sends these bytes.
    pub frame: Bytes,
}

/// Every policy that a lease may name, by version.
#[derive(Clone, Debug, Default)]
pub struct Shelf {
    policies: BTreeMap<u64, Arc<Published>>,
}

impl Shelf {
    /// Adds a policy that is published at this moment, ns since 1970.
    pub fn put(&mut self, policy: Policy, unix_nanos: u64) {
        let wire = convert::policy_to_wire(&policy, Some(unix_nanos));
        let frame = convert::grpc_frame(&wire);
        self.policies.insert(policy.provenance.version, Arc::new(Published { policy, wire, frame }));
    }

    /// Keeps what `wanted` says and the newest.
    pub fn keep(&mut self, wanted: impl Fn(u64) -> bool) {
        let newest = self.newest().map(|published| published.policy.provenance.version);
        self.policies.retain(|version, _| Some(*version) == newest || wanted(*version));
    }

    /// The newest policy.
    pub fn newest(&self) -> Option<&Arc<Published>> {
        self.policies.values().next_back()
    }

    /// One policy.
    pub fn get(&self, version: u64) -> Option<&Arc<Published>> {
        self.policies.get(&version)
    }

    /// All, oldest first.
    pub fn iter(&self) -> impl Iterator<Item = &Policy> {
        self.policies.values().map(|published| &published.policy)
    }
}
