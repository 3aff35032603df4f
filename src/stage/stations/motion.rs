//! What the vehicle did while its scanners turned: a spin takes a tenth of a second, and the scanners do not look at one
//! place at one moment. Speed and turn rate of each station are nuisances with a
//! prior of a vehicle at rest or slow; an error of the azimuths that grows over a spin looks the same.

use nalgebra::{DMatrix, DVector, Vector3};
use tieline_filter::innovation::chi_squared_limit;
use tieline_graph::{Model, StripSpec, TimeModel};

use super::Station;

/// Prior sigma of the speed: forward, right, down \[m/s\]. Stations are at rest or slow.
const SPEED_MPS: [f64; 3] = [0.3, 0.02, 0.02];
/// Prior sigma of the turn rate: roll, pitch, yaw \[deg/s\].
const TURN_DEGPS: [f64; 3] = [0.1, 0.1, 5.0];
/// A longer station is several spins: its motion would not be steady \[s\].
const LONGEST_S: f64 = 0.5;
/// Probability that a motion is said to be there though there is none.
const FALSE_ALARM: f64 = 0.001;
/// Coefficients of a station in the model: six of the middle, six of half the change.
const COMPONENTS: usize = 6;

/// Motion of a station during its spin.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Motion {
    /// Index of the station.
    pub station: usize,
    /// Speed forward and its sigma \[m/s\].
    pub forward_mps: (f64, f64),
    /// Turn rate about the axis down and its sigma \[rad/s\].
    pub yaw_rate_radps: (f64, f64),
}

/// What the model is told of the stations: priors of half the change over the spin.
#[must_use]
pub fn specs(stations: &[Station]) -> Vec<StripSpec> {
    stations
        .iter()
        .map(|station| {
            let (start_s, end_s) = station.span_s();
            let half_s = (0.5 * (end_s - start_s)).max(1e-3);
            StripSpec {
                start_s,
                end_s,
                fixed: false,
                position_sigma_m: Vector3::from(SPEED_MPS) * half_s,
                rotation_sigma_rad: Vector3::from(TURN_DEGPS).map(f64::to_radians) * half_s,
            }
        })
        .collect()
}

/// Which stations may have moved: those whose points have times within one spin.
#[must_use]
pub fn time_models(stations: &[Station]) -> Vec<Option<TimeModel>> {
    let moves = |station: &Station| {
        let (start_s, end_s) = station.span_s();
        end_s > start_s && end_s - start_s <= LONGEST_S
    };
    stations.iter().map(|s| moves(s).then_some(TimeModel::Linear)).collect()
}

/// Rows of the change over the spin, of all stations.
fn rows(model: &Model, stations: usize) -> Vec<usize> {
    (0..stations)
        .filter_map(|s| model.strip_basis(s))
        .flat_map(|(first, _)| first + COMPONENTS..first + 2 * COMPONENTS)
        .collect()
}

/// `vᵀ Σ⁻¹ v` of all motions over its limit: above 1 the points ask for them. `None` where none was estimated.
#[must_use]
pub fn need(model: &Model, covariance: &DMatrix<f64>, stations: usize) -> Option<f64> {
    let rows = rows(model, stations);
    if rows.is_empty() {
        return None;
    }
    let own = DMatrix::from_fn(rows.len(), rows.len(), |i, j| covariance[(rows[i], rows[j])]);
    let value = DVector::from_iterator(rows.len(), rows.iter().map(|i| model.state()[*i]));
    let squared = own.cholesky().map_or(f64::INFINITY, |c| value.dot(&c.solve(&value)));
    Some(squared / chi_squared_limit(rows.len(), FALSE_ALARM))
}

/// The motion of every station that has one in the model.
#[must_use]
pub fn motions(model: &Model, covariance: &DMatrix<f64>, stations: &[Station]) -> Vec<Motion> {
    let of = |station: usize| {
        let (first, _) = model.strip_basis(station)?;
        let (start_s, end_s) = stations[station].span_s();
        let half_s = (0.5 * (end_s - start_s)).max(1e-3);
        let rate = |component: usize| {
            let i = first + COMPONENTS + component;
            (model.state()[i] / half_s, covariance[(i, i)].max(0.0).sqrt() / half_s)
        };
        Some(Motion { station, forward_mps: rate(0), yaw_rate_radps: rate(5) })
    };
    (0..stations.len()).filter_map(of).collect()
}
