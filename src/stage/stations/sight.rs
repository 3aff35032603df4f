//! What the common planes see of the mounting, and what they do not.

use nalgebra::{DMatrix, Matrix6, Vector6};
use tieline_graph::Parameter;

use super::Mounts;

/// How well a direction is seen.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Grade {
    /// The planes say less than the prior: what stands there is the prior.
    NotSeen,
    /// Seen, but points [`FAR_M`] away may be moved by more than [`WEAK_M`] (one sigma).
    Weak,
    /// Seen.
    Seen,
}

impl Grade {
    /// The word used in files.
    #[must_use]
    pub fn as_str(self) -> &'static str {
        match self {
            Self::NotSeen => "not seen",
            Self::Weak => "weakly seen",
            Self::Seen => "seen",
        }
    }
}

/// A direction is weak when it leaves more than this open \[m\]…
pub const WEAK_M: f64 = 0.03;
/// … for points at this range \[m\].
pub const FAR_M: f64 = 20.0;
/// Members of a direction with a smaller coefficient are not named.
const LEAST_MEMBER: f64 = 0.2;

/// A combination of the six unknowns of a scanner that is seen apart from the others.
#[derive(Debug, Clone, PartialEq)]
pub struct Direction {
    /// Calibration block.
    pub block: usize,
    /// Coefficient and name of the unknowns that dominate it, in prior sigmas.
    pub members: Vec<(f64, String)>,
    /// Sigma of the combination by the planes alone over its prior sigma; infinite where they say nothing.
    pub sigma_over_prior: f64,
    /// Largest shift of a point [`FAR_M`] away that one sigma of it makes \[m\].
    pub effect_m: f64,
    /// How well it is seen.
    pub grade: Grade,
}

/// What is seen and what is not.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Sight {
    /// Directions of every scanner, weakest first.
    pub directions: Vec<Direction>,
    /// For each unknown, 1 - (sigma / prior sigma)²: 0 is held by its prior, 1 free of it.
    pub share: Vec<f64>,
    /// The same by ground alone; empty where there is none.
    pub share_of_ground: Vec<f64>,
}

impl Sight {
    /// In words: what cannot be seen at all, what is weak, and what hangs on walls.
    #[must_use]
    pub fn words(&self, mounts: &Mounts, parameters: &[Parameter]) -> Vec<String> {
        let names: Vec<&str> = mounts.calibrated().map(|h| h.name.as_str()).collect();
        let reference = &mounts.heads[mounts.reference].name;
        let mut words = vec![format!(
            "not seen: boresight roll, pitch, yaw and lever arm that all scanners have in common (those of {reference} against \
             the vehicle); they stay as given"
        )];
        for direction in self.directions.iter().filter(|d| d.grade != Grade::Seen) {
            let members: Vec<String> = direction.members.iter().map(|(c, name)| format!("{c:+.2} {name}")).collect();
            let sigma = if direction.sigma_over_prior.is_finite() {
                format!("sigma {:.2} of the prior's", direction.sigma_over_prior)
            } else {
                String::from("no information")
            };
            words.push(format!(
                "{}: {}: {} ({sigma}; {:.0} mm at {FAR_M} m)",
                direction.grade.as_str(),
                names.get(direction.block).unwrap_or(&""),
                members.join(" "),
                1e3 * direction.effect_m
            ));
        }
        for (block, name) in names.iter().enumerate() {
            let hang: Vec<&str> = (6 * block..6 * block + 6)
                .filter(|i| {
                    self.share_of_ground.get(*i).is_some_and(|s| *s < 0.5)
                        && self.share.get(*i).is_some_and(|s| *s >= 0.5)
                })
                .filter_map(|i| parameters.get(i).map(|p| p.name.as_str()))
                .collect();
            if !hang.is_empty() {
                words.push(format!("{name}: ground does not see {}; they hang on walls", hang.join(", ")));
            }
        }
        words
    }

    /// Whether everything relative is seen.
    #[must_use]
    pub fn all_seen(&self) -> bool {
        self.directions.iter().all(|d| d.grade != Grade::NotSeen)
    }
}

fn shares(covariance: &DMatrix<f64>, parameters: &[Parameter]) -> Vec<f64> {
    let share = |(i, p): (usize, &Parameter)| (1.0 - covariance[(i, i)] / p.prior_sigma.powi(2)).clamp(0.0, 1.0);
    parameters.iter().enumerate().map(share).collect()
}

/// Directions of every scanner by the eigenvectors of its covariance in prior sigmas.
#[must_use]
pub fn sight(
    mounts: &Mounts,
    parameters: &[Parameter],
    covariance: &DMatrix<f64>,
    of_ground: Option<&DMatrix<f64>>,
) -> Sight {
    let mut directions = Vec::new();
    for block in 0..mounts.heads.len() - 1 {
        let prior = Vector6::from_fn(|k, _| parameters[6 * block + k].prior_sigma);
        let own = Matrix6::from_fn(|i, j| covariance[(6 * block + i, 6 * block + j)] / (prior[i] * prior[j]));
        let eigen = own.symmetric_eigen();
        for k in 0..6 {
            let variance = eigen.eigenvalues[k].clamp(1e-12, 1.0);
            let mut vector: Vector6<f64> = eigen.eigenvectors.column(k).into();
            if vector[vector.iamax()] < 0.0 {
                vector = -vector;
            }
            let physical = vector.component_mul(&prior) * variance.sqrt();
            let effect_m = physical.fixed_rows::<3>(0).norm() * FAR_M + physical.fixed_rows::<3>(3).norm();
            let information = 1.0 / variance - 1.0;
            let grade = if information < 1.0 {
                Grade::NotSeen
            } else if effect_m > WEAK_M {
                Grade::Weak
            } else {
                Grade::Seen
            };
            let mut members: Vec<(f64, String)> = (0..6)
                .filter(|i| vector[*i].abs() >= LEAST_MEMBER)
                .map(|i| (vector[i], parameters[6 * block + i].name.clone()))
                .collect();
            members.sort_by(|a, b| b.0.abs().total_cmp(&a.0.abs()));
            let sigma_over_prior = if information > 1e-9 { information.sqrt().recip() } else { f64::INFINITY };
            directions.push(Direction { block, members, sigma_over_prior, effect_m, grade });
        }
    }
    directions
        .sort_by(|a, b| (a.grade, b.effect_m).partial_cmp(&(b.grade, a.effect_m)).unwrap_or(std::cmp::Ordering::Equal));
    Sight {
        directions,
        share: shares(covariance, parameters),
        share_of_ground: of_ground.map(|c| shares(c, parameters)).unwrap_or_default(),
    }
}
