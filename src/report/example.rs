//! A made-up survey for tests: strips side by side and one across, with errors that an adjustment took out.

use std::collections::BTreeMap;

use super::data::{
    AdjustmentSummary, Discrepancies, Discrepancy, FileSummary, PairSummary, ParameterSummary, PlaceSummary,
    StripSummary, Summary, TieCounts, TiePoint, Timing, TrialSummary,
};
use crate::settings::Setting;

/// Numbers that look random and are the same each time.
struct Noise(u64);

impl Noise {
    fn uniform(&mut self) -> f64 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 11) as f64 / (1_u64 << 53) as f64
    }

    fn normal(&mut self) -> f64 {
        (0..12).map(|_| self.uniform()).sum::<f64>() - 6.0
    }
}

/// A survey of `strips` strips with about `ties` ties, at least three strips.
pub(crate) fn survey(strips: usize, ties: usize) -> (Summary, Vec<TiePoint>) {
    let mut noise = Noise(7);
    let strip_summaries: Vec<StripSummary> = (0..strips).map(|i| strip(i, strips, &mut noise)).collect();
    let mut couples: Vec<(usize, usize)> = (1..strips - 1).map(|i| (i - 1, i)).collect();
    couples.extend((0..strips - 1).map(|i| (i, strips - 1)));
    let mut points = Vec::new();
    let per_pair = ties / couples.len();
    for (pair, &(a, b)) in couples.iter().enumerate() {
        let offset_m = strip_summaries[a].correction_enu_m[2] - strip_summaries[b].correction_enu_m[2];
        let across = b == strips - 1;
        for _ in 0..per_pair {
            let along = noise.uniform();
            let (east, north) = if across {
                (a as f64 * 180.0 + 300.0 * noise.uniform(), 700.0 + 250.0 * noise.uniform())
            } else {
                (b as f64 * 180.0 + 120.0 * noise.uniform(), 1800.0 * along)
            };
            let normal_up = 1.0 - 0.6 * noise.uniform().powi(3);
            let outlier = noise.uniform() < 0.01;
            let wild = if outlier { 0.15 * noise.normal() } else { 0.0 };
            let bend = if across { 0.0 } else { 0.03 * (6.0 * along).sin() };
            let block = ((east / 150.0).floor() * 7.0 + (north / 150.0).floor() * 3.0).rem_euclid(5.0);
            points.push(TiePoint {
                map_m: [465_000.0 + east, 5_247_000.0 + north, 410.0],
                pair: u32::try_from(pair).unwrap_or(0),
                normal_up,
                before_m: (offset_m + bend) * normal_up + 0.008 * noise.normal() + wild,
                after_m: 0.002 * noise.normal() * offset_m.signum() + 0.008 * noise.normal() + wild,
                held_out: block < 0.5,
                outlier,
            });
        }
    }
    (summary(strip_summaries, &couples, &points), points)
}

fn strip(i: usize, strips: usize, noise: &mut Noise) -> StripSummary {
    let across = i + 1 == strips;
    StripSummary {
        name: format!("20140403_zh_{:02}", i + 1),
        points: 2_000_000 + 137_531 * i as u64,
        start_s: 280_000.0 + 400.0 * i as f64,
        end_s: 280_031.5 + 400.0 * i as f64,
        start_utc: Some(format!("2014-04-03 11:{:02}:12 UTC", 10 + 6 * i)),
        mission: 0,
        scanners: vec![0],
        fixed: i == 0,
        trajectory: String::from("rebuilt from pulses with several returns (sigma 0.6 m)"),
        course_deg: if across { 91.3 } else { 1.2 + 180.0 * (i % 2) as f64 },
        speed_mps: 61.2,
        height_m: 702.0,
        correction_enu_m: [0.05 * noise.normal(), 0.05 * noise.normal(), 0.04 * noise.normal()],
        rotation_enu_deg: [0.002 * noise.normal(), 0.002 * noise.normal(), 0.003 * noise.normal()],
        largest_over_prior: 1.2 + noise.uniform() + if i == 2 { 3.0 } else { 0.0 },
        implausible: i == 2,
    }
}

fn statistics(points: &[TiePoint], chosen: impl Fn(&TiePoint) -> bool, value: fn(&TiePoint) -> f64) -> Discrepancy {
    let values: Vec<f64> = points.iter().filter(|p| !p.outlier && chosen(p)).map(value).collect();
    Discrepancy::of(&values)
}

fn summary(strips: Vec<StripSummary>, couples: &[(usize, usize)], points: &[TiePoint]) -> Summary {
    let pairs = couples.iter().enumerate().map(|(row, &(a, b))| {
        let mine = |p: &TiePoint| p.pair as usize == row;
        PairSummary {
            a: strips[a].name.clone(),
            b: strips[b].name.clone(),
            before: statistics(points, mine, |p| p.before_m),
            after: statistics(points, mine, |p| p.after_m),
            shift_before_m: [0.081 * a as f64, if row == 1 { f64::NAN } else { -0.12 }, 0.034],
            shift_after_m: [0.004, if row == 1 { f64::NAN } else { 0.006 }, -0.0004],
        }
    });
    let counts = TieCounts {
        found: 2 * points.len() as u64,
        used: points.len() as u64 * 4 / 5,
        held_out: points.len() as u64 / 5,
    };
    let setting =
        |key: &str, value: &str, reason: &str| Setting { key: key.into(), value: value.into(), reason: reason.into() };
    let files = strips.iter().map(|s| FileSummary {
        input: format!("data/{}.laz", s.name),
        output: format!("out/block/corrected/{}.laz", s.name),
        points: s.points,
        largest_shift_m: 0.093,
        scale_m: [0.001; 3],
        notes: vec![
            String::from("scale 0.01 to 0.001 m, so that corrections of millimetres survive"),
            String::from("offset, bounds and generating software"),
        ],
    });
    Summary {
        version: String::from("0.1.0"),
        name: String::from("Zürich, eight strips"),
        inputs: strips.iter().map(|s| (format!("data/{}.laz", s.name), s.points)).collect(),
        crs: String::from("EPSG:25832"),
        settings: vec![
            setting("match.patch_m", "2", "holds 11 points of one strip (median)"),
            setting("match.max_roughness_m", "0.034", "2.5 × the noise of smooth patches (13.6 mm), 30 to 80 mm"),
            setting("match.hold_out", "0.2 (seed 1)", "by place, to judge the solution"),
        ],
        notes: vec![String::from(
            "20140403_zh_03: GPS time is adjusted standard time although the header says week seconds.",
        )],
        pairs: pairs.collect(),
        ties: BTreeMap::from([(String::from("surface_line"), counts)]),
        places: BTreeMap::from([(
            String::from("ridge"),
            PlaceSummary {
                counts: TieCounts { found: 138, used: 97, held_out: 41 },
                rank: [56, 41, 0],
                before: statistics(points, |p| !p.held_out, |p| p.before_m),
                after: statistics(points, |p| !p.held_out, |p| p.after_m),
                held_out_after: statistics(points, |p| p.held_out, |p| p.after_m),
            },
        )]),
        rejected: BTreeMap::from([
            (String::from("normal_angle"), 5210),
            (String::from("roughness"), 31_204),
            (String::from("no_overlap"), 871),
        ]),
        discrepancy: Discrepancies {
            before: statistics(points, |p| !p.held_out, |p| p.before_m),
            after: statistics(points, |p| !p.held_out, |p| p.after_m),
            held_out_before: statistics(points, |p| p.held_out, |p| p.before_m),
            held_out_after: statistics(points, |p| p.held_out, |p| p.after_m),
        },
        calibration: adjustment(points.iter().filter(|p| p.outlier).count()),
        files: files.collect(),
        strips,
        trajectory: BTreeMap::from([(
            String::from("source"),
            String::from("rebuilt from pulses with several returns"),
        )]),
        timing: Timing {
            stage: [("match", 12.4), ("solve", 3.21), ("correct", 21.9), ("report", 0.4)]
                .map(|(s, t)| (String::from(s), t))
                .into(),
            points_per_second: 512_000.0,
            ..Timing::default()
        },
        peak_memory_bytes: 611 << 20,
    }
}

fn adjustment(outliers: usize) -> AdjustmentSummary {
    let parameter = |name: &str, unit: &str, value, sigma, prior_sigma, observed| ParameterSummary {
        block: String::from("scanner 0"),
        name: name.into(),
        unit: unit.into(),
        value,
        sigma,
        prior_sigma,
        observed,
    };
    let trial = |model: &str, unknowns, held_out_rms_m, gain_t, taken, reason: &str| TrialSummary {
        model: model.into(),
        unknowns,
        used_rms_m: held_out_rms_m * 0.97,
        held_out_rms_m,
        gain_t,
        taken,
        reason: reason.into(),
    };
    AdjustmentSummary {
        strip_model: String::from("linear"),
        trials: vec![
            trial("constant", 48, 0.0104, 31.2, true, "held-out ties 38.1 to 10.4 mm"),
            trial("linear", 96, 0.0089, 6.2, true, "held-out ties 10.4 to 8.9 mm"),
            trial("spline 10 s", 214, 0.0089, 0.7, false, "held-out ties do not get better by more than chance"),
        ],
        parameters: vec![
            parameter("boresight_roll", "deg", 0.012_34, 0.000_31, 0.05, 0.995),
            parameter("boresight_pitch", "deg", -0.004_4, 0.001_2, 0.05, 0.93),
            parameter("boresight_yaw", "deg", 0.021, 0.008, 0.05, 0.71),
            parameter("lever_arm_up", "m", 0.0, 0.05, 0.05, 0.02),
            parameter("range_scale", "ppm", 12.0, 9.0, 100.0, 0.88),
        ],
        unobservable: vec![
            String::from("the height of the block as a whole: no control"),
            String::from("lever arm up against range offset: all strips were flown at one height"),
        ],
        condition: 3.1e5,
        sigma0: 1.04,
        common_mode_factor: 1.8,
        class_scale: BTreeMap::from([(String::from("flat"), 0.97), (String::from("steep"), 1.31)]),
        iterations: 3,
        outliers,
        warnings: vec![String::from("20140403_zh_03 has ties on one side only: its roll is weakly determined.")],
    }
}
