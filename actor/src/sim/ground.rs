//! The shape of the ground as a function: height and normal over any point, without rapier.
//!
//! | symbol | name                                                            | unit |
//! |--------|-----------------------------------------------------------------|------|
//! | a      | slope, uphill along +x                                          | rad  |
//! | b(x, y)| bumps: random heights on a grid, triangles between them         | m    |
//! | s(x)   | steps: 0 around the start, then up and down by turns, both ways | m    |
//!
//! `z = x tan a + max(b(x, y), s(x))`: where there are both, the higher one counts, as it does for solids that overlap.
//! Bumps and steps reach `REACH_X` and `REACH_Y` from the start; beyond, the slope goes on bare.

use herd_common::seed::Seed;
use nalgebra::Vector3;
use rand::RngExt;

/// Distance from the start at which bumps and steps end, m: no robot comes further in the default episode of 10 s.
pub(super) const REACH_X: f64 = 30.0;
/// The same to either side, m.
pub(super) const REACH_Y: f64 = 4.0;
/// Edge of a cell of the grid of bumps, m: about the length of a stride.
pub(super) const CELL: f64 = 0.1;
/// Rows of the grid along y and columns along x, vertices counted.
pub(super) const ROWS: usize = (2.0 * REACH_Y / CELL) as usize + 1;
pub(super) const COLUMNS: usize = (2.0 * REACH_X / CELL) as usize + 1;
/// Distance from one edge of the steps to the next, m.
pub(super) const TREAD: f64 = 0.5;
/// Where the first edge may lie, m from the start: ahead of the feet of a standing robot, anywhere within a few strides.
const FIRST_EDGE: [f64; 2] = [0.3, 0.6];

/// The ground of one episode.
#[derive(Clone, Debug, PartialEq)]
pub struct Ground {
    /// Uphill along +x, rad.
    slope_rad: f64,
    /// Heights of the grid (m), column by column, each from +y to −y; none on even ground.
    bumps: Option<Vec<f32>>,
    steps: Option<Steps>,
}

/// Steps up and down.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Steps {
    /// m
    pub(super) height: f64,
    /// |x| of the first edge, m.
    pub(super) first_edge: f64,
}

impl Ground {
    /// Level and even.
    pub fn level() -> Self {
        Self { slope_rad: 0.0, bumps: None, steps: None }
    }

    /// Ground of this slope with bumps up to `bump` and steps of `step` metres, placed by `seed`.
    pub fn new(slope_rad: f64, bump: f64, step: f64, seed: Seed) -> Self {
        let bumps = (bump > 0.0).then(|| {
            let mut rng = seed.child("bumps", 0).rng();
            let mut height = |row: usize, column: usize| {
                let rim = row == 0 || row == ROWS - 1 || column == 0 || column == COLUMNS - 1;
                if rim { 0.0 } else { rng.random_range(0.0..=bump as f32) }
            };
            (0..COLUMNS).flat_map(|column| (0..ROWS).map(move |row| (row, column))).map(|(r, c)| height(r, c)).collect()
        });
        let [near, far] = FIRST_EDGE;
        let edge = || near + (far - near) * seed.child("steps", 0).rng().random::<f64>();
        let steps = (step > 0.0).then(|| Steps { height: step, first_edge: edge() });
        Self { slope_rad, bumps, steps }
    }

    /// Angle of the slope, uphill along +x, rad.
    pub fn slope_rad(&self) -> f64 {
        self.slope_rad
    }

    /// Height over a point, world, m.
    pub fn height(&self, x: f64, y: f64) -> f64 {
        x * self.slope_rad.tan() + self.bump(x, y)[0].max(self.step(x, y))
    }

    /// Unit normal over a point, upwards, world. The walls of steps have no area seen from above, so they have none.
    pub fn normal(&self, x: f64, y: f64) -> Vector3<f64> {
        let [bump, along_x, along_y] = self.bump(x, y);
        let (along_x, along_y) = if bump > self.step(x, y) { (along_x, along_y) } else { (0.0, 0.0) };
        Vector3::new(-self.slope_rad.tan() - along_x, -along_y, 1.0).normalize()
    }

    pub(super) fn bumps(&self) -> Option<&[f32]> {
        self.bumps.as_deref()
    }

    pub(super) fn steps(&self) -> Option<Steps> {
        self.steps
    }

    /// b with its derivatives along x and y.
    fn bump(&self, x: f64, y: f64) -> [f64; 3] {
        let (column, row) = ((x + REACH_X) / CELL, (REACH_Y - y) / CELL);
        let within = column >= 0.0 && row >= 0.0 && column < (COLUMNS - 1) as f64 && row < (ROWS - 1) as f64;
        let Some(heights) = self.bumps.as_ref().filter(|_| within) else {
            return [0.0; 3];
        };
        let (j, i) = (column as usize, row as usize);
        let (u, v) = (column - j as f64, row - i as f64);
        let at = |i: usize, j: usize| f64::from(heights[j * ROWS + i]);
        // A cell is cut in two by the diagonal from (i + 1, j) to (i, j + 1).
        let (near, along_u, along_v) = if u + v <= 1.0 {
            (at(i, j), at(i, j + 1) - at(i, j), at(i + 1, j) - at(i, j))
        } else {
            let far = at(i + 1, j + 1);
            let (along_u, along_v) = (far - at(i + 1, j), far - at(i, j + 1));
            (far - along_u - along_v, along_u, along_v)
        };
        [near + along_u * u + along_v * v, along_u / CELL, -along_v / CELL]
    }

    fn step(&self, x: f64, y: f64) -> f64 {
        let Some(steps) = self.steps.filter(|_| y.abs() <= REACH_Y && x.abs() <= REACH_X) else {
            return 0.0;
        };
        let treads = (x.abs() - steps.first_edge) / TREAD;
        if treads >= 0.0 && (treads as u64).is_multiple_of(2) { steps.height } else { 0.0 }
    }
}

impl Steps {
    /// The raised treads ahead, from and to which x, m; as many lie behind.
    pub(super) fn raised(self) -> impl Iterator<Item = (f64, f64)> {
        let begins = (0..).map(move |n| self.first_edge + 2.0 * TREAD * f64::from(n));
        begins.take_while(|begin| *begin < REACH_X).map(|begin| (begin, (begin + TREAD).min(REACH_X)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ground(slope: f64, bump: f64, step: f64) -> Ground {
        Ground::new(slope, bump, step, Seed::from_number(3))
    }

    #[test]
    fn a_slope_rises_along_x() {
        let ground = ground(0.2, 0.0, 0.0);
        assert!((ground.height(2.0, -1.0) - 2.0 * 0.2_f64.tan()).abs() < 1e-12);
        assert!((ground.normal(2.0, -1.0) - Vector3::new(-0.2_f64.sin(), 0.0, 0.2_f64.cos())).norm() < 1e-12);
    }

    #[test]
    fn normals_are_those_of_the_heights() {
        const STEP: f64 = 1e-6;
        let ground = ground(0.1, 0.02, 0.0);
        for n in 0..200 {
            let (x, y) = (f64::from(n) * 0.0371 - 3.003, f64::from(n) * 0.013_71 - 1.507);
            let along_x = (ground.height(x + STEP, y) - ground.height(x - STEP, y)) / (2.0 * STEP);
            let along_y = (ground.height(x, y + STEP) - ground.height(x, y - STEP)) / (2.0 * STEP);
            let expected = Vector3::new(-along_x, -along_y, 1.0).normalize();
            assert!((ground.normal(x, y) - expected).norm() < 1e-6, "at {x}, {y}");
        }
    }

    #[test]
    fn bumps_fill_their_range_are_continuous_and_end() {
        let ground = ground(0.0, 0.02, 0.0);
        let heights: Vec<f64> = (0..20_000).map(|n| ground.height(f64::from(n) * 1e-3 - 10.0, 0.33)).collect();
        let (low, high) = heights.iter().fold((1.0_f64, 0.0_f64), |(low, high), h| (low.min(*h), high.max(*h)));
        assert!((0.0..0.002).contains(&low) && (0.018..=0.02).contains(&high), "{low} {high}");
        // 2 cm over a cell of 10 cm is the steepest that there can be.
        assert!(heights.windows(2).all(|pair| (pair[1] - pair[0]).abs() <= 0.2 * 1e-3 + 1e-9));
        assert_eq!(ground.height(REACH_X + 0.01, 0.0), 0.0);
        assert_ne!(Ground::new(0.0, 0.02, 0.0, Seed::from_number(4)), ground);
    }

    #[test]
    fn steps_go_up_and_down_both_ways() {
        let ground = ground(0.0, 0.0, 0.03);
        assert_eq!(ground.height(0.0, 0.0), 0.0);
        let steps = ground.steps().expect("has steps");
        for (from, to) in steps.raised() {
            for x in [from, -from, to, -to] {
                let (inside, outside) = (x.signum() * 1e-6, x.signum() * -1e-6);
                let up = if x.abs() == from { [0.0, 0.03] } else { [0.03, 0.0] };
                assert_eq!([ground.height(x + outside, 0.5), ground.height(x + inside, 0.5)], up, "at {x}");
            }
        }
        assert_eq!(steps.raised().count(), 30);
    }
}
