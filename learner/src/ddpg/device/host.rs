//! The launches of an update on the calling thread, number by number, so that every build can test plans.

use super::super::error::Error;
use super::super::kernels::Activation;
use super::super::optimizer::{BETA_1, BETA_2, EPSILON};
use super::Machine;
use super::launches::{Gather, Launch, Losses, Mode, Moved, PARAMETERS, Product, REPORT, Step};

/// The arena and the replay memory in the host's memory.
#[derive(Debug)]
pub(super) struct Host {
    arena: Vec<f32>,
    memory: Vec<f32>,
    reward_scale: f32,
}

impl Host {
    pub(super) fn new(len: usize, reward_scale: f32) -> Self {
        Self { arena: vec![0.0; len], memory: Vec::new(), reward_scale }
    }

    fn launch(&mut self, launch: &Launch, feed: &[u32]) {
        match launch {
            Launch::Gather(gather) => self.gather(gather, &feed[1..]),
            Launch::Products(mode, products) => products.iter().for_each(|product| self.product(*mode, product)),
            Launch::Losses(losses) => self.losses(losses, feed[0]),
            Launch::Sum(moved) => moved.iter().for_each(|moved| self.sum(moved)),
            Launch::Step(step) => self.step(step, feed[0]),
        }
    }

    fn at(&self, place: u32, offset: u32) -> f32 {
        self.arena[place as usize + offset as usize]
    }

    fn set(&mut self, place: u32, offset: u32, number: f32) {
        self.arena[place as usize + offset as usize] = number;
    }

    fn gather(&mut self, g: &Gather, slots: &[u32]) {
        let (observation, inputs) = (g.observation as usize, g.observation + g.action);
        let width = 2 * observation + g.action as usize + 2;
        for (i, slot) in (0..g.n).zip(slots) {
            let row = self.memory[*slot as usize * width..][..width].to_vec();
            let (seen, rest) = row.split_at(observation);
            let (next, rest) = rest.split_at(observation);
            let (done, rest) = rest.split_at(g.action as usize);
            for (place, first, numbers) in [
                (g.inputs, 0, seen),
                (g.own_inputs, 0, seen),
                (g.next_inputs, 0, next),
                (g.inputs, g.observation, done),
                (g.rewards, 0, &[self.reward_scale * rest[0]]),
                (g.discounts, 0, &rest[1..]),
            ] {
                let ld = if place == g.rewards || place == g.discounts { 1 } else { inputs };
                (first..).zip(numbers).for_each(|(column, number)| self.set(place, i * ld + column, *number));
            }
        }
    }

    fn product(&mut self, mode: Mode, p: &Product) {
        let length = p.k.div_ceil(p.parts);
        for part in 0..p.parts {
            let terms = part * length..p.k.min((part + 1) * length);
            let c = p.c + part * p.stride;
            for m in 0..p.m {
                for n in 0..p.n {
                    let term = |k: u32| match mode {
                        Mode::Forward => self.at(p.a, m * p.lda + k) * self.at(p.b, k * p.ldb + n),
                        Mode::Back => self.at(p.a, m * p.lda + k) * self.at(p.b, n * p.ldb + k),
                        Mode::Weight => self.at(p.a, k * p.lda + m) * self.at(p.b, k * p.ldb + n),
                    };
                    let sum = terms.clone().map(term).sum();
                    let number = self.finish(mode, p, [m, n], sum);
                    self.set(c, m * p.ldc + n, number);
                }
            }
            if mode == Mode::Weight {
                for n in 0..p.n {
                    let sum = terms.clone().map(|k| self.at(p.b, k * p.ldb + n)).sum();
                    self.set(c, p.m * p.n + n, sum);
                }
            }
        }
    }

    fn finish(&self, mode: Mode, p: &Product, [m, n]: [u32; 2], sum: f32) -> f32 {
        match mode {
            Mode::Weight => sum,
            Mode::Back => p.finish.slope(sum, self.at(p.x, m * p.ldx + n)),
            Mode::Forward => {
                let y = activate(p.finish, sum + self.at(p.x, n));
                if p.noise == 0 { y } else { (y + self.at(p.noise, m * p.n + n)).clamp(-1.0, 1.0) }
            }
        }
    }

    fn losses(&mut self, l: &Losses, update: u32) {
        let (n, critics) = (l.n as f32, l.critics as usize);
        let (mut critic, mut value, mut own) = (0.0, 0.0, 0.0);
        for i in 0..l.n {
            let [first, second] = l.next_values.map(|values| self.at(values, i));
            // Without a second critic both are the first. What is not a number stays none.
            let next = if second < first || second.is_nan() { second } else { first };
            let (y, w) = (self.at(l.rewards, i) + self.at(l.discounts, i) * next, self.at(l.weights, i));
            for (values, slopes) in l.values.into_iter().zip(l.slopes).take(critics).rev() {
                let error = y - self.at(values, i);
                critic += w * error * error;
                self.set(slopes, i, -2.0 / n * w * error);
                self.set(l.errors, i, error);
            }
            value += self.at(l.values[0], i);
            if l.moves_actor == 1 {
                own += self.at(l.own_values, i);
                self.set(l.own_slopes, i, -1.0 / n);
            }
        }
        for (place, number) in (0..).zip([critic / (n * l.critics as f32), -own / n, value / n]) {
            self.set(l.report, update * REPORT as u32 + place, number);
        }
    }

    fn sum(&mut self, moved: &Moved) {
        for block in 0..moved.blocks() {
            let mut squares = 0.0;
            for at in block * PARAMETERS..moved.parameters.min((block + 1) * PARAMETERS) {
                let g: f32 = (0..moved.parts).map(|part| self.at(moved.gradient, part * moved.stride + at)).sum();
                self.set(moved.gradient, at, g);
                squares += g * g;
            }
            self.set(moved.squares, block, squares);
        }
    }

    fn step(&mut self, step: &Step, update: u32) {
        let report = step.report + update * REPORT as u32;
        let norm = |moved: &Moved| (0..moved.blocks()).map(|block| self.at(moved.squares, block)).sum::<f32>().sqrt();
        let norms: Vec<f32> = step.moved.iter().map(norm).collect();
        let ok = (0..3).all(|i| self.at(report, i).is_finite()) && norms.iter().all(|norm| norm.is_finite());
        self.set(report, 3, f32::from(u8::from(ok)));
        if step.resting > 0 {
            self.set(step.resting, update + 1, self.at(step.resting, update));
        }
        for (moved, norm) in step.moved.iter().zip(norms) {
            let taken = self.at(moved.taken, update);
            self.set(moved.taken, update + 1, taken + f32::from(u8::from(ok)));
            if ok {
                let [rate, root_scale] = [0, 1].map(|i| self.at(moved.rates, 2 * taken as u32 + i));
                let scale = if step.clip > 0.0 && norm > step.clip { step.clip / norm } else { 1.0 };
                self.adam(moved, [rate, root_scale, scale], step.target_rate);
            }
        }
    }

    fn adam(&mut self, moved: &Moved, [rate, root_scale, scale]: [f32; 3], target_rate: Option<f32>) {
        let (keep_1, take_1) = (BETA_1 as f32, (1.0 - BETA_1) as f32);
        let (keep_2, take_2) = (BETA_2 as f32, (1.0 - BETA_2) as f32);
        for at in 0..moved.parameters {
            let [weight, target, mean, square] = [0, 1, 2, 3].map(|row| moved.rows + row * moved.stride);
            let g = self.at(moved.gradient, at) * scale;
            let m = keep_1 * self.at(mean, at) + take_1 * g;
            let v = keep_2 * self.at(square, at) + take_2 * g * g;
            let w = moved.keep * self.at(weight, at) - rate * m / (v.sqrt() * root_scale + EPSILON);
            let t = self.at(target, at);
            let followed = target_rate.map_or(t, |rate| t + rate * (w - t));
            for (row, number) in [(weight, w), (target, followed), (mean, m), (square, v)] {
                self.set(row, at, number);
            }
        }
    }
}

impl Machine for Host {
    fn write(&mut self, at: u32, numbers: &[f32]) -> Result<(), Error> {
        self.arena[at as usize..][..numbers.len()].copy_from_slice(numbers);
        Ok(())
    }

    fn read(&self, at: u32, count: usize) -> Result<Vec<f32>, Error> {
        Ok(self.arena[at as usize..][..count].to_vec())
    }

    fn make_room(&mut self, numbers: usize) -> Result<(), Error> {
        if self.memory.len() < numbers {
            self.memory = vec![0.0; numbers];
        }
        Ok(())
    }

    fn remember(&mut self, at: usize, numbers: &[f32]) -> Result<(), Error> {
        self.memory[at..][..numbers.len()].copy_from_slice(numbers);
        Ok(())
    }

    fn run(&mut self, _number: usize, program: &[Launch], feed: &[u32]) -> Result<(), Error> {
        for launch in program {
            self.launch(launch, feed);
        }
        Ok(())
    }
}

fn activate(activation: Activation, sum: f32) -> f32 {
    match activation {
        Activation::Relu if sum < 0.0 => 0.0,
        Activation::Linear | Activation::Relu => sum,
        Activation::Tanh | Activation::OpenTanh => sum.tanh(),
    }
}
