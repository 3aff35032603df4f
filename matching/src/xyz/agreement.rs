//! Ties judged by what the others about them say together, along the directions that they hold.

use nalgebra::{Matrix3, Vector3};
use rstar::{RTree, primitives::GeomWithData};

/// What a tie says: a shift along some directions.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Said {
    /// Where, in plan \[m\].
    pub(crate) place_m: [f64; 2],
    /// The shift \[m\].
    pub(crate) shift_m: Vector3<f64>,
    /// Directions held, at right angles to each other, and the sigma along each \[m\].
    pub(crate) held: Vec<(Vector3<f64>, f64)>,
}

impl Said {
    /// Information matrix, and the same times the shift.
    fn information(&self) -> (Matrix3<f64>, Vector3<f64>) {
        let n: Matrix3<f64> = self.held.iter().map(|(e, sigma)| e * e.transpose() / (sigma * sigma)).sum();
        (n, n * self.shift_m)
    }
}

/// Who judges whom.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Neighbourhood {
    /// Others from this distance on: nearer ones share their error \[m\].
    pub(crate) from_m: f64,
    /// Others up to this distance \[m\].
    pub(crate) to_m: f64,
    /// What the shift may drift over the reach \[m\].
    pub(crate) drift_m: f64,
}

/// Why a tie does not stay.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Disagreement {
    /// It differs from what the others say.
    Neighbours,
    /// Nobody knows one of its directions.
    Alone,
}

/// Sigmas allowed beyond the drift.
const SIGMAS: f64 = 4.0;
/// Largest sigma \[m\] of what the others say along a direction, for them to be judges of it.
const JUDGES_SIGMA_M: f64 = 0.1;

/// Takes out the tie that disagrees most with the others, until none does; gives the reason for each that was. Ties that are `None` take
/// no part.
pub(crate) fn judge(ties: &[Option<Said>], hood: &Neighbourhood) -> Vec<Option<Disagreement>> {
    let places = ties.iter().enumerate().filter_map(|(row, t)| Some(GeomWithData::new(t.as_ref()?.place_m, row)));
    let tree = RTree::bulk_load(places.collect());
    let squared = |d: f64| d * d;
    let neighbours: Vec<Vec<usize>> = ties
        .iter()
        .enumerate()
        .map(|(row, tie)| {
            let Some(tie) = tie else { return Vec::new() };
            let near = tree.locate_within_distance(tie.place_m, squared(hood.to_m) * (1.0 + 1e-12));
            let apart = |p: &[f64; 2]| squared(p[0] - tie.place_m[0]) + squared(p[1] - tie.place_m[1]);
            let mut near: Vec<usize> =
                near.filter(|o| o.data != row && apart(o.geom()) >= squared(hood.from_m)).map(|o| o.data).collect();
            near.sort_unstable();
            near
        })
        .collect();
    let information: Vec<_> = ties.iter().map(|t| t.as_ref().map(Said::information)).collect();
    let mut reasons: Vec<Option<Disagreement>> = vec![None; ties.len()];
    let verdict = |row: usize, reasons: &[Option<Disagreement>]| -> Option<f64> {
        let tie = ties[row].as_ref().filter(|_| reasons[row].is_none())?;
        let others = neighbours[row].iter().filter(|o| reasons[**o].is_none()).filter_map(|o| information[*o]);
        value(tie, others, hood)
    };
    let mut values: Vec<Option<f64>> = (0..ties.len()).map(|row| verdict(row, &reasons)).collect();
    loop {
        let known = values.iter().enumerate().filter_map(|(row, v)| Some((row, (*v)?)));
        let Some((row, worst)) = known.max_by(|a, b| a.1.total_cmp(&b.1).then(b.0.cmp(&a.0))).filter(|w| w.1 > 1.0)
        else {
            return reasons;
        };
        reasons[row] = Some(if worst.is_infinite() { Disagreement::Alone } else { Disagreement::Neighbours });
        values[row] = None;
        for other in &neighbours[row] {
            values[*other] = verdict(*other, &reasons);
        }
    }
}

/// The difference of a tie from the others over what is allowed, along its worst direction; infinite when nobody can tell.
fn value(tie: &Said, others: impl Iterator<Item = (Matrix3<f64>, Vector3<f64>)>, hood: &Neighbourhood) -> Option<f64> {
    // a metre of prior sigma, so that what nobody says is no division by nothing
    let start = (Matrix3::identity(), Vector3::zeros());
    let (n, b) = others.fold(start, |(n, b), (of_n, of_b)| (n + of_n, b + of_b));
    let covariance_m2 = n.try_inverse()?;
    let difference_m = tie.shift_m - covariance_m2 * b;
    let values = tie.held.iter().map(|(e, sigma)| {
        let of_others_m = e.dot(&(covariance_m2 * e)).sqrt();
        if of_others_m > JUDGES_SIGMA_M {
            return f64::INFINITY;
        }
        e.dot(&difference_m).abs() / (hood.drift_m + SIGMAS * sigma.hypot(of_others_m))
    });
    Some(values.fold(0.0, f64::max))
}

#[cfg(test)]
mod tests {
    use super::*;

    const HOOD: Neighbourhood = Neighbourhood { from_m: 10.0, to_m: 60.0, drift_m: 0.02 };

    fn ties(shifts_m: &[f64], spacing_m: f64) -> Vec<Option<Said>> {
        let held = vec![(Vector3::x(), 0.005), (Vector3::z(), 0.003)];
        let mut east_m = -spacing_m;
        let said = |x: &f64| {
            east_m += spacing_m;
            Some(Said { place_m: [east_m, 0.0], shift_m: Vector3::new(*x, 0.0, 0.01), held: held.clone() })
        };
        shifts_m.iter().map(said).collect()
    }

    #[test]
    fn the_one_that_differs_goes_and_the_others_stay() {
        let found = judge(&ties(&[0.10, 0.10, 0.25, 0.11, 0.10], 20.0), &HOOD);
        assert_eq!(found, [None, None, Some(Disagreement::Neighbours), None, None]);
    }

    #[test]
    fn without_others_that_know_the_direction_a_tie_is_alone() {
        let mut list = ties(&[0.10, 0.10, 0.10], 20.0);
        if let Some(tie) = &mut list[1] {
            tie.held.push((Vector3::y(), 0.004));
        }
        assert_eq!(judge(&list, &HOOD), [None, Some(Disagreement::Alone), None]);
        // those next door and those out of reach are no judges
        assert_eq!(judge(&ties(&[0.1, 0.1], 5.0), &HOOD), [Some(Disagreement::Alone); 2]);
        assert_eq!(judge(&ties(&[0.1, 0.1], 70.0), &HOOD), [Some(Disagreement::Alone); 2]);
        let none = vec![None, ties(&[0.1], 1.0).remove(0)];
        assert_eq!(judge(&none, &HOOD), [None, Some(Disagreement::Alone)]);
    }
}
