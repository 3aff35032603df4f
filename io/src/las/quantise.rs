//! Metres to the integers of a LAS record and back; the scale and offset of corrected files.

use super::bytes::i32_at;
use super::error::LasError;
use super::header::AXES;
use std::path::Path;

/// Scale \[m\] of files that are not finer.
const USUAL_SCALE: f64 = 0.001;
/// Scale \[m\] of files whose input is finer than that.
const FINE_SCALE: f64 = 0.000_1;
/// Greatest magnitude of a stored integer.
const LARGEST: f64 = i32::MAX as f64;

/// Scale \[m\] to write a corrected file at, so that corrections of millimetres are not swallowed.
///
/// 0.001 m; 0.0001 m where the input is finer than 1 mm; never coarser than the input.
///
/// ```
/// assert_eq!(tieline_io::las::output_scale([0.01, 0.000_25, 0.000_05]), [0.001, 0.000_1, 0.000_05]);
/// ```
#[must_use]
pub fn output_scale(input_scale: [f64; 3]) -> [f64; 3] {
    input_scale.map(|scale| {
        let is_finer = scale < USUAL_SCALE * (1.0 - 1e-9);
        scale.min(if is_finer { FINE_SCALE } else { USUAL_SCALE })
    })
}

/// Offset \[m\] for points within these bounds \[m\]: a round number near their centre.
///
/// The integers then stay within ± half the extent / scale and a fifty-thousandth of their range.
///
/// ```
/// let offset = tieline_io::las::output_offset([667_231.4, 6_581_100.0, 3.0], [668_010.2, 6_582_300.0, 40.0], [0.001; 3]);
/// assert_eq!(offset, [667_600.0, 6_581_700.0, 0.0]);
/// ```
#[must_use]
#[allow(clippy::cast_possible_truncation)] // an exponent between -300 and 300
pub fn output_offset(min: [f64; 3], max: [f64; 3], scale: [f64; 3]) -> [f64; 3] {
    std::array::from_fn(|axis| {
        let centre = 0.5 * min[axis] + 0.5 * max[axis];
        let digits = -((scale[axis].log10() + 5.0).round() as i32);
        let per_unit = 10.0_f64.powi(digits.abs());
        let round =
            if digits > 0 { (centre * per_unit).round() / per_unit } else { (centre / per_unit).round() * per_unit };
        round + 0.0 // never -0.0
    })
}

/// Scale and offset of one file.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Grid {
    pub(super) scale: [f64; 3],
    pub(super) offset_m: [f64; 3],
}

impl Grid {
    /// The coordinates \[m\] of an integer triple.
    pub(super) fn metres(&self, stored: [i32; 3]) -> [f64; 3] {
        std::array::from_fn(|axis| f64::from(stored[axis]) * self.scale[axis] + self.offset_m[axis])
    }

    /// Replaces `coordinates_m` by those of the records.
    pub(super) fn load(&self, records: &[u8], record_length: usize, coordinates_m: &mut Vec<[f64; 3]>) {
        coordinates_m.clear();
        let stored = records.chunks_exact(record_length).map(|record| [0, 4, 8].map(|at| i32_at(record, at)));
        coordinates_m.extend(stored.map(|stored| self.metres(stored)));
    }

    /// Writes coordinates into the records and returns the bounds of the integers.
    ///
    /// `Err` with position, axis and coordinate of the first one that does not fit.
    #[allow(clippy::cast_possible_truncation)] // checked against the range of `i32`
    pub(super) fn store(
        &self,
        coordinates_m: &[[f64; 3]],
        records: &mut [u8],
        record_length: usize,
    ) -> Result<StoredBounds, (usize, usize)> {
        let mut bounds = StoredBounds::default();
        for (index, (record, metres)) in records.chunks_exact_mut(record_length).zip(coordinates_m).enumerate() {
            let mut stored = [0_i32; 3];
            for (axis, slot) in stored.iter_mut().enumerate() {
                let units = (metres[axis] - self.offset_m[axis]) / self.scale[axis];
                let rounded = units + 0.5_f64.copysign(units);
                if rounded.is_nan() || rounded.abs() > LARGEST {
                    return Err((index, axis));
                }
                *slot = rounded as i32;
            }
            bounds.include(stored);
            record[0..4].copy_from_slice(&stored[0].to_le_bytes());
            record[4..8].copy_from_slice(&stored[1].to_le_bytes());
            record[8..12].copy_from_slice(&stored[2].to_le_bytes());
        }
        Ok(bounds)
    }

    /// The error of a coordinate that [`Grid::store`] refused.
    pub(super) fn overflow(&self, path: &Path, point: u64, axis: usize, coordinate_m: f64) -> LasError {
        LasError::Overflow {
            path: path.into(),
            point,
            axis: AXES[axis],
            coordinate_m,
            scale: self.scale[axis],
            offset_m: self.offset_m[axis],
        }
    }
}

/// Least and greatest stored integers.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct StoredBounds {
    pub(super) min: [i32; 3],
    pub(super) max: [i32; 3],
}

impl Default for StoredBounds {
    fn default() -> Self {
        Self { min: [i32::MAX; 3], max: [i32::MIN; 3] }
    }
}

impl StoredBounds {
    pub(super) fn include(&mut self, stored: [i32; 3]) {
        for ((least, greatest), value) in self.min.iter_mut().zip(&mut self.max).zip(stored) {
            *least = value.min(*least);
            *greatest = value.max(*greatest);
        }
    }

    pub(super) fn merge(&mut self, other: &Self) {
        self.include(other.min);
        self.include(other.max);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_unedited_point_keeps_its_integers_on_the_same_grid() {
        for scale in [0.01, 0.001, 0.000_25, 1e-4, 0.3e-3] {
            let grid = Grid { scale: [scale; 3], offset_m: [500_000.0, 5_763_618.0, -33.0] };
            let mut records = Vec::new();
            for number in -2_000..2_000_i32 {
                for factor in [1_000_003, -999_979, 524_287] {
                    records.extend(number.wrapping_mul(factor).to_le_bytes());
                }
            }
            let (mut metres, mut again) = (Vec::new(), records.clone());
            grid.load(&records, 12, &mut metres);
            again.fill(0);
            grid.store(&metres, &mut again, 12).expect("in range");
            assert!(again == records, "scale {scale}");
        }
    }

    #[test]
    fn a_coordinate_out_of_range_or_not_finite_is_named() {
        let grid = Grid { scale: [0.001; 3], offset_m: [0.0; 3] };
        let mut records = vec![0; 24];
        assert_eq!(grid.store(&[[0.0; 3], [0.0, 2_147_484.0, 0.0]], &mut records, 12), Err((1, 1)));
        assert_eq!(grid.store(&[[0.0, 0.0, f64::NAN]], &mut records, 12), Err((0, 2)));
    }

    #[test]
    fn offsets_are_round_and_keep_the_integers_in_range() {
        let offset = output_offset([8.532_1, 47.1, -2.0], [8.548_9, 47.2, 9_000.0], [1e-7, 1e-7, 0.001]);
        assert_eq!(offset.map(f64::to_bits), [8.54, 47.15, 4_500.0].map(f64::to_bits));
    }
}
