//! The smoother's algebra against dense least squares on a linear Gaussian problem, with states that enter and leave.

use nalgebra::{DMatrix, DVector};
use tieline_filter::adjoint::{Adjoint, smoothed};
use tieline_filter::kalman::{Gaussian, Measurement, Slots, Stay};
use tieline_filter::state::{CORE, NAV};
use tieline_filter::tape::{NodeRecord, Operation};
use tieline_filter::transition::Transition;

const BASE: usize = CORE + 2;
const SLOTS: Slots = Slots { brief: 2, lasting: 6 };
const STEPS: usize = 12;

/// A reproducible series of numbers between -1 and 1.
struct Numbers(u64);

impl Numbers {
    #[allow(clippy::cast_precision_loss)]
    fn next(&mut self) -> f64 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        ((self.0 >> 11) as f64 / (1_u64 << 52) as f64) - 1.0
    }
}

fn transition(numbers: &mut Numbers) -> Transition {
    let mut t = Transition::identity(BASE);
    for row in &mut t.nav {
        for v in row.iter_mut() {
            *v += 0.1 * numbers.next();
        }
    }
    for d in &mut t.decay {
        *d = 0.95 + 0.05 * numbers.next();
    }
    t
}

fn dense(t: &Transition) -> DMatrix<f64> {
    DMatrix::from_fn(BASE, BASE, |i, j| match (i < NAV, i == j) {
        (true, _) if j < CORE => t.nav[i][j],
        (false, true) => t.decay[i - NAV],
        _ => 0.0,
    })
}

/// How the sightings of one scalar feature enter.
#[derive(Clone, Copy, PartialEq)]
enum Form {
    Landmark,
    Delayed,
}

/// A sighting: step, row over the base states, value, sigma.
type Seen = (usize, Vec<(usize, f64)>, f64, f64);

struct Problem {
    transitions: Vec<Transition>,
    noise: Vec<f64>,
    prior: Vec<f64>,
    fixes: Vec<(usize, Measurement)>,
    features: Vec<Vec<Seen>>,
}

fn problem(seed: u64) -> Problem {
    let mut numbers = Numbers(seed);
    let transitions = (0..STEPS).map(|_| transition(&mut numbers)).collect();
    let fixes = (1..=STEPS)
        .step_by(4)
        .map(|step| {
            let rows = (0..3).map(|k| vec![(k, 1.0), (6 + k, numbers.next()), (CORE, 0.5)]).collect();
            let residual = (0..3).map(|_| numbers.next()).collect();
            (step, Measurement { residual, rows, noise: vec![0.5, 0.1, 0.0, 0.1, 0.4, 0.0, 0.0, 0.0, 0.3] })
        })
        .collect();
    let steps: [&[usize]; 3] = [&[1, 4, 9], &[2, 3], &[5, 7, 8, 11]];
    let features = steps
        .iter()
        .map(|steps| {
            let seen = |step: &usize| {
                let row = (0..9).map(|k| (k, numbers.next())).collect();
                (*step, row, numbers.next(), 0.2 + 0.1 * numbers.next())
            };
            steps.iter().map(seen).collect()
        })
        .collect();
    let prior = (0..BASE).map(|_| 1.5 + numbers.next()).collect();
    Problem { transitions, noise: vec![0.02; BASE], prior, fixes, features }
}

/// Smoothed means and covariances of the base states at every step, by filter and adjoint.
fn by_smoother(p: &Problem, form: Form) -> Vec<(Vec<f64>, Vec<f64>)> {
    let mut g = Gaussian::new(&p.prior, SLOTS);
    let mut live: Vec<Vec<(usize, usize)>> = vec![Vec::new(); p.features.len()];
    let mut records = Vec::new();
    for step in 0..=STEPS {
        let mut operations = Vec::new();
        if step > 0 {
            g.add_variances(&p.noise, 0.5);
            g.advance(&p.transitions[step - 1]);
            g.add_variances(&p.noise, 0.5);
        }
        for (_, m) in p.fixes.iter().filter(|f| f.0 == step) {
            operations.push(Operation::Update(g.update(m.clone()).expect("noise")));
        }
        for (f, feature) in p.features.iter().enumerate() {
            let Some(s) = feature.iter().position(|s| s.0 == step) else { continue };
            let (_, row, value, sigma) = &feature[s];
            let last = s + 1 == feature.len();
            let enters = if form == Form::Landmark { s == 0 } else { !last };
            if enters {
                let variance = if form == Form::Landmark { sigma * sigma } else { 0.0 };
                let at = g.enter(row, variance, if f % 2 == 0 { Stay::Lasting } else { Stay::Brief }).expect("a slot");
                operations.push(Operation::Enter { at, row: row.clone() });
                live[f].push((at, s));
            } else {
                // row · x + value less that of the other sighting is noise, of both
                let n = live[f].len();
                let mut m = Measurement { residual: vec![], rows: vec![], noise: vec![sigma * sigma; n * n] };
                for (k, (at, other)) in live[f].iter().enumerate() {
                    m.rows.push(row.iter().copied().chain([(*at, -1.0)]).collect());
                    m.residual.push(feature[*other].2 - value);
                    if form == Form::Delayed {
                        m.noise[k * n + k] += feature[*other].3.powi(2);
                    }
                }
                operations.push(Operation::Update(g.update(m.clone()).expect("noise")));
            }
            if last {
                for (at, _) in std::mem::take(&mut live[f]) {
                    g.leave(at);
                }
            }
        }
        let rows: Vec<f64> = (0..BASE).flat_map(|i| g.row(i).to_vec()).collect();
        records.push((operations, g.mean().to_vec(), rows));
    }
    let mut adjoint = Adjoint::new(BASE, SLOTS);
    let mut out = Vec::new();
    for step in (0..=STEPS).rev() {
        let (operations, mean, rows) = &records[step];
        out.push(smoothed(rows, &mean[..BASE], (mean.len(), BASE), &adjoint));
        let transition = (step > 0).then(|| p.transitions[step - 1].clone());
        adjoint.back_through(&NodeRecord { transition, operations: operations.clone() }, BASE);
    }
    out.reverse();
    out
}

/// The same by dense least squares over all steps and features.
fn by_batch(p: &Problem) -> Vec<(Vec<f64>, Vec<f64>)> {
    let n = (STEPS + 1) * BASE + p.features.len();
    let (mut normal, mut right) = (DMatrix::<f64>::zeros(n, n), DVector::<f64>::zeros(n));
    let mut add = |j: &DMatrix<f64>, z: &DVector<f64>, weight: &DMatrix<f64>| {
        normal += j.transpose() * weight * j;
        right += j.transpose() * weight * z;
    };
    for (k, variance) in p.prior.iter().enumerate() {
        let mut j = DMatrix::zeros(1, n);
        j[(0, k)] = 1.0;
        add(&j, &DVector::zeros(1), &DMatrix::from_element(1, 1, 1.0 / variance));
    }
    for (step, t) in p.transitions.iter().enumerate() {
        let phi = dense(t);
        let half = DMatrix::from_diagonal(&DVector::from_vec(p.noise.clone())) * 0.5;
        let q = &phi * &half * phi.transpose() + &half;
        let mut j = DMatrix::zeros(BASE, n);
        j.view_mut((0, step * BASE), (BASE, BASE)).copy_from(&-&phi);
        j.view_mut((0, (step + 1) * BASE), (BASE, BASE)).fill_with_identity();
        add(&j, &DVector::zeros(BASE), &q.try_inverse().expect("noise"));
    }
    for (step, m) in &p.fixes {
        let mut j = DMatrix::zeros(3, n);
        for (i, row) in m.rows.iter().enumerate() {
            for (k, factor) in row {
                j[(i, step * BASE + k)] += factor;
            }
        }
        let r = DMatrix::from_row_slice(3, 3, &m.noise);
        add(&j, &DVector::from_vec(m.residual.clone()), &r.try_inverse().expect("noise"));
    }
    for (f, feature) in p.features.iter().enumerate() {
        for (step, row, value, sigma) in feature {
            let mut j = DMatrix::zeros(1, n);
            for (k, factor) in row {
                j[(0, step * BASE + k)] = *factor;
            }
            j[(0, (STEPS + 1) * BASE + f)] = -1.0;
            add(&j, &DVector::from_element(1, -value), &DMatrix::from_element(1, 1, 1.0 / (sigma * sigma)));
        }
    }
    let inverse = normal.cholesky().expect("positive definite").inverse();
    let x = &inverse * right;
    (0..=STEPS)
        .map(|step| {
            let at = step * BASE;
            let c = inverse.view((at, at), (BASE, BASE));
            (x.rows(at, BASE).iter().copied().collect(), c.transpose().iter().copied().collect())
        })
        .collect()
}

#[test]
fn landmarks_clones_and_dense_least_squares_agree() {
    for seed in 1..6 {
        let p = problem(seed);
        let batch = by_batch(&p);
        for form in [Form::Landmark, Form::Delayed] {
            let smoother = by_smoother(&p, form);
            for (step, ((x, c), (y, d))) in smoother.iter().zip(&batch).enumerate() {
                let mean = x.iter().zip(y).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
                let covariance = c.iter().zip(d).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
                assert!(
                    mean < 1e-9 && covariance < 1e-9,
                    "seed {seed}, step {step}: mean {mean:e}, covariance {covariance:e}"
                );
            }
        }
    }
}
