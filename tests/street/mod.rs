//! A small street seen by three spinning scanners of a vehicle at a few stations; extrinsics known, cast by hand.
#![allow(dead_code, clippy::expect_used, clippy::cast_precision_loss)] // each test uses a part of it

use nalgebra::{Rotation3, UnitQuaternion, Vector3};
use tieline::stage::stations::{Head, Mounts, Spin, Station};
use tieline_matching::mix;

/// Numbers that are the same everywhere.
pub(crate) struct Random(u64);

impl Random {
    pub(crate) fn new(seed: u64) -> Self {
        Self(mix(seed ^ 0x5_7ee7))
    }
    fn uniform(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        ((mix(self.0) >> 11) as f64 + 0.5) / (1_u64 << 53) as f64
    }
    /// A number of the normal distribution (Box and Muller).
    pub(crate) fn normal(&mut self) -> f64 {
        (-2.0 * self.uniform().ln()).sqrt() * (std::f64::consts::TAU * self.uniform()).cos()
    }
    pub(crate) fn vector(&mut self, sigma: f64) -> Vector3<f64> {
        Vector3::from_fn(|_, _| self.normal() * sigma)
    }
}

/// A rectangle: centre, half sides (their cross product is the normal).
pub(crate) struct Rectangle {
    centre: Vector3<f64>,
    half: [Vector3<f64>; 2],
}

impl Rectangle {
    fn new(centre: [f64; 3], a: [f64; 3], b: [f64; 3]) -> Self {
        Self { centre: centre.into(), half: [a.into(), b.into()] }
    }

    /// Range at which a ray meets it \[m\].
    fn range_m(&self, origin: &Vector3<f64>, beam: &Vector3<f64>) -> Option<f64> {
        let normal = self.half[0].cross(&self.half[1]);
        let range = normal.dot(&(self.centre - origin)) / normal.dot(beam);
        let at = origin + beam * range - self.centre;
        let inside = self.half.iter().all(|h| at.dot(h).abs() <= h.norm_squared());
        (range > 0.5 && range < 80.0 && inside).then_some(range)
    }
}

/// Axes east, north, up: a road with two crossfalls of 2 %, and façades.
pub(crate) fn street() -> Vec<Rectangle> {
    let mut scene = vec![road(5.0, 1.0), road(5.0, -1.0)];
    for (centre, along) in
        [([0.0, 10.5, 4.0], [40.0, 0.0]), ([-25.0, -14.0, 3.0], [9.0, 3.0]), ([32.0, 0.0, 4.0], [0.5, 9.0])]
    {
        scene.push(Rectangle::new(centre, [along[0], along[1], 0.0], [0.0, 0.0, 5.0]));
    }
    for (x, y) in [(-8.0, 8.0), (6.0, 8.5), (14.0, -9.0), (-14.0, -8.0), (20.0, 7.0)] {
        scene.push(Rectangle::new([x, y, 1.0], [0.3, 1.6, 0.0], [0.0, 0.0, 2.5]));
        scene.push(Rectangle::new([x + 1.2, y, 1.0], [1.4, -0.2, 0.0], [0.0, 0.0, 2.5]));
    }
    scene
}

/// Level ground and nothing else.
pub(crate) fn plain() -> Vec<Rectangle> {
    vec![Rectangle::new([0.0, 0.0, 0.0], [80.0, 0.0, 0.0], [0.0, 80.0, 0.0])]
}

/// Half a road as wide as twice `half_m`, to the left (1) or right (-1) of its crown.
fn road(half_m: f64, side: f64) -> Rectangle {
    Rectangle::new([0.0, side * half_m, -0.02 * half_m], [60.0, 0.0, 0.0], [0.0, half_m, -0.02 * side * half_m])
}

/// How far the vehicle moved while its scanners turned.
#[derive(Clone, Copy, Default)]
pub(crate) struct Moving {
    pub(crate) forward_mps: f64,
    pub(crate) yaw_rate_radps: f64,
}

/// The true mounting in the body frame (forward, right, down): one on the roof, two at the sides, tilted by 45°.
pub(crate) fn heads() -> Vec<Head> {
    let head = |scanner, name: &str, rpy_deg: [f64; 3], lever_arm_m: [f64; 3]| {
        let [roll, pitch, yaw] = rpy_deg.map(f64::to_radians);
        Head {
            scanner,
            name: name.to_string(),
            body_from_scanner: UnitQuaternion::from_euler_angles(roll, pitch, yaw),
            lever_arm_m: lever_arm_m.into(),
        }
    };
    vec![
        head(0, "top", [180.0, 0.0, 0.0], [0.0; 3]),
        head(1, "left", [135.0, 0.0, -90.0], [-0.07, -0.62, 0.43]),
        head(2, "right", [135.0, 0.0, 90.0], [0.0, 0.46, 0.38]),
    ]
}

/// What a file of rough extrinsics would say of it: errors of the sigmas.
pub(crate) fn rough(random: &mut Random, boresight_sigma_deg: f64, lever_arm_sigma_m: f64) -> Mounts {
    let mut heads = heads();
    for head in &mut heads[1..] {
        let error = Rotation3::new(random.vector(boresight_sigma_deg.to_radians()));
        head.body_from_scanner = UnitQuaternion::from(error).inverse() * head.body_from_scanner;
        head.lever_arm_m -= random.vector(lever_arm_sigma_m);
    }
    Mounts {
        heads,
        reference: 0,
        boresight_sigma_rad: boresight_sigma_deg.to_radians(),
        lever_arm_sigma_m,
        if_radians: None,
    }
}

/// One spin of every scanner from a place on the road (east, north, course from east to the left \[rad\]).
pub(crate) fn station(
    scene: &[Rectangle],
    place: (f64, f64, f64),
    moving: Moving,
    noise_m: f64,
    random: &mut Random,
) -> Station {
    let (east, north, course) = place;
    let spins = heads().into_iter().enumerate().map(|(k, head)| {
        let (rings, step_deg) = if k == 0 { (48, 0.8) } else { (57, 0.8) };
        let start_s = 0.03 * k as f64;
        let mut spin = Spin::default();
        for ring in 0..rings {
            let elevation = if k == 0 { -25.0 + 0.75 * f64::from(ring) } else { -38.0 + 1.3 * f64::from(ring) };
            let (sin_e, cos_e) = elevation.to_radians().sin_cos();
            for column in 0..450 {
                let azimuth_deg = step_deg * f64::from(column);
                let (sin_a, cos_a) = azimuth_deg.to_radians().sin_cos();
                let beam = Vector3::new(cos_e * cos_a, cos_e * sin_a, sin_e);
                let time_s = start_s + 0.1 * azimuth_deg / 360.0;
                // to the right is clockwise from above
                let turned = course - moving.yaw_rate_radps * time_s;
                let forward = Vector3::new(turned.cos(), turned.sin(), 0.0);
                let enu_from_body = |v: Vector3<f64>| {
                    let right = Vector3::new(turned.sin(), -turned.cos(), 0.0);
                    forward * v.x + right * v.y - Vector3::z() * v.z
                };
                let vehicle = Vector3::new(east, north, 1.9) + forward * (moving.forward_mps * time_s);
                let origin = vehicle + enu_from_body(head.lever_arm_m);
                let direction = enu_from_body(head.body_from_scanner * beam);
                let hit = scene.iter().filter_map(|r| r.range_m(&origin, &direction)).min_by(f64::total_cmp);
                if let Some(range_m) = hit {
                    spin.points_m.push(beam * (range_m + noise_m * random.normal()));
                    spin.intensity.push(50);
                    spin.time_s.push(1000.0 + time_s);
                }
            }
        }
        spin
    });
    Station { name: format!("station at {east:.0}"), spins: spins.collect() }
}

/// Three stations along the street.
pub(crate) fn survey(scene: &[Rectangle], moving: Moving, noise_m: f64, random: &mut Random) -> Vec<Station> {
    let places = [(-12.0, -2.0, 0.05), (2.0, -1.0, -0.1), (14.0, 1.5, 2.9)];
    places.iter().map(|place| station(scene, *place, moving, noise_m, random)).collect()
}
