//! Road, curbs, pavement and verge as triangles: squares of a metre, cut along the curb.

use nalgebra::{Vector2, Vector3};

use super::material::Material;
use super::mesh::MeshBuilder;
use crate::drive::network::Network;

/// Side of a square \[m\].
const CELL_M: f64 = 1.0;

/// A corner of the grid: its point and its distance from the curb \[m\].
type Corner = (Vector2<f64>, f64);

/// Adds the ground up to a distance from the curb.
pub(super) fn add(mesh: &mut MeshBuilder, network: &Network, bounds: (Vector2<f64>, Vector2<f64>), verge_m: f64) {
    let (low, high) = bounds;
    let columns = count(high.x - low.x);
    let rows = count(high.y - low.y);
    let point = |i: u32, j: u32| low + Vector2::new(f64::from(i), f64::from(j)) * CELL_M;
    let row = |j: u32| -> Vec<(Corner, f64)> {
        (0..=columns)
            .map(|i| {
                let p = point(i, j);
                let across = network.across(&p);
                ((p, across.from_curb_m), across.pavement_m)
            })
            .collect()
    };
    let mut below = row(0);
    for j in 0..rows {
        let above = row(j + 1);
        for i in 0..columns as usize {
            let cell = [below[i].0, below[i + 1].0, above[i + 1].0, above[i].0];
            let pavement_m = below[i].1;
            if cell.iter().any(|c| c.1 < pavement_m + verge_m) {
                add_cell(mesh, network, &cell, pavement_m);
            }
        }
        below = above;
    }
}

#[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // some kilometres
fn count(length_m: f64) -> u32 {
    (length_m / CELL_M).ceil() as u32
}

/// A square: the part on the road, the part beyond the curb, and the curb between them.
fn add_cell(mesh: &mut MeshBuilder, network: &Network, cell: &[Corner; 4], pavement_m: f64) {
    let (mut road, mut beyond, mut curb) = (Vec::new(), Vec::new(), Vec::new());
    for k in 0..4 {
        let ((p, a), (q, b)) = (cell[k], cell[(k + 1) % 4]);
        if a < 0.0 {
            road.push((p, a));
        } else {
            beyond.push((p, a));
        }
        if (a < 0.0) != (b < 0.0) {
            let crossing = p + (q - p) * (a / (a - b));
            road.push((crossing, 0.0));
            beyond.push((crossing, 0.0));
            curb.push(crossing);
        }
    }
    let on_road = |c: &Corner| c.0.push(network.road_at_m(&c.0, c.1));
    let on_pavement = |c: &Corner| c.0.push(network.pavement_at_m(&c.0, c.1));
    mesh.polygon(&road.iter().map(on_road).collect::<Vec<_>>(), Material::Asphalt);
    let is_pavement = beyond.iter().map(|c| c.1).fold(f64::INFINITY, f64::min) < pavement_m;
    let material = if is_pavement { Material::Pavement } else { Material::Verge };
    mesh.polygon(&beyond.iter().map(on_pavement).collect::<Vec<_>>(), material);
    if let [p, q] = curb[..] {
        let at = |v: Vector2<f64>| (on_road(&(v, 0.0)), on_pavement(&(v, 0.0)));
        let ((a, d), (b, c)): ((Vector3<f64>, _), (_, _)) = (at(p), at(q));
        mesh.polygon(&[a, b, c, d], Material::Curb);
    }
}
