//! Points of a sighting by squares of plan.

use super::keep::TexturePoint;

/// Edge of a square \[m\].
const SQUARE_M: f64 = 0.25;

/// Which points lie in which square.
#[derive(Debug)]
pub(super) struct Plan {
    low_m: f64,
    columns: usize,
    /// Where the points of each square begin in `order`, and where the last end.
    starts: Vec<u32>,
    order: Vec<u32>,
}

impl Plan {
    /// Points in a square of plan from `low_m` on, `width_m` wide.
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // a tile
    pub(super) fn new(points: &[TexturePoint], low_m: f64, width_m: f64) -> Self {
        let columns = (width_m / SQUARE_M).ceil().max(1.0) as usize;
        let mut plan = Self { low_m, columns, starts: vec![0; columns * columns + 1], order: vec![0; points.len()] };
        let squares: Vec<usize> = points
            .iter()
            .map(|p| {
                let [x, y] = [0, 1].map(|k| plan.column(f64::from(p.place_m[k])));
                y * columns + x
            })
            .collect();
        squares.iter().for_each(|s| plan.starts[s + 1] += 1);
        (0..columns * columns).for_each(|k| plan.starts[k + 1] += plan.starts[k]);
        let mut next = plan.starts.clone();
        for (k, s) in (0..).zip(&squares) {
            plan.order[next[*s] as usize] = k;
            next[*s] += 1;
        }
        plan
    }

    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // not negative, bounded
    fn column(&self, at_m: f64) -> usize {
        (((at_m - self.low_m) / SQUARE_M).max(0.0) as usize).min(self.columns - 1)
    }

    /// Rows of the points in the squares that a circle touches, square by square, each in the order of the points.
    pub(super) fn about(&self, place_m: [f64; 2], radius_m: f64) -> impl Iterator<Item = usize> + '_ {
        let [xs, ys] = [0, 1].map(|k| self.column(place_m[k] - radius_m)..=self.column(place_m[k] + radius_m));
        ys.flat_map(move |y| {
            let (from, to) = (y * self.columns + xs.start(), y * self.columns + xs.end() + 1);
            self.order[self.starts[from] as usize..self.starts[to] as usize].iter().map(|k| *k as usize)
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::block::SourceKey;

    #[test]
    fn all_points_of_a_circle_are_about_its_middle() {
        let points: Vec<TexturePoint> = (0..500_u16)
            .map(|k| TexturePoint {
                time_s: f64::from(k),
                source: SourceKey::new(1, 0, 0),
                place_m: [f32::from(k * 37 % 500) * 0.01 - 1.0, f32::from(k * 91 % 500) * 0.01 - 1.0, 0.0],
                intensity: 1,
                range_cm: 1,
            })
            .collect();
        let plan = Plan::new(&points, -1.0, 4.5);
        for (place_m, radius_m) in [([0.3, 1.1], 0.4), ([-1.0, 3.4], 0.6), ([9.0, 9.0], 0.3)] {
            let about: Vec<usize> = plan.about(place_m, radius_m).collect();
            let off_m =
                |p: &TexturePoint| (f64::from(p.place_m[0]) - place_m[0]).hypot(f64::from(p.place_m[1]) - place_m[1]);
            let within: Vec<usize> = (0..points.len()).filter(|k| off_m(&points[*k]) <= radius_m).collect();
            assert!(within.iter().all(|k| about.contains(k)));
            assert!(about.len() <= points.len() && (place_m[0] > 5.0 || !within.is_empty()));
        }
        assert_eq!(plan.about([1.25, 1.25], 9.0).count(), points.len());
    }
}
