//! What can go wrong in the learner's core.

use herd_common::caps;

/// Why the learner cannot go on.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// There is nothing to learn from.
    #[error("replay memory is empty, expected at least one transition before an update")]
    EmptyReplay,
    /// The replay memory is made for other spaces.
    #[error("replay memory has {what} of length {found}, the networks expect {expected}")]
    Dims {
        /// `observations` or `actions`.
        what: &'static str,
        /// The memory's length.
        found: usize,
        /// The networks' length.
        expected: usize,
    },
    /// Losses or gradients stayed NaN or infinite.
    #[error("{skipped} updates in a row had a loss or gradient that is not finite (last at update {update})")]
    Diverged {
        /// Updates skipped in a row.
        skipped: u32,
        /// The last of them.
        update: u64,
    },
    /// A weight is NaN or infinite.
    #[error("{record}[{index}] is {value}, expected a finite number")]
    NotFinite {
        /// Name of the tensor.
        record: String,
        /// Position in it.
        index: usize,
        /// The offending number.
        value: f32,
    },
    /// A snapshot belongs to other networks.
    #[error("snapshot has {found}, expected {expected}")]
    Snapshot {
        /// Name and shape found, or their absence.
        found: String,
        /// Name and shape that belong there.
        expected: String,
    },
    /// The configuration asks for a GPU that this program cannot use.
    #[error(
        "config: `ddpg.device` is \"cuda\", expected \"cpu\": this herd was built without the feature `cuda` (docs/gpu.md)"
    )]
    NoCuda,
    /// There is no GPU, or it, its driver or NVRTC does not fit.
    #[error("config: `ddpg.device` is \"cuda\", but no GPU can be used: {0}")]
    NoGpu(String),
    /// A GPU that could be used failed.
    #[error("the GPU failed: {0}")]
    GpuFailed(String),
    /// The networks at work on a minibatch need more numbers than a device is laid out for.
    #[error(
        "config: `ddpg.batch_size` and `ddpg.hidden` ask for {found} numbers on a device, expected at most {}",
        caps::DEVICE_NUMBERS
    )]
    TooLarge {
        /// Numbers in all.
        found: usize,
    },
    /// candle refused an operation: a mistake of the program.
    #[error("candle: {0}")]
    Candle(#[from] candle_core::Error),
}
