//! The smoother's algebra against batch least squares on a linear Gaussian problem, with states that enter and leave:
//! by dense normal equations, and by this crate with every state and feature a variable.

use nalgebra::{DMatrix, DVector};
use tieline_filter::adjoint::{Adjoint, smoothed};
use tieline_filter::kalman::{Gaussian, Measurement, Slots, Stay};
use tieline_filter::state::{CORE, NAV};
use tieline_filter::tape::{NodeRecord, Operation};
use tieline_filter::transition::Transition;
use tieline_graph::covariance::covariances;
use tieline_graph::factor::vector::Linear;
use tieline_graph::nonlinear::{SolveOptions, solve_system};
use tieline_graph::robust::Kernel;
use tieline_graph::system::System;
use tieline_graph::{Kind, VariableId};

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

/// Means and covariances (row by row) of the base states at every step.
type States = Vec<(Vec<f64>, Vec<f64>)>;

/// Smoothed states, by filter and adjoint.
fn by_smoother(p: &Problem, form: Form) -> States {
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

/// One equation `a · x = z` of the batch: rows over the states of steps and the features, values, covariance.
struct Equation {
    /// Step or feature (after the last step) and coefficients, for each variable.
    blocks: Vec<(usize, DMatrix<f64>)>,
    value: DVector<f64>,
    covariance: DMatrix<f64>,
}

/// The whole problem as equations.
fn equations(p: &Problem) -> Vec<Equation> {
    let row = |coefficients: &[(usize, f64)]| {
        let mut j = DMatrix::zeros(1, BASE);
        coefficients.iter().for_each(|(k, factor)| j[(0, *k)] += factor);
        j
    };
    let one = |v: f64| DMatrix::from_element(1, 1, v);
    let mut list: Vec<Equation> = (0..BASE)
        .map(|k| Equation {
            blocks: vec![(0, row(&[(k, 1.0)]))],
            value: DVector::zeros(1),
            covariance: one(p.prior[k]),
        })
        .collect();
    for (step, t) in p.transitions.iter().enumerate() {
        let phi = dense(t);
        let half = DMatrix::from_diagonal(&DVector::from_vec(p.noise.clone())) * 0.5;
        list.push(Equation {
            blocks: vec![(step, -&phi), (step + 1, DMatrix::identity(BASE, BASE))],
            value: DVector::zeros(BASE),
            covariance: &phi * &half * phi.transpose() + &half,
        });
    }
    for (step, m) in &p.fixes {
        let rows: Vec<DMatrix<f64>> = m.rows.iter().map(|r| row(r)).collect();
        list.push(Equation {
            blocks: vec![(*step, DMatrix::from_fn(rows.len(), BASE, |r, c| rows[r][(0, c)]))],
            value: DVector::from_vec(m.residual.clone()),
            covariance: DMatrix::from_row_slice(3, 3, &m.noise),
        });
    }
    for (f, feature) in p.features.iter().enumerate() {
        for (step, coefficients, value, sigma) in feature {
            list.push(Equation {
                blocks: vec![(*step, row(coefficients)), (STEPS + 1 + f, one(-1.0))],
                value: DVector::from_element(1, -value),
                covariance: one(sigma * sigma),
            });
        }
    }
    list
}

/// The same by this crate.
fn by_graph(p: &Problem) -> States {
    let mut problem = tieline_graph::Problem::new();
    let size = u8::try_from(BASE).expect("few states");
    let states: Vec<VariableId> = (0..=STEPS).map(|_| problem.add_variable(Kind::Vector(size), &[0.0; BASE])).collect();
    let features: Vec<VariableId> = p.features.iter().map(|_| problem.add_variable(Kind::Scalar, &[0.0])).collect();
    for equation in equations(p) {
        let lower = equation.covariance.cholesky().expect("noise").unpack();
        let whiten = |m: DMatrix<f64>| lower.solve_lower_triangular(&m).expect("regular");
        let ids = equation.blocks.iter().map(|(k, _)| *states.iter().chain(&features).nth(*k).expect("one of them"));
        let columns: Vec<DMatrix<f64>> = equation.blocks.iter().map(|(_, j)| whiten(j.clone())).collect();
        let mut coefficients = Vec::new();
        for r in 0..equation.value.len() {
            columns.iter().for_each(|block| coefficients.extend(block.row(r).iter()));
        }
        let right = whiten(DMatrix::from_column_slice(equation.value.len(), 1, equation.value.as_slice()));
        problem.add(Linear::new(ids.collect(), coefficients, right.as_slice().to_vec()));
    }
    let options = SolveOptions::default();
    let mut system = System::new(&problem, options.order, options.partition, options.method.clone()).expect("a net");
    solve_system(&mut problem, &mut system, &options).expect("determined");
    let sigma = covariances(&problem, &mut system, &Kernel::None, false).expect("determined");
    let of_step =
        |id: &VariableId| (problem.values.get(*id).to_vec(), sigma.of(*id).transpose().iter().copied().collect());
    states.iter().map(of_step).collect()
}

/// The same by dense least squares over all steps and features.
fn by_dense_equations(p: &Problem) -> States {
    let n = (STEPS + 1) * BASE + p.features.len();
    let (mut normal, mut right) = (DMatrix::<f64>::zeros(n, n), DVector::<f64>::zeros(n));
    let mut add = |j: &DMatrix<f64>, z: &DVector<f64>, weight: &DMatrix<f64>| {
        normal += j.transpose() * weight * j;
        right += j.transpose() * weight * z;
    };
    for equation in equations(p) {
        let mut j = DMatrix::zeros(equation.value.len(), n);
        for (k, block) in &equation.blocks {
            let first = if *k <= STEPS { k * BASE } else { (STEPS + 1) * BASE + k - STEPS - 1 };
            j.view_mut((0, first), block.shape()).copy_from(block);
        }
        add(&j, &equation.value, &equation.covariance.clone().try_inverse().expect("noise"));
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

fn assert_same(a: &States, b: &States, what: &str) {
    for (step, ((x, c), (y, d))) in a.iter().zip(b).enumerate() {
        let mean = x.iter().zip(y).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
        let covariance = c.iter().zip(d).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
        assert!(mean < 1e-9 && covariance < 1e-9, "{what}, step {step}: mean {mean:e}, covariance {covariance:e}");
    }
}

#[test]
fn landmarks_clones_and_batch_least_squares_agree() {
    for seed in 1..6 {
        let p = problem(seed);
        let batch = by_graph(&p);
        assert_same(&batch, &by_dense_equations(&p), &format!("seed {seed}, the graph against dense equations"));
        for form in [Form::Landmark, Form::Delayed] {
            assert_same(&by_smoother(&p, form), &batch, &format!("seed {seed}, the smoother against the graph"));
        }
    }
}
