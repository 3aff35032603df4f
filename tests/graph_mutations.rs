//! Damaged graphs and nets are refused, or adjusted, or not determined: never a panic, in reading or in adjusting.

use proptest::prelude::*;
use tieline::net::geodetic::GeodeticNet;
use tieline::net::pose_graph::problem;
use tieline_graph::Problem;
use tieline_graph::bowie::{BowieOptions, solve as bowie};
use tieline_graph::covariance::covariances;
use tieline_graph::factor::Convention;
use tieline_graph::initialise::chordal;
use tieline_graph::nonlinear::{SolveOptions, solve_system};
use tieline_graph::robust::Kernel;
use tieline_graph::system::System;
use tieline_io::network::{dynadjust, gama};
use tieline_io::pose_graph;

const PLANE: &str = "\
VERTEX_SE2 0 0 0 0
VERTEX_SE2 1 1 0 0.1
VERTEX_SE2 2 2 0.2 1.6
VERTEX_XY 7 3 3
FIX 0
EDGE_SE2 0 1 1 0 0.1 100 0 0 100 0 400
EDGE_SE2 1 2 1 0 1.5 100 1 2 100 3 400
EDGE_SE2 0 2 2 0.2 1.6 50 0 0 50 0 100
EDGE_SE2_XY 1 7 2 3 25 0 25
EDGE_SE2_XY 2 7 3 -1 25 0 25
EDGE_PRIOR_SE2 0 0 0 0 10 0 0 10 0 10
";
const SPACE: &str = "\
VERTEX_SE3:QUAT 0 0 0 0 0 0 0 1
VERTEX_SE3:QUAT 1 1 0 0 0 0 0.1 0.995
VERTEX_SE3:QUAT 2 1 1 0 0 0.2 0.7 0.7
EDGE_SE3:QUAT 0 1 1 0 0 0 0 0.1 0.995 9 0 0 0 0 0 9 0 0 0 0 9 0 0 0 9 0 0 9 0 9
EDGE_SE3:QUAT 1 2 1 0 0 0 0 0.7 0.7 9 0 0 0 0 0 9 0 0 0 0 9 0 0 0 9 0 0 9 0 9
EDGE_SE3:QUAT 0 2 1 1 0 0 0.2 0.7 0.7 9 0 0 0 0 0 9 0 0 0 0 9 0 0 0 9 0 0 9 0 9
";
const TORO: &str = "\
VERTEX2 0 0 0 0
VERTEX2 1 1 0 0.1
VERTEX2 2 2 0 0.2
EDGE2 0 1 1 0 0.1 100 0 100 400 0 0
EDGE2 1 2 1 0 0.1 100 0 100 400 0 0
EDGE2 2 0 -2 0 -0.2 100 0 100 400 0 0
";
const GAMA: &str = "\
<gama-local><network axes-xy=\"ne\" angles=\"left-handed\">
<parameters sigma-apr=\"10\" conf-pr=\"0.95\" />
<points-observations distance-stdev=\"5\" direction-stdev=\"10\">
<point id=\"A\" x=\"0\" y=\"0\" z=\"9\" fix=\"xyz\" /> <point id=\"B\" x=\"100\" y=\"0\" fix=\"xy\" />
<point id=\"C\" x=\"50\" y=\"80\" z=\"10\" adj=\"xyz\" />
<obs from=\"A\"> <direction to=\"B\" val=\"0\" /> <direction to=\"C\" val=\"64.4\" /> <distance to=\"C\" val=\"94.34\" /> </obs>
<obs from=\"B\"> <direction to=\"A\" val=\"200\" /> <direction to=\"C\" val=\"135.6\" /> <distance to=\"C\" val=\"94.34\" /> </obs>
<height-differences> <dh from=\"A\" to=\"C\" val=\"1\" stdev=\"1\" /> </height-differences>
</points-observations></network></gama-local>
";

/// What stands in the place of a word.
const WORDS: [&str; 14] = [
    "nan",
    "inf",
    "-1",
    "0",
    "-0",
    "1e308",
    "-1e308",
    "1e-320",
    "4294967295",
    "18446744073709551616",
    "",
    "x",
    "\"",
    "<",
];

/// Makes a problem's way to the end, as far as it goes.
fn adjust(problem: &mut Problem) {
    let options = SolveOptions { iterations: 4, kernel: Kernel::Dcs(1.0), ..SolveOptions::default() };
    let _ = chordal(problem);
    let _ = bowie(problem, &options.kernel, &BowieOptions::default(), 4);
    let system = System::new(problem, options.order, options.partition, options.method.clone());
    let Ok(mut system) = system else { return };
    if solve_system(problem, &mut system, &options).is_ok() {
        let _ = covariances(problem, &mut system, &options.kernel, true);
    }
}

fn pose_graph_of(text: &str) {
    let Ok(graph) = pose_graph::parse(text) else { return };
    for convention in [Convention::Plain, Convention::Log, Convention::G2o] {
        if let Ok(mut problem) = problem(&graph, convention) {
            adjust(&mut problem);
        }
    }
}

fn net_of(text: &str) {
    if let Ok(net) = gama::parse(text)
        && let Ok(mut net) = GeodeticNet::new(net)
    {
        adjust(&mut net.problem);
    }
}

/// Changes words and bytes of a text.
fn damaged(text: &str, words: &[(prop::sample::Index, usize)], bytes: &[(prop::sample::Index, u8)]) -> String {
    let mut list: Vec<String> = text.split_inclusive([' ', '\n']).map(str::to_string).collect();
    for (at, with) in words {
        let at = at.index(list.len());
        let end = if list[at].ends_with('\n') { "\n" } else { " " };
        list[at] = format!("{}{end}", WORDS[*with]);
    }
    let mut raw = list.concat().into_bytes();
    for (at, value) in bytes {
        let at = at.index(raw.len());
        raw[at] = *value;
    }
    String::from_utf8_lossy(&raw).into_owned()
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 10_000, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn pose_graphs(
        which in 0..3_usize,
        words in prop::collection::vec((any::<prop::sample::Index>(), 0..WORDS.len()), 0..4),
        bytes in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 0..3),
    ) {
        pose_graph_of(&damaged([PLANE, SPACE, TORO][which], &words, &bytes));
    }

    #[test]
    fn nets(
        words in prop::collection::vec((any::<prop::sample::Index>(), 0..WORDS.len()), 0..4),
        bytes in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 0..3),
    ) {
        net_of(&damaged(GAMA, &words, &bytes));
    }

    #[test]
    fn columns_of_dynadjust(
        bytes in prop::collection::vec((any::<prop::sample::Index>(), 32..127_u8), 0..6),
        cut in any::<prop::sample::Index>(),
    ) {
        let station = "S000000             FFF XYZ    -4285027.3100   3000839.3529  -3636794.5132\n\
                       S000001             FFF XYZ    -4285127.3100   3000839.3529  -3636794.5132\n";
        let space = " ".repeat(64);
        let row = "           10.0000 1.0000000000000e-04 1.0000000000000e-06 1.0000000000000e-06";
        let measured = format!("G S000000             S000001\n{space}{row}\n{space}{row}\n{space}{row}\n");
        let text = damaged(&format!("{station}--\n{measured}"), &[], &bytes);
        let text: String = text.chars().take(cut.index(2 * text.len())).collect();
        let (stations, measurements) = text.split_once("--\n").unwrap_or((&text, ""));
        if let Ok(mut net) = dynadjust::parse_stations(stations)
            && dynadjust::parse_measurements(measurements, &mut net).is_ok()
            && let Ok(mut net) = GeodeticNet::new(net)
        {
            adjust(&mut net.problem);
        }
    }
}

#[test]
fn what_is_damaged_here_is_good() {
    for text in [PLANE, SPACE, TORO] {
        let graph = pose_graph::parse(text).expect("a graph");
        let mut problem = problem(&graph, Convention::Plain).expect("a problem");
        tieline_graph::nonlinear::solve(&mut problem, &SolveOptions::default()).expect("determined");
    }
    let net = GeodeticNet::new(gama::parse(GAMA).expect("a net")).expect("a problem");
    assert!(net.problem.factor_count() > 5);
}
