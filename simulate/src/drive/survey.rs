//! Echoes of a drive: for every pulse the true and the delivered point.

use nalgebra::{Matrix3, UnitQuaternion, Vector3};
use tieline_filter::{Inputs, Trajectory};

use super::motion::Driven;
use super::navigation;
use super::network::Network;
use super::returns::{Found, Return, mixed};
use super::scenario::DriveScenario;
use super::scene::{Hit, Material, Nearby, Scene};
use super::sensor::ProfileScanner;
use crate::error::SimulateError;
use crate::navigation::Motion;
use crate::random::Random;
use crate::survey::{Echo, MapFromBody, PoseCursor};

/// Duration of a block of pulses \[s\]: what one thread does at a time, with random numbers of its own.
const BLOCK_S: f64 = 0.05;
/// Interval of the true poses that are interpolated between \[s\]: 2 µm of way at 2 m/s².
const POSE_S: f64 = 0.0025;
/// Echoes nearer to each other than this reach the scanner as one \[m\].
const RESOLUTION_M: f64 = 0.5;
/// Surfaces whose planes lie nearer to each other than this are one \[m\].
const SAME_PLANE_M: f64 = 0.002;
/// Share of beams that go on behind a leaf.
const THROUGH_LEAF: f64 = 0.5;

/// A drive, ready to be recorded.
#[derive(Debug)]
pub struct DriveSurvey {
    scenario: DriveScenario,
    driven: Driven,
    scene: Scene,
    scanners: Vec<ProfileScanner>,
    inputs: Inputs,
    delivered: Trajectory,
    delivered_local: Trajectory,
    truth: Trajectory,
}

impl DriveSurvey {
    /// Drives, simulates the sensors, runs the smoother on what they say, and builds the streets.
    ///
    /// # Errors
    /// [`SimulateError`] when a number makes no sense, or the smoother finds no trajectory.
    pub fn new(scenario: &DriveScenario) -> Result<Self, SimulateError> {
        scenario.check()?;
        let network = Network::new(scenario);
        let driven = Driven::new(scenario, &network);
        let inputs = navigation::inputs(scenario, &driven)?;
        let delivered = navigation::delivered(scenario, &inputs)?;
        Ok(Self {
            scene: Scene::new(scenario, &network, &driven),
            scanners: scenario.scanners.iter().map(ProfileScanner::new).collect(),
            truth: navigation::truth_at(&driven.motion, &delivered)?,
            delivered_local: scenario.local_crs()?.to_map(&delivered)?,
            scenario: scenario.clone(),
            driven,
            inputs,
            delivered,
        })
    }

    /// What was asked for.
    #[must_use]
    pub fn scenario(&self) -> &DriveScenario {
        &self.scenario
    }
    /// The streets.
    #[must_use]
    pub fn scene(&self) -> &Scene {
        &self.scene
    }
    /// The scanners, by channel.
    #[must_use]
    pub fn scanners(&self) -> &[ProfileScanner] {
        &self.scanners
    }
    /// What IMU, GNSS and odometer delivered.
    #[must_use]
    pub fn inputs(&self) -> &Inputs {
        &self.inputs
    }
    /// The true motion.
    #[must_use]
    pub fn motion(&self) -> &Motion {
        &self.driven.motion
    }
    /// First and last moment of the data \[s of week\].
    #[must_use]
    pub fn span_s(&self) -> (f64, f64) {
        self.driven.span_s
    }
    /// First and last moment of each lap \[s of week\]; lap `i` is strip `i`.
    #[must_use]
    pub fn laps_s(&self) -> &[(f64, f64)] {
        &self.driven.laps_s
    }
    /// Length of the way \[m\].
    #[must_use]
    pub fn length_m(&self) -> f64 {
        self.driven.length_m()
    }
    /// The trajectory the user has, geodetic, with its own standard deviations.
    #[must_use]
    pub fn delivered(&self) -> &Trajectory {
        &self.delivered
    }
    /// The same, east-north-up about the origin, attitude in the axes at the origin.
    #[must_use]
    pub fn delivered_local(&self) -> &Trajectory {
        &self.delivered_local
    }
    /// The true trajectory at the same epochs, geodetic.
    #[must_use]
    pub fn truth(&self) -> &Trajectory {
        &self.truth
    }

    /// Pulses of all laps and scanners, roughly: what there is to be done.
    #[must_use]
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)]
    pub fn pulses(&self) -> u64 {
        let rate_hz: f64 = self.scanners.iter().map(|s| s.options.pulse_rate_hz).sum();
        self.laps_s().iter().map(|(a, b)| ((b - a) * rate_hz) as u64).sum()
    }

    /// Number of blocks of a lap.
    #[must_use]
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // some thousand
    pub fn blocks(&self, lap: usize) -> usize {
        let (start_s, end_s) = self.laps_s()[lap];
        ((end_s - start_s) / BLOCK_S).ceil() as usize
    }

    /// Where the scene is looked at from during a block, east, north, up \[m\].
    #[must_use]
    pub fn place_of_block(&self, lap: usize, block: usize) -> Vector3<f64> {
        let pose = self.driven.motion.local_pose(self.block_span_s(lap, block).0);
        enu(&pose.0)
    }

    #[allow(clippy::cast_precision_loss)] // block numbers are small
    fn block_span_s(&self, lap: usize, block: usize) -> (f64, f64) {
        let (start_s, end_s) = self.laps_s()[lap];
        let from_s = start_s + BLOCK_S * block as f64;
        (from_s, (from_s + BLOCK_S).min(end_s))
    }

    /// The echoes of a block, in time order; the same whenever and wherever they are computed.
    #[must_use]
    pub fn block(&self, lap: usize, block: usize) -> Vec<Echo> {
        let span_s = self.block_span_s(lap, block);
        let place = self.place_of_block(lap, block);
        let reach_m = self.scanners.iter().map(|s| s.options.max_range_m).fold(0.0, f64::max);
        let nearby = self.scene.nearby(lap, &place, reach_m, (span_s.0 - 0.2, span_s.1 + 0.2));
        let mut echoes = Vec::new();
        for (channel, scanner) in (0_u8..).zip(&self.scanners) {
            let latency_s = scanner.options.latency_s;
            let mut recorder = Recorder {
                survey: self,
                scanner,
                channel,
                nearby: &nearby,
                random: Random::new(self.scenario.seed, &[66, lap as u64, u64::from(channel), block as u64]),
                poses: TruePoses::new(&self.driven.motion, (span_s.0 + latency_s, span_s.1 + latency_s)),
                delivered: PoseCursor::new(&self.delivered_local, span_s.0),
            };
            let (start_s, rate_hz) = (self.driven.span_s.0, scanner.options.pulse_rate_hz);
            let mut pulse = ((span_s.0 - start_s) * rate_hz).ceil();
            let end = ((span_s.1 - start_s) * rate_hz).ceil();
            while pulse < end {
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

/// North, east, down turned into east, north, up.
fn enu(ned: &Vector3<f64>) -> Vector3<f64> {
    Vector3::new(ned.y, ned.x, -ned.z)
}

/// The true poses of a block, interpolated.
struct TruePoses {
    start_s: f64,
    poses: Vec<(Vector3<f64>, UnitQuaternion<f64>)>,
}

impl TruePoses {
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // some twenty
    fn new(motion: &Motion, (start_s, end_s): (f64, f64)) -> Self {
        let count = ((end_s - start_s) / POSE_S).ceil() as u32 + 1;
        let poses = (0..=count).map(|k| motion.local_pose(start_s + f64::from(k) * POSE_S)).collect();
        Self { start_s, poses }
    }

    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // some twenty
    fn at(&self, time_s: f64) -> (Vector3<f64>, MapFromBody) {
        let x = ((time_s - self.start_s) / POSE_S).max(0.0);
        let k = (x as usize).min(self.poses.len() - 2);
        let (a, b) = (&self.poses[k], &self.poses[k + 1]);
        let u = x - x.floor();
        let turn = a.1.nlerp(&b.1, u).to_rotation_matrix().into_inner();
        let enu_from_ned = Matrix3::new(0.0, 1.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, -1.0);
        (enu(&(a.0 + (b.0 - a.0) * u)), enu_from_ned * turn)
    }
}

/// Records the pulses of one scanner in one block.
struct Recorder<'a> {
    survey: &'a DriveSurvey,
    scanner: &'a ProfileScanner,
    channel: u8,
    nearby: &'a Nearby<'a>,
    random: Random,
    poses: TruePoses,
    delivered: PoseCursor<'a>,
}

impl Recorder<'_> {
    /// The echoes of the pulse with a stamp counted from the begin of the data \[s\].
    fn pulse(&mut self, stamp_s: f64, echoes: &mut Vec<Echo>) {
        let options = &self.scanner.options;
        let time_s = self.survey.driven.span_s.0 + stamp_s;
        let scan_angle_rad = self.scanner.scan_angle_rad(stamp_s);
        let beam = ProfileScanner::beam(scan_angle_rad);
        let (position, map_from_body) = self.poses.at(time_s + options.latency_s);
        let origin = position + map_from_body * self.scanner.true_lever_arm_m;
        let aim = map_from_body * (self.scanner.true_body_from_scanner * beam);
        let (returns, count) = self.returns(&origin, &aim, time_s + options.latency_s);
        if count == 0 {
            return;
        }
        let (position, map_from_body) = self.delivered.at(time_s);
        let first = echoes.len();
        for echo in &returns[..count] {
            let noise_m = options.range_noise_m * self.random.normal();
            let range_m = echo.distance_m + self.scanner.bias_m(echo.distance_m) + noise_m;
            if range_m < options.min_range_m || range_m > options.max_range_m {
                continue;
            }
            let speckle = 1.0 + 0.06 * self.random.normal();
            let intensity = intensity(echo.intensity * speckle);
            let range_m = range_m
                + self.scanner.bias_at_incidence_m(echo.cosine.clamp(0.0, 1.0).acos().to_degrees())
                + self.scanner.bias_at_intensity_m(f64::from(intensity));
            let body_m = self.scanner.nominal_lever_arm_m + self.scanner.nominal_body_from_scanner * (beam * range_m);
            echoes.push(Echo {
                time_s,
                true_m: origin + aim * echo.distance_m,
                delivered_m: position + map_from_body * body_m,
                range_m,
                scan_angle_rad,
                scanner: self.channel,
                return_number: u8::try_from(echoes.len() - first + 1).unwrap_or(u8::MAX),
                number_of_returns: 0,
                class: echo.material.class(),
                intensity,
            });
        }
        let number_of_returns = u8::try_from(echoes.len() - first).unwrap_or(u8::MAX);
        echoes[first..].iter_mut().for_each(|e| e.number_of_returns = number_of_returns);
    }

    /// What comes back from a beam, nearest first, and how many of it.
    fn returns(&mut self, origin: &Vector3<f64>, aim: &Vector3<f64>, time_s: f64) -> ([Return; 3], usize) {
        let options = &self.scanner.options;
        let scene = &self.survey.scene;
        let within_m = options.max_range_m;
        let middle = scene.solid(self.nearby, origin, aim, time_s, within_m);
        let edge = match options.divergence_mrad > 0.0 {
            true => {
                let beside = self.beside(aim);
                scene.solid(self.nearby, origin, &beside, time_s, within_m).map(|hit| (hit, beside))
            }
            false => None,
        };
        let mut found = Found::new();
        match (middle, edge) {
            (None, None) => {}
            (Some(hit), None) | (None, Some((hit, _))) => {
                // half of the beam, where there is an edge at all
                let share = if options.divergence_mrad > 0.0 { 0.5 } else { 1.0 };
                found.add(self.of_hit(&hit, share));
            }
            (Some(a), Some((b, beside))) => {
                let apart_m = (beside * b.distance_m - aim * a.distance_m).dot(&a.normal).abs();
                if apart_m < SAME_PLANE_M && a.normal.dot(&b.normal).abs() > 0.999 {
                    found.add(self.of_hit(&a, 1.0));
                } else {
                    let share = self.random.between(0.1, 0.9);
                    let (near, far) = if a.distance_m <= b.distance_m { (a, b) } else { (b, a) };
                    let (near, far) = (self.of_hit(&near, share), self.of_hit(&far, 1.0 - share));
                    if far.distance_m - near.distance_m > RESOLUTION_M {
                        found.add(near);
                        found.add(far);
                    } else {
                        found.add(mixed(&near, &far));
                    }
                }
            }
        }
        self.through_leaves(origin, aim, &mut found);
        found.detect(&mut self.random)
    }

    /// A direction within the beam.
    fn beside(&mut self, aim: &Vector3<f64>) -> Vector3<f64> {
        let radius = 0.5e-3 * self.scanner.options.divergence_mrad;
        let (across, angle) = (radius * self.random.uniform().sqrt(), self.random.between(0.0, std::f64::consts::TAU));
        let helper = if aim.z.abs() < 0.9 { Vector3::z() } else { Vector3::x() };
        let u = aim.cross(&helper).normalize();
        let v = aim.cross(&u);
        aim + (u * angle.cos() + v * angle.sin()) * across
    }

    fn of_hit(&mut self, hit: &Hit, share: f64) -> Return {
        let rough_m = self.survey.scene.roughness_m(hit, &mut self.random);
        let strength = hit.strength(self.scanner.options.reach_m) * share;
        let range_m = hit.distance_m;
        let intensity = hit.material.reflectance() * hit.cosine * share / (1.0 + (range_m / 40.0).powi(2));
        Return { distance_m: range_m + rough_m, strength, material: hit.material, intensity, cosine: hit.cosine }
    }

    /// A leaf may take the beam, or a part of it.
    fn through_leaves(&mut self, origin: &Vector3<f64>, aim: &Vector3<f64>, found: &mut Found) {
        let before_m = match found.count {
            0 => self.scanner.options.max_range_m,
            _ => found.list[0].distance_m,
        };
        let Some(distance_m) = Scene::leaf_m(self.nearby, origin, aim, before_m, &mut self.random) else { return };
        let cosine = self.random.between(0.2, 1.0);
        let hit = Hit { distance_m, cosine, normal: -aim, material: Material::Foliage };
        let goes_on = self.random.uniform() < THROUGH_LEAF;
        let leaf = self.of_hit(&hit, if goes_on { 0.5 } else { 1.0 });
        if goes_on {
            let behind = found.list;
            let kept = found.count.min(2);
            found.list[1..=kept].copy_from_slice(&behind[..kept]);
            found.list[1..=kept].iter_mut().for_each(|r| {
                r.strength *= 0.5;
                r.intensity *= 0.5;
            });
            found.count = kept + 1;
        } else {
            found.count = 1;
        }
        found.list[0] = leaf;
    }
}

#[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // clamped
fn intensity(brightness: f64) -> u16 {
    (brightness * 80_000.0).clamp(0.0, 65_535.0) as u16
}
