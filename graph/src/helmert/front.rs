//! Dense elimination of one block: partial Cholesky of its front.
//!
//! A front is two pieces: the panel (own columns, all rows) and the square of the boundary, of which the lower
//! triangle is used. Small fronts are eliminated by plain loops, large ones by the library's kernels.

use faer::dyn_stack::{MemBuffer, MemStack};
use faer::linalg::cholesky::llt::factor::{LltParams, LltRegularization, cholesky_in_place, cholesky_in_place_scratch};
use faer::linalg::matmul::triangular::{self, BlockStructure};
use faer::linalg::triangular_solve::solve_lower_triangular_in_place;
use faer::reborrow::{Reborrow, ReborrowMut};
use faer::{Accum, Auto, MatMut, MatRef, Par, Spec};

/// Own scalars up to which the plain loops are faster.
const SMALL: usize = 8;

/// Eliminates the own columns of a front.
///
/// `panel`: `rows × own`, column by column; `square`: `(rows - own)²`, lower triangle, less `L₂₁ L₂₁ᵀ` afterwards.
///
/// # Errors
/// The own column whose pivot is not positive.
pub fn eliminate(panel: &mut [f64], square: &mut [f64], rows: usize, own: usize, par: Par) -> Result<(), usize> {
    if own == 0 {
        return Ok(());
    }
    if own <= SMALL {
        return eliminate_small(panel, square, rows, own);
    }
    let boundary = rows - own;
    let whole = MatMut::from_column_major_slice_mut(panel, rows, own);
    let (mut top, mut bottom) = whole.split_at_row_mut(own);
    let params: Spec<LltParams, f64> = Spec::new(<LltParams as Auto<f64>>::auto());
    let mut memory = MemBuffer::new(cholesky_in_place_scratch::<f64>(own, par, params));
    let none = LltRegularization { dynamic_regularization_delta: 0.0, dynamic_regularization_epsilon: 0.0 };
    cholesky_in_place(top.rb_mut(), none, par, MemStack::new(&mut memory), params).map_err(|e| match e {
        faer::linalg::cholesky::llt::factor::LltError::NonPositivePivot { index } => index,
    })?;
    if boundary > 0 {
        solve_lower_triangular_in_place(top.rb(), bottom.rb_mut().transpose_mut(), par);
        let square = MatMut::from_column_major_slice_mut(square, boundary, boundary);
        triangular::matmul(
            square,
            BlockStructure::TriangularLower,
            Accum::Add,
            bottom.rb(),
            BlockStructure::Rectangular,
            bottom.rb().transpose(),
            BlockStructure::Rectangular,
            -1.0,
            par,
        );
    }
    Ok(())
}

fn eliminate_small(panel: &mut [f64], square: &mut [f64], rows: usize, own: usize) -> Result<(), usize> {
    for j in 0..own {
        let (done, rest) = panel.split_at_mut(j * rows);
        let column = &mut rest[j..rows];
        for previous in done.chunks_exact(rows) {
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
    }
    let boundary = rows - own;
    for column in panel.chunks_exact(rows) {
        let low = &column[own..];
        for c in 0..boundary {
            let factor = low[c];
            let target = &mut square[c * boundary + c..(c + 1) * boundary];
            target.iter_mut().zip(&low[c..]).for_each(|(t, l)| *t -= factor * l);
        }
    }
    Ok(())
}

/// Forward substitution with a factorised panel: solves the own part, takes its share off the boundary part.
pub fn forward(panel: &[f64], rows: usize, own: usize, own_right: &mut [f64], boundary_right: &mut [f64]) {
    for (j, column) in panel.chunks_exact(rows).enumerate().take(own) {
        let value = own_right[j] / column[j];
        own_right[j] = value;
        own_right[j + 1..].iter_mut().zip(&column[j + 1..own]).for_each(|(r, l)| *r -= value * l);
        boundary_right.iter_mut().zip(&column[own..]).for_each(|(r, l)| *r -= value * l);
    }
}

/// Backward substitution with a factorised panel: solves the own part with the boundary's solution.
pub fn backward(panel: &[f64], rows: usize, own: usize, own_part: &mut [f64], boundary_part: &[f64]) {
    for j in (0..own).rev() {
        let column = &panel[j * rows..(j + 1) * rows];
        let sum = dot(&column[own..], boundary_part) + dot(&column[j + 1..own], &own_part[j + 1..own]);
        own_part[j] = (own_part[j] - sum) / column[j];
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

/// A view of a panel's own square.
#[must_use]
pub fn own_square(panel: &[f64], rows: usize, own: usize) -> MatRef<'_, f64> {
    MatRef::from_column_major_slice(panel, rows, own).subrows(0, own)
}

/// A view of a panel below its own square.
#[must_use]
pub fn below(panel: &[f64], rows: usize, own: usize) -> MatRef<'_, f64> {
    MatRef::from_column_major_slice(panel, rows, own).subrows(own, rows - own)
}
