//! Echoes of a survey: for every pulse the true and the delivered point.

use nalgebra::{UnitQuaternion, Vector3};
use tieline_filter::Trajectory;

use crate::error::SimulateError;
use crate::flight::{self, FlightLine};
use crate::random::Random;
use crate::scanner::Scanner;
use crate::scenario::Scenario;
use crate::truth::{StripError, Truth};
use crate::world::World;

/// Duration of a block of pulses \[s\]: what one thread does at a time, with random numbers of its own.
const BLOCK_S: f64 = 0.05;
/// Ground beyond the area that is still cast \[m\]: hills and houses move the echo.
const BORDER_M: f64 = 45.0;

/// An echo. Points are east, north, up \[m\] about the scenario's origin.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Echo {
    /// Seconds of week.
    pub time_s: f64,
    /// Where the echo came from.
    pub true_m: Vector3<f64>,
    /// Where the delivered trajectory, the nominal calibration and the measured range put it.
    pub delivered_m: Vector3<f64>,
    /// Measured range \[m\].
    pub range_m: f64,
    /// Scan angle as measured \[rad\].
    pub scan_angle_rad: f64,
    /// Scanner channel.
    pub scanner: u8,
    /// From 1.
    pub return_number: u8,
    /// Returns of the pulse.
    pub number_of_returns: u8,
    /// ASPRS class.
    pub class: u8,
    /// Intensity.
    pub intensity: u16,
}

/// A survey, ready to be recorded.
#[derive(Debug)]
pub struct Survey {
    scenario: Scenario,
    world: World,
    lines: Vec<FlightLine>,
    scanners: Vec<Scanner>,
    truth: Truth,
    true_trajectory: Trajectory,
    delivered_trajectory: Trajectory,
}

impl Survey {
    /// World, flight and errors of a scenario.
    ///
    /// # Errors
    /// [`SimulateError::Scenario`] when a number makes no sense.
    pub fn new(scenario: &Scenario) -> Result<Self, SimulateError> {
        scenario.check()?;
        let lines = flight::lines(scenario);
        let strips = lines.iter().map(|line| StripError::new(scenario.seed, line, &scenario.errors)).collect();
        let scanners: Vec<Scanner> = scenario.scanners.iter().map(Scanner::new).collect();
        let truth = Truth { scanners: scanners.iter().map(|s| s.truth).collect(), strips };
        let rate_hz = scenario.output.trajectory_rate_hz;
        let error = |line: &FlightLine| truth.strips[line.number as usize];
        let line_count = u32::try_from(lines.len()).unwrap_or(u32::MAX);
        Ok(Self {
            world: World::new(scenario.seed, &scenario.area, &scenario.world, line_count),
            true_trajectory: flight::trajectory(&lines, rate_hz, |_, _, pose| pose)?,
            delivered_trajectory: flight::trajectory(&lines, rate_hz, |line, t, pose| error(line).apply(t, &pose))?,
            scenario: scenario.clone(),
            lines,
            scanners,
            truth,
        })
    }

    /// What was asked for.
    #[must_use]
    pub fn scenario(&self) -> &Scenario {
        &self.scenario
    }
    /// What is flown over.
    #[must_use]
    pub fn world(&self) -> &World {
        &self.world
    }
    /// The flight lines; line `i` is strip `i`.
    #[must_use]
    pub fn lines(&self) -> &[FlightLine] {
        &self.lines
    }
    /// The scanners, by channel.
    #[must_use]
    pub fn scanners(&self) -> &[Scanner] {
        &self.scanners
    }
    /// What is wrong.
    #[must_use]
    pub fn truth(&self) -> &Truth {
        &self.truth
    }
    /// The true trajectory, east-north-up about the origin, attitude in the axes at the origin.
    #[must_use]
    pub fn true_trajectory(&self) -> &Trajectory {
        &self.true_trajectory
    }
    /// The trajectory the user has, in the same axes.
    #[must_use]
    pub fn delivered_trajectory(&self) -> &Trajectory {
        &self.delivered_trajectory
    }

    /// Number of blocks of a strip.
    #[must_use]
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // a few thousand
    pub fn blocks(&self, strip: usize) -> usize {
        let (start_s, end_s) = self.lines[strip].span_s;
        ((end_s - start_s) / BLOCK_S).ceil() as usize
    }

    /// The echoes of a block within the area, in time order; the same whenever and wherever they are computed.
    #[must_use]
    #[allow(clippy::cast_precision_loss)] // block numbers are small
    pub fn block(&self, strip: usize, block: usize) -> Vec<Echo> {
        let line = &self.lines[strip];
        let (from_s, to_s) = (BLOCK_S * block as f64, BLOCK_S * (block + 1) as f64);
        let mut echoes = Vec::new();
        for (channel, scanner) in (0_u8..).zip(&self.scanners) {
            let place = [6, u64::from(line.number), u64::from(channel), block as u64];
            let mut recorder = Recorder {
                survey: self,
                line,
                scanner,
                channel,
                random: Random::new(self.scenario.seed, &place),
                true_pose: PoseCursor::new(&self.true_trajectory, line.span_s.0 + from_s),
                delivered_pose: PoseCursor::new(&self.delivered_trajectory, line.span_s.0 + from_s),
            };
            let rate_hz = scanner.options.pulse_rate_hz;
            let mut pulse = (from_s * rate_hz).ceil();
            while pulse < (to_s * rate_hz).ceil() && line.span_s.0 + pulse / rate_hz <= line.span_s.1 {
                recorder.pulse(pulse / rate_hz, &mut echoes);
                pulse += 1.0;
            }
        }
        if self.scanners.len() > 1 {
            echoes.sort_by(|a, b| a.time_s.total_cmp(&b.time_s)); // stable: channels and returns keep their order
        }
        echoes
    }
}

/// Records the pulses of one scanner in one block.
struct Recorder<'a> {
    survey: &'a Survey,
    line: &'a FlightLine,
    scanner: &'a Scanner,
    channel: u8,
    random: Random,
    true_pose: PoseCursor<'a>,
    delivered_pose: PoseCursor<'a>,
}

impl Recorder<'_> {
    /// The echoes of the pulse at a time since the begin of the line \[s\].
    fn pulse(&mut self, line_time_s: f64, echoes: &mut Vec<Echo>) {
        let time_s = self.line.span_s.0 + line_time_s;
        let scan_angle_rad = self.scanner.scan_angle_rad(line_time_s);
        let beam = Scanner::beam(scan_angle_rad);
        let (position, map_from_body) = self.true_pose.at(time_s);
        let origin = position + map_from_body * self.scanner.truth.lever_arm_m;
        let aim = map_from_body * (self.scanner.true_body_from_scanner * self.with_noise(&beam, scan_angle_rad));
        if !self.may_hit_area(&origin, &aim) {
            return;
        }
        let returns = self.survey.world.cast(&origin, &aim, self.line.number, &mut self.random);
        if returns.is_empty() {
            return;
        }
        let (position, map_from_body) = self.delivered_pose.at(time_s);
        let number_of_returns = u8::try_from(returns.len()).unwrap_or(u8::MAX);
        let options = &self.scanner.options;
        for (return_number, echo) in (1..).zip(returns) {
            let noise_m = options.range_noise_m * self.random.normal();
            let range_m = self.scanner.measured_range_m(echo.distance_m) + noise_m;
            let body_m = self.scanner.nominal_lever_arm_m + self.scanner.nominal_body_from_scanner * (beam * range_m);
            let delivered_m = position + map_from_body * body_m;
            let area = &self.survey.scenario.area;
            if delivered_m.x.abs() > 0.5 * area.east_m
                || delivered_m.y.abs() > 0.5 * area.north_m
                || range_m > options.max_range_m
            {
                continue;
            }
            echoes.push(Echo {
                time_s,
                true_m: origin + aim * echo.distance_m,
                delivered_m,
                range_m,
                scan_angle_rad,
                scanner: self.channel,
                return_number,
                number_of_returns,
                class: echo.class,
                intensity: intensity(echo.brightness),
            });
        }
    }

    /// The beam as it really went.
    fn with_noise(&mut self, beam: &Vector3<f64>, scan_angle_rad: f64) -> Vector3<f64> {
        let sigma = self.scanner.options.angular_noise_deg.to_radians();
        if sigma <= 0.0 {
            return *beam;
        }
        let (sin, cos) = scan_angle_rad.sin_cos();
        let aside = Vector3::new(0.0, cos, -sin);
        (beam + Vector3::x() * (sigma * self.random.normal()) + aside * (sigma * self.random.normal())).normalize()
    }

    /// Whether the ray comes down on the area or near it.
    fn may_hit_area(&self, origin: &Vector3<f64>, aim: &Vector3<f64>) -> bool {
        let area = &self.survey.scenario.area;
        let down = origin - aim * (origin.z / aim.z);
        aim.z < 0.0 && down.x.abs() < 0.5 * area.east_m + BORDER_M && down.y.abs() < 0.5 * area.north_m + BORDER_M
    }
}

#[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // clamped
fn intensity(brightness: f64) -> u16 {
    (brightness * 60_000.0).clamp(0.0, 65_535.0) as u16
}

/// Poses of a trajectory at growing times: as [`Trajectory::pose_at`], without its search.
#[derive(Debug)]
pub(crate) struct PoseCursor<'a> {
    trajectory: &'a Trajectory,
    interval: usize,
}

/// Turns body axes at the origin's north-east-down into east, north, up.
pub(crate) type MapFromBody = nalgebra::Matrix3<f64>;

impl<'a> PoseCursor<'a> {
    pub(crate) fn new(trajectory: &'a Trajectory, time_s: f64) -> Self {
        Self { trajectory, interval: trajectory.interval(time_s) }
    }

    pub(crate) fn at(&mut self, time_s: f64) -> (Vector3<f64>, MapFromBody) {
        let times = self.trajectory.time_s();
        while self.interval + 2 < times.len() && times[self.interval + 1] <= time_s {
            self.interval += 1;
        }
        let (i, j) = (self.interval, self.interval + 1);
        let u = (time_s - times[i]) / (times[j] - times[i]);
        let position = self.trajectory.position();
        let attitude: &[UnitQuaternion<f64>] = self.trajectory.ned_from_body();
        // Epochs are a fraction of a degree apart: the normalised chord is the shortest arc to 1e-12 rad.
        let ned_from_body = attitude[i].nlerp(&attitude[j], u).to_rotation_matrix().into_inner();
        let enu_from_ned = MapFromBody::new(0.0, 1.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, -1.0);
        (position[i] + (position[j] - position[i]) * u, enu_from_ned * ned_from_body)
    }
}
