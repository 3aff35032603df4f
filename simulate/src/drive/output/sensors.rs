//! What the user receives beside the strips: sensor data, nominal calibration, project file.

use std::fmt::Write as _;
use std::io::Write as _;
use std::path::Path;

use flate2::Compression;
use flate2::write::GzEncoder;

use super::super::navigation::{ANGLE_DECIMALS, LENGTH_DECIMALS, SPEED_DECIMALS, correlated_share};
use super::super::survey::DriveSurvey;
use super::{array, write_stream};
use crate::error::SimulateError;

/// Seconds of a day.
const DAY_S: f64 = 86_400.0;

/// KF-GINS text: time, increments of angle and velocity.
pub(super) fn write_imu(path: &Path, survey: &DriveSurvey) -> Result<(), SimulateError> {
    let digits = survey.scenario().imu.digits - 1;
    write_stream(path, |file| {
        let mut text = GzEncoder::new(file, Compression::default());
        for sample in survey.inputs().imu.samples() {
            write!(text, "{:.6}", sample.time_s)?;
            for value in sample.angle_rad.iter().chain(sample.velocity_mps.iter()) {
                write!(text, " {value:.digits$e}")?;
            }
            text.write_all(b"\n")?;
        }
        text.finish().map(|_| ())
    })
}

/// A solution of RTKLIB: antenna, GPST.
pub(super) fn gnss(survey: &DriveSurvey) -> String {
    let scenario = survey.scenario();
    let mut text = format!(
        "% program   : RTKLIB-style output of tieline simulate (kinematic, fixed)\n\
         % ref pos   : {:.9} {:.9} {:.4}\n%\n\
         % (lat/lon/height=WGS84/ellipsoidal,Q=1:fix,2:float,3:sbas,4:dgps,5:single,6:ppp,ns=# of satellites)\n\
         %  GPST                  latitude(deg) longitude(deg)  height(m)   Q  ns   sdn(m)   sde(m)   sdu(m)  \
         sdne(m)  sdeu(m)  sdun(m) age(s)  ratio\n",
        scenario.origin[0], scenario.origin[1], scenario.origin[2]
    );
    for fix in &survey.inputs().gnss {
        let sd = |axis: usize| fix.covariance_ned_m2[(axis, axis)].sqrt();
        let _ = writeln!(
            text,
            "{} {:.ANGLE_DECIMALS$} {:.ANGLE_DECIMALS$} {:.LENGTH_DECIMALS$} 1 14 {:.LENGTH_DECIMALS$} \
             {:.LENGTH_DECIMALS$} {:.LENGTH_DECIMALS$} 0.0000 0.0000 0.0000 0.00 99.9",
            stamp(scenario.week, fix.time_s),
            fix.geodetic.x.to_degrees(),
            fix.geodetic.y.to_degrees(),
            fix.geodetic.z,
            sd(0),
            sd(1),
            sd(2),
        );
    }
    text
}

/// Calendar date of GPS time, `2024/09/03 10:03:20.000`.
#[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // a time of this century
fn stamp(week: u32, seconds_of_week: f64) -> String {
    let ms = (seconds_of_week * 1000.0).round();
    let days = (ms / (DAY_S * 1000.0)).floor();
    let left_ms = (ms - days * DAY_S * 1000.0) as u64;
    // days since 1970-01-01, then H. Hinnant, "chrono-compatible low-level date algorithms"
    let from_1970 = i64::from(week) * 7 + days as i64 + 3657;
    let shifted = from_1970 + 719_468;
    let era = shifted.div_euclid(146_097);
    let day_of_era = shifted.rem_euclid(146_097);
    let year_of_era = (day_of_era - day_of_era / 1460 + day_of_era / 36_524 - day_of_era / 146_096) / 365;
    let day_of_year = day_of_era - (365 * year_of_era + year_of_era / 4 - year_of_era / 100);
    let part = (5 * day_of_year + 2) / 153;
    let day = day_of_year - (153 * part + 2) / 5 + 1;
    let month = if part < 10 { part + 3 } else { part - 9 };
    let year = year_of_era + era * 400 + i64::from(month <= 2);
    let (hour, minute) = (left_ms / 3_600_000, left_ms / 60_000 % 60);
    let (second, milli) = (left_ms / 1000 % 60, left_ms % 1000);
    format!("{year:04}/{month:02}/{day:02} {hour:02}:{minute:02}:{second:02}.{milli:03}")
}

/// Speed of the wheel.
pub(super) fn odometer(survey: &DriveSurvey) -> String {
    let mut text = String::from("sow,speed_mps\n");
    for reading in &survey.inputs().odometer {
        let _ = writeln!(text, "{:.4},{:.SPEED_DECIMALS$}", reading.time_s, reading.speed_mps);
    }
    text
}

/// What the user believes about the sensors.
pub(super) fn calibration(survey: &DriveSurvey) -> String {
    let scenario = survey.scenario();
    let mut text = format!(
        "frames = \"body FRD at the IMU centre; C_s^b = Rz(yaw) Ry(pitch) Rx(roll); scanner axis x is the rotation axis, \
         beam = [0, sin(a), cos(a)] with a = scan angle\"\n\n\
         [crs]\nname = {:?}\norigin_lat_deg = {:?}\norigin_lon_deg = {:?}\norigin_h_m = {:?}\ngps_week = {}\n\
         las_time = \"adjusted\"\n\n\
         [gnss]\nlever_arm_m = {}\nrate_hz = {:?}\n",
        scenario.crs,
        scenario.origin[0],
        scenario.origin[1],
        scenario.origin[2],
        scenario.week,
        array(scenario.gnss.lever_arm_m),
        scenario.gnss.rate_hz,
    );
    if scenario.odometer.used {
        let odometer = &scenario.odometer;
        let _ = write!(
            text,
            "\n[odometer]\nlever_arm_m = {}\nrear_axle_m = {}\nrate_hz = {:?}\nnoise_mps = {:?}\nscale_sd = {:?}\n",
            array(odometer.lever_arm_m),
            array(scenario.vehicle.axle_lever_arm_m),
            odometer.rate_hz,
            odometer.noise_mps,
            odometer.scale_sd,
        );
    }
    let _ = write!(text, "\n[imu]\nrate_hz = {:?}\ngrade = {:?}\n", scenario.imu.rate_hz, scenario.imu.grade);
    text += &imu_overrides(survey);
    for (channel, scanner) in scenario.scanners.iter().enumerate() {
        let _ = write!(
            text,
            "\n[scanner{}]\nchannel = {channel}\nlever_arm_m = {}\nrpy_deg = {}\nprr_hz = {:?}\nspin_hz = {:?}\n\
             range_noise_m = {:?}\nmax_range_m = {:?}\n",
            channel + 1,
            array(scanner.lever_arm_m),
            array(scanner.mounting_deg),
            scanner.pulse_rate_hz,
            scanner.profile_rate_hz,
            scanner.range_noise_m,
            scanner.max_range_m,
        );
    }
    text
}

/// Noise of the IMU where it is not that of its grade.
fn imu_overrides(survey: &DriveSurvey) -> String {
    let imu = &survey.scenario().imu;
    let mut text = String::new();
    for (key, value) in [
        ("angle_random_walk_deg_rth", imu.angle_random_walk_deg_rth),
        ("velocity_random_walk_mps_rth", imu.velocity_random_walk_mps_rth),
        ("gyro_bias_degph", imu.gyro_bias_degph),
        ("accelerometer_bias_mgal", imu.accelerometer_bias_mgal),
    ] {
        if let Some(value) = value {
            let _ = writeln!(text, "{key} = {value:?}");
        }
    }
    text
}

/// The project file: what a user knows.
pub(super) fn project(survey: &DriveSurvey) -> String {
    let scenario = survey.scenario();
    let mut text = format!(
        "# Simulated by tieline; the truth is in truth/, and nothing of it is in here.\n\
         [project]\nname = {:?}\ncrs = {:?}\nweek = {}\n\n\
         [[strips]]\npath = \"strips/*.laz\"\n\n\
         [trajectory]\npath = \"trajectory.sbet\"\naccuracy = \"trajectory_rms.out\"\nformat = \"sbet\"\n\n\
         [imu]\npath = \"imu.txt.gz\"\nformat = \"kf-gins\"\ngrade = {:?}\n{}\n\
         [gnss]\npath = \"gnss.pos\"\ncorrelated_share = {:?}\ncorrelation_s = {:?}\n",
        scenario.name,
        scenario.crs,
        scenario.week,
        scenario.imu.grade,
        imu_overrides(survey),
        correlated_share(scenario),
        scenario.gnss.correlation_s,
    );
    if scenario.odometer.used {
        let odometer = &scenario.odometer;
        let _ = write!(
            text,
            "\n[odometer]\npath = \"odometer.csv\"\nlever_arm_m = {}\nnoise_mps = {:?}\nscale_sd = {:?}\n",
            array(odometer.lever_arm_m),
            odometer.noise_mps,
            odometer.scale_sd,
        );
    }
    if scenario.vehicle.constrained {
        let _ = write!(
            text,
            "\n# a car: it neither slides nor jumps\n[vehicle]\nlever_arm_m = {}\n",
            array(scenario.vehicle.axle_lever_arm_m)
        );
    }
    let _ = write!(text, "\n[platform]\ngnss_lever_arm_m = {}\n", array(scenario.gnss.lever_arm_m));
    for (id, scanner) in scenario.scanners.iter().enumerate() {
        let _ = write!(
            text,
            "\n[[platform.scanner]]\nid = {id}\nlever_arm_m = {}\nmounting_deg = {}\n",
            array(scanner.lever_arm_m),
            array(scanner.mounting_deg),
        );
    }
    text
}

#[cfg(test)]
mod tests {
    #[test]
    fn a_moment_of_gps_time_has_its_date() {
        // X-Val: ../../shared/data/mms-sim-block, week 2330
        assert_eq!(super::stamp(2330, 209_000.2), "2024/09/03 10:03:20.200");
        assert_eq!(super::stamp(2200, 604_799.999_6), "2022/03/13 00:00:00.000");
    }
}
