//! The learner wing of herd: what it keeps, what it learns and how it is spoken to.

pub mod history;
