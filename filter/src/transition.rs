//! How errors pass from one moment to the next.
//!
//! The error model of the mechanisation in north, east, down with errors counted as true minus nominal (Groves, *Principles
//! of GNSS, Inertial, and Multisensor Integrated Navigation Systems*, 2nd ed., section 14.2.4, there with the opposite
//! sign; Shin, *Estimation techniques for low-cost inertial navigation*, 2005, section 2.3):
//!
//! ```text
//! δṗ = δv - ω_en × δp - …          position, with the curvature terms
//! δv̇ = -[f]× δψ - C (δb_a + f_b ∘ δs_a) - (2 ω_ie + ω_en) × δv + v × (2 δω_ie + δω_en) + δg
//! δψ̇ = -ω_in × δψ - δω_in - C (δb_g + ω_b ∘ δs_g)
//! ```

use nalgebra::{Matrix3, Vector3};

use crate::state::{
    ACCELEROMETER_BIAS, ACCELEROMETER_SCALE, ATTITUDE, CORE, GYRO_BIAS, GYRO_SCALE, NAV, POSITION, VELOCITY,
};
use crate::strapdown::{Increment, Locality, NavState, StepTrace};

/// Sums over the steps of the mechanisation since the covariance was last moved.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct StepSums {
    /// Time \[s\].
    pub interval_s: f64,
    /// Angle turned through \[rad\].
    pub turned_rad: f64,
    force_ned_mps: Vector3<f64>,
    rotation_s: Matrix3<f64>,
    rotation_force: Matrix3<f64>,
    rotation_angle: Matrix3<f64>,
}

impl StepSums {
    /// Adds a step.
    pub fn add(&mut self, increment: &Increment, trace: &StepTrace) {
        let c = &trace.ned_from_body;
        self.interval_s += increment.interval_s;
        self.turned_rad += increment.angle_rad.norm();
        self.force_ned_mps += trace.force_ned_mps;
        self.rotation_s += c * increment.interval_s;
        for k in 0..3 {
            for i in 0..3 {
                self.rotation_force[(i, k)] += c[(i, k)] * increment.velocity_mps[k];
                self.rotation_angle[(i, k)] += c[(i, k)] * increment.angle_rad[k];
            }
        }
    }
}

/// Transition of the core states: nine full rows for position, velocity and attitude; the others only decay.
#[derive(Debug, Clone, PartialEq)]
pub struct Transition {
    /// Rows of position, velocity, attitude over the core states.
    pub nav: [[f64; CORE]; NAV],
    /// Factors of the states from the gyro biases on.
    pub decay: Vec<f64>,
}

impl Transition {
    /// The identity for `base` states.
    #[must_use]
    pub fn identity(base: usize) -> Self {
        let mut nav = [[0.0; CORE]; NAV];
        for (i, row) in nav.iter_mut().enumerate() {
            row[i] = 1.0;
        }
        Self { nav, decay: vec![1.0; base - NAV] }
    }

    /// The transition over the steps summed: `I + F T + (F T)² / 2`; decays are left at one.
    #[must_use]
    pub fn of(sums: &StepSums, nav: &NavState, locality: &Locality, base: usize) -> Self {
        let ft = rates_times_interval(sums, nav, locality);
        let mut transition = Self::identity(base);
        for i in 0..NAV {
            let row = &mut transition.nav[i];
            for j in 0..CORE {
                row[j] += ft[i][j];
            }
            for (k, f) in ft[i].iter().enumerate().take(NAV) {
                let half = 0.5 * f;
                if half != 0.0 {
                    for j in 0..CORE {
                        row[j] += half * ft[k][j];
                    }
                }
            }
        }
        transition
    }

    /// This transition after another: the product of both.
    pub fn follow(&mut self, before: &Self) {
        let mut product = [[0.0; CORE]; NAV];
        for (out, row) in product.iter_mut().zip(&self.nav) {
            for (factor, of_before) in row.iter().zip(&before.nav) {
                for (o, b) in out.iter_mut().zip(of_before) {
                    *o += factor * b;
                }
            }
            for k in NAV..CORE {
                out[k] += row[k] * before.decay[k - NAV];
            }
        }
        self.nav = product;
        for (a, b) in self.decay.iter_mut().zip(&before.decay) {
            *a *= b;
        }
    }
}

/// `F T` of the nine mechanisation states over the core.
fn rates_times_interval(sums: &StepSums, nav: &NavState, locality: &Locality) -> [[f64; CORE]; NAV] {
    let t = sums.interval_s;
    let (rm, rn) = (locality.meridian_m, locality.prime_vertical_m);
    let (cos, tan) = locality.cos_tan;
    let v = nav.velocity_ned_mps;
    let earth = locality.earth_rate_radps;
    let transport = locality.transport_rate_radps(&v);
    let mut f = [[0.0; CORE]; NAV];
    let mut put = |row: usize, column: usize, m: &Matrix3<f64>, factor: f64| {
        for i in 0..3 {
            for j in 0..3 {
                f[row + i][column + j] += factor * m[(i, j)];
            }
        }
    };
    // position in metres of the moving frame: δlat = δn / rm, δlon cos = δe / rn; down is free
    let position =
        Matrix3::new(-v.z / rm, 0.0, v.x / rm, v.y * tan / rm, -v.z / rn - v.x * tan / rm, v.y / rn, 0.0, 0.0, 0.0);
    put(POSITION, POSITION, &position, t);
    put(POSITION, VELOCITY, &Matrix3::identity(), t);

    // how earth rate, transport rate and gravity change with position and velocity
    let earth_by_position = Matrix3::new(earth.z / rm, 0.0, 0.0, 0.0, 0.0, 0.0, -earth.x / rm, 0.0, 0.0);
    let transport_by_velocity = Matrix3::new(0.0, 1.0 / rn, 0.0, -1.0 / rm, 0.0, 0.0, 0.0, -tan / rn, 0.0);
    let transport_by_position = Matrix3::new(
        0.0,
        0.0,
        v.y / (rn * rn),
        0.0,
        0.0,
        -v.x / (rm * rm),
        -v.y / (cos * cos * rm * rn),
        0.0,
        -v.y * tan / (rn * rn),
    );
    let gravity_by_position =
        Matrix3::new(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 2.0 * locality.gravity_mps2 / (rm * rn).sqrt());
    let v_cross = v.cross_matrix();
    let velocity_by_position = v_cross * (2.0 * earth_by_position + transport_by_position) + gravity_by_position;
    put(VELOCITY, POSITION, &velocity_by_position, t);
    let coriolis = (2.0 * earth + transport).cross_matrix();
    put(VELOCITY, VELOCITY, &(v_cross * transport_by_velocity - coriolis), t);
    put(VELOCITY, ATTITUDE, &sums.force_ned_mps.cross_matrix(), -1.0);
    put(VELOCITY, ACCELEROMETER_BIAS, &sums.rotation_s, -1.0);
    put(VELOCITY, ACCELEROMETER_SCALE, &sums.rotation_force, -1.0);

    put(ATTITUDE, POSITION, &(earth_by_position + transport_by_position), -t);
    put(ATTITUDE, VELOCITY, &transport_by_velocity, -t);
    put(ATTITUDE, ATTITUDE, &(earth + transport).cross_matrix(), -t);
    put(ATTITUDE, GYRO_BIAS, &sums.rotation_s, -1.0);
    put(ATTITUDE, GYRO_SCALE, &sums.rotation_angle, -1.0);
    f
}
