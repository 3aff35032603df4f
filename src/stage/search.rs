//! How far two sightings of a place may lie apart, by what is stated of the trajectory.

use tieline_filter::Trajectory;

/// Search radii: so many standard deviations of both positions and a little more; between these; that where none is stated \[m\].
const SEARCH_SIGMAS: f64 = 4.0;
const SEARCH_MORE_M: f64 = 0.1;
const SEARCH_M: [f64; 2] = [0.25, 1.2];
const SEARCH_UNSTATED_M: f64 = 0.75;

/// Search radii in plan along a trajectory.
#[derive(Debug, Clone, Copy)]
pub struct Search<'a> {
    trajectory: &'a Trajectory,
}

impl<'a> Search<'a> {
    /// Those of a trajectory.
    #[must_use]
    pub fn of(trajectory: &'a Trajectory) -> Self {
        Self { trajectory }
    }

    /// How far sightings at two times may lie apart \[m\].
    #[must_use]
    pub fn radius_m(&self, a_s: f64, b_s: f64) -> f64 {
        let sigma_m = |time_s: f64| self.trajectory.sigma_at(time_s).map(|s| s.position_ned_m.xy().norm());
        let stated = sigma_m(a_s).zip(sigma_m(b_s)).map(|(a, b)| SEARCH_SIGMAS * a.hypot(b) + SEARCH_MORE_M);
        stated.map_or(SEARCH_UNSTATED_M, |m| m.clamp(SEARCH_M[0], SEARCH_M[1]))
    }

    /// The largest of them \[m\].
    #[must_use]
    pub fn most_m(&self) -> f64 {
        let sigmas = self.trajectory.sigma();
        let worst_m = sigmas.iter().map(|s| s.position_ned_m.xy().norm()).fold(0.0, f64::max);
        match sigmas {
            [] => SEARCH_UNSTATED_M,
            _ => (SEARCH_SIGMAS * worst_m * std::f64::consts::SQRT_2 + SEARCH_MORE_M).clamp(SEARCH_M[0], SEARCH_M[1]),
        }
    }
}
