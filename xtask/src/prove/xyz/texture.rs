//! Lines 1, 5 and 6: texture of pavement and corners, judged at the true trajectory and calibration.

use std::collections::BTreeSet;
use std::process::Command;

use anyhow::{Result, ensure};
use tieline::cpu;
use tieline_matching::xyz::XyzKind;

use super::judged::{Judged, asked, judged, of_all_kinds, rows};
use crate::prove::Row;
use crate::prove::mobile::{seeds, simulate, text};
use crate::prove::real::{program, root};

/// Largest rms of a component of ties of spots, and of corners \[mm\].
const SPOTS_MM: f64 = 12.0;
const CORNERS_MM: f64 = 3.0;
/// Kinds that are judged, with their names.
const KINDS: [(XyzKind, &str, f64); 3] = [
    (XyzKind::Texture, "texture", SPOTS_MM),
    (XyzKind::Corner, "corners", CORNERS_MM),
    (XyzKind::Pole, "poles", SPOTS_MM),
];
/// What is looked for.
const ASKED: &str = "[\"texture\", \"corner\", \"pole\"]";

/// Line 1: ties against the truth; pulses come at twice the rate of the scenario, 260 points in a square metre and scanner at the median.
#[allow(clippy::cast_precision_loss)]
pub(crate) fn accuracy() -> Result<Vec<Row>> {
    let mut all = Vec::new();
    let mut fewest = f64::INFINITY;
    for seed in 1..=seeds() {
        let folder = tempfile::tempdir()?;
        let denser = |t: String| t.replace("pulse_rate_hz = 25_000.0", "pulse_rate_hz = 50_000.0");
        let project = asked(&simulate("loop113", seed, folder.path(), denser)?, ASKED)?;
        let (found, doubly_m) = judged(&project, &folder.path().join("data"), &folder.path().join("out"))?;
        let count = |rank: usize| {
            let of_rank = found.iter().filter(|j| j.passes && j.rank() >= rank);
            of_rank.map(|j| (j.kind, j.feature)).collect::<BTreeSet<(XyzKind, u32)>>().len()
        };
        println!(
            "seed {seed}: {} ties, {} points between passes on {doubly_m:.0} m, {} of them hold three directions",
            found.len(),
            count(2),
            count(3)
        );
        fewest = fewest.min(100.0 * count(2) as f64 / doubly_m);
        all.extend(found);
    }
    let name = "loop113 at 50 kHz";
    let mut lines =
        vec![Row::at_least(format!("{name}: points per 100 m of doubly driven road, fewest"), fewest, 20.0, "")];
    lines.extend(of_all_kinds(&format!("{name}, all kinds"), &all));
    let (passes, scanners): (Vec<_>, Vec<_>) = all.into_iter().partition(|j| j.passes);
    for (kind, what, most_mm) in KINDS {
        for (of, between) in [(&passes, "pass to pass"), (&scanners, "scanner to scanner")] {
            let of = of_kind(of, kind);
            // a house corner shows one wall to one scanner and the other to the other
            if kind != XyzKind::Corner || !of.is_empty() || between == "pass to pass" {
                lines.extend(rows(&format!("{name}, {what}, {between}"), &of, most_mm));
            }
        }
    }
    lines.extend(independent()?);
    Ok(lines)
}

fn of_kind(all: &[Judged], kind: XyzKind) -> Vec<&Judged> {
    all.iter().filter(|j| j.kind == kind).collect()
}

/// The drive of an independent simulator.
#[allow(clippy::cast_precision_loss)]
fn independent() -> Result<Vec<Row>> {
    let out = tempfile::tempdir()?;
    let source = std::fs::read_to_string(root().join("samples/real/mms-sim-block.toml"))?;
    let data = root().join("../shared/data/mms-sim-block");
    let file = out.path().join("block.toml");
    std::fs::write(&file, source.replace("../../../shared/data/mms-sim-block", text(&data)?))?;
    let project = asked(&file, ASKED)?;
    let (found, doubly_m) = judged(&project, &data, &out.path().join("out"))?;
    let beyond = found.iter().filter(|j| j.error_m.amax() > 0.03).count() as f64;
    let mut lines = Vec::new();
    for (kind, what, most_mm) in KINDS {
        // both passes drive the same way: spots lie in both alike and come out better than their sigmas, so that these are told, not bounded
        for row in rows(&format!("mms-sim-block, {what}"), &of_kind(&found, kind), most_mm) {
            println!("{}: {:.2} {}", row.name, row.value, row.unit);
        }
    }
    println!("mms-sim-block: {} ties on {doubly_m:.0} m of doubly driven road", found.len());
    lines.push(Row::at_most("mms-sim-block: ties beyond 3 cm of the truth", beyond, 0.0, ""));
    Ok(lines)
}

/// Line 5: what looking for spots costs.
pub(crate) fn time() -> Result<Vec<Row>> {
    let folder = tempfile::tempdir()?;
    let plain = simulate("loop113", 1, folder.path(), |t| t)?;
    let auto = asked(&plain, "\"auto\"")?;
    let mut least = [f64::INFINITY; 2];
    for _ in 0..2 {
        for (project, least_s) in [&plain, &auto].into_iter().zip(&mut least) {
            let before_s = cpu::of_children_s();
            let arguments =
                ["match", "--quiet", "--out", text(&folder.path().join("out"))?, text(project)?].map(String::from);
            let ran = Command::new(program()?).args(&arguments).output()?;
            ensure!(ran.status.success(), "tieline match: {}", String::from_utf8_lossy(&ran.stderr));
            *least_s = least_s.min(cpu::of_children_s() - before_s);
        }
    }
    println!("tieline match of loop113: {:.2} s CPU, with xyz = \"auto\" {:.2} s", least[0], least[1]);
    Ok(vec![Row::at_most("match with xyz = \"auto\" over without, CPU", least[1] / least[0], 2.0, "")])
}

/// Line 6: each has a test.
pub(crate) fn false_ties() -> Result<Vec<Row>> {
    let arguments = ["test", "--quiet", "--release", "-p", "tieline-matching", "--test", "texture"];
    let good = Command::new("cargo").args(arguments).current_dir(root()).status()?.success();
    Ok(vec![Row::at_most("asphalt, shadow, zebra, grid: tests that fail", f64::from(u8::from(!good)), 0.0, "")])
}
