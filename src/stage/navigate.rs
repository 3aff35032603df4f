//! The trajectory from inertial measurements, GNSS and odometer: reading, one clock for all, the smoother.

use std::path::Path;

use anyhow::{Context, Result, bail};
use nalgebra::Vector3;
use tieline_filter::grade::{DEG_PER_HOUR, DEG_PER_ROOT_HOUR, MILLIGAL, MPS_PER_ROOT_HOUR, PPM};
use tieline_filter::options::{ConstraintModel, OdometerModel};
use tieline_filter::time::SECONDS_PER_WEEK;
use tieline_filter::{
    ImuGrade, InitialState, Inputs, NavState, Options, Smoother, Solution, SurveyClock, TimeEncoding, ned_from_body,
};
use tieline_io::measurements::{
    GnssFormat, GnssReadOptions, ImuFormat, ImuKind, ImuReadOptions, read_gnss, read_imu, read_odometer, read_points,
};

use crate::project::Project;
use crate::project::measurements::{GnssFormatChoice, ImuFormatChoice, ImuKindChoice, InitialSection};
use crate::stage::{drive, given_ties};

/// A stretch of time without GNSS: fixes after `start_s` and not after `start_s + length_s` are left out.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Mask {
    /// Seconds of week.
    pub start_s: f64,
    /// Length \[s\].
    pub length_s: f64,
}

impl std::str::FromStr for Mask {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let number = |t: &str| t.trim().parse::<f64>().ok().filter(|v| v.is_finite());
        let parts = text.split_once(':').and_then(|(a, b)| Some((number(a)?, number(b)?)));
        match parts {
            Some((start_s, length_s)) if length_s > 0.0 => Ok(Self { start_s, length_s }),
            _ => Err(format!("\"{text}\" is no window; say start:length in seconds, such as 358190:113")),
        }
    }
}

/// All measurements of a project on one clock.
#[derive(Debug)]
pub struct Measurements {
    /// For the smoother.
    pub inputs: Inputs,
    /// The clock.
    pub clock: SurveyClock,
    /// What the readers and the clock have to say.
    pub notes: Vec<String>,
}

/// Times of a file, before they are on the clock.
struct FileTime<'a> {
    path: &'a Path,
    encoding: TimeEncoding,
    week: Option<u32>,
}

/// Reads the measurements of a project.
///
/// # Errors
/// File, place and remedy of what cannot be read; when IMU and GNSS cannot be brought onto one clock.
pub fn load(project: &Project, masks: &[Mask]) -> Result<Measurements> {
    let Some(section) = &project.imu else { bail!("the project has no [imu]") };
    let path = project.resolve(&section.path);
    let mut file = read_imu(
        &path,
        &ImuReadOptions {
            format: section.format.map(|f| match f {
                ImuFormatChoice::Text => ImuFormat::Text,
                ImuFormatChoice::KfGins => ImuFormat::KfGins,
                ImuFormatChoice::Binary => ImuFormat::Binary,
            }),
            columns: section.columns.clone(),
            kind: section.kind.map(|k| match k {
                ImuKindChoice::Increments => ImuKind::Increments,
                ImuKindChoice::Rates => ImuKind::Rates,
            }),
            axes: section.axes,
        },
    )?;
    if file.is_slow() {
        bail!(
            "{}: a sample every {:.2} s is too slow for a mechanisation: 10 Hz at least, 100 Hz and more are usual",
            path.display(),
            file.imu.interval_s()
        );
    }
    let mut notes = std::mem::take(&mut file.notes);
    let gnss_path = project.gnss.as_ref().map(|g| project.resolve(&g.path));
    let mut gnss = match (&project.gnss, &gnss_path) {
        (Some(section), Some(path)) => Some(read_gnss(
            path,
            &GnssReadOptions {
                format: section.format.map(|f| match f {
                    GnssFormatChoice::RtklibPos => GnssFormat::RtklibPos,
                    GnssFormatChoice::KfGins => GnssFormat::KfGins,
                    GnssFormatChoice::Csv => GnssFormat::Csv,
                }),
                columns: section.columns.clone(),
            },
        )?),
        _ => None,
    };
    // the clock: the week that a file names, or that of adjusted times
    let adjusted = |encoding: TimeEncoding, time_s: f64| {
        (encoding == TimeEncoding::AdjustedStandard).then(|| SurveyClock::from_adjusted_s(time_s))
    };
    let week = project.project.week.or(gnss.as_ref().and_then(|g| g.week)).or(file.week);
    let clock = match week {
        Some(week) => SurveyClock { reference_week: Some(week) },
        None => adjusted(file.time_encoding, file.imu.span_s().0)
            .or_else(|| gnss.as_ref().and_then(|g| adjusted(g.time_encoding, g.fixes.first()?.time_s)))
            .unwrap_or(SurveyClock { reference_week: None }),
    };
    let imu_time = FileTime { path: &path, encoding: file.time_encoding, week: file.week };
    let imu_shift_s = shift_onto(&clock, &imu_time)?;
    let mut imu = shifted_imu(file.imu, imu_shift_s)?;
    let mut fixes = Vec::new();
    if let (Some(gnss), Some(path)) = (&mut gnss, &gnss_path) {
        notes.append(&mut gnss.notes);
        let time = FileTime { path, encoding: gnss.time_encoding, week: gnss.week };
        let shift_s = shift_onto(&clock, &time)?;
        fixes = std::mem::take(&mut gnss.fixes);
        fixes.iter_mut().for_each(|f| f.time_s += shift_s);
        if let (Some(first), Some(last)) = (fixes.first(), fixes.last()) {
            // a file without week may be of the week before or after
            let (a, b) = imu.span_s();
            let apart =
                |weeks: f64| last.time_s < a + weeks * SECONDS_PER_WEEK || first.time_s > b + weeks * SECONDS_PER_WEEK;
            if apart(0.0) {
                for weeks in [1.0, -1.0] {
                    if !apart(weeks) {
                        imu = shifted_imu(imu, weeks * SECONDS_PER_WEEK)?;
                        notes.push(format!(
                            "{}: its times lie {weeks:+} week from those of GNSS: taken for the same week",
                            imu_time.path.display()
                        ));
                        break;
                    }
                }
            }
        }
    }
    let before = fixes.len();
    fixes.retain(|f| {
        let sow = f.time_s.rem_euclid(SECONDS_PER_WEEK);
        !masks.iter().any(|m| sow > m.start_s && sow <= m.start_s + m.length_s)
    });
    if !masks.is_empty() {
        notes.push(format!("{} of {before} GNSS fixes masked", before - fixes.len()));
    }
    let mut odometer = Vec::new();
    if let Some(section) = &project.odometer {
        let path = project.resolve(&section.path);
        let mut file = read_odometer(&path, section.columns.as_deref())?;
        notes.append(&mut file.notes);
        let shift_s = shift_onto(&clock, &FileTime { path: &path, encoding: file.time_encoding, week: file.week })?;
        odometer = file.samples;
        odometer.iter_mut().for_each(|o| o.time_s += shift_s);
    }
    let mut points = Vec::new();
    for section in &project.points {
        let path = project.resolve(&section.path);
        let mut file = read_points(&path, section.columns.as_deref())?;
        notes.append(&mut file.notes);
        let shift_s = shift_onto(&clock, &FileTime { path: &path, encoding: file.time_encoding, week: file.week })?;
        points.extend(file.points.into_iter().map(|mut p| {
            p.time_s += shift_s;
            p
        }));
    }
    let ties = given_ties::load(project, &clock, imu.span_s(), &mut notes)?;
    Ok(Measurements { inputs: Inputs { imu, gnss: fixes, odometer, points, ties }, clock, notes })
}

/// Seconds to add to the times of a file.
fn shift_onto(clock: &SurveyClock, time: &FileTime<'_>) -> Result<f64> {
    let mut shift_s = clock.shift_s(time.encoding).with_context(|| {
        format!(
            "{}: adjusted GPS time, while the week of the other times is unknown; set project.week",
            time.path.display()
        )
    })?;
    if let (TimeEncoding::SecondsOfWeek, Some(week), Some(reference)) = (time.encoding, time.week, clock.reference_week)
    {
        shift_s += (f64::from(week) - f64::from(reference)) * SECONDS_PER_WEEK;
    }
    Ok(shift_s)
}

fn shifted_imu(imu: tieline_filter::Imu, shift_s: f64) -> Result<tieline_filter::Imu> {
    if shift_s == 0.0 {
        return Ok(imu);
    }
    let mut samples = imu.samples().to_vec();
    samples.iter_mut().for_each(|s| s.time_s += shift_s);
    Ok(tieline_filter::Imu::new(samples)?)
}

/// What the smoother is told, by the project.
///
/// # Errors
/// When the grade of the IMU is unknown.
pub fn options(project: &Project) -> Result<Options> {
    let Some(imu) = &project.imu else { bail!("the project has no [imu]") };
    let grade: ImuGrade = imu.grade.parse().map_err(|message: String| anyhow::anyhow!("imu.grade: {message}"))?;
    let mut noise = grade.noise();
    let set = |value: &mut f64, given: Option<f64>, unit: f64| {
        if let Some(given) = given {
            *value = given * unit;
        }
    };
    set(&mut noise.angle_random_walk, imu.angle_random_walk_deg_rth, DEG_PER_ROOT_HOUR);
    set(&mut noise.velocity_random_walk, imu.velocity_random_walk_mps_rth, MPS_PER_ROOT_HOUR);
    set(&mut noise.gyro_bias_radps, imu.gyro_bias_degph, DEG_PER_HOUR);
    set(&mut noise.accelerometer_bias_mps2, imu.accelerometer_bias_mgal, MILLIGAL);
    set(&mut noise.gyro_scale, imu.gyro_scale_ppm, PPM);
    set(&mut noise.accelerometer_scale, imu.accelerometer_scale_ppm, PPM);
    set(&mut noise.correlation_s, imu.correlation_h, 3600.0);
    let mut options = Options::new(noise);
    let gnss = &mut options.gnss;
    gnss.lever_arm_m = project.platform.gnss_lever_arm_m.map_or_else(Vector3::zeros, Vector3::from);
    if let Some(section) = &project.gnss {
        set(&mut gnss.sigma_factor, section.sigma_factor, 1.0);
        set(&mut gnss.least_sigma_m, section.least_sigma_m, 1.0);
        set(&mut gnss.correlated_share, section.correlated_share, 1.0);
        set(&mut gnss.correlation_s, section.correlation_s, 1.0);
        set(&mut gnss.delay_s.0, section.delay_s, 1.0);
        set(&mut gnss.velocity_delay_s.0, section.delay_s, 1.0);
        set(&mut gnss.delay_s.1, section.delay_sigma_s, 1.0);
        set(&mut gnss.velocity_delay_s.1, section.velocity_delay_sigma_s, 1.0);
        set(&mut gnss.lever_arm_sigma_m, section.lever_arm_sigma_m, 1.0);
        gnss.use_velocity = section.velocity.unwrap_or(true);
    }
    options.odometer = project.odometer.as_ref().map(|o| OdometerModel {
        lever_arm_m: Vector3::from(o.lever_arm_m),
        noise_mps: o.noise_mps,
        scale_sigma: o.scale_sd,
    });
    options.constraint = project.vehicle.as_ref().map(|v| {
        let mut model = ConstraintModel { lever_arm_m: Vector3::from(v.lever_arm_m), ..ConstraintModel::default() };
        model.slip_sigma_mps = v.slip_mps.unwrap_or(model.slip_sigma_mps);
        set(&mut model.slip_correlation_s, v.slip_correlation_s, 1.0);
        set(&mut model.mounting_sigma_rad, v.mounting_sigma_deg, 1.0_f64.to_radians());
        model
    });
    Ok(options)
}

/// Estimates the trajectory of a project.
///
/// # Errors
/// As [`options`] and the smoother.
pub fn navigate(project: &Project, measurements: &Measurements, memory_bytes: u64) -> Result<Solution> {
    let mut options = options(project)?;
    options.memory_bytes = usize::try_from(memory_bytes).unwrap_or(usize::MAX);
    if !measurements.inputs.ties.is_empty() {
        // what `run` has chosen finds room again
        let points = measurements.inputs.ties.iter().filter(|t| t.directions.len() > 1);
        options.ties.most_live = drive::MOST_LIVE + drive::points::most_live(points);
    }
    smooth(project, &measurements.inputs, &options)
}

/// Estimates the trajectory of a project with given options.
///
/// # Errors
/// As the smoother.
pub fn smooth(project: &Project, inputs: &Inputs, options: &Options) -> Result<Solution> {
    match &project.initial {
        Some(section) => {
            let rests = tieline_filter::rest::find(&inputs.imu, &inputs.gnss);
            let rests = if options.standstill.is_some() { rests } else { Vec::new() };
            Ok(Smoother::run_from(inputs, options, &initial_of(section, inputs), rests)?)
        }
        None => Ok(Smoother::run(inputs, options)?),
    }
}

fn initial_of(section: &InitialSection, inputs: &Inputs) -> InitialState {
    let [roll, pitch, heading] = section.roll_pitch_heading_deg.map(f64::to_radians);
    let attitude = ned_from_body(roll, pitch, heading);
    let [sr, sp, sh] = section.attitude_sigma_deg.map(f64::to_radians);
    let (sin, cos) = heading.sin_cos();
    // seconds of week, in the week of the data
    let weeks = ((inputs.imu.span_s().0 - section.gps_time_s) / SECONDS_PER_WEEK).round();
    InitialState {
        nav: NavState {
            time_s: section.gps_time_s + weeks * SECONDS_PER_WEEK,
            geodetic: Vector3::new(section.lat_deg.to_radians(), section.lon_deg.to_radians(), section.h_m),
            velocity_ned_mps: Vector3::from(section.velocity_ned_mps),
            ned_from_body: attitude,
        },
        position_sigma_m: Vector3::from(section.position_sigma_m),
        velocity_sigma_mps: Vector3::from(section.velocity_sigma_mps),
        attitude_sigma_rad: Vector3::new((sr * cos).hypot(sp * sin), (sr * sin).hypot(sp * cos), sh),
        gyro_bias_radps: Vector3::zeros(),
    }
}
