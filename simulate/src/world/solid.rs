//! Convex solids: houses with walls and roofs, boxes of cars.

use nalgebra::{Vector2, Vector3};

/// What roof a house has.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Roof {
    /// Level.
    Flat,
    /// Two slopes that meet in a ridge along the house.
    Gable,
    /// Four slopes.
    Hip,
}

/// A convex solid: the points with `normal · x ≤ offset` for every face.
#[derive(Debug, Clone)]
pub struct Solid {
    faces: Vec<(Vector3<f64>, f64)>,
    /// Middle of the footprint.
    pub(super) centre: Vector2<f64>,
    /// Radius \[m\] about the middle that holds the footprint.
    pub(super) radius_m: f64,
    /// Highest point \[m\].
    pub(super) top_m: f64,
    /// Brightness, 0 to 1.
    pub(super) reflectance: f64,
    /// The only strip in which it is there; `None`: always.
    pub(super) only_strip: Option<u32>,
}

/// Outline of a house: footprint and heights.
#[derive(Debug, Clone, Copy)]
pub(super) struct House {
    pub(super) centre: Vector2<f64>,
    /// Of the long axis, counter-clockwise from east \[rad\].
    pub(super) azimuth_rad: f64,
    pub(super) half_length_m: f64,
    pub(super) half_width_m: f64,
    /// Ground level \[m\].
    pub(super) base_m: f64,
    /// Height of the eaves above the base \[m\].
    pub(super) eaves_m: f64,
    pub(super) roof: Roof,
    /// Slope of the roof \[rad\].
    pub(super) slope_rad: f64,
    pub(super) reflectance: f64,
}

impl Solid {
    /// The solid of a house, reaching well into the ground.
    pub(super) fn house(house: &House) -> Self {
        let (sin, cos) = house.azimuth_rad.sin_cos();
        let (along, across) = (Vector3::new(cos, sin, 0.0), Vector3::new(-sin, cos, 0.0));
        let centre = Vector3::new(house.centre.x, house.centre.y, house.base_m);
        let eaves = centre + Vector3::z() * house.eaves_m;
        let face = |normal: Vector3<f64>, point: Vector3<f64>| (normal, normal.dot(&point));
        let (a, b) = (house.half_length_m, house.half_width_m);
        let mut faces = vec![
            face(along, centre + along * a),
            face(-along, centre - along * a),
            face(across, centre + across * b),
            face(-across, centre - across * b),
        ];
        let (tilt_sin, tilt_cos) = house.slope_rad.sin_cos();
        let mut slope = |outward: Vector3<f64>, distance_m: f64| {
            faces.push(face(outward * tilt_sin + Vector3::z() * tilt_cos, eaves + outward * distance_m));
        };
        if house.roof != Roof::Flat {
            slope(across, b);
            slope(-across, b);
        }
        if house.roof == Roof::Hip {
            slope(along, a);
            slope(-along, a);
        }
        let rise_m = match house.roof {
            Roof::Flat => 0.0,
            Roof::Gable | Roof::Hip => b * house.slope_rad.tan(),
        };
        let top_m = house.base_m + house.eaves_m + rise_m;
        faces.push((Vector3::z(), top_m));
        Self {
            faces,
            centre: house.centre,
            radius_m: a.hypot(b),
            top_m,
            reflectance: house.reflectance,
            only_strip: None,
        }
    }

    /// Where a ray enters \[m\], and the normal of the face; `None` when it passes by.
    pub(super) fn hit(&self, origin: &Vector3<f64>, direction: &Vector3<f64>) -> Option<(f64, Vector3<f64>)> {
        let (mut enter, mut leave) = (f64::NEG_INFINITY, f64::INFINITY);
        let mut normal = Vector3::zeros();
        for (n, offset) in &self.faces {
            let closing = n.dot(direction);
            let distance = offset - n.dot(origin);
            if closing < 0.0 {
                let t = distance / closing;
                if t > enter {
                    (enter, normal) = (t, *n);
                }
            } else if closing > 0.0 {
                leave = leave.min(distance / closing);
            } else if distance < 0.0 {
                return None;
            }
            if enter > leave {
                return None;
            }
        }
        (enter > 0.0).then_some((enter, normal))
    }

    /// Distance \[m\] of a point outside of the faces; negative inside.
    pub(super) fn outside_m(&self, point: &Vector3<f64>) -> f64 {
        self.faces.iter().map(|(n, offset)| n.dot(point) - offset).fold(f64::NEG_INFINITY, f64::max)
    }
}
