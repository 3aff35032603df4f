//! A simulated net as a problem.

use nalgebra::Matrix3;
use tieline_graph::factor::baseline::Baseline;
use tieline_graph::factor::terrestrial::{Direction, Distance};
use tieline_graph::{Kind, Problem, VariableId};
use tieline_simulate::net::{BASELINE_COVARIANCE_M2, DIRECTION_SIGMA_RAD, NetKind, NetObservation, SimulatedNet};

/// The problem of a net: stations in their order, control held; of direction nets an orientation unknown right after
/// each station.
#[must_use]
pub fn problem(net: &SimulatedNet) -> Problem {
    let mut problem = Problem::new();
    let directions = net.kind == NetKind::Directions;
    for p in &net.approximate_m {
        if directions {
            let station = problem.add_variable(Kind::Point2, &[p.x, p.y]);
            problem.add_attached(station, Kind::Scalar, &[0.0]);
        } else {
            problem.add_variable(Kind::Point3, &[p.x, p.y, p.z]);
        }
    }
    let per_station = if directions { 2 } else { 1 };
    let station = |s: u32| VariableId(per_station * s);
    for control in &net.control {
        problem.fix(station(*control));
    }
    let rows = BASELINE_COVARIANCE_M2;
    let covariance = Matrix3::from_fn(|r, c| rows[r][c]);
    let mut oriented = vec![(0.0_f64, 0.0_f64); if directions { net.approximate_m.len() } else { 0 }];
    for observation in &net.observations {
        match *observation {
            NetObservation::Direction(from, to, reading_rad) => {
                let d = net.approximate_m[to as usize] - net.approximate_m[from as usize];
                let (sin, cos) = (d.y.atan2(d.x) - reading_rad).sin_cos();
                let sum = &mut oriented[from as usize];
                *sum = (sum.0 + sin, sum.1 + cos);
                let orientation = VariableId(2 * from + 1);
                problem.add(Direction::new(
                    [station(from), station(to), orientation],
                    reading_rad,
                    DIRECTION_SIGMA_RAD,
                ));
            }
            NetObservation::Distance(from, to, length_m, sigma_m) => {
                problem.add(Distance::new([station(from), station(to)], length_m, sigma_m));
            }
            NetObservation::Baseline(from, to, difference_m) => {
                if let Ok(baseline) = Baseline::new([station(from), station(to)], difference_m, &covariance) {
                    problem.add(baseline);
                }
            }
        }
    }
    for (k, (sin, cos)) in oriented.iter().enumerate() {
        let id = VariableId(2 * u32::try_from(k).unwrap_or(u32::MAX) + 1);
        problem.values.get_mut(id)[0] = sin.atan2(*cos);
    }
    problem.shrink();
    problem
}
