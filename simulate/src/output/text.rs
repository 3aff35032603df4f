//! The text files of a survey.

use std::fmt::Write;

use nalgebra::Vector3;

use super::strip_name;
use crate::scenario::Scenario;
use crate::survey::Survey;

/// Three numbers as a TOML array.
fn array(v: [f64; 3]) -> String {
    format!("[{:?}, {:?}, {:?}]", v[0], v[1], v[2])
}

/// Radians as a TOML array of degrees.
fn degrees(v: &Vector3<f64>) -> String {
    array(v.map(f64::to_degrees).into())
}

/// The project file: what a user knows.
pub(super) fn project(scenario: &Scenario) -> String {
    let mut text = format!(
        "# Simulated by tieline; the truth is in truth/, and nothing of it is in here.\n\
         [project]\nname = {name:?}\ncrs = {crs:?}\n",
        name = scenario.name,
        crs = scenario.crs,
    );
    if scenario.crs.eq_ignore_ascii_case("local") {
        let _ =
            writeln!(text, "origin = {} # latitude, longitude [deg], ellipsoidal height [m]", array(scenario.origin));
    }
    text += "\n[[strips]]\npath = \"strips/*.laz\"\n\n\
             [trajectory]\npath = \"trajectory.sbet\"\naccuracy = \"trajectory_rms.out\"\nformat = \"sbet\"\n";
    for (id, scanner) in scenario.scanners.iter().enumerate() {
        let _ = write!(
            text,
            "\n[[platform.scanner]]\nid = {id}\nlever_arm_m = {}\nmounting_deg = {}\nboresight_deg = {}\n",
            array(scanner.lever_arm_m),
            array(scanner.mounting_deg),
            array(scanner.boresight_deg),
        );
    }
    text
}

/// The true calibration.
pub(super) fn calibration_true(survey: &Survey) -> String {
    let mut text = String::from(
        "# x = p + C [ lever_arm + R(boresight) R0(mounting) d (rho + f(rho)) ],\n\
         # f(rho) = range_offset_m + range_scale_ppm * 1e-6 * rho: true range = measured range + f.\n\
         # The errors are true minus nominal.\n",
    );
    for (id, (truth, options)) in survey.truth().scanners.iter().zip(&survey.scenario().scanners).enumerate() {
        let _ = write!(
            text,
            "\n[[scanner]]\nid = {id}\nmounting_deg = {}\nboresight_deg = {}\nboresight_error_deg = {}\n\
             lever_arm_m = {}\nlever_arm_error_m = {}\nrange_offset_m = {:?}\nrange_scale_ppm = {:?}\n",
            array(options.mounting_deg),
            degrees(&truth.boresight_rad),
            degrees(&truth.boresight_error_rad),
            array(truth.lever_arm_m.into()),
            array(truth.lever_arm_error_m.into()),
            truth.range_offset_m,
            options.range_scale_ppm,
        );
    }
    text
}

/// The errors of the delivered trajectory, a line per strip.
pub(super) fn strip_errors(survey: &Survey) -> String {
    let mut text = String::from(
        "# delivered minus true; component = constant + linear * (gps_time_s - middle_s) / half_s;\n\
         # rotation vector psi in north-east-down: C_delivered = exp([psi]x) C_true;\n\
         # roll, pitch and heading are delivered minus true at the middle of the line, for reading\n\
         strip,middle_s,half_s",
    );
    for part in ["constant", "linear"] {
        for axis in ["n", "e", "d"] {
            let _ = write!(text, ",{part}_{axis}_m");
        }
    }
    for part in ["constant", "linear"] {
        for axis in ["n", "e", "d"] {
            let _ = write!(text, ",rotation_{part}_{axis}_deg");
        }
    }
    text += ",roll_deg,pitch_deg,heading_deg\n";
    for error in &survey.truth().strips {
        let _ = write!(text, "{},{},{}", strip_name(error.strip as usize), error.middle_s, error.half_s);
        for vector in [&error.position_constant_ned_m, &error.position_linear_ned_m] {
            vector.iter().for_each(|v| {
                let _ = write!(text, ",{v}");
            });
        }
        for vector in [&error.rotation_constant_ned_rad, &error.rotation_linear_ned_rad] {
            vector.iter().for_each(|v| {
                let _ = write!(text, ",{}", v.to_degrees());
            });
        }
        let angles = |trajectory: &tieline_filter::Trajectory| {
            let pose = trajectory.pose_at(error.middle_s);
            pose.map_or((0.0, 0.0, 0.0), |pose| tieline_filter::frames::roll_pitch_heading_rad(&pose.ned_from_body))
        };
        let (delivered, truth) = (angles(survey.delivered_trajectory()), angles(survey.true_trajectory()));
        let turn = (delivered.2 - truth.2 + std::f64::consts::PI).rem_euclid(std::f64::consts::TAU);
        for v in [delivered.0 - truth.0, delivered.1 - truth.1, turn - std::f64::consts::PI] {
            let _ = write!(text, ",{}", v.to_degrees());
        }
        text.push('\n');
    }
    text
}

/// The scenario itself.
pub(super) fn scenario(scenario: &Scenario) -> String {
    toml::to_string(scenario).unwrap_or_default()
}
