//! Work items, leases and greetings.

use crate::{WireError, v1};
use herd_common::caps;
use herd_common::seed::Seed;
use herd_common::work::{Order, Work};
use v1::work_item::Item;

impl From<Work> for v1::WorkItem {
    fn from(work: Work) -> Self {
        let item = match work {
            Work::Episode(episode) => Item::Episode(episode),
            Work::Evaluation { version, index } => Item::Evaluation(v1::EvaluationItem { version, index }),
        };
        Self { item: Some(item) }
    }
}

/// The work that a message is about.
pub fn work_from_wire(item: Option<&v1::WorkItem>) -> Result<Work, WireError> {
    match item.and_then(|work| work.item.as_ref()) {
        Some(Item::Episode(episode)) => Ok(Work::Episode(*episode)),
        Some(Item::Evaluation(v1::EvaluationItem { version, index })) => {
            Ok(Work::Evaluation { version: *version, index: *index })
        }
        None => Err(WireError::Missing("work")),
    }
}

impl From<Order> for v1::Lease {
    fn from(order: Order) -> Self {
        Self {
            work: Some(order.work.into()),
            attempt: order.attempt,
            seed: order.seed.as_bytes().to_vec().into(),
            policy_version: order.policy_version,
            sigma: order.sigma,
            random: order.random,
        }
    }
}

impl TryFrom<v1::Lease> for Order {
    type Error = WireError;

    fn try_from(lease: v1::Lease) -> Result<Self, WireError> {
        let seed: [u8; 32] = lease
            .seed
            .as_ref()
            .try_into()
            .map_err(|_| WireError::invalid("seed", format!("{} bytes", lease.seed.len()), "32 bytes"))?;
        if !(0.0..=10.0).contains(&lease.sigma) {
            return Err(WireError::invalid("sigma", lease.sigma, "0 to 10"));
        }
        Ok(Self {
            work: work_from_wire(lease.work.as_ref())?,
            attempt: lease.attempt,
            seed: Seed::from(seed),
            policy_version: lease.policy_version,
            sigma: lease.sigma,
            random: lease.random,
        })
    }
}

/// Checks the host name of a `Hello`: it is shown to people, so it may hold no control characters.
pub fn hello_name(field: &'static str, name: &str) -> Result<String, WireError> {
    let allowed = |c: char| c.is_ascii_alphanumeric() || matches!(c, '.' | '_' | '-');
    if name.is_empty() || name.len() > caps::NAME_BYTES || !name.chars().all(allowed) {
        let expected = format!("1 to {} of [a-zA-Z0-9._-]", caps::NAME_BYTES);
        return Err(WireError::invalid(field, format!("{name:?}"), expected));
    }
    Ok(name.to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn orders_round_trip() {
        for work in [Work::Episode(9), Work::Evaluation { version: 50, index: 3 }] {
            let seed = Seed::from_number(4);
            let order = Order { work, attempt: 2, seed, policy_version: 7, sigma: 0.25, random: true };
            assert_eq!(Order::try_from(v1::Lease::from(order)).expect("valid"), order);
        }
    }

    #[test]
    fn bad_leases_and_names_are_refused() {
        let short = v1::Lease { work: Some(Work::Episode(1).into()), seed: vec![0; 31].into(), ..Default::default() };
        assert_eq!(Order::try_from(short).expect_err("refused").to_string(), "seed is 31 bytes, expected 32 bytes");
        assert!(work_from_wire(None).is_err());
        assert!(hello_name("host", "node-1.lab").is_ok());
        for bad in ["", "a b", "../x", "a\u{1b}[2J", &"x".repeat(65)] {
            assert!(hello_name("host", bad).is_err(), "{bad:?}");
        }
    }
}
