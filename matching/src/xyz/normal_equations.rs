//! Robust normal equations of facets, the directions that they hold, and their covariance.

use nalgebra::{DMatrix, DVector, SymmetricEigen, Vector3, Vector6};

use super::facet::Facet;
use super::held::Held;
use super::slab::{Slab, class, common_error_m, lonely, normal_of, pretended_of, slabs, sums, variances_m2};

/// What decides which directions are held.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Bounds {
    /// Number of unknowns: three shifts, or six with the turns.
    pub(crate) unknowns: usize,
    /// Largest sigma of a direction that counts as held \[m\].
    pub(crate) max_sigma_m: f64,
    /// Edge of the blocks of space whose facets may be off together \[m\].
    pub(crate) neighbourhood_m: f64,
}

/// About which point turns are counted, and over which length a turn is a displacement.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Frame {
    /// Weighted centre of the facets \[m\].
    pub(crate) origin_m: Vector3<f64>,
    /// Radius of gyration of the facets about it \[m\]: an unknown turn is counted as turn times this.
    pub(crate) gyration_m: f64,
}

/// Huber's k, in scaled sigmas.
const HUBER: f64 = 2.0;
/// Rounds with Huber's weights: the problem is convex, the start does not matter.
const HUBER_ROUNDS: usize = 10;
/// Rounds of least squares over facets and slabs within [`OUTLIER`] sigmas.
const PLAIN_ROUNDS: usize = 6;
/// Facets, and slabs, beyond this many sigmas are of something that has changed or is no surface.
const OUTLIER: f64 = 3.5;
/// Least number of facets of a class of slope for a scale of its own.
const CLASS_MEMBERS: usize = 12;
/// Least ratio of a direction's information to what the noise of the normals alone would pretend.
const GEOMETRY: f64 = 4.0;
/// Least number of slabs that must carry a direction, counted as (Σ I)² / Σ I².
const CARRIERS: f64 = 3.0;
/// Wider blocks that are tried for the covariance, in blocks.
const REACHES: [f64; 2] = [2.0, 4.0];
/// Fewest slabs that tell a variance.
const ENOUGH_SLABS: usize = 24;

/// The outcome of one adjustment.
#[derive(Debug, Clone)]
pub(crate) struct Adjusted {
    /// Shift \[m\] and, with turns, turn \[rad\].
    pub(crate) step: Vector6<f64>,
    /// The directions that are held.
    pub(crate) held: Held,
    /// Whether a facet is in use.
    pub(crate) used: Vec<bool>,
    /// Scale of the sigmas of level, sloped and steep facets, 1 or more.
    pub(crate) scale: [f64; 3],
    /// Sigma of the errors that level, sloped and steep slabs have in common \[m\].
    pub(crate) common_sigma_m: [f64; 3],
    /// Least share of a held direction's information that is left once slabs may be off together.
    pub(crate) independent: f64,
    /// For each held direction what each slab says.
    pub(crate) carriers: Vec<Vec<Carrier>>,
}

/// What a slab adds to the shift along a held direction: the shift is -Σ aₖ dₖ over facets, so that a displacement Δ(x) of the moving
/// cloud that is not the same everywhere shows as Σ along·Δ(centre) over carriers.
#[derive(Debug, Clone, PartialEq)]
pub struct Carrier {
    /// Where, weighted by what each facet adds \[m\].
    pub centre_m: Vector3<f64>,
    /// Mean times of the facets' points in the fixed and in the moving cloud \[s\].
    pub time_s: [f64; 2],
    /// Σ aₖ nₖ of its facets; over all carriers the held direction itself.
    pub along: Vector3<f64>,
}

/// The centre of some facets and their radius of gyration, by information.
pub(crate) fn frame(facets: &[Facet]) -> Frame {
    let total: f64 = facets.iter().map(|f| f.sigma_m.powi(-2)).sum();
    let origin_m = facets.iter().map(|f| f.centre_m * f.sigma_m.powi(-2)).sum::<Vector3<f64>>() / total.max(1e-300);
    let second: f64 = facets.iter().map(|f| (f.centre_m - origin_m).norm_squared() * f.sigma_m.powi(-2)).sum();
    Frame { origin_m, gyration_m: (second / total.max(1e-300)).sqrt().max(1e-3) }
}

/// State of the rounds.
struct Rounds<'a> {
    facets: &'a [Facet],
    /// Derivatives of the residuals.
    rows: Vec<DVector<f64>>,
    /// The same, level facets all with their mean normal: what takes part in the normal equations.
    instruments: Vec<DVector<f64>>,
    slabs: Vec<Slab>,
    frame: &'a Frame,
    bounds: &'a Bounds,
    x: DVector<f64>,
    /// Facets without company in their slab.
    lonely: Vec<bool>,
    /// Robust weight of each facet, 0 to 1.
    robust: Vec<f64>,
    scale: [f64; 3],
    tau_m2: [f64; 3],
}

/// Adjusts the motion of the moving cloud over some facets; `None` when no direction is held.
pub(crate) fn adjust(facets: &[Facet], frame: &Frame, bounds: &Bounds) -> Option<Adjusted> {
    let slabs = slabs(facets, bounds.neighbourhood_m);
    let mut rounds = Rounds {
        lonely: lonely(&slabs, facets.len()),
        facets,
        rows: facets.iter().map(|f| row(f, &f.normal, frame, bounds.unknowns)).collect(),
        instruments: instruments(facets, frame, bounds.unknowns),
        slabs,
        frame,
        bounds,
        x: DVector::zeros(bounds.unknowns),
        robust: vec![1.0; facets.len()],
        scale: [1.0; 3],
        tau_m2: [0.0; 3],
    };
    for _ in 0..HUBER_ROUNDS {
        rounds.huber();
        rounds.solve()?;
    }
    for _ in 0..PLAIN_ROUNDS {
        rounds.plain();
        rounds.solve()?;
    }
    rounds.finish()
}

impl Rounds<'_> {
    fn residuals_m(&self) -> Vec<f64> {
        self.facets.iter().zip(&self.rows).map(|(f, row)| f.distance_m + row.dot(&self.x)).collect()
    }

    /// Sigma of a facet \[m\] with the scale of its class.
    fn sigma_m(&self, facet: &Facet) -> f64 {
        facet.sigma_m * self.scale[class(facet)]
    }

    fn weights(&self) -> Vec<f64> {
        self.facets.iter().zip(&self.robust).map(|(f, r)| r / self.sigma_m(f).powi(2)).collect()
    }

    fn huber(&mut self) {
        let v = self.residuals_m();
        self.scale = scales(self.facets, &v);
        let sigmas: Vec<f64> = self.facets.iter().map(|f| self.sigma_m(f)).collect();
        self.robust = v.iter().zip(sigmas).map(|(v, s)| HUBER / (v / s).abs().max(HUBER)).collect();
        for (robust, lonely) in self.robust.iter_mut().zip(&self.lonely) {
            *robust *= f64::from(u8::from(!*lonely));
        }
    }

    /// Weights 1 and 0, scale and common errors from what is left.
    fn plain(&mut self) {
        let v = self.residuals_m();
        let (in_use, all) = (self.weights(), self.facets.iter().map(|f| self.sigma_m(f).powi(-2)).collect::<Vec<_>>());
        let (mut alone, mut off) = (v.clone(), self.lonely.clone());
        for slab in &self.slabs {
            let tau_m2 = self.tau_m2[slab.class];
            // a slab that was left out is judged again by all its facets
            let out = slab.members.iter().all(|k| in_use[*k] <= 0.0);
            let (m, c) = sums(slab, if out { &all } else { &in_use }, &v);
            let is_off = tau_m2 > 0.0 && c * c > OUTLIER * OUTLIER * m * (1.0 + tau_m2 * m);
            for k in &slab.members {
                alone[*k] -= common_error_m(m, c, tau_m2);
                off[*k] |= is_off;
            }
        }
        self.scale = scales(self.facets, &alone);
        let inside: Vec<bool> =
            self.facets.iter().zip(&alone).map(|(f, v)| v.abs() < OUTLIER * self.sigma_m(f)).collect();
        self.robust = inside.iter().zip(&off).map(|(inside, off)| f64::from(u8::from(*inside && !off))).collect();
        self.tau_m2 = variances_m2(&self.slabs, &self.weights(), &v, self.bounds.unknowns);
    }

    /// Normal matrix and right side of each slab.
    fn normals(&self) -> Vec<(DMatrix<f64>, DVector<f64>)> {
        let (w, v) = (self.weights(), self.residuals_m());
        self.slabs.iter().map(|s| normal_of(s, &self.instruments, &w, &v, self.tau_m2[s.class])).collect()
    }

    fn total(&self, parts: &[(DMatrix<f64>, DVector<f64>)]) -> (DMatrix<f64>, DVector<f64>) {
        let p = self.bounds.unknowns;
        parts.iter().fold((DMatrix::zeros(p, p), DVector::zeros(p)), |(n, b), (of_n, of_b)| (n + of_n, b + of_b))
    }

    /// Moves x within the held subspace; what is not held stays where it was given.
    fn solve(&mut self) -> Option<()> {
        let (normal, b) = self.total(&self.normals());
        for (e, information) in self.held_directions(&normal)? {
            self.x += &e * (e.dot(&b) / information);
        }
        Some(())
    }

    /// Eigenvectors of the normal matrix, and their information, that geometry holds; best first.
    fn held_directions(&self, normal: &DMatrix<f64>) -> Option<Vec<(DVector<f64>, f64)>> {
        if !normal.iter().all(|v| v.is_finite()) {
            return None;
        }
        let pretended = self.pretended();
        let least = self.bounds.max_sigma_m.powi(-2);
        let eigen = SymmetricEigen::new(normal.clone());
        let mut held: Vec<(DVector<f64>, f64)> = (0..normal.nrows())
            .map(|j| (eigen.eigenvectors.column(j).into_owned(), eigen.eigenvalues[j]))
            .filter(|(e, information)| {
                let noise = e.dot(&(&pretended * e));
                *information > GEOMETRY * noise && *information > least
            })
            .collect();
        held.sort_by(|a, b| b.1.total_cmp(&a.1));
        (!held.is_empty()).then_some(held)
    }

    /// The information that the noise of the normals pretends.
    fn pretended(&self) -> DMatrix<f64> {
        let p = self.bounds.unknowns;
        let lever = |centre_m: &Vector3<f64>| {
            let arm = (centre_m - self.frame.origin_m).cross_matrix() / self.frame.gyration_m;
            DMatrix::from_fn(p, 3, |i, k| if i < 3 { f64::from(u8::from(i == k)) } else { arm[(i - 3, k)] })
        };
        let (w, mut sum) = (self.weights(), DMatrix::zeros(p, p));
        for slab in self.slabs.iter().filter(|s| s.class != 0) {
            pretended_of(slab, self.facets, &lever, &w, self.tau_m2[slab.class], &mut sum);
        }
        sum
    }

    /// Normal matrices with slabs over wider blocks and a τ² of their own, at the solution.
    fn wider(&self) -> Vec<DMatrix<f64>> {
        let (w, v) = (self.weights(), self.residuals_m());
        let of = |reach: f64| {
            let slabs = slabs(self.facets, self.bounds.neighbourhood_m * reach);
            let tau_m2 = variances_m2(&slabs, &w, &v, self.bounds.unknowns);
            let sum = slabs.iter().map(|s| normal_of(s, &self.instruments, &w, &v, tau_m2[s.class]).0).sum();
            (slabs.len() >= ENOUGH_SLABS).then_some(sum)
        };
        REACHES.into_iter().filter_map(of).collect()
    }

    /// What each slab adds to a direction e of information λ: aₖ = wₖ (eᵀJ̃ₖ - eᵀ(Σ w J̃) τ²/(1 + τ² m))/λ of its facets. What is missing to e
    /// itself (level facets count with their mean normal, wider blocks with another τ) is laid where the others are on average.
    fn carriers(&self, e: &DVector<f64>, information: f64, w: &[f64]) -> Vec<Carrier> {
        let mut found = Vec::with_capacity(self.slabs.len() + 1);
        let mut missing = Vector3::new(e[0], e[1], e[2]);
        let mut of_all = Mean::default();
        for slab in &self.slabs {
            let mut m = 0.0;
            let mut sum = 0.0;
            for k in &slab.members {
                m += w[*k];
                sum += w[*k] * e.dot(&self.instruments[*k]);
            }
            let share = self.tau_m2[slab.class] / (1.0 + self.tau_m2[slab.class] * m) * sum;
            let (mut mean, mut along) = (Mean::default(), Vector3::zeros());
            for k in slab.members.iter().filter(|k| w[**k] > 0.0) {
                let facet = &self.facets[*k];
                let a = w[*k] * (e.dot(&self.instruments[*k]) - share) / information;
                mean.add(a.abs(), facet);
                of_all.add(a.abs(), facet);
                along += facet.normal * a;
            }
            if let Some((centre_m, time_s)) = mean.value() {
                missing -= along;
                found.push(Carrier { centre_m, time_s, along });
            }
        }
        found.extend(of_all.value().map(|(centre_m, time_s)| Carrier { centre_m, time_s, along: missing }));
        found
    }

    fn finish(self) -> Option<Adjusted> {
        let parts = self.normals();
        let (normal, _) = self.total(&parts);
        let (w, v) = (self.weights(), self.residuals_m());
        let alone: DMatrix<f64> = self.slabs.iter().map(|s| normal_of(s, &self.instruments, &w, &v, 0.0).0).sum();
        let along = |n: &DMatrix<f64>, e: &DVector<f64>| e.dot(&(n * e));
        let mut held = self.held_directions(&normal)?;
        held.retain(|(e, information)| {
            let squares: f64 = parts.iter().map(|(n, _)| along(n, e).powi(2)).sum();
            information * information >= CARRIERS * squares
        });
        if held.is_empty() {
            return None;
        }
        // errors may reach over more than one block: the longest reach that the residuals ask for counts
        for wide in self.wider() {
            for (e, information) in &mut held {
                *information = information.min(along(&wide, e));
            }
        }
        held.retain(|(_, information)| *information > self.bounds.max_sigma_m.powi(-2));
        if held.is_empty() {
            return None;
        }
        let independent = held.iter().map(|(e, i)| i / along(&alone, e)).fold(1.0, f64::min);
        let carriers = held.iter().map(|(e, _)| self.carriers(e, along(&normal, e), &w)).collect();
        let (directions, information): (Vec<DVector<f64>>, Vec<f64>) = held.into_iter().unzip();
        let held = Held {
            directions: DMatrix::from_columns(&directions),
            sigma_m: DVector::from_iterator(information.len(), information.iter().map(|i| i.powf(-0.5))),
        };
        // a direction that few slabs carry is taken back: it stays as it was given
        let kept = &held.directions * (held.directions.transpose() * &self.x);
        let mut step = Vector6::zeros();
        for k in 0..self.bounds.unknowns {
            step[k] = if k < 3 { kept[k] } else { kept[k] / self.frame.gyration_m };
        }
        let used = self.robust.iter().map(|r| *r > 0.5).collect();
        let common_sigma_m = self.tau_m2.map(f64::sqrt);
        Some(Adjusted { step, held, used, scale: self.scale, common_sigma_m, independent, carriers })
    }
}

/// Weighted mean of places and times of facets.
#[derive(Default)]
struct Mean {
    weight: f64,
    centre_m: Vector3<f64>,
    time_s: [f64; 2],
}

impl Mean {
    fn add(&mut self, weight: f64, facet: &Facet) {
        self.weight += weight;
        self.centre_m += facet.centre_m * weight;
        self.time_s.iter_mut().zip(facet.time_s).for_each(|(sum, t)| *sum += t * weight);
    }
    fn value(&self) -> Option<(Vector3<f64>, [f64; 2])> {
        (self.weight > 1e-12).then(|| (self.centre_m / self.weight, self.time_s.map(|t| t / self.weight)))
    }
}

/// A facet's derivative, for a given normal, in unknowns that are all metres.
fn row(facet: &Facet, normal: &Vector3<f64>, frame: &Frame, unknowns: usize) -> DVector<f64> {
    let turn = (facet.centre_m - frame.origin_m).cross(normal) / frame.gyration_m;
    DVector::from_fn(unknowns, |k, _| if k < 3 { normal[k] } else { turn[k - 3] })
}

/// The derivatives that weigh the residuals: level facets all have their mean normal.
///
/// The slopes of level ground say nothing about the plan that could be believed: at 3° a centimetre of height, from
/// grass or from a tilt between the strips, is 20 cm of plan. Taken together level facets give one distance along one
/// normal. With Σ w (n - n̄) = 0 the normal equations Σ w J̃ Jᵀ = Σ w J̃ J̃ᵀ stay symmetric.
fn instruments(facets: &[Facet], frame: &Frame, unknowns: usize) -> Vec<DVector<f64>> {
    let level = facets.iter().filter(|f| class(f) == 0);
    let mean = level.map(|f| f.normal * f.sigma_m.powi(-2)).sum::<Vector3<f64>>();
    let mean = mean.try_normalize(0.0).unwrap_or_else(Vector3::z);
    facets.iter().map(|f| row(f, if class(f) == 0 { &mean } else { &f.normal }, frame, unknowns)).collect()
}

/// Robust scale of normalised residuals by class of slope, from the median, 1 or more.
fn scales(facets: &[Facet], v: &[f64]) -> [f64; 3] {
    let of = |wanted: Option<usize>| -> (usize, f64) {
        let members = facets.iter().zip(v).filter(|(f, _)| wanted.is_none_or(|c| class(f) == c));
        let mut d: Vec<f64> = members.map(|(f, v)| (v / f.sigma_m).abs()).collect();
        let (count, middle) = (d.len(), d.len() / 2);
        if count == 0 {
            return (0, 1.0);
        }
        let (_, median, _) = d.select_nth_unstable_by(middle, f64::total_cmp);
        (count, (1.4826 * *median).max(1.0))
    };
    let all = of(None).1;
    std::array::from_fn(|c| match of(Some(c)) {
        (members, own) if members >= CLASS_MEMBERS => own,
        _ => all,
    })
}
