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
        (0..self.columns.div_ceil(WIDTH)).map(move |strip| self.strip(strip))
    }

    /// The strip of this number.
    pub(super) fn strip(self, strip: usize) -> Self {
        let columns = WIDTH.min(self.columns - strip * WIDTH);
        Self { pieces: &self.pieces[strip * self.rows..][..self.rows], rows: self.rows, columns }
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
        self.view().strip(strip)
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
        self.set_part(row, 0, numbers);
    }

    /// Replaces a row's numbers from this column on.
    pub(super) fn set_part(&mut self, row: usize, mut column: usize, mut numbers: &[f32]) {
        let end = column + numbers.len();
        assert!(end <= self.columns, "numbers up to the {end}th for a row of {}", self.columns);
        while !numbers.is_empty() {
            let piece = &mut self.pieces[column / WIDTH * self.rows + row].0[column % WIDTH..];
            let (here, rest) = numbers.split_at(piece.len().min(numbers.len()));
            piece[..here.len()].copy_from_slice(here);
            (column, numbers) = (column + here.len(), rest);
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

/// `to ← fromᵀ`; beyond its last column stands 0.
pub(super) fn turn(to: &mut Strips, from: &Strips) {
    assert_eq!((to.rows, to.columns), (from.columns, from.rows), "the shape of a matrix turned over");
    for strip in 0..to.columns.div_ceil(WIDTH) {
        turn_strip(to.strip_mut(strip), from, strip);
    }
}

/// `to ←` a strip of `fromᵀ`; beyond its last column stands 0.
pub(super) fn turn_strip<'a>(to: &'a mut [Piece], from: &Strips, strip: usize) -> Matrix<'a> {
    let columns = WIDTH.min(from.rows - strip * WIDTH);
    for (to, from) in to.chunks_mut(WIDTH).zip(from.pieces.chunks_exact(from.rows)) {
        turn_block(to, &from[strip * WIDTH..][..columns]);
    }
    Matrix::new(to, from.columns, columns)
}

/// Up to 32 rows and columns.
fn turn_block(to: &mut [Piece], from: &[Piece]) {
    if from.len() < WIDTH {
        to.fill(Piece::ZERO);
    }
    let (rows, columns) = (from.len() - from.len() % SQUARE, to.len() - to.len() % SQUARE);
    for row in (0..rows).step_by(SQUARE) {
        let from: &[Piece; SQUARE] = from[row..].first_chunk().expect("SQUARE rows are left");
        for column in (0..columns).step_by(SQUARE) {
            let to: &mut [Piece; SQUARE] = to[column..].first_chunk_mut().expect("SQUARE columns are left");
            let square = turn_square([
                part(&from[0], column),
                part(&from[1], column),
                part(&from[2], column),
                part(&from[3], column),
            ]);
            for i in 0..SQUARE {
                *to[i].0[row..].first_chunk_mut().expect("SQUARE divides WIDTH") = square[i];
            }
        }
    }
    for row in 0..from.len() {
        let beside_squares = if row < rows { columns } else { 0 };
        for column in beside_squares..to.len() {
            to[column].0[row] = from[row].0[column];
        }
    }
}

/// Rows and columns that are turned over within registers.
const SQUARE: usize = 4;

/// A row of a square.
#[inline(always)]
fn part(piece: &Piece, column: usize) -> [f32; SQUARE] {
    *piece.0[column..].first_chunk().expect("SQUARE divides WIDTH")
}

/// A square turned over. Left to itself the compiler gathers number by number, which takes longer than the shuffles.
#[cfg(target_arch = "x86_64")]
#[inline(always)]
fn turn_square(rows: [[f32; SQUARE]; SQUARE]) -> [[f32; SQUARE]; SQUARE] {
    let sse = pulp::core_arch::x86::Sse::try_new().expect("every x86-64 CPU has SSE");
    let [a, b, c, d]: [std::arch::x86_64::__m128; SQUARE] = pulp::bytemuck::cast(rows);
    let (low, next_low) = (sse._mm_unpacklo_ps(a, b), sse._mm_unpacklo_ps(c, d));
    let (high, next_high) = (sse._mm_unpackhi_ps(a, b), sse._mm_unpackhi_ps(c, d));
    pulp::bytemuck::cast([
        sse._mm_movelh_ps(low, next_low),
        sse._mm_movehl_ps(next_low, low),
        sse._mm_movelh_ps(high, next_high),
        sse._mm_movehl_ps(next_high, high),
    ])
}

/// A square turned over.
#[inline(always)]
#[cfg(not(target_arch = "x86_64"))]
fn turn_square(rows: [[f32; SQUARE]; SQUARE]) -> [[f32; SQUARE]; SQUARE] {
    std::array::from_fn(|i| std::array::from_fn(|j| rows[j][i]))
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
        matrix.set_part(2, 30, &numbers[..40]);
        assert_eq!((matrix.row(2)[..30].to_vec(), &matrix.row(2)[30..]), (vec![0.0; 30], &numbers[..40]));
        matrix.set_part(2, 0, &[0.0; 70]);
        let mut other = Strips::new(5, 70);
        other.set_rows(3, &matrix, 1..3);
        assert_eq!((other.row(3), other.row(4), other.row(2)), (numbers, vec![0.0; 70], vec![0.0; 70]));
    }

    #[test]
    fn a_matrix_turned_over() {
        for (rows, columns) in [(1, 1), (32, 32), (64, 96), (40, 33), (5, 70), (31, 64)] {
            let matrix = random((rows, columns), 1);
            let mut turned = Strips::new(columns, rows);
            turned.pieces_mut().fill(Piece([f32::NAN; WIDTH]));
            turn(&mut turned, &matrix);
            let turned = turned.view();
            for row in 0..rows.next_multiple_of(WIDTH) {
                for column in 0..columns {
                    let expected = if row < rows { matrix.view().at(row, column) } else { 0.0 };
                    assert_eq!(turned.at(column, row), expected);
                }
            }
        }
    }
}
