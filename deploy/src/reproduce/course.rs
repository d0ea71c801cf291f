//! How far the whole is: which step of how many, and about how long it still takes.

use crate::table::duration;

/// The steps of a reproduction with the time that each is expected to take on two cores, s; 0 for one that is done.
#[derive(Debug)]
pub(super) struct Course {
    expected: Vec<f64>,
}

impl Course {
    /// A course of these steps.
    pub(super) fn new(expected: Vec<f64>) -> Self {
        Self { expected }
    }

    /// Time still needed before step `index` begins, after `elapsed` s: what is left as expected, but as fast as what is
    /// over went.
    pub(super) fn remaining_secs(&self, index: usize, elapsed: f64) -> f64 {
        let (over, left) = self.expected.split_at(index.min(self.expected.len()));
        let (over, left) = (over.iter().sum::<f64>(), left.iter().sum::<f64>());
        if over > 0.0 { left * elapsed / over } else { left }
    }

    /// The line that announces step `index`.
    pub(super) fn headline(&self, index: usize, name: &str, elapsed: f64) -> String {
        let (n, left) = (self.expected.len(), duration(self.remaining_secs(index, elapsed)));
        let state = if self.expected[index] > 0.0 { format!("about {left} to go") } else { "done before".to_owned() };
        format!("[{}/{n}] {name} · {state}", index + 1)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_left_goes_as_fast_as_what_is_over() {
        let course = Course::new(vec![0.0, 100.0, 100.0, 50.0]);
        assert_eq!(course.remaining_secs(0, 0.0), 250.0);
        assert_eq!(course.remaining_secs(1, 0.1), 250.0, "nothing was done yet that tells");
        assert_eq!(course.remaining_secs(2, 50.0), 75.0, "twice as fast as expected");
        assert_eq!(course.remaining_secs(4, 60.0), 0.0);
        assert_eq!(course.headline(0, "gait, seed 1", 0.0), "[1/4] gait, seed 1 · done before");
        assert_eq!(course.headline(2, "gait, seed 3", 50.0), "[3/4] gait, seed 3 · about 1 min 15 s to go");
    }
}
