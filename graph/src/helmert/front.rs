//! Dense elimination of one block: partial Cholesky of its front.
//!
//! A front is three pieces: the square of the own scalars, the panel below it (boundary rows, own columns), and the
//! square of the boundary; of the squares the lower triangle is used. What is kept of a block is its panel: the packed
//! triangle of the own square, column by column, then the panel below. Small fronts are eliminated by plain loops,
//! large ones by the library's kernels.

use faer::dyn_stack::{MemBuffer, MemStack};
use faer::linalg::cholesky::llt::factor::{LltParams, LltRegularization, cholesky_in_place, cholesky_in_place_scratch};
use faer::linalg::matmul::matmul;
use faer::linalg::matmul::triangular::{self, BlockStructure};
use faer::linalg::triangular_solve::solve_lower_triangular_in_place;
use faer::reborrow::{Reborrow, ReborrowMut};
use faer::{Accum, Auto, Mat, MatMut, MatRef, Par, Spec};

use super::block::{PACKED_FROM, column_base};

/// Own scalars up to which the plain loops are faster.
const SMALL: usize = 8;

/// Numbers of a packed triangle.
#[must_use]
pub fn triangle(own: usize) -> usize {
    own * (own + 1) / 2
}

/// Eliminates the own columns of a front with `own` and `boundary` scalars.
///
/// `top`: `own²`, becomes `L₁₁`; `low`: `boundary × own`, becomes `L₂₁`; `square`: of the boundary as
/// [`super::block::Update`] has it, less `L₂₁ L₂₁ᵀ` afterwards. All column by column.
///
/// # Errors
/// The own column whose pivot is not positive.
pub fn eliminate(
    top: &mut [f64],
    low: &mut [f64],
    square: &mut [f64],
    own: usize,
    boundary: usize,
) -> Result<(), usize> {
    if own == 0 {
        return Ok(());
    }
    if own <= SMALL {
        return eliminate_small(top, low, square, own, boundary);
    }
    let mut top = MatMut::from_column_major_slice_mut(top, own, own);
    let params: Spec<LltParams, f64> = Spec::new(<LltParams as Auto<f64>>::auto());
    let mut memory = MemBuffer::new(cholesky_in_place_scratch::<f64>(own, Par::Seq, params));
    let none = LltRegularization { dynamic_regularization_delta: 0.0, dynamic_regularization_epsilon: 0.0 };
    cholesky_in_place(top.rb_mut(), none, Par::Seq, MemStack::new(&mut memory), params).map_err(|e| match e {
        faer::linalg::cholesky::llt::factor::LltError::NonPositivePivot { index } => index,
    })?;
    if boundary > 0 {
        let mut low = MatMut::from_column_major_slice_mut(low, boundary, own);
        solve_lower_triangular_in_place(top.rb(), low.rb_mut().transpose_mut(), Par::Seq);
        if boundary > PACKED_FROM {
            subtract_packed(low.rb(), square);
            return Ok(());
        }
        triangular::matmul(
            MatMut::from_column_major_slice_mut(square, boundary, boundary),
            BlockStructure::TriangularLower,
            Accum::Add,
            low.rb(),
            BlockStructure::Rectangular,
            low.rb().transpose(),
            BlockStructure::Rectangular,
            -1.0,
            Par::Seq,
        );
    }
    Ok(())
}

fn eliminate_small(
    top: &mut [f64],
    low: &mut [f64],
    square: &mut [f64],
    own: usize,
    boundary: usize,
) -> Result<(), usize> {
    for j in 0..own {
        let (done, rest) = top.split_at_mut(j * own);
        let column = &mut rest[j..own];
        for previous in done.chunks_exact(own) {
            let factor = previous[j];
            column.iter_mut().zip(&previous[j..]).for_each(|(c, p)| *c -= factor * p);
        }
        let pivot = column[0];
        // also catches what is not a number
        if pivot.is_nan() || pivot <= 0.0 {
            return Err(j);
        }
        let root = pivot.sqrt();
        let inverse = 1.0 / root;
        column.iter_mut().for_each(|c| *c *= inverse);
        column[0] = root;
        let (low_done, low_rest) = low.split_at_mut(j * boundary);
        let low_column = &mut low_rest[..boundary];
        for (k, previous) in low_done.chunks_exact(boundary.max(1)).enumerate() {
            let factor = done[k * own + j];
            low_column.iter_mut().zip(previous).for_each(|(c, p)| *c -= factor * p);
        }
        low_column.iter_mut().for_each(|c| *c *= inverse);
    }
    for column in low.chunks_exact(boundary.max(1)) {
        for c in 0..boundary {
            let factor = column[c];
            let start = column_base(boundary, c);
            let target = &mut square[start + c..start + boundary];
            target.iter_mut().zip(&column[c..]).for_each(|(t, l)| *t -= factor * l);
        }
    }
    Ok(())
}

/// Columns of a strip of the packed square.
const STRIP: usize = 96;

/// Takes `L₂₁ L₂₁ᵀ` off a packed triangle, strip by strip.
fn subtract_packed(low: MatRef<'_, f64>, packed: &mut [f64]) {
    let boundary = low.nrows();
    let mut scratch = vec![0.0; boundary * STRIP];
    let mut first = 0;
    while first < boundary {
        let (width, rows) = (STRIP.min(boundary - first), boundary - first);
        let mut strip = MatMut::from_column_major_slice_mut(&mut scratch[..rows * width], rows, width);
        let left = low.subrows(first, rows);
        let right = low.subrows(first, width);
        matmul(strip.rb_mut(), Accum::Replace, left, right.transpose(), 1.0, Par::Seq);
        for c in 0..width {
            let start = column_base(boundary, first + c);
            let target = &mut packed[start + first + c..start + boundary];
            let source = &scratch[c * rows + c..(c + 1) * rows];
            target.iter_mut().zip(source).for_each(|(t, s)| *t -= s);
        }
        first += width;
    }
}

/// Packs the lower triangle of a square.
pub fn pack(top: &[f64], own: usize, packed: &mut [f64]) {
    let mut next = 0;
    for c in 0..own {
        packed[next..next + own - c].copy_from_slice(&top[c * own + c..(c + 1) * own]);
        next += own - c;
    }
}

/// Forward substitution with a panel: solves the own part, takes its share off the boundary part.
pub fn forward(panel: &[f64], own: usize, boundary: usize, own_right: &mut [f64], boundary_right: &mut [f64]) {
    let (top, low) = panel.split_at(triangle(own));
    let mut next = 0;
    for j in 0..own {
        let column = &top[next..next + own - j];
        next += own - j;
        let value = own_right[j] / column[0];
        own_right[j] = value;
        own_right[j + 1..].iter_mut().zip(&column[1..]).for_each(|(r, l)| *r -= value * l);
        let column = &low[j * boundary..(j + 1) * boundary];
        boundary_right.iter_mut().zip(column).for_each(|(r, l)| *r -= value * l);
    }
}

/// Backward substitution with a panel: solves the own part with the boundary's solution.
pub fn backward(panel: &[f64], own: usize, boundary: usize, own_part: &mut [f64], boundary_part: &[f64]) {
    let (top, low) = panel.split_at(triangle(own));
    let mut next = triangle(own);
    for j in (0..own).rev() {
        next -= own - j;
        let column = &top[next..next + own - j];
        let sum = dot(&low[j * boundary..(j + 1) * boundary], boundary_part) + dot(&column[1..], &own_part[j + 1..own]);
        own_part[j] = (own_part[j] - sum) / column[0];
    }
}

/// Scalar product in eight lanes, in a fixed order.
fn dot(a: &[f64], b: &[f64]) -> f64 {
    let mut lanes = [0.0; 8];
    let n = a.len().min(b.len());
    let (a, b) = (&a[..n], &b[..n]);
    let (chunks_a, chunks_b) = (a.chunks_exact(8), b.chunks_exact(8));
    let mut sum: f64 = chunks_a.remainder().iter().zip(chunks_b.remainder()).map(|(x, y)| x * y).sum();
    for (x, y) in chunks_a.zip(chunks_b) {
        for k in 0..8 {
            lanes[k] += x[k] * y[k];
        }
    }
    sum += lanes.iter().sum::<f64>();
    sum
}

/// The own triangle of a panel as a square with zeros above.
#[must_use]
pub fn own_square(panel: &[f64], own: usize) -> Mat<f64> {
    let mut square = Mat::zeros(own, own);
    let mut next = 0;
    for c in 0..own {
        for r in c..own {
            square[(r, c)] = panel[next];
            next += 1;
        }
    }
    square
}

/// A view of a panel below its own square.
#[must_use]
pub fn below(panel: &[f64], own: usize, boundary: usize) -> MatRef<'_, f64> {
    MatRef::from_column_major_slice(&panel[triangle(own)..], boundary, own)
}
