//! The innermost loops of the filter, with as wide registers as the processor has: on a covariance, and on the rows of the
//! backward pass.
//!
//! The compiler makes each loop once for every kind of processor ([`pulp`]); for that the whole of it must be inlined. Where
//! a processor multiplies and adds at once the last digits differ from where it does not, never from run to run.

mod covariance;
mod rows;

pub(crate) use covariance::{add_symmetric, move_columns};
pub(crate) use rows::{Move, Pull, SplitRow, Step, dot, pass};

use crate::state::CORE;

/// Numbers that the longest register holds: lengths of rows are multiples of it.
pub(crate) const LANES: usize = 8;
/// Columns of a transition, filled up to whole registers.
pub(crate) const PADDED: usize = CORE.next_multiple_of(LANES);

#[cfg(test)]
mod numbers {
    use crate::state::{CORE, NAV};

    /// Numbers that look random.
    pub(crate) fn numbers(count: usize) -> Vec<f64> {
        (0..count).map(|k| ((k * 7919 + 13) % 1009) as f64 / 504.0 - 1.0).collect()
    }

    pub(crate) fn transition() -> [[f64; CORE]; NAV] {
        let all = numbers(NAV * CORE);
        std::array::from_fn(|i| std::array::from_fn(|k| all[i * CORE + k]))
    }
}
