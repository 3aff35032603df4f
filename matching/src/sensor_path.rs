//! Where the sensor was, when nobody says: rebuilt from multi-return pulses, or from level flight.
//!
//! First and last return of one pulse lie on one ray; the rays of a moment meet in the sensor. The path is a
//! polynomial in time, fitted so that the two returns of every pulse line up with the sensor (errors at the
//! returns, where they are made; intersecting rays directly would pull the sensor towards the ground). It gives
//! position and course, no attitude. What it gives is checked, and refused when it is nonsense
//! (see [`crate::level_flight`] for what remains then).

use nalgebra::{DMatrix, DVector, Matrix3, Vector3};

use crate::sketch::ReturnPair;

/// A rebuilt path of the sensor over one strip, in the local frame.
#[derive(Debug, Clone, PartialEq)]
pub struct SensorPath {
    /// Coefficients of the position in powers of `(t - middle) / half` \[m\].
    pub coefficients: Vec<Vector3<f64>>,
    /// Middle of the strip \[s\].
    pub middle_s: f64,
    /// Half its duration \[s\].
    pub half_s: f64,
    /// Covariance of the coefficients (3 × count) \[m²\].
    pub covariance: DMatrix<f64>,
    /// How it was found.
    pub source: PathSource,
}

/// How a path was found.
#[derive(Debug, Clone, PartialEq)]
pub enum PathSource {
    /// From return pairs: their number, and rms of the returns from the rays \[m\].
    ReturnPairs {
        /// Pairs used.
        pairs: usize,
        /// Misfit at the returns \[m\].
        misfit_m: f64,
    },
    /// From level flight: course from the times of points, height from the scan angle.
    ScanAngle {
        /// Points used.
        points: usize,
    },
    /// From level flight at an assumed height, for neither pairs nor scan angles say anything.
    AssumedHeight,
}

impl SensorPath {
    /// Position \[m\] and velocity \[m/s\] at a time.
    #[must_use]
    pub fn at(&self, time_s: f64) -> (Vector3<f64>, Vector3<f64>) {
        let u = (time_s - self.middle_s) / self.half_s;
        let (mut position, mut velocity, mut power) = (Vector3::zeros(), Vector3::zeros(), 1.0);
        let mut lower = 0.0;
        for (k, c) in self.coefficients.iter().enumerate() {
            position += c * power;
            #[allow(clippy::cast_precision_loss)]
            let factor = k as f64;
            velocity += c * (factor * lower / self.half_s);
            lower = power;
            power *= u;
        }
        (position, velocity)
    }

    /// Sigma of the position at a time \[m\], from the fit alone.
    #[must_use]
    pub fn sigma_m(&self, time_s: f64) -> Vector3<f64> {
        let u = (time_s - self.middle_s) / self.half_s;
        let n = self.coefficients.len();
        let powers: Vec<f64> = std::iter::successors(Some(1.0), |p| Some(p * u)).take(n).collect();
        Vector3::from_fn(|axis, _| {
            let mut variance = 0.0;
            for (a, pa) in powers.iter().enumerate() {
                for (b, pb) in powers[..n].iter().enumerate() {
                    variance += pa * pb * self.covariance[(3 * a + axis, 3 * b + axis)];
                }
            }
            variance.max(0.0).sqrt()
        })
    }
}

/// Why a rebuilt path is refused.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum PathRefused {
    /// Too few return pairs.
    #[error("only {found} return pairs further apart than {least_m} m ({needed} are needed)")]
    TooFewPairs {
        /// Pairs found.
        found: usize,
        /// Pairs needed.
        needed: usize,
        /// Least separation \[m\].
        least_m: f64,
    },
    /// The rays do not meet.
    #[error("the rays do not meet: rms {misfit_m:.3} m at the returns")]
    NoIntersection {
        /// Misfit \[m\].
        misfit_m: f64,
    },
    /// The position is not determined.
    #[error("the sensor's position is known to {sigma_m:.0} m only, at a range of {range_m:.0} m")]
    Undetermined {
        /// Sigma \[m\].
        sigma_m: f64,
        /// Range \[m\].
        range_m: f64,
    },
    /// Not above the ground.
    #[error("the sensor would be {height_m:.0} m above the points")]
    Height {
        /// Height above the points \[m\].
        height_m: f64,
    },
    /// Not a speed of an aircraft.
    #[error("the sensor would move at {speed_mps:.1} m/s, {climb_mps:.1} m/s of it upward")]
    Speed {
        /// Speed over ground \[m/s\].
        speed_mps: f64,
        /// Climb \[m/s\].
        climb_mps: f64,
    },
}

/// Least separation of the two returns of a pair \[m\].
const LEAST_SEPARATION_M: f64 = 2.0;
/// Fewest pairs.
const FEWEST_PAIRS: usize = 60;
/// Speeds of anything that carries a scanner in the air \[m/s\].
pub(crate) const SPEEDS_MPS: std::ops::RangeInclusive<f64> = 1.0..=250.0;

struct Fit<'a> {
    pairs: &'a [ReturnPair],
    middle_s: f64,
    half_s: f64,
}

/// Fits the path of a sensor to the return pairs of one strip.
///
/// # Errors
/// [`PathRefused`] says what does not hold.
pub fn path_from_return_pairs(pairs: &[ReturnPair], start_s: f64, end_s: f64) -> Result<SensorPath, PathRefused> {
    let wide: Vec<ReturnPair> = pairs.iter().copied().filter(|p| separation_m(p) >= LEAST_SEPARATION_M).collect();
    if wide.len() < FEWEST_PAIRS {
        let (found, needed) = (wide.len(), FEWEST_PAIRS);
        return Err(PathRefused::TooFewPairs { found, needed, least_m: LEAST_SEPARATION_M });
    }
    let fit = Fit { pairs: &wide, middle_s: 0.5 * (start_s + end_s), half_s: (0.5 * (end_s - start_s)).max(0.05) };
    // A straight line first; more freedom only where the strip is long and the fit gets clearly better (BIC).
    let mut best = fit.polynomial(1)?;
    for degree in 2..=4_usize {
        #[allow(clippy::cast_precision_loss)]
        if fit.half_s < 2.5 * degree as f64 {
            break;
        }
        let Ok(next) = fit.polynomial(degree) else { break };
        if fit.score(&next) >= fit.score(&best) || fit.check(&next).is_err() {
            break;
        }
        best = next;
    }
    fit.check(&best)?;
    Ok(best)
}

fn separation_m(pair: &ReturnPair) -> f64 {
    (Vector3::from(pair.first_m) - Vector3::from(pair.last_m)).norm()
}

impl Fit<'_> {
    fn u(&self, time_s: f64) -> f64 {
        (time_s - self.middle_s) / self.half_s
    }

    /// Part of the vector between the returns that does not point at the sensor, and the sensor's direction and range.
    fn misalignment(pair: &ReturnPair, sensor: &Vector3<f64>) -> (Vector3<f64>, Vector3<f64>, f64) {
        let (first, last) = (Vector3::from(pair.first_m), Vector3::from(pair.last_m));
        let to_sensor = sensor - (first + last) / 2.0;
        let range_m = to_sensor.norm().max(1.0);
        let direction = to_sensor / range_m;
        let between = first - last;
        (between - direction * direction.dot(&between), direction, range_m)
    }

    fn polynomial(&self, degree: usize) -> Result<SensorPath, PathRefused> {
        let n = degree + 1;
        let mut path = SensorPath {
            coefficients: self.start(n),
            middle_s: self.middle_s,
            half_s: self.half_s,
            covariance: DMatrix::zeros(3 * n, 3 * n),
            source: PathSource::ReturnPairs { pairs: self.pairs.len(), misfit_m: 0.0 },
        };
        let mut scale_m = 0.05;
        for _ in 0..25 {
            let mut normal = DMatrix::zeros(3 * n, 3 * n);
            let mut right = DVector::zeros(3 * n);
            let mut norms = Vec::with_capacity(self.pairs.len());
            for pair in self.pairs {
                let (sensor, _) = path.at(pair.time_s);
                let (e, direction, range_m) = Self::misalignment(pair, &sensor);
                norms.push(e.norm());
                let weight = (2.0 * scale_m / e.norm().max(1e-9)).min(1.0);
                if e.norm() > 6.0 * scale_m {
                    continue;
                }
                let lever = separation_m(pair) / range_m;
                let across = Matrix3::identity() - direction * direction.transpose();
                let u = self.u(pair.time_s);
                let powers = [1.0, u, u * u, u * u * u, u * u * u * u];
                for (a, pa) in powers[..n].iter().enumerate() {
                    // moving the sensor by s turns the direction by s/range: e changes by -lever · across · s
                    let mut block = right.fixed_rows_mut::<3>(3 * a);
                    block += e * (weight * lever * pa);
                    for (b, pb) in powers[..n].iter().enumerate() {
                        let mut block = normal.fixed_view_mut::<3, 3>(3 * a, 3 * b);
                        block += across * (weight * lever * lever * pa * pb);
                    }
                }
            }
            let Some(inverse) = normal.try_inverse() else {
                return Err(PathRefused::NoIntersection { misfit_m: scale_m });
            };
            let step = &inverse * right;
            for (a, c) in path.coefficients.iter_mut().enumerate() {
                *c += step.fixed_rows::<3>(3 * a);
            }
            let middle = norms.len() / 2;
            norms.select_nth_unstable_by(middle, f64::total_cmp);
            // median of a Rayleigh variable is 1.1774 σ
            scale_m = (norms[middle] / 1.1774).max(1e-4);
            path.covariance = inverse * (scale_m * scale_m);
            if step.norm() < 1e-2 {
                break;
            }
        }
        // each return carries its share of the vector between the two
        let misfit_m = scale_m / std::f64::consts::SQRT_2;
        path.source = PathSource::ReturnPairs { pairs: self.pairs.len(), misfit_m };
        Ok(path)
    }

    /// Start: intersection of the rays by plain least squares, standing still, weighted by separation.
    fn start(&self, n: usize) -> Vec<Vector3<f64>> {
        let (mut normal, mut right) = (DMatrix::zeros(6, 6), DVector::zeros(6));
        for pair in self.pairs {
            let (first, last) = (Vector3::from(pair.first_m), Vector3::from(pair.last_m));
            let direction = (first - last).normalize();
            let across = Matrix3::identity() - direction * direction.transpose();
            let weight = separation_m(pair).powi(2);
            let u = self.u(pair.time_s);
            for (a, pa) in [1.0, u].into_iter().enumerate() {
                let mut block = right.fixed_rows_mut::<3>(3 * a);
                block += across * first * (weight * pa);
                for (b, pb) in [1.0, u].into_iter().enumerate() {
                    let mut block = normal.fixed_view_mut::<3, 3>(3 * a, 3 * b);
                    block += across * (weight * pa * pb);
                }
            }
        }
        let solution = normal.lu().solve(&right).unwrap_or_else(|| DVector::zeros(6));
        (0..n).map(|k| if k < 2 { solution.fixed_rows::<3>(3 * k).into_owned() } else { Vector3::zeros() }).collect()
    }

    /// Bayes' information criterion: twice the negative log-likelihood plus ln(n) for each coefficient.
    #[allow(clippy::cast_precision_loss)]
    fn score(&self, path: &SensorPath) -> f64 {
        let n = self.pairs.len() as f64;
        let PathSource::ReturnPairs { misfit_m, .. } = path.source else { return f64::INFINITY };
        4.0 * n * misfit_m.max(1e-5).ln() + 3.0 * path.coefficients.len() as f64 * (2.0 * n).ln()
    }

    fn check(&self, path: &SensorPath) -> Result<(), PathRefused> {
        if let PathSource::ReturnPairs { misfit_m, .. } = path.source
            && misfit_m > 0.2
        {
            return Err(PathRefused::NoIntersection { misfit_m });
        }
        #[allow(clippy::cast_precision_loss)]
        let ground_m = self.pairs.iter().map(|p| p.last_m[2]).sum::<f64>() / self.pairs.len() as f64;
        for u in [-1.0, 0.0, 1.0] {
            let time_s = self.middle_s + u * self.half_s;
            let (position, velocity) = path.at(time_s);
            let height_m = position.z - ground_m;
            if !(8.0..=12_000.0).contains(&height_m) {
                return Err(PathRefused::Height { height_m });
            }
            let range_m = self
                .pairs
                .iter()
                .map(|p| (position - Vector3::from(p.last_m)).norm())
                .fold(f64::INFINITY, f64::min)
                .max(height_m);
            let sigma_m = path.sigma_m(time_s).norm();
            if sigma_m > 0.05 * range_m {
                return Err(PathRefused::Undetermined { sigma_m, range_m });
            }
            let (speed_mps, climb_mps) = (velocity.xy().norm(), velocity.z);
            if !SPEEDS_MPS.contains(&speed_mps) || climb_mps.abs() > 0.35 * speed_mps + 2.0 {
                return Err(PathRefused::Speed { speed_mps, climb_mps });
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn noise(k: u64) -> f64 {
        // two uniform numbers by hash, about Gaussian by Irwin-Hall of four
        #[allow(clippy::cast_precision_loss)]
        let uniform = |i: u64| crate::sketch::mix(k * 8 + i) as f64 / u64::MAX as f64;
        ((0..4).map(uniform).sum::<f64>() - 2.0) * 3.0_f64.sqrt()
    }

    fn flight(noise_m: f64, count: u64) -> Vec<ReturnPair> {
        (0..count)
            .map(|k| {
                #[allow(clippy::cast_precision_loss)]
                let u = k as f64 / count as f64;
                let time_s = 100.0 + 4.0 * u;
                let sensor = Vector3::new(-100.0 + 50.0 * 4.0 * u, 300.0, 1_000.0);
                let across = -80.0 + 160.0 * ((crate::sketch::mix(k) % 1_000) as f64 / 1_000.0);
                let last = Vector3::new(-100.0 + 200.0 * u, across, 2.0 * noise(k));
                let direction = (sensor - last).normalize();
                #[allow(clippy::cast_precision_loss)]
                let first = last + direction * (3.0 + (k % 10) as f64);
                let wobble = |i: u64| Vector3::new(noise(k * 7 + i), noise(k * 11 + i), noise(k * 13 + i)) * noise_m;
                ReturnPair {
                    time_s,
                    first_m: (first + wobble(1)).into(),
                    last_m: (last + wobble(2)).into(),
                    scan_angle_deg: 0.0,
                }
            })
            .collect()
    }

    #[test]
    fn the_rays_of_a_flight_meet_in_the_sensor_within_the_sigma_given() {
        let path = path_from_return_pairs(&flight(0.01, 4_000), 100.0, 104.0).expect("a good flight");
        let (position, velocity) = path.at(102.0);
        let sigma = path.sigma_m(102.0);
        let miss = position - Vector3::new(0.0, 300.0, 1_000.0);
        for axis in 0..3 {
            assert!(miss[axis].abs() < 4.0 * sigma[axis], "{miss} against {sigma}");
            assert!(sigma[axis] < 5.0);
        }
        assert!((velocity.x - 50.0).abs() < 1.0 && velocity.y.abs() < 1.0);
    }

    #[test]
    fn pairs_of_unrelated_points_are_refused() {
        let mut pairs = flight(0.01, 500);
        for (k, pair) in pairs.iter_mut().enumerate() {
            let k = k as u64;
            pair.first_m = [noise(k) * 30.0, noise(k + 9_000) * 30.0, 5.0 + noise(k + 70_000).abs() * 20.0];
        }
        assert!(path_from_return_pairs(&pairs, 100.0, 104.0).is_err());
    }

    #[test]
    fn a_handful_of_pairs_is_not_enough() {
        let refused = path_from_return_pairs(&flight(0.01, 20), 100.0, 104.0).expect_err("too few");
        assert!(matches!(refused, PathRefused::TooFewPairs { .. }));
    }
}
