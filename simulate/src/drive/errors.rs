//! How far a trajectory is from the truth.

use tieline_filter::Trajectory;
use tieline_filter::earth::{ecef_from_geodetic, ned_from_ecef};
use tieline_filter::frames::roll_pitch_heading_rad;

use super::axis::wrapped;

/// Error of a geodetic trajectory at an epoch that it shares with the true one, delivered minus true: north, east,
/// down \[m\], roll, pitch, heading \[deg\].
#[must_use]
pub fn errors_at(delivered: &Trajectory, truth: &Trajectory, epoch: usize) -> [f64; 6] {
    let (place, true_place) = (delivered.position()[epoch], truth.position()[epoch]);
    let apart = ecef_from_geodetic(&place) - ecef_from_geodetic(&true_place);
    let ned = ned_from_ecef(true_place.x, true_place.y) * apart;
    let (a, b) = (
        roll_pitch_heading_rad(&delivered.ned_from_body()[epoch]),
        roll_pitch_heading_rad(&truth.ned_from_body()[epoch]),
    );
    let degrees = |a: f64, b: f64| wrapped(a - b).to_degrees();
    [ned.x, ned.y, ned.z, degrees(a.0, b.0), degrees(a.1, b.1), degrees(a.2, b.2)]
}
