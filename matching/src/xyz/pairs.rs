//! Features of several sightings in pairs: each with the nearest that fits it in every other sighting, if that is the only one and wants it too.

use std::collections::BTreeMap;

use nalgebra::Vector2;

use super::corner_match::NotTied;

/// A feature to be paired.
#[derive(Debug, Clone, Copy)]
pub(super) struct Item<S> {
    /// Whose it is: features of one sighting are not paired.
    pub(super) sighting: S,
    /// Where it is in plan \[m\].
    pub(super) place_m: Vector2<f64>,
    /// When \[s\].
    pub(super) time_s: f64,
}

/// A second candidate must be further away than so many times the first, counted from this at least \[m\].
const UNIQUE: f64 = 2.0;
const COUNTED_M: f64 = 0.05;

/// Pairs of features, rows of `items`, which are in the order of their sightings, and why one is no tie. `search_m` is how far sightings of two times may lie apart \[m\], `most_search_m` its bound;
/// `fits` says whether two may be the same. What is tied to an earlier sighting does not look for later ones itself.
#[allow(clippy::cast_possible_truncation)] // squares of a survey
pub(super) fn pairs<S: Copy + Ord>(
    items: &[Item<S>],
    search_m: &dyn Fn(f64, f64) -> f64,
    most_search_m: f64,
    fits: &dyn Fn(usize, usize) -> bool,
) -> Vec<([usize; 2], Option<NotTied>)> {
    let square = |item: &Item<S>| [item.place_m.x, item.place_m.y].map(|v| (v / most_search_m).floor() as i64);
    let mut places: BTreeMap<[i64; 2], Vec<usize>> = BTreeMap::new();
    for (row, item) in items.iter().enumerate() {
        places.entry(square(item)).or_default().push(row);
    }
    // those of another sighting that may be it, the nearest first
    let candidates = |row: usize, sighting: S| -> Vec<(f64, usize)> {
        let own = &items[row];
        let [x, y] = square(own);
        let about = (x - 1..=x + 1).flat_map(|x| (y - 1..=y + 1).map(move |y| [x, y]));
        let near = about.filter_map(|at| places.get(&at)).flatten().copied();
        let mut found: Vec<(f64, usize)> = near
            .filter(|k| items[*k].sighting == sighting)
            .map(|k| ((items[k].place_m - own.place_m).norm(), k))
            .filter(|(m, k)| *m <= search_m(own.time_s, items[*k].time_s) && fits(row, *k))
            .collect();
        found.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        found
    };
    let mut sightings: Vec<S> = items.iter().map(|c| c.sighting).collect();
    sightings.dedup();
    let mut found = Vec::new();
    let mut is_second = vec![false; items.len()];
    for row in 0..items.len() {
        if is_second[row] {
            continue;
        }
        for sighting in sightings.iter().filter(|s| **s > items[row].sighting) {
            let near = candidates(row, *sighting);
            let Some((nearest_m, second)) = near.first().copied() else { continue };
            let back = candidates(second, items[row].sighting);
            let is_rival = |next: &(f64, usize)| next.0 < UNIQUE * nearest_m.max(COUNTED_M);
            let rejection = match back.first() {
                _ if near.get(1).is_some_and(is_rival) => Some(NotTied::Ambiguous),
                Some((_, best)) if *best == row => None,
                _ => Some(NotTied::NotReciprocal),
            };
            is_second[second] |= rejection.is_none();
            found.push(([row, second], rejection));
        }
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;

    fn item(sighting: u32, x: f64) -> Item<u32> {
        Item { sighting, place_m: Vector2::new(x, 0.0), time_s: f64::from(sighting) }
    }

    fn found(items: &[Item<u32>]) -> Vec<([usize; 2], Option<NotTied>)> {
        pairs(items, &|_, _| 0.5, 0.5, &|_, _| true)
    }

    #[test]
    fn all_sightings_of_a_feature_are_paired_with_the_first() {
        let items = [item(0, 0.0), item(0, 9.0), item(1, 0.2), item(1, 9.1), item(2, -0.1), item(3, 9.7)];
        assert_eq!(found(&items), [([0, 2], None), ([0, 4], None), ([1, 3], None)]);
        assert!(pairs(&items, &|_, _| 0.5, 0.5, &|_, _| false).is_empty());
    }

    #[test]
    fn a_rival_and_a_better_match_are_reasons() {
        let rival = [item(0, 0.0), item(1, 0.2), item(1, -0.3)];
        assert_eq!(found(&rival), [([0, 1], Some(NotTied::Ambiguous))]);
        let taken = [item(0, 0.0), item(0, 0.3), item(1, 0.28)];
        assert_eq!(found(&taken), [([0, 2], Some(NotTied::NotReciprocal)), ([1, 2], None)]);
    }
}
