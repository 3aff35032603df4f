//! Approximate coordinates of stations that have none: polar, intersection, resection, until no more is found.

use std::collections::HashMap;
use std::f64::consts::{PI, TAU};

use nalgebra::{DMatrix, DVector, Vector2};
use tieline_io::network::{Network, Observation};

/// Computes missing places from directions and distances; places in the sense of the angles (x towards y).
pub fn complete(net: &Network, places: &mut [Option<Vector2<f64>>]) {
    let mut sets: HashMap<usize, (usize, Vec<(usize, f64)>)> = HashMap::new();
    let mut lengths: HashMap<(usize, usize), f64> = HashMap::new();
    for observation in &net.observations {
        match observation {
            Observation::Direction(set, from, to, value, _) => {
                sets.entry(*set).or_insert_with(|| (*from, Vec::new())).1.push((*to, *value));
            }
            Observation::Distance(a, b, length, _) => {
                lengths.insert((*a, *b), *length);
                lengths.insert((*b, *a), *length);
            }
            _ => {}
        }
    }
    let mut keys: Vec<usize> = sets.keys().copied().collect();
    keys.sort_unstable();
    loop {
        let before = places.iter().flatten().count();
        for key in &keys {
            let (station, readings) = &sets[key];
            resect(places, *station, readings);
        }
        let mut rays: HashMap<usize, Vec<(Vector2<f64>, f64)>> = HashMap::new();
        for key in &keys {
            let (station, readings) = &sets[key];
            let Some(at) = places[*station] else { continue };
            let Some(zero) = orientation(places, at, readings) else { continue };
            for (to, reading) in readings.iter().filter(|(to, _)| places[*to].is_none()) {
                let bearing = zero + reading;
                rays.entry(*to).or_default().push((at, bearing));
            }
            for (to, reading) in readings {
                if places[*to].is_none()
                    && let Some(length) = lengths.get(&(*station, *to))
                {
                    let (sin, cos) = (zero + reading).sin_cos();
                    places[*to] = Some(at + *length * Vector2::new(cos, sin));
                }
            }
        }
        let mut targets: Vec<_> = rays.into_iter().collect();
        targets.sort_by_key(|(to, _)| *to);
        for (to, rays) in targets {
            if places[to].is_none() {
                places[to] = intersect(&rays);
            }
        }
        if places.iter().flatten().count() == before {
            return;
        }
    }
}

/// Bearing of a set's zero, the mean over known targets.
fn orientation(places: &[Option<Vector2<f64>>], at: Vector2<f64>, readings: &[(usize, f64)]) -> Option<f64> {
    let (mut sin, mut cos) = (0.0, 0.0);
    for (to, reading) in readings {
        if let Some(target) = places[*to] {
            let d = target - at;
            let zero = d.y.atan2(d.x) - reading;
            sin += zero.sin();
            cos += zero.cos();
        }
    }
    (sin != 0.0 || cos != 0.0).then(|| sin.atan2(cos))
}

/// The point that is nearest to all rays; none when they are parallel.
fn intersect(rays: &[(Vector2<f64>, f64)]) -> Option<Vector2<f64>> {
    let (mut matrix, mut right) = (nalgebra::Matrix2::zeros(), Vector2::zeros());
    for (at, bearing) in rays {
        let normal = Vector2::new(-bearing.sin(), bearing.cos());
        matrix += normal * normal.transpose();
        right += normal * normal.dot(at);
    }
    (matrix.determinant() > 1e-3).then(|| matrix.try_inverse().map(|m| m * right)).flatten()
}

/// A station from directions to three or more known targets: Gauss-Newton from several starts.
fn resect(places: &mut [Option<Vector2<f64>>], station: usize, readings: &[(usize, f64)]) {
    if places[station].is_some() {
        return;
    }
    let known: Vec<(Vector2<f64>, f64)> = readings.iter().filter_map(|(to, r)| places[*to].map(|p| (p, *r))).collect();
    if known.len() < 3 {
        return;
    }
    #[allow(clippy::cast_precision_loss)]
    let middle = known.iter().map(|k| k.0).sum::<Vector2<f64>>() / known.len() as f64;
    let size = known.iter().map(|k| (k.0 - middle).norm()).fold(0.0, f64::max);
    let mut best: Option<(f64, Vector2<f64>)> = None;
    for ring in 0..4_u8 {
        for step in 0..8_u8 {
            let angle = f64::from(step) * TAU / 8.0;
            let start = middle + f64::from(ring) * 0.4 * size * Vector2::new(angle.cos(), angle.sin());
            if let Some((error, place)) = resect_from(&known, start)
                && best.is_none_or(|(e, _)| error < e)
            {
                best = Some((error, place));
            }
        }
    }
    places[station] = best.filter(|(error, _)| *error < 1e-2).map(|(_, place)| place);
}

fn resect_from(known: &[(Vector2<f64>, f64)], start: Vector2<f64>) -> Option<(f64, Vector2<f64>)> {
    let bearing = |p: &Vector2<f64>, at: &Vector2<f64>| (p.y - at.y).atan2(p.x - at.x);
    let mut at = start;
    let mut zero = bearing(&known[0].0, &at) - known[0].1;
    let mut error = f64::INFINITY;
    for _ in 0..40 {
        let mut matrix = DMatrix::zeros(known.len(), 3);
        let mut right = DVector::zeros(known.len());
        for (k, (p, reading)) in known.iter().enumerate() {
            let d = p - at;
            let square = d.norm_squared().max(1e-6);
            matrix[(k, 0)] = d.y / square;
            matrix[(k, 1)] = -d.x / square;
            matrix[(k, 2)] = -1.0;
            right[k] = -((bearing(p, &at) - zero - reading + PI).rem_euclid(TAU) - PI);
        }
        error = right.norm();
        let step = matrix.svd(true, true).solve(&right, 1e-12).ok()?;
        at += Vector2::new(step[0], step[1]);
        zero += step[2];
        if step[0].hypot(step[1]) < 1e-6 {
            break;
        }
    }
    at.iter().all(|v| v.is_finite()).then_some((error, at))
}
