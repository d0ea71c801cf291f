//! One update as a list of launches over one arena, for any layers, batch and settings.
//!
//! What does not depend on each other goes together: a layer of all networks at once, then all weights' gradients. Two
//! lists are kept, one for updates that leave the actor alone.

use super::super::error::Error;
use super::super::kernels::Activation;
use super::super::optimizer::kept;
use super::super::rows::{Row, Span, parameters, spans};
use super::super::update::Shapes;
use super::launches::{Gather, Launch, Losses, Mode, Moved, NETWORKS, PRODUCTS, Product, REPORT, Step};
use herd_common::caps;
use herd_common::config::ddpg::Config;
use herd_common::spaces::Dims;

/// Most parts that the sums over a minibatch are cut into, and the fewest transitions of one; measured on an H200.
const PARTS: u32 = 8;
const PART_ROWS: u32 = 64;
/// A GPU copies this many floats at a time.
const ALIGNMENT: usize = 4;

/// Where everything stands, and what an update does with it.
#[derive(Debug)]
pub(super) struct Plan {
    /// Numbers of the arena.
    pub(super) len: usize,
    pub(super) actor: Place,
    pub(super) critics: Vec<Place>,
    /// Rates of the critics' steps and of the actor's, `[updates, 2]`; then steps taken, `[updates + 1]` each.
    pub(super) schedule: u32,
    /// Weights of the losses, `[n]`.
    pub(super) weights: u32,
    /// On target actions, `[n, action]`, if there is any.
    pub(super) noise: Option<u32>,
    /// `[updates, REPORT]`
    pub(super) report: u32,
    /// y − Q(s, a), `[n]`.
    pub(super) errors: u32,
    /// Of an update that leaves the actor alone, of one that does not.
    pub(super) programs: [Vec<Launch>; 2],
}

/// Where a network stands.
#[derive(Clone, Debug)]
pub(super) struct Place {
    pub(super) spans: Vec<Span>,
    activation: Activation,
    pub(super) moved: Moved,
}

/// A matrix `[n, some]` in the arena.
#[derive(Clone, Copy, Debug)]
struct Matrix {
    at: u32,
    ld: u32,
}

/// A network at work on a minibatch: x, y of every layer, δ of every layer.
struct Pass {
    network: Place,
    row: Row,
    x: Matrix,
    y: Vec<Matrix>,
    deltas: Vec<Matrix>,
}

/// Hands out places.
struct Arena(usize);

impl Arena {
    /// Each begins at a multiple of `ALIGNMENT`.
    fn take(&mut self, count: usize) -> u32 {
        let at = self.0.next_multiple_of(ALIGNMENT);
        self.0 = at + count;
        // `Plan::new` refuses an arena that is too large once it has counted all of it. Until then what does not fit
        // stands at 0, so that no place within it leaves u32.
        if self.0 <= caps::DEVICE_NUMBERS { at as u32 } else { 0 }
    }

    fn matrix(&mut self, rows: usize, columns: usize) -> Matrix {
        Matrix { at: self.take(rows * columns), ld: columns as u32 }
    }
}

impl Plan {
    /// For these networks and so many updates at once. Fails if that is more than a device is laid out for; nothing of
    /// the size is allocated here.
    pub(super) fn new(config: &Config, dims: Dims, updates: usize) -> Result<Self, Error> {
        let (n, shapes) = (config.batch_size, Shapes::new(config, dims));
        // A place of 0 stands for none.
        let mut arena = Arena(1);
        let schedule = arena.take(2 * (2 * updates + updates + 1));
        let (rates, taken) = (schedule, schedule + 4 * updates as u32);
        let parts = (n as u32 / PART_ROWS).clamp(1, PARTS);
        let mut place = |widths: &[usize], activation, who: u32, keep: f64| {
            let mut place = Place::new(spans(widths), activation, parts, &mut arena);
            place.moved.rates = rates + who * 2 * updates as u32;
            place.moved.taken = taken + who * (updates as u32 + 1);
            place.moved.keep = keep as f32;
            place
        };
        let keep = kept(config.critic_rate, config.critic_decay);
        let critics: Vec<Place> =
            (0..shapes.critics).map(|_| place(&shapes.critic, Activation::Linear, 0, keep)).collect();
        let actor = place(&shapes.actor, shapes.squash, 1, 1.0);
        let inputs = || (n, dims.observation + dims.action);
        let [own, next, both] = [inputs(), inputs(), inputs()].map(|(n, width)| arena.matrix(n, width));
        let column = |arena: &mut Arena| arena.take(n);
        let mut plan = Self {
            len: 0,
            schedule,
            weights: column(&mut arena),
            noise: (config.smoothing_sigma > 0.0).then(|| arena.take(n * dims.action)),
            report: arena.take(updates * REPORT),
            errors: column(&mut arena),
            programs: [Vec::new(), Vec::new()],
            actor,
            critics,
        };
        let gather = Gather {
            n: n as u32,
            observation: dims.observation as u32,
            action: dims.action as u32,
            inputs: both.at,
            own_inputs: own.at,
            next_inputs: next.at,
            rewards: column(&mut arena),
            discounts: column(&mut arena),
        };
        let work = Work::new(&plan, n, dims.observation as u32, [both, own, next], &mut arena);
        let losses = work.losses(&plan, &gather);
        for (moves_actor, program) in [false, true].into_iter().zip(&mut plan.programs) {
            *program = work.program(&gather, Losses { moves_actor: moves_actor.into(), ..losses }, config);
        }
        plan.len = arena.0;
        if plan.len > caps::DEVICE_NUMBERS {
            return Err(Error::TooLarge { found: plan.len });
        }
        Ok(plan)
    }
}

impl Place {
    /// Its rates, counts and decay are told later.
    fn new(spans: Vec<Span>, activation: Activation, parts: u32, arena: &mut Arena) -> Self {
        let parameters = parameters(&spans);
        let stride = parameters.next_multiple_of(ALIGNMENT);
        let mut moved = Moved {
            rows: arena.take(Row::LASTING.len() * stride),
            parameters: parameters as u32,
            gradient: arena.take(parts as usize * stride),
            parts,
            squares: 0,
            rates: 0,
            taken: 0,
            stride: stride as u32,
            keep: 1.0,
        };
        moved.squares = arena.take(moved.blocks() as usize);
        Self { spans, activation, moved }
    }

    fn layers(&self) -> usize {
        self.spans.len() / 2
    }

    fn activation_of(&self, layer: usize) -> Activation {
        if layer + 1 == self.layers() { self.activation } else { Activation::Relu }
    }

    /// Inputs and outputs of a layer.
    fn widths(&self, layer: usize) -> [u32; 2] {
        [0, 1].map(|i| self.spans[2 * layer].shape[i] as u32)
    }

    /// Place of a layer's weight, `[inputs, outputs]`, and of its bias.
    fn layer(&self, row: Row, layer: usize) -> [u32; 2] {
        let row = self.moved.rows + row as u32 * self.moved.stride;
        [0, 1].map(|i| row + self.spans[2 * layer + i].start as u32)
    }
}

impl Pass {
    fn new(network: &Place, row: Row, x: Matrix, n: usize, arena: &mut Arena) -> Self {
        let mut wide =
            || (0..network.layers()).map(|layer| arena.matrix(n, network.widths(layer)[1] as usize)).collect();
        let y = wide();
        let deltas = if row == Row::Online { wide() } else { Vec::new() };
        Self { network: network.clone(), row, x, y, deltas }
    }

    /// x of a layer.
    fn input(&self, layer: usize) -> Matrix {
        if layer == 0 { self.x } else { self.y[layer - 1] }
    }

    fn last(&self) -> Matrix {
        *self.y.last().expect("a network has a layer")
    }

    /// ∂loss/∂ what the last layer sums up.
    fn last_delta(&self) -> Matrix {
        *self.deltas.last().expect("an online network has a way back")
    }

    fn forward(&self, layer: usize, n: u32, noise: u32) -> Product {
        let ([k, width], [weight, bias]) = (self.network.widths(layer), self.network.layer(self.row, layer));
        let (x, y) = (self.input(layer), self.y[layer]);
        let last = layer + 1 == self.network.layers();
        Product {
            finish: self.network.activation_of(layer),
            x: bias,
            noise: if last { noise } else { 0 },
            ..product(x, Matrix { at: weight, ld: width }, y, [n, width, k])
        }
    }

    /// δ of the layer before.
    fn back(&self, layer: usize, n: u32) -> Product {
        let ([inputs, width], [weight, _]) = (self.network.widths(layer), self.network.layer(self.row, layer));
        let y = self.y[layer - 1];
        let (a, c) = (self.deltas[layer], self.deltas[layer - 1]);
        Product {
            finish: self.network.activation_of(layer - 1),
            x: y.at,
            ldx: y.ld,
            ..product(a, Matrix { at: weight, ld: width }, c, [n, inputs, width])
        }
    }

    /// A layer's part of g.
    fn weight(&self, layer: usize, n: u32) -> Product {
        let ([inputs, width], moved) = (self.network.widths(layer), &self.network.moved);
        let at = moved.gradient + self.network.spans[2 * layer].start as u32;
        let (a, b) = (self.input(layer), self.deltas[layer]);
        Product {
            parts: moved.parts,
            stride: moved.stride,
            ..product(a, b, Matrix { at, ld: width }, [inputs, width, n])
        }
    }
}

fn product(a: Matrix, b: Matrix, c: Matrix, [m, n, k]: [u32; 3]) -> Product {
    let (a, lda, b, ldb, c, ldc) = (a.at, a.ld, b.at, b.ld, c.at, c.ld);
    let finish = Activation::Linear;
    Product { a, lda, b, ldb, c, ldc, m, n, k, finish, x: 0, ldx: 0, noise: 0, parts: 1, stride: 0, unused: 0 }
}

/// Adds launches of independent products.
fn together(program: &mut Vec<Launch>, mode: Mode, products: impl Iterator<Item = Product>) {
    let products: Vec<Product> = products.collect();
    program.extend(products.chunks(PRODUCTS).map(|products| Launch::Products(mode, products.to_vec())));
}

/// All networks at work on a minibatch.
struct Work {
    n: u32,
    observation: u32,
    /// Place of the noise on target actions, or 0.
    noise: u32,
    actor: Pass,
    target_actor: Pass,
    /// On (s, a).
    critics: Vec<Pass>,
    target_critics: Vec<Pass>,
    /// The first critic on (s, π(s)).
    guide: Pass,
}

impl Work {
    /// `inputs` are (s, a), (s, π(s)), (s′, π′(s′)); the actor's answers go straight into the latter two.
    fn new(plan: &Plan, n: usize, observation: u32, inputs: [Matrix; 3], arena: &mut Arena) -> Self {
        let [both, own, next] = inputs;
        let mut pass = |place: &Place, row, x| Pass::new(place, row, x, n, arena);
        let mut actor = pass(&plan.actor, Row::Online, own);
        let mut target_actor = pass(&plan.actor, Row::Target, next);
        for (pass, x) in [(&mut actor, own), (&mut target_actor, next)] {
            *pass.y.last_mut().expect("a network has a layer") = Matrix { at: x.at + observation, ..x };
        }
        Self {
            n: n as u32,
            observation,
            noise: plan.noise.unwrap_or(0),
            actor,
            target_actor,
            critics: plan.critics.iter().map(|critic| pass(critic, Row::Online, both)).collect(),
            target_critics: plan.critics.iter().map(|critic| pass(critic, Row::Target, next)).collect(),
            guide: pass(&plan.critics[0], Row::Online, own),
        }
    }

    fn losses(&self, plan: &Plan, gather: &Gather) -> Losses {
        let of = |passes: &[Pass], place: fn(&Pass) -> Matrix| [0, passes.len() - 1].map(|i| place(&passes[i]).at);
        Losses {
            n: self.n,
            critics: self.critics.len() as u32,
            moves_actor: 0,
            values: of(&self.critics, Pass::last),
            next_values: of(&self.target_critics, Pass::last),
            own_values: self.guide.last().at,
            rewards: gather.rewards,
            discounts: gather.discounts,
            weights: plan.weights,
            slopes: of(&self.critics, Pass::last_delta),
            own_slopes: self.guide.last_delta().at,
            errors: plan.errors,
            report: plan.report,
        }
    }

    fn program(&self, gather: &Gather, losses: Losses, config: &Config) -> Vec<Launch> {
        let (n, moves_actor, layers) = (self.n, losses.moves_actor == 1, self.actor.network.layers());
        let (actor, guide) = (moves_actor.then_some(&self.actor), moves_actor.then_some(&self.guide));
        let mut program = vec![Launch::Gather(*gather)];
        for layer in 0..layers {
            let others = self.critics.iter().chain(actor).map(|pass| pass.forward(layer, n, 0));
            let target = self.target_actor.forward(layer, n, self.noise);
            together(&mut program, Mode::Forward, std::iter::once(target).chain(others));
        }
        for layer in 0..layers {
            let all = self.target_critics.iter().chain(guide);
            together(&mut program, Mode::Forward, all.map(|pass| pass.forward(layer, n, 0)));
        }
        program.push(Launch::Losses(losses));
        for layer in (1..layers).rev() {
            together(&mut program, Mode::Back, self.critics.iter().chain(guide).map(|pass| pass.back(layer, n)));
        }
        if let Some(actor) = actor {
            together(&mut program, Mode::Back, std::iter::once(self.guidance()));
            for layer in (1..layers).rev() {
                together(&mut program, Mode::Back, std::iter::once(actor.back(layer, n)));
            }
        }
        let moving: Vec<&Pass> = self.critics.iter().chain(actor).collect();
        let weights = moving.iter().flat_map(|pass| (0..layers).map(|layer| pass.weight(layer, n)));
        together(&mut program, Mode::Weight, weights);
        let moved: Vec<Moved> = moving.iter().map(|pass| pass.network.moved).collect();
        assert!(moved.len() <= NETWORKS, "{} networks move", moved.len());
        program.push(Launch::Sum(moved.clone()));
        program.push(Launch::Step(Step {
            moved,
            resting: if moves_actor { 0 } else { self.actor.network.moved.taken },
            report: losses.report,
            clip: config.gradient_clip as f32,
            target_rate: moves_actor.then_some(config.target_rate as f32),
        }));
        program
    }

    /// δ of the actor's last layer: the first critic's gradient in the actor's own actions.
    fn guidance(&self) -> Product {
        let critic = &self.guide.network;
        let ([_, width], [weight, _]) = (critic.widths(0), critic.layer(Row::Online, 0));
        let (actions, delta) = (self.actor.last(), self.actor.last_delta());
        let weight = Matrix { at: weight + self.observation * width, ld: width };
        Product {
            finish: self.actor.network.activation,
            x: actions.at,
            ldx: actions.ld,
            ..product(self.guide.deltas[0], weight, delta, [self.n, delta.ld, width])
        }
    }
}
