//! Loops through an outage.

use anyhow::Result;

use super::super::Row;
use super::{SEEDS, errors, median, simulate, text, tieline};

/// Line 2: a loop through an outage.
pub(crate) fn loop_closure() -> Result<Vec<Row>> {
    let (mut north, mut east, mut down, mut inside) = (vec![], vec![], vec![], vec![]);
    let mut before = Vec::new();
    for seed in 1..=SEEDS {
        let folder = tempfile::tempdir()?;
        let project = simulate("loop113", seed, folder.path(), |t| t)?;
        let out = folder.path().join("out");
        tieline(&["run", "--quiet", "--out", text(&out)?, text(&project)?])?;
        let data = folder.path().join("data");
        let after = errors(&data, &out)?;
        let handed_out = errors(&data, &data)?;
        println!(
            "seed {seed}: handed out N {:.3} E {:.3} D {:.3} m, now N {:.3} E {:.3} D {:.3} m, {:.0} % inside 2 sigma",
            handed_out.largest_ned_m[0],
            handed_out.largest_ned_m[1],
            handed_out.largest_ned_m[2],
            after.largest_ned_m[0],
            after.largest_ned_m[1],
            after.largest_ned_m[2],
            after.inside
        );
        before.push(handed_out.largest_ned_m[0].hypot(handed_out.largest_ned_m[1]));
        for (all, value) in [&mut north, &mut east, &mut down].into_iter().zip(after.largest_ned_m) {
            all.push(value);
        }
        inside.push(after.inside);
    }
    let mut rows = vec![Row::between(
        "loop113: handed out, largest plan error, median",
        median(&mut before),
        0.10,
        f64::INFINITY,
        "m",
    )];
    for (axis, values, middle, worst) in
        [("north", &mut north, 0.02, 0.03), ("east", &mut east, 0.02, 0.03), ("down", &mut down, 0.015, 0.025)]
    {
        rows.push(Row::at_most(format!("loop113: largest error {axis}, median of seeds"), median(values), middle, "m"));
        let most = values.iter().copied().fold(0.0, f64::max);
        rows.push(Row::at_most(format!("loop113: largest error {axis}, worst seed"), most, worst, "m"));
    }
    let mean = inside.iter().sum::<f64>() / inside.len() as f64;
    rows.push(Row::between("loop113: errors inside 2 sigma", mean, 90.0, 99.0, "%"));
    Ok(rows)
}
