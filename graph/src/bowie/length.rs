//! Bowie's own weights (Adams 1930): a section counts as one observation of the difference of its two junctions, with a
//! weight that falls with its length, and every coordinate is adjusted for itself, all with the same normal equations.
//!
//! What is measured along a section is summed to its misclosure; the junction net takes the misclosures up; what a
//! section has to give is shared out along it by length. Rotations first, then positions with the new rotations; in
//! space again until nothing moves. Covariances play no part, so that the result is near the least-squares solution, not
//! at it: how near is what there is to learn.

use nalgebra::{UnitQuaternion, Vector3};

use crate::factor::Factor;
use crate::factor::baseline::Baseline;
use crate::factor::pose2::Between2;
use crate::factor::pose3::Between3;
use crate::factor::vector::Linear;
use crate::linear::blocks::Normal;
use crate::nonlinear::SolveOptions;
use crate::problem::Problem;
use crate::robust::Kernel;
use crate::system::{Order, System, SystemError};
use crate::variable::{Kind, Values, VariableId};

/// Why a graph has no solution with length weights.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum LengthError {
    /// An observation that is no difference of two nodes.
    #[error(
        "weights by length take relations of poses and baselines alone, and the graph has a `{0}`; use Schur complements"
    )]
    NotADifference(&'static str),
    /// The junction net.
    #[error(transparent)]
    System(#[from] SystemError),
}

/// What the method did.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct LengthWeighted {
    /// Sum of squares of whitened residuals before.
    pub first_cost: f64,
    /// After.
    pub cost: f64,
    /// Nodes where sections meet or end.
    pub junctions: usize,
    /// Chains between them.
    pub sections: usize,
    /// Passes over rotations and positions.
    pub passes: usize,
}

/// Most passes: a plane graph needs one, one in space a few.
const PASSES: usize = 30;
/// Largest correction of a pass that ends them \[m, rad\].
const SETTLED: f64 = 1e-9;

/// A measured difference: the second node is at `position + rotation · shift_m`, turned by `turn`.
struct Link {
    nodes: [usize; 2],
    shift_m: Vector3<f64>,
    turn: UnitQuaternion<f64>,
}

/// A chain of links between two junctions; `true`: along the link.
struct Section {
    ends: [usize; 2],
    links: Vec<(usize, bool)>,
    length_m: f64,
}

/// Moves the values of a problem to the solution with weights by length.
///
/// # Errors
/// [`LengthError`].
pub fn solve_by_length(problem: &mut Problem) -> Result<LengthWeighted, LengthError> {
    let links = links(problem)?;
    // a loop edge at one place has no length: what one step of the trajectory has stands for it
    let shortest_m = median_m(&links).max(1e-6);
    let (junctions, sections) = sections(problem, &links, shortest_m);
    let net = JunctionNet::new(problem, &junctions, sections)?;
    let mut result = LengthWeighted {
        first_cost: problem.cost(&problem.values, &Kernel::None),
        junctions: junctions.len(),
        sections: net.sections.len(),
        ..LengthWeighted::default()
    };
    while result.passes < PASSES {
        let turned = net.adjust(problem, turn_misclosure, &links, shortest_m)?;
        let rotated = apply(problem, &turned, turn_by);
        let moved = net.adjust(problem, shift_misclosure, &links, shortest_m)?;
        let shifted = apply(problem, &moved, shift_by);
        result.passes += 1;
        if rotated.max(shifted) < SETTLED {
            break;
        }
    }
    result.cost = problem.cost(&problem.values, &Kernel::None);
    Ok(result)
}

fn links(problem: &Problem) -> Result<Vec<Link>, LengthError> {
    let known = ["relation of poses", "baseline"];
    if let Some(other) = problem.factors().find(|f| !known.contains(&f.label())) {
        return Err(LengthError::NotADifference(other.label()));
    }
    let nodes = |f: &dyn Factor| [f.variables()[0].index(), f.variables()[1].index()];
    let plane = problem.factors_of::<Between2>().iter().map(|f| {
        let [x, y, angle] = f.measured();
        let turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), angle);
        Link { nodes: nodes(f), shift_m: Vector3::new(x, y, 0.0), turn }
    });
    let space = problem.factors_of::<Between3>().iter().map(|f| {
        let motion = f.measured();
        Link { nodes: nodes(f), shift_m: motion.translation, turn: motion.rotation }
    });
    let baselines = problem.factors_of::<Baseline>().iter().map(|f| Link {
        nodes: nodes(f),
        shift_m: f.measured_m(),
        turn: UnitQuaternion::identity(),
    });
    Ok(plane.chain(space).chain(baselines).collect())
}

fn median_m(links: &[Link]) -> f64 {
    let mut lengths: Vec<f64> = links.iter().map(|l| l.shift_m.norm()).collect();
    lengths.sort_by(f64::total_cmp);
    lengths.get(lengths.len() / 2).copied().unwrap_or(1.0)
}

/// Nodes that are no inner nodes of a chain, and the chains between them.
fn sections(problem: &Problem, links: &[Link], shortest_m: f64) -> (Vec<usize>, Vec<Section>) {
    let mut at: Vec<Vec<usize>> = vec![Vec::new(); problem.values.len()];
    for (k, link) in links.iter().enumerate() {
        link.nodes.iter().for_each(|n| at[*n].push(k));
    }
    let held: Vec<bool> = problem.variables().map(|id| problem.is_fixed(id)).collect();
    let mut is_junction: Vec<bool> = (0..at.len()).map(|n| at[n].len() != 2 || held[n]).collect();
    let mut used = vec![false; links.len()];
    let mut sections = Vec::new();
    let follow = |start: usize, first: usize, used: &mut [bool], is_junction: &[bool]| {
        let mut section = Section { ends: [start, start], links: Vec::new(), length_m: 0.0 };
        let (mut node, mut link) = (start, first);
        loop {
            used[link] = true;
            let forward = links[link].nodes[0] == node;
            section.links.push((link, forward));
            section.length_m += links[link].shift_m.norm().max(shortest_m);
            node = links[link].nodes[usize::from(forward)];
            if is_junction[node] {
                break;
            }
            let Some(next) = at[node].iter().copied().find(|k| !used[*k]) else { break };
            link = next;
        }
        section.ends[1] = node;
        section
    };
    for round in 0..2 {
        for node in 0..at.len() {
            // in the second round only rings without a junction are left
            if round == 1 && at[node].iter().any(|k| !used[*k]) {
                is_junction[node] = true;
            }
            if is_junction[node] {
                for link in &at[node] {
                    if !used[*link] {
                        sections.push(follow(node, *link, &mut used, &is_junction));
                    }
                }
            }
        }
    }
    ((0..at.len()).filter(|n| is_junction[*n]).collect(), sections)
}

/// The net of junctions: one scalar each, factorised once for all coordinates and passes.
struct JunctionNet {
    sections: Vec<Section>,
    net: Problem,
    system: System,
    variable_of: Vec<Option<VariableId>>,
}

impl JunctionNet {
    fn new(problem: &Problem, junctions: &[usize], sections: Vec<Section>) -> Result<Self, SystemError> {
        let mut net = Problem::new();
        let mut variable_of = vec![None; problem.values.len()];
        let all: Vec<VariableId> = problem.variables().collect();
        for node in junctions {
            let id = net.add_variable(Kind::Scalar, &[0.0]);
            net.set_name(id, problem.name(all[*node]));
            net.set_fixed(id, problem.is_fixed(all[*node]));
            if let Some(place) = problem.place(all[*node]) {
                net.set_place(id, place);
            }
            variable_of[*node] = Some(id);
        }
        for section in &sections {
            if let [Some(a), Some(b)] = section.ends.map(|n| variable_of[n])
                && a != b
            {
                let weight = section.length_m.sqrt().recip();
                net.add(Linear::new(vec![a, b], vec![-weight, weight], vec![0.0]));
            }
        }
        let options = SolveOptions::default();
        let mut system = System::new(&net, Order::Automatic, options.partition, options.method)?;
        let mut normal = Normal::default();
        system.pattern.assemble(&net, &net.values, &Kernel::None, &mut normal);
        system.solve(&net, &normal.numbers, &mut normal.right)?;
        Ok(Self { sections, net, system, variable_of })
    }

    /// Corrections of all nodes, by what each link's second node should move more than its first.
    fn adjust(
        &self,
        problem: &Problem,
        misclosure: impl Fn(&Values, &Link) -> Vector3<f64>,
        links: &[Link],
        shortest_m: f64,
    ) -> Result<Vec<Vector3<f64>>, SystemError> {
        let of_link = |(link, forward): (usize, bool)| {
            let value = misclosure(&problem.values, &links[link]);
            if forward { value } else { -value }
        };
        let sums: Vec<Vector3<f64>> =
            self.sections.iter().map(|s| s.links.iter().map(|l| of_link(*l)).sum::<Vector3<f64>>()).collect();
        let mut corrections = vec![Vector3::zeros(); problem.values.len()];
        for c in 0..3 {
            let mut right = vec![0.0; self.system.scalars()];
            for (section, sum) in self.sections.iter().zip(&sums).filter(|(s, _)| s.ends[0] != s.ends[1]) {
                for (node, sign) in section.ends.iter().zip([-1.0, 1.0]) {
                    let Some(id) = self.variable_of[*node].filter(|id| !self.net.is_fixed(*id)) else { continue };
                    right[self.system.pattern.scalar[id.index()] as usize] += sign * sum[c] / section.length_m;
                }
            }
            self.system.solve_again(&mut right);
            for (node, id) in self.variable_of.iter().enumerate() {
                if let Some(id) = id.filter(|id| !self.net.is_fixed(*id)) {
                    corrections[node][c] = right[self.system.pattern.scalar[id.index()] as usize];
                }
            }
        }
        for (section, sum) in self.sections.iter().zip(&sums) {
            let [a, b] = section.ends;
            // what the ends leave is shared out by length
            let rest = corrections[b] - corrections[a] - sum;
            let (mut along_m, mut at) = (0.0, corrections[a]);
            for (k, (link, forward)) in section.links.iter().enumerate() {
                along_m += links[*link].shift_m.norm().max(shortest_m);
                at += of_link((*link, *forward));
                if k + 1 < section.links.len() {
                    corrections[links[*link].nodes[usize::from(*forward)]] = at + along_m / section.length_m * rest;
                }
            }
        }
        Ok(corrections)
    }
}

fn pose(values: &Values, node: usize) -> (Vector3<f64>, UnitQuaternion<f64>) {
    let id = VariableId(u32::try_from(node).unwrap_or(u32::MAX));
    let v = values.get(id);
    match values.kind(id) {
        Kind::Pose2 => (Vector3::new(v[0], v[1], 0.0), UnitQuaternion::from_axis_angle(&Vector3::z_axis(), v[2])),
        Kind::Pose3 => (values.xyz(id), values.rotation(id)),
        _ => (values.xyz(id), UnitQuaternion::identity()),
    }
}

/// By what map rotation the second node should turn more than the first \[rad\].
fn turn_misclosure(values: &Values, link: &Link) -> Vector3<f64> {
    let [(_, a), (_, b)] = link.nodes.map(|n| pose(values, n));
    (a * link.turn * b.inverse()).scaled_axis()
}

/// By what the second node should move more than the first \[m\].
fn shift_misclosure(values: &Values, link: &Link) -> Vector3<f64> {
    let [(from, rotation), (to, _)] = link.nodes.map(|n| pose(values, n));
    from + rotation * link.shift_m - to
}

fn turn_by(values: &mut Values, id: VariableId, by: &Vector3<f64>) {
    match values.kind(id) {
        Kind::Pose2 => values.retract(id, &[0.0, 0.0, by.z]),
        Kind::Pose3 => {
            // a turn about map axes, in the frame of the pose
            let own = values.rotation(id).inverse() * by;
            values.retract(id, &[0.0, 0.0, 0.0, own.x, own.y, own.z]);
        }
        _ => {}
    }
}

fn shift_by(values: &mut Values, id: VariableId, by: &Vector3<f64>) {
    let count = if values.kind(id) == Kind::Pose2 { 2 } else { 3 };
    values.get_mut(id)[..count].iter_mut().zip(by.iter()).for_each(|(v, d)| *v += d);
}

/// Corrects all free nodes; the largest correction.
fn apply(
    problem: &mut Problem,
    corrections: &[Vector3<f64>],
    correct: fn(&mut Values, VariableId, &Vector3<f64>),
) -> f64 {
    let free: Vec<VariableId> = problem.variables().filter(|id| !problem.is_fixed(*id)).collect();
    let mut largest = 0.0_f64;
    for id in free {
        correct(&mut problem.values, id, &corrections[id.index()]);
        largest = largest.max(corrections[id.index()].norm());
    }
    largest
}
