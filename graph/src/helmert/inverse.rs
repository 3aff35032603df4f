//! Selected inverse: covariances of all unknowns, and between those that share a factor, down the tree of blocks
//! (Erisman and Tinney 1975; in geodesy, Hanson 1978).
//!
//! With the panel `L₁₁, L₂₁` of a block and the inverse `Z₂₂` on its boundary, which the block above has:
//! `X = L₂₁ L₁₁⁻¹`, `Z₂₁ = -Z₂₂ X`, `Z₁₁ = (L₁₁ L₁₁ᵀ)⁻¹ - Xᵀ Z₂₁`.

use faer::linalg::matmul::matmul;
use faer::linalg::matmul::triangular::{BlockStructure, matmul as triangular_matmul};
use faer::linalg::triangular_inverse::invert_lower_triangular;
use faer::reborrow::{Reborrow, ReborrowMut};
use faer::{Accum, Mat, MatMut, MatRef, Par};

use super::front;
use super::tree::{NONE, Tree};

/// The inverse on a block's own and boundary scalars: `rows × rows`, lower triangle, column by column.
#[derive(Debug, Clone)]
pub struct BlockInverse {
    /// Scalars.
    pub rows: usize,
    /// Numbers, lower triangle.
    pub numbers: Vec<f64>,
}

impl BlockInverse {
    /// Covariance of two scalars of the front.
    #[must_use]
    #[inline]
    pub fn at(&self, a: usize, b: usize) -> f64 {
        self.numbers[a.min(b) * self.rows + a.max(b)]
    }
}

/// Goes down the tree and hands every block's inverse to `visit`.
///
/// `panel` gives a block's panel; it is asked for each block once, in reverse order.
///
/// # Errors
/// What `panel` fails with.
pub fn visit_inverse<'a, E>(
    tree: &Tree,
    mut panel: impl FnMut(usize) -> Result<std::borrow::Cow<'a, [f64]>, E>,
    mut visit: impl FnMut(usize, &BlockInverse),
) -> Result<(), E> {
    let mut kept: Vec<Option<BlockInverse>> = vec![None; tree.blocks.len()];
    let mut waiting: Vec<u32> =
        (0..tree.blocks.len()).map(|b| u32::try_from(tree.children(b).len()).unwrap_or(u32::MAX)).collect();
    for index in (0..tree.blocks.len()).rev() {
        let parent = tree.blocks[index].parent;
        let boundary = if parent == NONE {
            Vec::new()
        } else {
            let above = kept[parent as usize].as_ref();
            above.map_or_else(Vec::new, |z| boundary_inverse(tree, index, parent as usize, z))
        };
        let inverse = block_inverse(tree, index, &panel(index)?, &boundary);
        visit(index, &inverse);
        if waiting[index] > 0 {
            kept[index] = Some(inverse);
        }
        if parent != NONE {
            waiting[parent as usize] -= 1;
            if waiting[parent as usize] == 0 {
                kept[parent as usize] = None;
            }
        }
    }
    Ok(())
}

/// The whole inverse, in the order of elimination: `scalars²` numbers, for nets of a few thousand unknowns.
///
/// From the last block down: with all later scalars 3, `Z₃₁ = -Z₃₂ X`, and `Z₁₁` as above.
///
/// # Errors
/// What `panel` fails with.
pub fn whole_inverse<'a, E>(
    tree: &Tree,
    mut panel: impl FnMut(usize) -> Result<std::borrow::Cow<'a, [f64]>, E>,
) -> Result<Mat<f64>, E> {
    let n = tree.scalars();
    let mut z = Mat::<f64>::zeros(n, n);
    for (index, block) in tree.blocks.iter().enumerate().rev() {
        let (k, m) = (block.own_scalars, block.boundary_scalars);
        if k == 0 {
            continue;
        }
        let first = tree.scalar_start[block.first as usize] as usize;
        let end = first + k;
        let panel = panel(index)?;
        let mut inverse = Mat::<f64>::zeros(k, k);
        invert_lower_triangular(inverse.as_mut(), front::own_square(&panel, k).as_ref(), Par::Seq);
        let mut own = product(inverse.transpose(), inverse.as_ref());
        if m > 0 {
            let boundary: Vec<usize> = tree
                .boundary(index)
                .iter()
                .flat_map(|q| tree.scalar_start[*q as usize]..tree.scalar_start[*q as usize + 1])
                .map(|s| s as usize)
                .collect();
            let x = product(front::below(&panel, k, m), inverse.as_ref());
            let later = Mat::from_fn(n - end, m, |r, c| -z[(end + r, boundary[c])]);
            let below = product(later.as_ref(), x.as_ref());
            let at_boundary = Mat::from_fn(m, k, |r, c| below[(boundary[r] - end, c)]);
            own -= product(x.transpose(), at_boundary.as_ref());
            for c in 0..k {
                for r in 0..n - end {
                    z[(end + r, first + c)] = below[(r, c)];
                    z[(first + c, end + r)] = below[(r, c)];
                }
            }
        }
        for c in 0..k {
            for r in 0..k {
                z[(first + r, first + c)] = 0.5 * (own[(r, c)] + own[(c, r)]);
            }
        }
    }
    Ok(z)
}

/// On one thread: bits must not depend on the number of threads.
fn product(a: MatRef<'_, f64>, b: MatRef<'_, f64>) -> Mat<f64> {
    let mut c = Mat::zeros(a.nrows(), b.ncols());
    matmul(c.as_mut(), Accum::Replace, a, b, 1.0, Par::Seq);
    c
}

/// The inverse on the boundary of a block out of that of the block above, lower triangle.
fn boundary_inverse(tree: &Tree, index: usize, parent: usize, above: &BlockInverse) -> Vec<f64> {
    let block = &tree.blocks[parent];
    let first_scalar = tree.scalar_start[block.first as usize];
    let offsets = tree.boundary_offsets(parent);
    let mut rows = Vec::with_capacity(tree.blocks[index].boundary_scalars);
    for q in tree.boundary(index) {
        let local = if *q < block.end {
            tree.scalar_start[*q as usize] - first_scalar
        } else {
            offsets[tree.boundary(parent).partition_point(|b| b < q)]
        } as usize;
        rows.extend(local..local + tree.dimension(*q) as usize);
    }
    let m = rows.len();
    let mut z = vec![0.0; m * m];
    for c in 0..m {
        let column = &above.numbers[rows[c] * above.rows..(rows[c] + 1) * above.rows];
        for (target, r) in z[c * m + c..(c + 1) * m].iter_mut().zip(&rows[c..]) {
            *target = column[*r];
        }
    }
    z
}

fn block_inverse(tree: &Tree, index: usize, panel: &[f64], boundary: &[f64]) -> BlockInverse {
    let block = &tree.blocks[index];
    let (n, k, m) = (block.scalars(), block.own_scalars, block.boundary_scalars);
    let mut numbers = vec![0.0; n * n];
    if k == 0 {
        numbers.copy_from_slice(boundary);
        return BlockInverse { rows: n, numbers };
    }
    let mut inverse = Mat::<f64>::zeros(k, k);
    invert_lower_triangular(inverse.as_mut(), front::own_square(panel, k).as_ref(), Par::Seq);
    let whole = MatMut::from_column_major_slice_mut(&mut numbers, n, n);
    let (z1, z2) = whole.split_at_col_mut(k);
    let (mut z11, mut z21) = z1.split_at_row_mut(k);
    triangular_matmul(
        z11.rb_mut(),
        BlockStructure::TriangularLower,
        Accum::Replace,
        inverse.transpose(),
        BlockStructure::TriangularUpper,
        inverse.as_ref(),
        BlockStructure::TriangularLower,
        1.0,
        Par::Seq,
    );
    if m > 0 {
        let mut x = Mat::<f64>::zeros(m, k);
        triangular_matmul(
            x.as_mut(),
            BlockStructure::Rectangular,
            Accum::Replace,
            front::below(panel, k, m),
            BlockStructure::Rectangular,
            inverse.as_ref(),
            BlockStructure::TriangularLower,
            1.0,
            Par::Seq,
        );
        // the whole of the boundary's inverse, for the product
        let full = Mat::from_fn(m, m, |r, c| boundary[r.min(c) * m + r.max(c)]);
        matmul(z21.rb_mut(), Accum::Replace, full.as_ref(), x.as_ref(), -1.0, Par::Seq);
        triangular_matmul(
            z11.rb_mut(),
            BlockStructure::TriangularLower,
            Accum::Add,
            x.transpose(),
            BlockStructure::Rectangular,
            z21.rb(),
            BlockStructure::Rectangular,
            -1.0,
            Par::Seq,
        );
        let mut z22 = z2.split_at_row_mut(k).1;
        for c in 0..m {
            for r in c..m {
                z22[(r, c)] = boundary[c * m + r];
            }
        }
    }
    BlockInverse { rows: n, numbers }
}
