//! What a device does in one go, as plain numbers: each launch of an update, laid out as the kernels of a GPU read it.
//!
//! Everything stands in one arena of f32; a place in it is a number of floats from the start. A matrix is stored by
//! rows, `ld` floats from one row to the next.

use super::super::kernels::Activation;

/// Products that one launch may hold.
pub(super) const PRODUCTS: usize = 8;
/// Networks that one launch may move: two critics and the actor.
pub(super) const NETWORKS: usize = 3;
/// Parameters whose squares are added up together, `PARAMETERS` of the kernels.
pub(super) const PARAMETERS: u32 = 1024;
/// Numbers that an update reports: critic's loss, actor's loss, mean value, whether all was finite.
pub(super) const REPORT: usize = 4;

/// One launch; each begins when the one before is through.
#[derive(Clone, Debug)]
pub(super) enum Launch {
    /// The minibatch out of the replay memory.
    Gather(Gather),
    /// Independent products of one kind.
    Products(Mode, Vec<Product>),
    /// Targets, losses, and the losses' gradients in the values.
    Losses(Losses),
    /// The gradients from their parts, and their squares.
    Sum(Vec<Moved>),
    /// Adam and the target copies, if all is finite.
    Step(Step),
}

/// What a product does.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Mode {
    /// `C ← f(A B + x)` for a layer's x `[m, k]` and weight `[k, n]`.
    Forward,
    /// `C ← f′(x) ∘ (A Bᵀ)` for a layer's δ `[m, k]` and weight `[n, k]`.
    Back,
    /// `C ← Aᵀ B` for a layer's x `[k, m]` and δ `[k, n]`; the sums of B's columns stand behind it, as a bias does.
    Weight,
}

/// One product. `repr(C)`: a GPU reads it as it stands.
#[derive(Clone, Copy, Debug)]
#[repr(C)]
pub(super) struct Product {
    pub(super) a: u32,
    pub(super) lda: u32,
    pub(super) b: u32,
    pub(super) ldb: u32,
    pub(super) c: u32,
    pub(super) ldc: u32,
    /// Rows of C.
    pub(super) m: u32,
    /// Columns of C.
    pub(super) n: u32,
    /// Terms of each sum.
    pub(super) k: u32,
    /// f
    pub(super) finish: Activation,
    /// Forward: the bias `[n]`. Back: y `[m, n]`, from which f′ is told.
    pub(super) x: u32,
    pub(super) ldx: u32,
    /// Forward: noise `[m, n]` on the output, which is then clipped to ±1; 0 for none.
    pub(super) noise: u32,
    /// Weight: parts that the terms are cut into.
    pub(super) parts: u32,
    /// Weight: from one part's C to the next.
    pub(super) stride: u32,
    pub(super) unused: u32,
}

/// `repr(C)`, as all below.
#[derive(Clone, Copy, Debug)]
#[repr(C)]
pub(super) struct Gather {
    /// Transitions of a minibatch.
    pub(super) n: u32,
    pub(super) observation: u32,
    pub(super) action: u32,
    /// s and a, s and room for π(s), s′ and room for π′(s′), `[n, observation + action]` each.
    pub(super) inputs: u32,
    pub(super) own_inputs: u32,
    pub(super) next_inputs: u32,
    /// `[n]`, in units that are learned.
    pub(super) rewards: u32,
    /// `[n]`
    pub(super) discounts: u32,
}

/// Every place but the last is of `[n]`.
#[derive(Clone, Copy, Debug)]
#[repr(C)]
pub(super) struct Losses {
    pub(super) n: u32,
    pub(super) critics: u32,
    /// 1 if π is to move.
    pub(super) moves_actor: u32,
    /// Q(s, a), critic by critic.
    pub(super) values: [u32; 2],
    /// Q′(s′, a′)
    pub(super) next_values: [u32; 2],
    /// Q(s, π(s)) of the first critic.
    pub(super) own_values: u32,
    pub(super) rewards: u32,
    pub(super) discounts: u32,
    pub(super) weights: u32,
    /// ∂J/∂Q(s, a) goes here, critic by critic.
    pub(super) slopes: [u32; 2],
    /// The same of Q(s, π(s)).
    pub(super) own_slopes: u32,
    /// y − Q(s, a) of the first critic goes here.
    pub(super) errors: u32,
    /// `[updates, REPORT]`
    pub(super) report: u32,
}

/// A network that moves.
#[derive(Clone, Copy, Debug)]
#[repr(C)]
pub(super) struct Moved {
    /// θ, θ′, m and v, `[4, stride]`.
    pub(super) rows: u32,
    pub(super) parameters: u32,
    /// g, `[parts, stride]`; the first part becomes the sum.
    pub(super) gradient: u32,
    pub(super) parts: u32,
    /// Sums of g², a number for every `PARAMETERS` of them.
    pub(super) squares: u32,
    /// Rate and root scale of the steps that may come, `[updates, 2]`.
    pub(super) rates: u32,
    /// Steps taken before each update, `[updates + 1]`.
    pub(super) taken: u32,
    /// From one row or part to the next.
    pub(super) stride: u32,
    /// Share of a weight that a step leaves; 1 without decay.
    pub(super) keep: f32,
}

impl Moved {
    /// Sums of squares.
    pub(super) fn blocks(&self) -> u32 {
        self.parameters.div_ceil(PARAMETERS)
    }
}

/// How all networks move.
#[derive(Clone, Debug)]
pub(super) struct Step {
    pub(super) moved: Vec<Moved>,
    /// `Moved::taken` of the network that does not move, whose count goes on as it is; 0 for none.
    pub(super) resting: u32,
    /// As `Losses::report`.
    pub(super) report: u32,
    /// Largest global gradient norm; 0 for any.
    pub(super) clip: f32,
    /// γ, if the target copies move too.
    pub(super) target_rate: Option<f32>,
}
