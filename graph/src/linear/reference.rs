//! The reference: faer's sparse Cholesky of the same normal equations on the same order of elimination.

use faer::dyn_stack::{MemBuffer, MemStack};
use faer::sparse::linalg::cholesky::{
    CholeskySymbolicParams, SymbolicCholesky, SymmetricOrdering, factorize_symbolic_cholesky,
};
use faer::sparse::{SparseColMatRef, SymbolicSparseColMatRef};
use faer::{Conj, MatMut, Par, Side};

use super::blocks::Pattern;
use crate::helmert::block::Singular;
use crate::helmert::tree::Tree;

/// Symbolic factorisation on scalars, for many numeric ones.
#[derive(Debug)]
pub struct Reference {
    starts: Vec<usize>,
    rows: Vec<usize>,
    /// Number in the block normal equations of each number of the sparse matrix.
    source: Vec<u32>,
    symbolic: SymbolicCholesky<usize>,
    scalars: usize,
}

impl Reference {
    /// The sparse pattern of the block normal equations.
    ///
    /// # Errors
    /// [`Singular`] when the pattern is too large for the library.
    #[allow(clippy::cast_possible_truncation)] // numbers are fewer than 2^32, see `Pattern`
    pub fn new(tree: &Tree, pattern: &Pattern) -> Result<Self, Singular> {
        let (mut starts, mut rows, mut source) = (vec![0], Vec::new(), Vec::new());
        for p in 0..tree.order.len() as u32 {
            let (range, height) = pattern.panel(p);
            let own = tree.dimension(p) as usize;
            let first = tree.scalar_start[p as usize] as usize;
            for c in 0..own {
                let mut at = range.start + c * height;
                for r in 0..own {
                    if r >= c {
                        rows.push(first + r);
                        source.push((at + r) as u32);
                    }
                }
                at += own;
                for q in pattern.later(p) {
                    let start = tree.scalar_start[*q as usize] as usize;
                    for r in 0..tree.dimension(*q) as usize {
                        rows.push(start + r);
                        source.push((at + r) as u32);
                    }
                    at += tree.dimension(*q) as usize;
                }
                starts.push(rows.len());
            }
        }
        let scalars = tree.scalars();
        let symbolic_matrix = SymbolicSparseColMatRef::new_checked(scalars, scalars, &starts, None, &rows);
        let identity: Vec<usize> = (0..scalars).collect();
        let parameters = CholeskySymbolicParams::default();
        let symbolic = factorize_symbolic_cholesky(
            symbolic_matrix,
            Side::Lower,
            // the library's `Identity` fails on a lower triangle where its simplicial way is taken
            SymmetricOrdering::Custom(faer::perm::PermRef::new_checked(&identity, &identity, scalars)),
            parameters,
        )
        .map_err(|_| Singular { scalar: 0 })?;
        Ok(Self { starts, rows, source, symbolic, scalars })
    }

    /// Factorises and solves for one right-hand side, in place.
    ///
    /// # Errors
    /// [`Singular`].
    pub fn solve(&self, numbers: &[f64], right: &mut [f64]) -> Result<(), Singular> {
        let values: Vec<f64> = self.source.iter().map(|s| numbers[*s as usize]).collect();
        let pattern = SymbolicSparseColMatRef::new_checked(self.scalars, self.scalars, &self.starts, None, &self.rows);
        let matrix = SparseColMatRef::new(pattern, &values);
        let mut panels = vec![0.0; self.symbolic.len_val()];
        let scratch = self.symbolic.factorize_numeric_llt_scratch::<f64>(Par::Seq, faer::Spec::default());
        let mut memory = MemBuffer::new(scratch);
        let factor = self
            .symbolic
            .factorize_numeric_llt(
                &mut panels,
                matrix,
                Side::Lower,
                faer::linalg::cholesky::llt::factor::LltRegularization::default(),
                Par::Seq,
                MemStack::new(&mut memory),
                faer::Spec::default(),
            )
            .map_err(|_| Singular { scalar: 0 })?;
        let mut memory = MemBuffer::new(self.symbolic.solve_in_place_scratch::<f64>(1, Par::Seq));
        let right = MatMut::from_column_major_slice_mut(right, self.scalars, 1);
        factor.solve_in_place_with_conj(Conj::No, right, Par::Seq, MemStack::new(&mut memory));
        Ok(())
    }
}
