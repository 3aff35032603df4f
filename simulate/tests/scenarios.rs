//! Scenarios: their files, their mistakes, and the two that come with the crate.

use std::collections::BTreeSet;

use tieline_simulate::scenario::Scenario;
use tieline_simulate::{Survey, simulate};

#[test]
fn a_scenario_goes_through_its_file() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("scenario.toml");
    for scenario in [Scenario::airborne_block(3), Scenario::airborne_sample()] {
        std::fs::write(&path, toml::to_string(&scenario).expect("text")).expect("written");
        assert_eq!(Scenario::read(&path).expect("read"), scenario);
    }
    let short = "seed = 5\n[[flight.group]]\nheight_m = 400.0\n[[scanner]]\nkind = \"oscillating\"\n";
    std::fs::write(&path, short).expect("written");
    assert_eq!(Scenario::read(&path).expect("defaults for the rest").flight.groups[0].lines, 2);
}

#[test]
fn a_mistake_in_a_scenario_is_named() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("scenario.toml");
    for (text, word) in [
        ("sead = 5", "sead"),
        ("seed = 5", "flight.group"),
        ("[[flight.group]]\nheight_m = 10.0", "height_m"),
        ("crs = \"EPSG:0\"\n[[flight.group]]", "EPSG:0"),
        ("origin = [95.0, 0.0, 0.0]\n[[flight.group]]", "95"),
        ("scanner = []\n[[flight.group]]", "scanner"),
        ("[[flight.group]]\n[[scanner]]\nfield_of_view_deg = 170.0", "field_of_view_deg"),
        ("[[flight.group]]\n[errors]\nposition_linear_sd_m = -1.0", "position_linear_sd_m"),
    ] {
        std::fs::write(&path, text).expect("written");
        let error = Scenario::read(&path).expect_err(text).to_string();
        assert!(error.contains(word), "\"{word}\" is not in: {error}");
    }
    assert!(Scenario::read(&folder.path().join("none.toml")).is_err());
}

#[test]
fn the_block_has_strips_in_three_directions_and_two_heights_to_and_fro() {
    let scenario = Scenario::airborne_block(1);
    let survey = Survey::new(&scenario).expect("a good scenario");
    assert!(survey.lines().len() >= 8);
    let heights: BTreeSet<u64> = scenario.flight.groups.iter().map(|g| g.height_m.to_bits()).collect();
    assert_eq!(heights.len(), 2);
    let courses: BTreeSet<i32> = survey.lines().iter().map(|l| nearest(l.course_rad.to_degrees()) % 360).collect();
    assert_eq!(courses, BTreeSet::from([0, 45, 90, 180, 225, 270]));
    assert!(survey.world().solid_count() > 80 && survey.world().tree_count() > 60);
}

#[allow(clippy::cast_possible_truncation)]
fn nearest(degrees: f64) -> i32 {
    degrees.round() as i32
}

#[test]
fn another_seed_is_another_world_with_other_errors() {
    let [a, b] = [1, 2].map(|seed| Survey::new(&Scenario::airborne_block(seed)).expect("a good scenario"));
    assert_ne!(a.truth(), b.truth());
    assert!((a.world().terrain().height(10.0, 20.0).0 - b.world().terrain().height(10.0, 20.0).0).abs() > 1e-3);
}

#[test]
fn the_sample_is_small_enough_to_be_shipped() {
    let folder = tempfile::tempdir().expect("a folder");
    let report = simulate(&Scenario::airborne_sample(), folder.path()).expect("simulated");
    let size = |path: &std::path::Path| std::fs::metadata(path).expect("there").len();
    let laz: u64 = report.strips.iter().map(|s| size(&s.path)).sum();
    assert!(laz <= 3_500_000, "{laz} bytes in {} points", report.points());
    assert!(laz + size(&folder.path().join("trajectory.sbet")) <= 4_000_000);
    assert!(report.strips.len() >= 4 && report.strips.iter().all(|s| s.points > 20_000), "{:?}", report.strips);
}
