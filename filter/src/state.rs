//! The states: what the filter estimates, where each stands in the error vector, and how each changes by itself.
//!
//! | index | error state | unit | model |
//! |---|---|---|---|
//! | 0–2 | position north, east, down | m | mechanisation |
//! | 3–5 | velocity north, east, down | m/s | mechanisation |
//! | 6–8 | attitude, rotation vector in n, `C ← exp([δψ]×) C` | rad | mechanisation |
//! | 9–11 | gyro bias | rad/s | first-order Gauss-Markov |
//! | 12–14 | accelerometer bias | m/s² | first-order Gauss-Markov |
//! | 15–17 | gyro scale error | 1 | first-order Gauss-Markov |
//! | 18–20 | accelerometer scale error | 1 | first-order Gauss-Markov |
//! | then, as switched on: | | | |
//! | | GNSS lever arm in b | m | constant |
//! | | correlated GNSS error north, east, down, in standard deviations of a fix | 1 | first-order Gauss-Markov |
//! | | delay of GNSS positions against the IMU | s | constant |
//! | | delay of GNSS velocities against the IMU | s | constant |
//! | | odometer scale | 1 | constant |
//! | | pitch and yaw of the vehicle in b | rad | constant |
//! | | sideways and vertical slip of the vehicle | m/s | first-order Gauss-Markov |
//! | | calibration: what ties depend on beside the pose, as their sightings say | any | constant |
//!
//! Errors are *true minus nominal*. Landmarks and clones stand behind these in slots of their own.

use nalgebra::{UnitQuaternion, Vector3};

use crate::earth::{meridian_radius_m, prime_vertical_radius_m};
use crate::strapdown::{ImuErrors, NavState};

/// First index of position.
pub const POSITION: usize = 0;
/// First index of velocity.
pub const VELOCITY: usize = 3;
/// First index of attitude.
pub const ATTITUDE: usize = 6;
/// First index of the gyro biases.
pub const GYRO_BIAS: usize = 9;
/// First index of the accelerometer biases.
pub const ACCELEROMETER_BIAS: usize = 12;
/// First index of the gyro scale errors.
pub const GYRO_SCALE: usize = 15;
/// First index of the accelerometer scale errors.
pub const ACCELEROMETER_SCALE: usize = 18;
/// States that every filter has.
pub const CORE: usize = 21;
/// States of the mechanisation.
pub const NAV: usize = 9;

/// Where the optional states stand.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Layout {
    /// GNSS lever arm: three.
    pub gnss_lever_arm: Option<usize>,
    /// Correlated GNSS error: three.
    pub gnss_error: Option<usize>,
    /// Delay of GNSS positions: one.
    pub gnss_delay: Option<usize>,
    /// Delay of GNSS velocities: one.
    pub velocity_delay: Option<usize>,
    /// Odometer scale: one.
    pub odometer_scale: Option<usize>,
    /// Pitch and yaw of the vehicle: two.
    pub mounting: Option<usize>,
    /// Slip right and down: two.
    pub slip: Option<usize>,
    /// Calibration: from here to the end.
    pub calibration: Option<usize>,
    /// States before the landmarks.
    pub base: usize,
}

/// Which optional states there are.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[allow(clippy::struct_excessive_bools)] // switches, each of its own
pub struct Optional {
    /// GNSS lever arm.
    pub gnss_lever_arm: bool,
    /// Correlated GNSS error.
    pub gnss_error: bool,
    /// Delay of GNSS positions.
    pub gnss_delay: bool,
    /// Delay of GNSS velocities.
    pub velocity_delay: bool,
    /// Odometer scale.
    pub odometer_scale: bool,
    /// Pitch and yaw of the vehicle.
    pub mounting: bool,
    /// Slip of the vehicle.
    pub slip: bool,
    /// Number of calibration states.
    pub calibration: usize,
}

impl Layout {
    /// A layout of the core states and those switched on.
    #[must_use]
    pub fn new(optional: &Optional) -> Self {
        let mut base = CORE;
        let mut place = |wanted: bool, count: usize| {
            wanted.then(|| {
                base += count;
                base - count
            })
        };
        let mut layout = Self {
            gnss_lever_arm: place(optional.gnss_lever_arm, 3),
            gnss_error: place(optional.gnss_error, 3),
            gnss_delay: place(optional.gnss_delay, 1),
            velocity_delay: place(optional.velocity_delay, 1),
            odometer_scale: place(optional.odometer_scale, 1),
            mounting: place(optional.mounting, 2),
            slip: place(optional.slip, 2),
            calibration: place(optional.calibration > 0, optional.calibration),
            base: 0,
        };
        layout.base = base;
        layout
    }

    /// States that the nominal holds; the calibration is counted from zero and stands in the errors alone.
    #[must_use]
    pub fn nominal_states(&self) -> usize {
        self.calibration.unwrap_or(self.base)
    }

    /// States that are smoothed at every node: pose, and what changes within seconds.
    #[must_use]
    pub fn quick_states(&self) -> Vec<usize> {
        let gnss_error = self.gnss_error.into_iter().flat_map(|at| at..at + 3);
        let slip = self.slip.into_iter().flat_map(|at| at..at + 2);
        (0..NAV).chain(gnss_error).chain(slip).collect()
    }

    /// Names of the states with their units, but for the calibration, whose meaning the ties know.
    #[must_use]
    pub fn names(&self) -> Vec<String> {
        let mut names = vec![String::new(); self.nominal_states()];
        let mut name = |at: Option<usize>, parts: &[&str]| {
            for (k, part) in parts.iter().enumerate() {
                if let Some(at) = at {
                    names[at + k] = String::from(*part);
                }
            }
        };
        name(Some(POSITION), &["position north [m]", "position east [m]", "position down [m]"]);
        name(Some(VELOCITY), &["velocity north [m/s]", "velocity east [m/s]", "velocity down [m/s]"]);
        name(Some(ATTITUDE), &["attitude about north [rad]", "attitude about east [rad]", "attitude about down [rad]"]);
        name(Some(GYRO_BIAS), &["gyro bias x [rad/s]", "gyro bias y [rad/s]", "gyro bias z [rad/s]"]);
        name(
            Some(ACCELEROMETER_BIAS),
            &["accelerometer bias x [m/s²]", "accelerometer bias y [m/s²]", "accelerometer bias z [m/s²]"],
        );
        name(Some(GYRO_SCALE), &["gyro scale x", "gyro scale y", "gyro scale z"]);
        name(Some(ACCELEROMETER_SCALE), &["accelerometer scale x", "accelerometer scale y", "accelerometer scale z"]);
        name(self.gnss_lever_arm, &["GNSS lever arm x [m]", "GNSS lever arm y [m]", "GNSS lever arm z [m]"]);
        name(self.gnss_error, &["GNSS error north", "GNSS error east", "GNSS error down"]);
        name(self.gnss_delay, &["GNSS position delay [s]"]);
        name(self.velocity_delay, &["GNSS velocity delay [s]"]);
        name(self.odometer_scale, &["odometer scale"]);
        name(self.mounting, &["vehicle pitch [rad]", "vehicle yaw [rad]"]);
        name(self.slip, &["slip right [m/s]", "slip down [m/s]"]);
        names
    }
}

/// What is estimated beside the pose: the errors of the sensors.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Parameters {
    /// Errors of the IMU.
    pub imu: ImuErrors,
    /// From the IMU to the antenna, body axes \[m\].
    pub gnss_lever_arm_m: Vector3<f64>,
    /// Correlated GNSS error north, east, down, in standard deviations of a fix.
    pub gnss_error_ned: Vector3<f64>,
    /// A position stamped t was measured at t plus this \[s\], on the clock of the IMU.
    pub gnss_delay_s: f64,
    /// The same of GNSS velocities \[s\].
    pub velocity_delay_s: f64,
    /// The odometer reads (1 + scale) times the speed.
    pub odometer_scale: f64,
    /// Pitch and yaw of the vehicle's forward axis in b \[rad\].
    pub mounting_rad: [f64; 2],
    /// Velocity of the vehicle to the right and down \[m/s\].
    pub slip_mps: [f64; 2],
}

impl Parameters {
    /// With what changes slowly taken from the way between two others, 0 at the first and 1 at the second.
    #[must_use]
    pub fn between(self, first: &Self, second: &Self, share: f64) -> Self {
        let way = |a: f64, b: f64| a + share * (b - a);
        Self {
            imu: first.imu.towards(&second.imu, share),
            gnss_lever_arm_m: first.gnss_lever_arm_m.lerp(&second.gnss_lever_arm_m, share),
            gnss_delay_s: way(first.gnss_delay_s, second.gnss_delay_s),
            velocity_delay_s: way(first.velocity_delay_s, second.velocity_delay_s),
            odometer_scale: way(first.odometer_scale, second.odometer_scale),
            mounting_rad: std::array::from_fn(|k| way(first.mounting_rad[k], second.mounting_rad[k])),
            ..self
        }
    }
}

/// The point of linearisation: pose and parameters.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Nominal {
    /// Position, velocity, attitude.
    pub nav: NavState,
    /// Parameters.
    pub parameters: Parameters,
}

impl Nominal {
    /// Adds an error vector to the nominal.
    pub fn shift(&mut self, layout: &Layout, error: &[f64]) {
        let three = |at: usize| Vector3::new(error[at], error[at + 1], error[at + 2]);
        shift_nav(&mut self.nav, &three(POSITION), &three(VELOCITY), &three(ATTITUDE));
        let p = &mut self.parameters;
        p.imu.gyro_bias_radps += three(GYRO_BIAS);
        p.imu.accelerometer_bias_mps2 += three(ACCELEROMETER_BIAS);
        p.imu.gyro_scale += three(GYRO_SCALE);
        p.imu.accelerometer_scale += three(ACCELEROMETER_SCALE);
        if let Some(at) = layout.gnss_lever_arm {
            p.gnss_lever_arm_m += three(at);
        }
        if let Some(at) = layout.gnss_error {
            p.gnss_error_ned += three(at);
        }
        let one = |at: Option<usize>| at.map_or(0.0, |at| error[at]);
        p.gnss_delay_s += one(layout.gnss_delay);
        p.velocity_delay_s += one(layout.velocity_delay);
        p.odometer_scale += one(layout.odometer_scale);
        for k in 0..2 {
            p.mounting_rad[k] += one(layout.mounting.map(|at| at + k));
            p.slip_mps[k] += one(layout.slip.map(|at| at + k));
        }
    }

    /// The parameters in the order of the states, from the gyro biases on.
    #[must_use]
    pub fn parameter_values(&self, layout: &Layout) -> Vec<f64> {
        let zero = Self { parameters: Parameters::default(), ..*self };
        let mut values = self.minus(&zero, layout);
        values.truncate(layout.nominal_states());
        values.split_off(NAV)
    }

    /// Lets the parameters decay by the factors of the states from the gyro biases on.
    pub fn decay(&mut self, layout: &Layout, factors: &[f64]) {
        let three = |at: usize| Vector3::new(factors[at - NAV], factors[at - NAV + 1], factors[at - NAV + 2]);
        let p = &mut self.parameters;
        p.imu.gyro_bias_radps.component_mul_assign(&three(GYRO_BIAS));
        p.imu.accelerometer_bias_mps2.component_mul_assign(&three(ACCELEROMETER_BIAS));
        p.imu.gyro_scale.component_mul_assign(&three(GYRO_SCALE));
        p.imu.accelerometer_scale.component_mul_assign(&three(ACCELEROMETER_SCALE));
        if let Some(at) = layout.gnss_error {
            p.gnss_error_ned.component_mul_assign(&three(at));
        }
        if let Some(at) = layout.slip {
            for k in 0..2 {
                p.slip_mps[k] *= factors[at + k - NAV];
            }
        }
    }

    /// The error vector that leads from another nominal to this one: the inverse of [`Nominal::shift`].
    #[must_use]
    pub fn minus(&self, other: &Self, layout: &Layout) -> Vec<f64> {
        let mut error = vec![0.0; layout.base];
        let mut three = |at: usize, v: Vector3<f64>| error[at..at + 3].copy_from_slice(v.as_slice());
        let (position, velocity, attitude) = nav_minus(&self.nav, &other.nav);
        three(POSITION, position);
        three(VELOCITY, velocity);
        three(ATTITUDE, attitude);
        let (a, b) = (&self.parameters, &other.parameters);
        three(GYRO_BIAS, a.imu.gyro_bias_radps - b.imu.gyro_bias_radps);
        three(ACCELEROMETER_BIAS, a.imu.accelerometer_bias_mps2 - b.imu.accelerometer_bias_mps2);
        three(GYRO_SCALE, a.imu.gyro_scale - b.imu.gyro_scale);
        three(ACCELEROMETER_SCALE, a.imu.accelerometer_scale - b.imu.accelerometer_scale);
        if let Some(at) = layout.gnss_lever_arm {
            three(at, a.gnss_lever_arm_m - b.gnss_lever_arm_m);
        }
        if let Some(at) = layout.gnss_error {
            three(at, a.gnss_error_ned - b.gnss_error_ned);
        }
        let mut one = |at: Option<usize>, v: f64| {
            if let Some(at) = at {
                error[at] = v;
            }
        };
        one(layout.gnss_delay, a.gnss_delay_s - b.gnss_delay_s);
        one(layout.velocity_delay, a.velocity_delay_s - b.velocity_delay_s);
        one(layout.odometer_scale, a.odometer_scale - b.odometer_scale);
        for k in 0..2 {
            one(layout.mounting.map(|at| at + k), a.mounting_rad[k] - b.mounting_rad[k]);
            one(layout.slip.map(|at| at + k), a.slip_mps[k] - b.slip_mps[k]);
        }
        error
    }
}

/// Adds errors of position \[m\], velocity \[m/s\] and attitude \[rad\] in north-east-down to a pose.
pub fn shift_nav(nav: &mut NavState, position: &Vector3<f64>, velocity: &Vector3<f64>, attitude: &Vector3<f64>) {
    let latitude_rad = nav.geodetic.x;
    nav.geodetic.x += position.x / (meridian_radius_m(latitude_rad) + nav.geodetic.z);
    nav.geodetic.y += position.y / ((prime_vertical_radius_m(latitude_rad) + nav.geodetic.z) * latitude_rad.cos());
    nav.geodetic.z -= position.z;
    nav.velocity_ned_mps += velocity;
    nav.ned_from_body = UnitQuaternion::from_scaled_axis(*attitude) * nav.ned_from_body;
}

/// Errors of position, velocity and attitude that lead from the second pose to the first: the inverse of [`shift_nav`].
#[must_use]
pub fn nav_minus(nav: &NavState, other: &NavState) -> (Vector3<f64>, Vector3<f64>, Vector3<f64>) {
    let latitude_rad = other.geodetic.x;
    let d = nav.geodetic - other.geodetic;
    let position = Vector3::new(
        d.x * (meridian_radius_m(latitude_rad) + other.geodetic.z),
        d.y * (prime_vertical_radius_m(latitude_rad) + other.geodetic.z) * latitude_rad.cos(),
        -d.z,
    );
    let attitude = (nav.ned_from_body * other.ned_from_body.inverse()).scaled_axis();
    (position, nav.velocity_ned_mps - other.velocity_ned_mps, attitude)
}
