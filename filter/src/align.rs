//! Alignment: where the trajectory begins, without anybody typing it.
//!
//! At rest the accelerometers give the level and, where the gyros are good enough, the earth's rotation gives the heading
//! (Groves, 2nd ed., section 5.6). On the move the course of GNSS is the heading of a platform that moves forward; the
//! gyros carry it back to the beginning of the data.

use nalgebra::{UnitQuaternion, Vector3};

use crate::aiding::GnssFix;
use crate::earth::{EARTH_RATE_RADPS, earth_rate_ned_radps, ecef_from_geodetic, ned_from_ecef, normal_gravity_mps2};
use crate::events::Inputs;
use crate::frames::ned_from_body;
use crate::imu::Imu;
use crate::options::{InitialState, Options};
use crate::rest::Rest;
use crate::strapdown::NavState;

/// Why a beginning cannot be found.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum AlignError {
    /// IMU and GNSS do not overlap.
    #[error(
        "GNSS from {} s to {} s and IMU from {} s to {} s do not overlap; are both on GPS time, and of the same week?",
        gnss_s.0, gnss_s.1, imu_s.0, imu_s.1
    )]
    NoOverlap {
        /// First and last fix \[s\].
        gnss_s: (f64, f64),
        /// First and last sample \[s\].
        imu_s: (f64, f64),
    },
    /// No GNSS at all.
    #[error("without GNSS the beginning is not known: give [gnss], or the beginning in [initial]")]
    NoGnss,
    /// Neither rest nor motion to take a heading from.
    #[error(
        "no heading can be had: the platform never moves faster than {moving_mps} m/s (fastest: {fastest_mps:.1} m/s) and its \
         gyros do not feel the earth turn; give the beginning in [initial]"
    )]
    NoHeading {
        /// Speed from which a course counts \[m/s\].
        moving_mps: f64,
        /// Fastest \[m/s\].
        fastest_mps: f64,
    },
    /// The accelerometers do not feel gravity.
    #[error(
        "at rest the specific force is {force_mps2:.3} m/s² where gravity is {gravity_mps2:.3} m/s²; check unit, axes and kind \
         (rates or increments) of the IMU"
    )]
    NotGravity {
        /// Measured \[m/s²\].
        force_mps2: f64,
        /// Due \[m/s²\].
        gravity_mps2: f64,
    },
    /// The accelerometers feel gravity from the wrong side.
    #[error(
        "gravity points {axis} in the IMU's axes, down was due: declare its axes (axes = \"{suggestion}\" or the like)"
    )]
    WrongAxes {
        /// Where it points.
        axis: &'static str,
        /// Axes to try.
        suggestion: &'static str,
    },
    /// The clocks of IMU and GNSS differ by whole seconds.
    #[error(
        "the gyros turn {} s {} than the course of GNSS (correlation {correlation:.2}): {}",
        lag_s.abs(), if *lag_s > 0.0 { "later" } else { "earlier" },
        if (lag_s.abs() - 18.0).abs() < 1.5 {
            "18 s are the leap seconds between UTC and GPS time; bring both files to GPS time"
        } else {
            "bring both files to one clock, or give [gnss] delay_s"
        }
    )]
    ClockSlip {
        /// How much later the IMU turns \[s\].
        lag_s: f64,
        /// Correlation of yaw rate and rate of the course at that lag.
        correlation: f64,
    },
    /// Gyros and course disagree.
    #[error(
        "the gyros turn the {} way than the course of GNSS (correlation {correlation:.2}): check the axes of the IMU, or its clock",
        if *correlation < -0.5 { "other" } else { "a different" }
    )]
    NotTurning {
        /// Correlation of yaw rate and rate of the course.
        correlation: f64,
    },
}

/// Speed from which a course is a heading \[m/s\].
const MOVING_MPS: f64 = 3.0;
/// Gyrocompassing better than this is used \[rad\].
const COMPASS_RAD: f64 = 1.0 * std::f64::consts::PI / 180.0;
/// Standard deviation of a heading from the course, beside that of the course \[rad\].
const COURSE_RAD: f64 = 3.0 * std::f64::consts::PI / 180.0;
/// Standard deviation of level attitude on the move \[rad\].
const LEVEL_RAD: f64 = 3.0 * std::f64::consts::PI / 180.0;
/// Largest accelerometer bias that may hide in the level, as a share of gravity.
const GRAVITY_SHARE: f64 = 0.05;

/// Finds the beginning. Gives it with a sentence on how it was found.
///
/// # Errors
/// [`AlignError`].
pub fn align(inputs: &Inputs, options: &Options, rests: &[Rest]) -> Result<(InitialState, String), AlignError> {
    let (first_s, last_s) = inputs.imu.span_s();
    let usable: Vec<&GnssFix> = inputs.gnss.iter().filter(|f| f.time_s >= first_s && f.time_s <= last_s).collect();
    let (Some(first), Some(last)) = (inputs.gnss.first(), inputs.gnss.last()) else { return Err(AlignError::NoGnss) };
    if usable.len() < 2 {
        return Err(AlignError::NoOverlap { gnss_s: (first.time_s, last.time_s), imu_s: (first_s, last_s) });
    }
    let start = usable[0];
    check_gravity(&inputs.imu, rests, start)?;
    check_turning(&inputs.imu, &usable)?;
    if let Some(aligned) = at_rest(inputs, options, rests, &usable) {
        return Ok(aligned);
    }
    on_the_move(inputs, options, rests, &usable)
}

/// Mean rates over a span: rotation \[rad/s\] and specific force \[m/s²\].
fn mean_rates(imu: &Imu, from_s: f64, to_s: f64) -> Option<(Vector3<f64>, Vector3<f64>, f64)> {
    let samples = imu.samples();
    let from = samples.partition_point(|s| s.time_s < from_s).max(1);
    let to = samples.partition_point(|s| s.time_s <= to_s);
    if to <= from + 1 {
        return None;
    }
    let sum = samples[from..to]
        .iter()
        .fold((Vector3::zeros(), Vector3::zeros()), |a, s| (a.0 + s.angle_rad, a.1 + s.velocity_mps));
    let interval_s = samples[to - 1].time_s - samples[from - 1].time_s;
    Some((sum.0 / interval_s, sum.1 / interval_s, interval_s))
}

/// At rest the specific force is gravity, upwards; on average it is on the move as well.
fn check_gravity(imu: &Imu, rests: &[Rest], fix: &GnssFix) -> Result<(), AlignError> {
    let gravity_mps2 = normal_gravity_mps2(fix.geodetic.x, fix.geodetic.z);
    let (span, tolerance) = match rests.iter().max_by(|a, b| (a.end_s - a.start_s).total_cmp(&(b.end_s - b.start_s))) {
        Some(rest) => ((rest.start_s, rest.end_s), GRAVITY_SHARE),
        None => (imu.span_s(), 2.0 * GRAVITY_SHARE),
    };
    let Some((_, force, _)) = mean_rates(imu, span.0, span.1) else { return Ok(()) };
    let force_mps2 = force.norm();
    if (force_mps2 / gravity_mps2 - 1.0).abs() > tolerance {
        return Err(AlignError::NotGravity { force_mps2, gravity_mps2 });
    }
    let up = -force / force_mps2; // gravity in body axes
    let (axis, suggestion) = match up.iamax() {
        0 if up.x > 0.0 => ("forward", "DRB"),
        0 => ("back", "URF"),
        1 if up.y > 0.0 => ("right", "FDL"),
        1 => ("left", "FUR"),
        _ if up.z < 0.0 => ("up", "FLU or RFU"),
        _ => return Ok(()),
    };
    Err(AlignError::WrongAxes { axis, suggestion })
}

/// Yaw rate of the gyros against the rate of the course: axes, and clocks that differ by whole seconds.
fn check_turning(imu: &Imu, fixes: &[&GnssFix]) -> Result<(), AlignError> {
    let rates = course_rates(fixes);
    let spread = rates.iter().map(|r| r.2 * r.2).sum::<f64>();
    #[allow(clippy::cast_precision_loss)]
    let turns_enough = rates.len() >= 20 && (spread / rates.len() as f64).sqrt() > 0.03;
    if !turns_enough {
        return Ok(());
    }
    let correlation_at = |lag_s: f64| {
        let (mut xx, mut yy, mut xy) = (0.0, 0.0, 0.0);
        for (from_s, to_s, rate) in &rates {
            if let Some((gyro, ..)) = mean_rates(imu, from_s + lag_s, to_s + lag_s) {
                xx += rate * rate;
                yy += gyro.z * gyro.z;
                xy += rate * gyro.z;
            }
        }
        xy / (xx * yy).sqrt().max(1e-12)
    };
    let correlation = correlation_at(0.0);
    if correlation > 0.8 {
        return Ok(());
    }
    let best = (-LONGEST_SLIP_S..=LONGEST_SLIP_S)
        .map(|lag| (f64::from(lag), correlation_at(f64::from(lag))))
        .max_by(|a, b| a.1.total_cmp(&b.1));
    match best {
        Some((lag_s, at_lag)) if lag_s.abs() >= 2.0 && at_lag > 0.7 && correlation < 0.7 * at_lag => {
            Err(AlignError::ClockSlip { lag_s, correlation: at_lag })
        }
        _ if correlation < 0.3 => Err(AlignError::NotTurning { correlation }),
        _ => Ok(()),
    }
}

/// Longest difference of clocks that is looked for \[s\]: beyond the leap seconds between UTC and GPS time.
const LONGEST_SLIP_S: i32 = 40;

/// Rates of the course of a moving platform: from and to \[s\], and the rate \[rad/s\].
fn course_rates(fixes: &[&GnssFix]) -> Vec<(f64, f64, f64)> {
    let mut rates = Vec::new();
    let mut last: Option<(f64, f64)> = None;
    let mut next_s = f64::NEG_INFINITY;
    for pair in fixes.windows(2) {
        if pair[1].time_s < next_s {
            continue;
        }
        let (speed, course) = course_of(pair[0], pair[1]);
        // the receiver's velocity is that of the fix, a difference of positions that of the middle
        let middle_s =
            if pair[0].velocity.is_some() { pair[0].time_s } else { 0.5 * (pair[0].time_s + pair[1].time_s) };
        if speed < MOVING_MPS || pair[1].time_s - pair[0].time_s > 3.0 {
            last = None;
            continue;
        }
        if let Some((before_s, before)) = last {
            rates.push((before_s, middle_s, wrapped(course - before) / (middle_s - before_s)));
        }
        last = Some((middle_s, course));
        next_s = pair[1].time_s + 0.9;
    }
    rates
}

/// Speed \[m/s\] and course \[rad\] from one fix to another; the receiver's velocity where it has one.
fn course_of(a: &GnssFix, b: &GnssFix) -> (f64, f64) {
    let v = velocity_of(a, b);
    (v.x.hypot(v.y), v.y.atan2(v.x))
}

fn velocity_of(a: &GnssFix, b: &GnssFix) -> Vector3<f64> {
    if let Some(v) = &a.velocity {
        return v.ned_mps;
    }
    let moved = ecef_from_geodetic(&b.geodetic) - ecef_from_geodetic(&a.geodetic);
    ned_from_ecef(a.geodetic.x, a.geodetic.y) * moved / (b.time_s - a.time_s)
}

fn wrapped(angle_rad: f64) -> f64 {
    (angle_rad + std::f64::consts::PI).rem_euclid(std::f64::consts::TAU) - std::f64::consts::PI
}

/// Roll and pitch of a mean specific force at rest \[rad\].
fn level(force: &Vector3<f64>) -> (f64, f64) {
    ((-force.y).atan2(-force.z), force.x.atan2(force.y.hypot(force.z)))
}

/// The beginning at the first rest, when the gyros feel the earth turn.
fn at_rest(inputs: &Inputs, options: &Options, rests: &[Rest], fixes: &[&GnssFix]) -> Option<(InitialState, String)> {
    let early = rests.iter().take_while(|r| r.start_s <= fixes[0].time_s + 5.0);
    let rest = early.max_by(|a, b| (a.end_s - a.start_s).total_cmp(&(b.end_s - b.start_s)))?;
    let (rate, force, interval_s) = mean_rates(&inputs.imu, rest.start_s, rest.end_s)?;
    let fix = fixes.iter().find(|f| f.time_s >= rest.start_s && f.time_s <= rest.end_s)?;
    let (roll, pitch) = level(&force);
    let noise = &options.noise;
    let sigma_rate =
        (noise.gyro_bias_radps * noise.switch_on.max(1.0)).hypot(noise.angle_random_walk / interval_s.sqrt());
    let heading_sigma = sigma_rate / (EARTH_RATE_RADPS * fix.geodetic.x.cos());
    if heading_sigma > COMPASS_RAD {
        return None;
    }
    let level_rate = ned_from_body(roll, pitch, 0.0) * rate;
    let heading = (-level_rate.y).atan2(level_rate.x);
    let level_sigma = accelerometer_level(options);
    let nav = NavState {
        time_s: rest.start_s.max(inputs.imu.span_s().0),
        geodetic: fix.geodetic,
        velocity_ned_mps: Vector3::zeros(),
        ned_from_body: ned_from_body(roll, pitch, heading),
    };
    let how = format!(
        "aligned at rest from {:.1} s to {:.1} s: heading {:.2}° ± {:.2}° by the earth's rotation",
        rest.start_s,
        rest.end_s,
        heading.to_degrees(),
        heading_sigma.to_degrees()
    );
    let sigma = Vector3::new(level_sigma, level_sigma, 2.0 * heading_sigma);
    Some((state(nav, fix, options, &sigma, 0.02, Vector3::zeros()), how))
}

/// Standard deviation of the level by the accelerometers' biases \[rad\].
fn accelerometer_level(options: &Options) -> f64 {
    let noise = &options.noise;
    2.0 * noise.accelerometer_bias_mps2 * noise.switch_on.max(1.0) / 9.8 + 1e-4
}

fn state(
    mut nav: NavState,
    fix: &GnssFix,
    options: &Options,
    attitude_sigma_rad: &Vector3<f64>,
    velocity_sigma_mps: f64,
    gyro_bias_radps: Vector3<f64>,
) -> InitialState {
    // the antenna is where the fix is, the IMU a lever arm away
    let arm = nav.ned_from_body * options.gnss.lever_arm_m;
    crate::state::shift_nav(&mut nav, &-arm, &Vector3::zeros(), &Vector3::zeros());
    let of_fix = fix.covariance_ned_m2.diagonal().map(|v| v.max(0.0).sqrt());
    // the fix itself comes in again as a measurement: the beginning must not count it twice
    let position_sigma_m = of_fix.map(|s| 10.0 * s + 0.5);
    InitialState {
        nav,
        position_sigma_m,
        velocity_sigma_mps: Vector3::repeat(velocity_sigma_mps),
        attitude_sigma_rad: *attitude_sigma_rad,
        gyro_bias_radps,
    }
}

/// The beginning from the first clear course, carried back by the gyros.
fn on_the_move(
    inputs: &Inputs,
    options: &Options,
    rests: &[Rest],
    fixes: &[&GnssFix],
) -> Result<(InitialState, String), AlignError> {
    let speeds = fixes.windows(2).map(|w| course_of(w[0], w[1]).0);
    let fastest_mps = speeds.fold(0.0, f64::max);
    let straight = |w: &[&GnssFix]| {
        let (a, b) = (course_of(w[0], w[1]), course_of(w[1], w[2]));
        a.0 > MOVING_MPS && b.0 > MOVING_MPS && wrapped(a.1 - b.1).abs() < 0.1 && w[2].time_s - w[0].time_s < 5.0
    };
    let Some(at) = fixes.windows(3).position(straight) else {
        return Err(AlignError::NoHeading { moving_mps: MOVING_MPS, fastest_mps });
    };
    let moving = fixes[at + 1];
    let (speed, course) = course_of(fixes[at], fixes[at + 1]);
    // a rest before gives the bias of the gyros and the level
    let start = fixes[0];
    let rest = rests
        .iter()
        .take_while(|r| r.end_s <= moving.time_s)
        .max_by(|a, b| (a.end_s - a.start_s).total_cmp(&(b.end_s - b.start_s)));
    let known = rest.and_then(|r| mean_rates(&inputs.imu, r.start_s, r.end_s).map(|m| (r, m)));
    let bias = known.map_or_else(Vector3::zeros, |(_, (rate, ..))| rate);
    let noise = &options.noise;
    let back_s = moving.time_s - start.time_s;
    let carried = gyros_between(&inputs.imu, start.time_s, moving.time_s, &bias);
    let moving_attitude = ned_from_body(0.0, 0.0, course);
    let (attitude, level_sigma) = match known {
        Some((rest, (_, force, _))) if rest.start_s <= start.time_s + 5.0 => {
            let (roll, pitch) = level(&force);
            // heading at the beginning that the gyros turn into the course
            let tilted = ned_from_body(roll, pitch, 0.0);
            let (_, _, turned) = crate::frames::roll_pitch_heading_rad(&(tilted * carried));
            (ned_from_body(roll, pitch, wrapped(course - turned)), accelerometer_level(options))
        }
        _ => (moving_attitude * carried.inverse(), LEVEL_RAD.hypot(noise.gyro_bias_radps * back_s)),
    };
    let rate_sigma =
        if known.is_some() { noise.gyro_bias_radps } else { noise.gyro_bias_radps * noise.switch_on.max(1.0) };
    let heading_sigma =
        (COURSE_RAD + 0.3 / speed).hypot(rate_sigma * back_s).hypot(noise.angle_random_walk * back_s.sqrt());
    // gyros at rest feel their bias and the earth; what is felt beyond the bias of their grade is not a bias
    let earth = attitude.inverse() * earth_rate_ned_radps(start.geodetic.x);
    let bias_sigma = noise.gyro_bias_radps * noise.switch_on.max(1.0);
    let bias = known.map_or_else(Vector3::zeros, |_| bias - earth).map(|b| b.clamp(-bias_sigma, bias_sigma));
    let velocity = velocity_of(fixes[0], fixes[1]);
    let nav = NavState {
        time_s: start.time_s.max(inputs.imu.span_s().0),
        geodetic: start.geodetic,
        velocity_ned_mps: velocity,
        ned_from_body: attitude,
    };
    let how = format!(
        "aligned on the move at {:.1} s by a course of {:.1}° at {speed:.1} m/s, carried back {back_s:.1} s by the gyros: heading \
         {:.1}° ± {:.1}°",
        moving.time_s,
        course.to_degrees(),
        crate::frames::roll_pitch_heading_rad(&attitude).2.to_degrees(),
        heading_sigma.to_degrees()
    );
    let sigma = Vector3::new(level_sigma, level_sigma, heading_sigma);
    // the rest that gave the bias comes in again as zero rotation: only the point of linearisation is taken from it
    Ok((state(nav, start, options, &sigma, 0.5, bias), how))
}

/// Rotation of the body from one time to another by the gyros alone.
fn gyros_between(imu: &Imu, from_s: f64, to_s: f64, bias: &Vector3<f64>) -> UnitQuaternion<f64> {
    let samples = imu.samples();
    let from = samples.partition_point(|s| s.time_s <= from_s).max(1);
    let to = samples.partition_point(|s| s.time_s <= to_s);
    let mut turned = UnitQuaternion::identity();
    for k in from..to {
        let interval_s = samples[k].time_s - samples[k - 1].time_s;
        turned *= UnitQuaternion::from_scaled_axis(samples[k].angle_rad - bias * interval_s);
    }
    turned
}
