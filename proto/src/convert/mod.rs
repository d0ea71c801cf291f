//! Wire ⇄ domain. Domain to wire cannot fail; wire to domain checks every length, shape and number.

mod frame;
mod numbers;
mod outcome;
mod policy;
mod status;
mod transitions;
mod work;

pub use frame::grpc_frame;
pub(crate) use numbers::to_bytes as column;
pub(crate) use policy::policy_from_wire_into;
pub use policy::{policy_from_wire, policy_to_wire};
pub use transitions::{transitions_from_wire, transitions_to_wire};
pub use work::{hello_name, work_from_wire};
