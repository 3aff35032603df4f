//! The difference of two trajectories over time: what the point cloud is corrected with.

use nalgebra::{Vector3, Vector6};

use crate::trajectory::TrajectoryError;

/// One epoch of a correction: new pose minus old pose.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct CorrectionRow {
    /// Survey time \[s\].
    pub time_s: f64,
    /// East, north, up \[m\] in map axes, to be added to the position.
    pub position_enu_m: Vector3<f64>,
    /// Roll, pitch, heading \[rad\], to be added to the attitude angles.
    pub attitude_rph_rad: Vector3<f64>,
    /// One sigma of the six numbers above, in their order and units; zeros when unknown.
    pub sigma: Vector6<f64>,
}

/// A correction over time, linear between its rows; rows in strictly increasing time.
#[derive(Debug, Clone, PartialEq)]
pub struct Correction {
    rows: Vec<CorrectionRow>,
}

impl Correction {
    /// A correction of rows in strictly increasing time; one row is a constant.
    ///
    /// # Errors
    /// [`TrajectoryError`] when there is no row, a time does not increase or a value is not finite.
    pub fn new(rows: Vec<CorrectionRow>) -> Result<Self, TrajectoryError> {
        if rows.is_empty() {
            return Err(TrajectoryError::TooShort { found: 0 });
        }
        for (record, row) in rows.iter().enumerate() {
            let finite = row.time_s.is_finite()
                && row.position_enu_m.iter().chain(row.attitude_rph_rad.iter()).all(|v| v.is_finite());
            if !finite {
                return Err(TrajectoryError::NotFinite { record, column: "correction" });
            }
            if record > 0 && row.time_s <= rows[record - 1].time_s {
                return Err(TrajectoryError::TimeNotIncreasing {
                    record,
                    time_s: row.time_s,
                    previous_s: rows[record - 1].time_s,
                });
            }
        }
        Ok(Self { rows })
    }

    /// The rows, in time order.
    #[must_use]
    pub fn rows(&self) -> &[CorrectionRow] {
        &self.rows
    }

    /// Position \[m, ENU\] and attitude \[rad, roll-pitch-heading\] to be added at a time \[s\]; constant beyond the ends.
    #[must_use]
    pub fn at(&self, time_s: f64) -> (Vector3<f64>, Vector3<f64>) {
        let rows = &self.rows;
        let i = rows.partition_point(|r| r.time_s <= time_s);
        if i == 0 || i == rows.len() {
            let r = &rows[i.saturating_sub(1).min(rows.len() - 1)];
            return (r.position_enu_m, r.attitude_rph_rad);
        }
        let (a, b) = (&rows[i - 1], &rows[i]);
        let u = (time_s - a.time_s) / (b.time_s - a.time_s);
        (
            a.position_enu_m + (b.position_enu_m - a.position_enu_m) * u,
            a.attitude_rph_rad + (b.attitude_rph_rad - a.attitude_rph_rad) * u,
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn row(time_s: f64, east_m: f64) -> CorrectionRow {
        CorrectionRow {
            time_s,
            position_enu_m: Vector3::new(east_m, 0.0, 0.0),
            attitude_rph_rad: Vector3::zeros(),
            sigma: Vector6::zeros(),
        }
    }

    #[test]
    fn between_two_rows_the_correction_is_linear_and_beyond_them_constant() {
        let correction = Correction::new(vec![row(0.0, 0.0), row(2.0, 1.0)]).expect("two good rows");
        for (time_s, east_m) in [(-1.0, 0.0), (0.5, 0.25), (2.0, 1.0), (9.0, 1.0)] {
            assert!((correction.at(time_s).0.x - east_m).abs() < 1e-15);
        }
    }

    #[test]
    fn rows_out_of_order_are_refused() {
        assert!(Correction::new(vec![row(2.0, 0.0), row(1.0, 0.0)]).is_err());
        assert!(Correction::new(Vec::new()).is_err());
    }
}
