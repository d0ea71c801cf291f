//! Matrices in strips of 32 columns, the order in which a product reads and writes them: nothing is packed on the way.
//!
//! | symbol | name | shape |
//! |---|---|---|
//! | piece | 32 numbers of a row, side by side: two lines of cache | `[WIDTH]` |
//! | strip | the pieces of all rows in the same 32 columns, first row first | `[rows, WIDTH]` |
//! | matrix | strips, leftmost first; what is beyond the last column becomes no number of a product | `[rows, columns]` |

#![expect(clippy::inline_always, reason = "vector code must be inlined into the function that has the features")]
#![expect(clippy::needless_range_loop, reason = "iterators are not inlined where there is much code around them")]

use std::ops::Range;

/// Columns of a strip: as many numbers as two of the widest registers hold.
pub(super) const WIDTH: usize = 32;

/// A row's numbers within one strip.
#[derive(Clone, Copy, Debug)]
#[repr(align(128))]
pub(super) struct Piece(pub(super) [f32; WIDTH]);

impl Piece {
    /// All zeros.
    pub(super) const ZERO: Self = Self([0.0; WIDTH]);
}

/// Pieces of a matrix of this shape.
pub(super) fn pieces(rows: usize, columns: usize) -> usize {
    rows * columns.div_ceil(WIDTH)
}

/// A view of a matrix.
#[derive(Clone, Copy, Debug)]
pub(super) struct Matrix<'a> {
    pub(super) pieces: &'a [Piece],
    pub(super) rows: usize,
    pub(super) columns: usize,
}

impl<'a> Matrix<'a> {
    /// True if what is beyond the last column is 0.
    pub(super) fn is_padded_with_zeros(&self) -> bool {
        let used = (self.columns + WIDTH - 1) % WIDTH + 1;
        let last = self.pieces.iter().rev().take(self.rows);
        last.flat_map(|piece| &piece.0[used..]).all(|number| *number == 0.0)
    }

    /// A view of these pieces, of which there are as many as the shape asks for.
    pub(super) fn new(numbers: &'a [Piece], rows: usize, columns: usize) -> Self {
        assert_eq!(numbers.len(), pieces(rows, columns), "pieces of a matrix [{rows}, {columns}]");
        Self { pieces: numbers, rows, columns }
    }

    /// The strips, each of them a matrix of its own.
    pub(super) fn strips(self) -> impl Iterator<Item = Self> {
        let columns = (1..=self.columns).rev().step_by(WIDTH).map(|left| left.min(WIDTH));
        let strips = self.pieces.chunks_exact(self.rows).zip(columns);
        strips.map(move |(pieces, columns)| Self { pieces, rows: self.rows, columns })
    }

    /// The number in this row and column.
    pub(super) fn at(&self, row: usize, column: usize) -> f32 {
        self.pieces[column / WIDTH * self.rows + row].0[column % WIDTH]
    }
}

/// A matrix that owns its numbers.
#[derive(Clone, Debug)]
pub(super) struct Strips {
    rows: usize,
    columns: usize,
    pieces: Vec<Piece>,
}

impl Strips {
    /// All zeros.
    pub(super) fn new(rows: usize, columns: usize) -> Self {
        Self { rows, columns, pieces: vec![Piece::ZERO; pieces(rows, columns)] }
    }

    /// Rows.
    pub(super) fn rows(&self) -> usize {
        self.rows
    }

    /// Columns.
    pub(super) fn columns(&self) -> usize {
        self.columns
    }

    /// All of it.
    pub(super) fn view(&self) -> Matrix<'_> {
        Matrix { pieces: &self.pieces, rows: self.rows, columns: self.columns }
    }

    /// The strip of this number.
    pub(super) fn strip(&self, strip: usize) -> Matrix<'_> {
        let columns = WIDTH.min(self.columns - strip * WIDTH);
        Matrix { pieces: &self.pieces[strip * self.rows..][..self.rows], rows: self.rows, columns }
    }

    /// The pieces of a strip, to be written.
    pub(super) fn strip_mut(&mut self, strip: usize) -> &mut [Piece] {
        &mut self.pieces[strip * self.rows..][..self.rows]
    }

    /// All pieces, to be written.
    pub(super) fn pieces_mut(&mut self) -> &mut [Piece] {
        &mut self.pieces
    }

    /// The numbers of a row.
    pub(super) fn row(&self, row: usize) -> Vec<f32> {
        let numbers = self.pieces.iter().skip(row).step_by(self.rows).flat_map(|piece| piece.0);
        numbers.take(self.columns).collect()
    }

    /// Replaces a row's first numbers.
    pub(super) fn set_row(&mut self, row: usize, numbers: &[f32]) {
        assert!(numbers.len() <= self.columns, "{} numbers for a row of {}", numbers.len(), self.columns);
        for (strip, numbers) in self.pieces.chunks_exact_mut(self.rows).zip(numbers.chunks(WIDTH)) {
            strip[row].0[..numbers.len()].copy_from_slice(numbers);
        }
    }

    /// Replaces the rows from `first` on by these rows of `source`, which has as many columns.
    pub(super) fn set_rows(&mut self, first: usize, source: &Self, rows: Range<usize>) {
        assert_eq!(self.columns, source.columns, "columns of rows that are copied");
        let strips = self.pieces.chunks_exact_mut(self.rows).zip(source.pieces.chunks_exact(source.rows));
        for (to, from) in strips {
            to[first..][..rows.len()].copy_from_slice(&from[rows.clone()]);
        }
    }
}

/// `to ← fromᵀ`, the first pieces of `to`; beyond its last column stands 0.
pub(super) fn turn<'a>(to: &'a mut [Piece], from: &Strips) -> Matrix<'a> {
    let (rows, columns) = (from.columns, from.rows);
    let to = &mut to[..pieces(rows, columns)];
    pulp::Arch::new().dispatch(|| {
        for (s, strip) in from.pieces.chunks_exact(from.rows).enumerate() {
            let width = WIDTH.min(rows - s * WIDTH);
            for (i, block) in strip.chunks(WIDTH).enumerate() {
                turn_block(&mut to[i * rows + s * WIDTH..][..width], block);
            }
        }
    });
    Matrix { pieces: to, rows, columns }
}

/// Rows that are turned over together: they make a register of each column.
const GROUP: usize = 16;

/// Up to 32 rows and columns.
#[inline(always)]
fn turn_block(to: &mut [Piece], from: &[Piece]) {
    if let (Some(to), Some(from)) = (to.first_chunk_mut::<WIDTH>(), from.first_chunk::<WIDTH>()) {
        for first in (0..WIDTH).step_by(GROUP) {
            let rows: &[Piece; GROUP] = from[first..].first_chunk().expect("GROUP divides WIDTH");
            for column in 0..WIDTH {
                let group: &mut [f32; GROUP] = to[column].0[first..].first_chunk_mut().expect("GROUP divides WIDTH");
                for i in 0..GROUP {
                    group[i] = rows[i].0[column];
                }
            }
        }
        return;
    }
    to.fill(Piece::ZERO);
    for (row, from) in from.iter().enumerate() {
        for (to, number) in to.iter_mut().zip(from.0) {
            to.0[row] = number;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::networks::tests::random;
    use super::*;

    #[test]
    fn rows_and_numbers_are_where_they_were_put() {
        let mut matrix = Strips::new(3, 70);
        let numbers: Vec<f32> = (0..70_u8).map(f32::from).collect();
        matrix.set_row(1, &numbers);
        assert_eq!(matrix.row(1), numbers);
        assert_eq!((matrix.view().at(1, 69), matrix.view().at(2, 69)), (69.0, 0.0));
        let mut other = Strips::new(5, 70);
        other.set_rows(3, &matrix, 1..3);
        assert_eq!((other.row(3), other.row(4), other.row(2)), (numbers, vec![0.0; 70], vec![0.0; 70]));
    }

    #[test]
    fn a_matrix_turned_over() {
        for (rows, columns) in [(1, 1), (32, 32), (64, 96), (40, 33), (5, 70), (31, 64)] {
            let matrix = random((rows, columns), 1);
            let mut room = vec![Piece([f32::NAN; WIDTH]); pieces(columns, rows) + 1];
            let turned = turn(&mut room, &matrix);
            assert_eq!((turned.rows, turned.columns), (columns, rows));
            for row in 0..rows.next_multiple_of(WIDTH) {
                for column in 0..columns {
                    let expected = if row < rows { matrix.view().at(row, column) } else { 0.0 };
                    assert_eq!(turned.at(column, row), expected);
                }
            }
        }
    }
}
