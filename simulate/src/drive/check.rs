//! Reading a scenario, and whether it makes sense.

use std::collections::HashMap;
use std::path::Path;

use nalgebra::{Vector2, Vector3};
use tieline_filter::grade::{DEG_PER_HOUR, DEG_PER_ROOT_HOUR, MILLIGAL, MPS_PER_ROOT_HOUR};
use tieline_filter::{ImuGrade, ImuNoise};
use tieline_io::crs::{Crs, CrsKind};

use super::axis::Axis;
use super::scenario::DriveScenario;
use super::sensor_options::{DriveScannerOptions, ImuOptions};
use crate::error::SimulateError;
use crate::scenario::{not_negative, positive, require};

/// Nodes nearer to each other than this make no street \[m\].
const LEAST_M: f64 = 5.0;
/// Sharpest turn \[deg\].
const SHARPEST_DEG: f64 = 135.0;

impl DriveScenario {
    /// Reads a scenario and checks it.
    ///
    /// # Errors
    /// [`SimulateError`] names the key and what would make sense.
    pub fn read(path: &Path) -> Result<Self, SimulateError> {
        let io = |source| SimulateError::Io { path: path.to_path_buf(), source };
        let text = std::fs::read_to_string(path).map_err(io)?;
        let scenario: Self = toml::from_str(&text)
            .map_err(|source| SimulateError::Toml { path: path.to_path_buf(), source: Box::new(source) })?;
        scenario.check()?;
        Ok(scenario)
    }

    /// Checks that every number makes sense, and that streets and laps hang together.
    ///
    /// # Errors
    /// [`SimulateError::Scenario`] names the first that does not; [`SimulateError::Crs`].
    pub fn check(&self) -> Result<(), SimulateError> {
        self.check_streets()?;
        self.check_scene()?;
        self.check_drive()?;
        self.check_sensors()?;
        let channels = self.scanners.len();
        require("scanner", (1..=4).contains(&channels), &channels, "one to four scanners")?;
        self.scanners.iter().try_for_each(check_scanner)?;
        positive("output.scale_m", self.output.scale_m)?;
        positive("output.trajectory_rate_hz", self.output.trajectory_rate_hz)?;
        self.local_crs()?;
        let kind = self.strip_crs()?.kind();
        require("crs", kind == CrsKind::Projected, &self.crs, "a projected system such as EPSG:32633")?;
        let start_is_good = (0.0..604_800.0).contains(&self.start_s);
        require("start_s", start_is_good, &self.start_s, "seconds of week, 0 to 604800, were due")
    }

    fn check_streets(&self) -> Result<(), SimulateError> {
        let mut known = HashMap::new();
        for node in &self.nodes {
            let is_number = node.east_m.abs() < 20_000.0 && node.north_m.abs() < 20_000.0;
            let place = format!("{}, {} of \"{}\"", node.east_m, node.north_m, node.name);
            require("node.east_m, node.north_m", is_number, &place, "metres from the origin, at most 20 km")?;
            let is_new = known.insert(node.name.as_str(), ()).is_none();
            require("node.name", is_new, &node.name, "this name is taken: give every node its own")?;
        }
        require("street", !self.streets.is_empty(), &0, "one street or more: [[street]] nodes = [\"a\", \"b\"]")?;
        for street in &self.streets {
            self.check_line("street.nodes", &street.nodes)?;
            let is_wide = street.half_width_m >= 2.5 && street.half_width_m <= 30.0;
            require("street.half_width_m", is_wide, &street.half_width_m, "2.5 m to 30 m")?;
            let is_good = (0.0..=50.0).contains(&street.pavement_m);
            require("street.pavement_m", is_good, &street.pavement_m, "0 m to 50 m")?;
        }
        Ok(())
    }

    fn check_scene(&self) -> Result<(), SimulateError> {
        let scene = &self.scene;
        for (key, value) in [
            ("scene.hill_m", scene.hill_m),
            ("scene.cross_slope", scene.cross_slope),
            ("scene.curb_m", scene.curb_m),
            ("scene.verge_m", scene.verge_m),
            ("scene.gap_share", scene.gap_share),
            ("scene.pole_spacing_m", scene.pole_spacing_m),
            ("scene.tree_spacing_m", scene.tree_spacing_m),
            ("scene.manhole_spacing_m", scene.manhole_spacing_m),
            ("scene.patch_spacing_m", scene.patch_spacing_m),
            ("scene.zebra_spacing_m", scene.zebra_spacing_m),
            ("scene.arrow_spacing_m", scene.arrow_spacing_m),
            ("scene.parked_spacing_m", scene.parked_spacing_m),
            ("scene.traffic_s", scene.traffic_s),
            ("scene.roughness_m", scene.roughness_m),
        ] {
            not_negative(key, value)?;
        }
        positive("scene.hill_length_m", scene.hill_length_m)?;
        positive("scene.corner_radius_m", scene.corner_radius_m)?;
        let steep = scene.hill_m / scene.hill_length_m;
        require("scene.hill_m", steep <= 0.05, &scene.hill_m, "at most a twentieth of scene.hill_length_m")?;
        for (key, [low, high]) in [("scene.facade_height_m", scene.facade_height_m), ("scene.recess_m", scene.recess_m)]
        {
            let pair = format!("[{low}, {high}]");
            require(key, low > 0.0 && high >= low && high < 100.0, &pair, "the least and the largest, above zero")?;
        }
        Ok(())
    }

    fn check_drive(&self) -> Result<(), SimulateError> {
        let drive = &self.drive;
        positive("drive.speed_mps", drive.speed_mps)?;
        require("drive.speed_mps", drive.speed_mps <= 50.0, &drive.speed_mps, "at most 50 m/s")?;
        positive("drive.acceleration_mps2", drive.acceleration_mps2)?;
        positive("drive.lateral_mps2", drive.lateral_mps2)?;
        positive("drive.turn_radius_m", drive.turn_radius_m)?;
        let is_share = (0.0..=0.8).contains(&drive.speed_changes);
        require("drive.speed_changes", is_share, &drive.speed_changes, "a share of 0 to 0.8")?;
        for (key, value) in [
            ("drive.lane_sd_m", drive.lane_sd_m),
            ("drive.first_rest_s", drive.first_rest_s),
            ("drive.last_rest_s", drive.last_rest_s),
            ("drive.sway_deg", drive.sway_deg),
            ("drive.vibration_m", drive.vibration_m),
        ] {
            not_negative(key, value)?;
        }
        require("drive.lane_m", drive.lane_m.abs() < 10.0, &drive.lane_m, "less than 10 m")?;
        require("drive.lap", !drive.laps.is_empty(), &0, "one lap or more: [[drive.lap]] nodes = [\"a\", \"b\"]")?;
        for (number, lap) in drive.laps.iter().enumerate() {
            self.check_line("drive.lap.nodes", &lap.nodes)?;
            let follows = number == 0 || drive.laps[number - 1].nodes.last() == lap.nodes.first();
            let begin = lap.nodes.first().cloned().unwrap_or_default();
            require("drive.lap.nodes", follows, &begin, "a lap begins at the node where the one before ended")?;
        }
        self.check_line("drive.lap.nodes", &self.route_nodes())?;
        let length_m = self.route().0.length_m;
        for stop in &drive.stops {
            let is_there = stop.way_m > 0.0 && stop.way_m < length_m;
            let value = format!("{} of {length_m:.1}", stop.way_m);
            require("drive.stop.way_m", is_there, &value, "metres from the begin, before the end of the drive")?;
            not_negative("drive.stop.rest_s", stop.rest_s)?;
        }
        Ok(())
    }

    fn check_sensors(&self) -> Result<(), SimulateError> {
        self.imu_noise()?;
        let rate_is_good = (10.0..=2000.0).contains(&self.imu.rate_hz);
        require("imu.rate_hz", rate_is_good, &self.imu.rate_hz, "10 Hz to 2000 Hz")?;
        require("imu.digits", (4..=17).contains(&self.imu.digits), &self.imu.digits, "4 to 17 digits")?;
        positive("gnss.rate_hz", self.gnss.rate_hz)?;
        positive("gnss.correlation_s", self.gnss.correlation_s)?;
        for axis in 0..3 {
            positive("gnss.white_m", self.gnss.white_m[axis])?;
            not_negative("gnss.correlated_m", self.gnss.correlated_m[axis])?;
        }
        for outage in &self.gnss.outages {
            not_negative("gnss.outage.start_s", outage.start_s)?;
            require(
                "gnss.outage.start_s",
                outage.start_s < 100_000.0,
                &outage.start_s,
                "seconds since the begin of the data, not seconds of week",
            )?;
            positive("gnss.outage.length_s", outage.length_s)?;
        }
        positive("odometer.rate_hz", self.odometer.rate_hz)?;
        positive("odometer.noise_mps", self.odometer.noise_mps)?;
        not_negative("odometer.scale_sd", self.odometer.scale_sd)?;
        let scale = self.odometer.scale_error;
        require("odometer.scale_error", scale.abs() < 0.2, &scale, "a share, such as 0.002 for 0.2 %")
    }

    /// A line of nodes that are all known, apart, and without a turn that no vehicle takes.
    fn check_line(&self, key: &'static str, names: &[String]) -> Result<(), SimulateError> {
        let all = names.join(", ");
        require(key, names.len() >= 2, &all, "two nodes or more")?;
        if let Some(name) = names.iter().find(|name| !self.nodes.iter().any(|n| n.name == **name)) {
            return require(key, false, name, "no [[node]] has this name");
        }
        let points = self.points(names);
        let apart = points.windows(2).all(|p| (p[1] - p[0]).norm() >= LEAST_M);
        require(key, apart, &all, "neighbouring nodes are 5 m apart at least")?;
        let turns = points.windows(3).map(|p| (p[1] - p[0]).angle(&(p[2] - p[1])).to_degrees());
        require(key, turns.fold(0.0, f64::max) <= SHARPEST_DEG, &all, "no turn is sharper than 135 deg")
    }

    /// Places of nodes; unknown names are left out.
    pub(super) fn points(&self, names: &[String]) -> Vec<Vector2<f64>> {
        let place = |name: &String| self.nodes.iter().find(|n| n.name == *name);
        names.iter().filter_map(place).map(|n| Vector2::new(n.east_m, n.north_m)).collect()
    }

    fn route_nodes(&self) -> Vec<String> {
        let mut names: Vec<String> = Vec::new();
        for lap in &self.drive.laps {
            names.extend(lap.nodes.iter().skip(usize::from(!names.is_empty())).cloned());
        }
        names
    }

    /// The line that is driven, and the way \[m\] at which each lap ends.
    pub(super) fn route(&self) -> (Axis, Vec<f64>) {
        let axis = Axis::new(&self.points(&self.route_nodes()), self.drive.turn_radius_m);
        let mut last = 0;
        let ends_m = self.drive.laps.iter().map(|lap| {
            last += lap.nodes.len() - 1;
            axis.vertices_m[last]
        });
        let ends_m = ends_m.collect();
        (axis, ends_m)
    }

    /// Latitude \[rad\], longitude \[rad\], ellipsoidal height \[m\] of the origin.
    pub(super) fn origin_rad(&self) -> Vector3<f64> {
        Vector3::new(self.origin[0].to_radians(), self.origin[1].to_radians(), self.origin[2])
    }

    /// The system that the streets stand in: east, north, up about the origin.
    ///
    /// # Errors
    /// When the origin is no place.
    pub fn local_crs(&self) -> Result<Crs, SimulateError> {
        Ok(Crs::local(self.origin_rad())?)
    }

    /// The system of the strips.
    ///
    /// # Errors
    /// When it is not understood.
    pub fn strip_crs(&self) -> Result<Crs, SimulateError> {
        Ok(Crs::parse(&self.crs)?)
    }

    /// Noise of the IMU: its grade and what was set beside it.
    ///
    /// # Errors
    /// When the grade is unknown, or a number is negative.
    pub fn imu_noise(&self) -> Result<ImuNoise, SimulateError> {
        let ImuOptions { grade, .. } = &self.imu;
        let Ok(grade) = grade.parse::<ImuGrade>() else {
            let expected = "one of navigation, ap60, leador-a15, stim300, adis16465, consumer";
            return Err(SimulateError::Scenario { key: "imu.grade", value: grade.clone(), expected });
        };
        let mut noise = grade.noise();
        for (key, value, given, unit) in [
            (
                "imu.angle_random_walk_deg_rth",
                &mut noise.angle_random_walk,
                self.imu.angle_random_walk_deg_rth,
                DEG_PER_ROOT_HOUR,
            ),
            (
                "imu.velocity_random_walk_mps_rth",
                &mut noise.velocity_random_walk,
                self.imu.velocity_random_walk_mps_rth,
                MPS_PER_ROOT_HOUR,
            ),
            ("imu.gyro_bias_degph", &mut noise.gyro_bias_radps, self.imu.gyro_bias_degph, DEG_PER_HOUR),
            (
                "imu.accelerometer_bias_mgal",
                &mut noise.accelerometer_bias_mps2,
                self.imu.accelerometer_bias_mgal,
                MILLIGAL,
            ),
        ] {
            if let Some(given) = given {
                positive(key, given)?;
                *value = given * unit;
            }
        }
        Ok(noise)
    }
}

fn check_scanner(scanner: &DriveScannerOptions) -> Result<(), SimulateError> {
    for (key, value) in [
        ("scanner.pulse_rate_hz", scanner.pulse_rate_hz),
        ("scanner.profile_rate_hz", scanner.profile_rate_hz),
        ("scanner.max_range_m", scanner.max_range_m),
        ("scanner.reach_m", scanner.reach_m),
    ] {
        positive(key, value)?;
    }
    for (key, value) in [
        ("scanner.range_noise_m", scanner.range_noise_m),
        ("scanner.divergence_mrad", scanner.divergence_mrad),
        ("scanner.min_range_m", scanner.min_range_m),
    ] {
        not_negative(key, value)?;
    }
    let is_short = scanner.max_range_m <= 500.0;
    require("scanner.max_range_m", is_short, &scanner.max_range_m, "at most 500 m")?;
    let latency_s = scanner.latency_s;
    require("scanner.latency_s", latency_s.abs() <= 0.1, &latency_s, "at most 0.1 s to either side")?;
    for bump in &scanner.bias_bumps {
        positive("scanner.bias_bump.width_m", bump.width_m)?;
    }
    let grows = scanner.bias_knots_m.windows(2).all(|k| k[1][0] > k[0][0]);
    let knots = format!("{:?}", scanner.bias_knots_m);
    require("scanner.bias_knots_m", grows, &knots, "pairs [range, bias] in metres whose ranges grow")?;
    for (key, knots, limits, due) in [
        (
            "scanner.bias_incidence",
            &scanner.bias_incidence,
            (0.0, 90.0),
            "pairs [incidence, bias] in degrees from 0 to 90 that grow, and metres",
        ),
        (
            "scanner.bias_intensity",
            &scanner.bias_intensity,
            (1.0, 65_535.0),
            "pairs [intensity, bias] with intensities from 1 to 65535 that grow, and metres",
        ),
    ] {
        let grows = knots.windows(2).all(|k| k[1][0] > k[0][0]);
        let within = knots.iter().all(|k| k[0] >= limits.0 && k[0] <= limits.1);
        require(key, grows && within, &format!("{knots:?}"), due)?;
    }
    let knots = || scanner.bias_knots_m.iter().chain(&scanner.bias_incidence).chain(&scanner.bias_intensity);
    let largest_m = scanner.bias_offset_m.abs()
        + scanner.bias_bumps.iter().map(|b| b.height_m.abs()).fold(0.0, f64::max)
        + knots().map(|k| k[1].abs()).fold(0.0, f64::max);
    let all = knots().all(|k| k[1].is_finite());
    require("scanner.bias_knots_m and others", all, &all, "biases in metres")?;
    require("scanner.bias_offset_m and others", largest_m < 1.0, &largest_m, "a bias in metres, below 1 m")
}
