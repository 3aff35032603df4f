//! What each part of a drive's solution is worth: the thesis's ablations, from the ties of one run.

use std::path::Path;

use anyhow::{Context, Result};
use tieline_filter::TieKind;
use tieline_io::ties::text::{TextTie, TieTextReader, write_tie_text};

use super::super::Row;
use super::{Errors, errors, errors_within, median, seeds, simulate, solved, text, tieline, windows};

/// Ties with their calibration are those of the whole run; each case takes some of them.
struct Case {
    name: &'static str,
    odometer: bool,
    takes: fn(&[TextTie], (f64, f64)) -> Vec<usize>,
}

/// Sightings nearer than this are near \[m\].
const NEAR_M: f64 = 10.0;

fn is_loop(tie: &TextTie) -> bool {
    tie.kind == TieKind::SurfaceLine
}

fn of(ties: &[TextTie], takes: impl Fn(&TextTie) -> bool) -> Vec<usize> {
    (0..ties.len()).filter(|k| takes(&ties[*k])).collect()
}

/// Loop ties whose last sighting lies in the outage, so many, evenly over their time.
fn some_loops(ties: &[TextTie], (from_s, to_s): (f64, f64), count: usize) -> Vec<usize> {
    let last_s = |k: &usize| ties[*k].sightings.last().map_or(0.0, |s| s.time_s);
    let mut loops = of(ties, is_loop);
    loops.retain(|k| last_s(k) > from_s && last_s(k) <= to_s);
    loops.sort_by(|a, b| last_s(a).total_cmp(&last_s(b)));
    let picked = (0..count.min(loops.len())).map(|k| loops[(2 * k + 1) * loops.len() / (2 * count)]);
    picked.collect()
}

const CASES: [Case; 14] = [
    Case { name: "no ties", odometer: true, takes: |_, _| Vec::new() },
    Case { name: "1 loop tie", odometer: true, takes: |t, w| some_loops(t, w, 1) },
    Case { name: "2 loop ties", odometer: true, takes: |t, w| some_loops(t, w, 2) },
    Case { name: "4 loop ties", odometer: true, takes: |t, w| some_loops(t, w, 4) },
    Case { name: "16 loop ties", odometer: true, takes: |t, w| some_loops(t, w, 16) },
    Case { name: "all loop ties (back end)", odometer: true, takes: |t, _| of(t, is_loop) },
    Case { name: "all increments (front end)", odometer: true, takes: |t, _| of(t, |tie| !is_loop(tie)) },
    Case { name: "all ties (both)", odometer: true, takes: |t, _| of(t, |_| true) },
    Case { name: "all ties within 10 m", odometer: true, takes: |t, _| of(t, is_near) },
    Case { name: "no odometer, no ties", odometer: false, takes: |_, _| Vec::new() },
    Case { name: "no odometer, back end", odometer: false, takes: |t, _| of(t, is_loop) },
    Case { name: "no odometer, front end", odometer: false, takes: |t, _| of(t, |tie| !is_loop(tie)) },
    Case { name: "no odometer, both", odometer: false, takes: |t, _| of(t, |_| true) },
    Case { name: "no odometer, both within 10 m", odometer: false, takes: |t, _| of(t, is_near) },
];

fn is_near(tie: &TextTie) -> bool {
    tie.sightings.iter().all(|s| s.body_vector_m.norm() <= NEAR_M)
}

/// A project for `solve`: no strips, these ties, perhaps no odometer.
fn project_of(source: &str, ties: Option<&str>, odometer: bool) -> Result<String> {
    let mut kept = String::new();
    let mut keep = true;
    for line in source.lines() {
        if line.starts_with('[') {
            keep = line != "[[strips]]" && (odometer || line != "[odometer]");
        }
        if keep {
            kept += line;
            kept.push('\n');
        }
    }
    anyhow::ensure!(kept.len() < source.len(), "no [[strips]] in the project");
    Ok(ties.map_or(kept.clone(), |path| format!("{kept}\n[ties]\npath = \"{path}\"\n")))
}

/// Solves a case beside the project; gives the folder's errors.
fn solve(project: &Path, run: &Path, case: &Case, window: (f64, f64)) -> Result<std::path::PathBuf> {
    let data = project.parent().context("a folder")?;
    let reader = TieTextReader::open(&run.join("ties.txt"))?;
    let header = reader.header().clone();
    let ties: Vec<TextTie> = reader.collect::<Result<_, _>>()?;
    let picked = (case.takes)(&ties, window);
    let path = (!picked.is_empty()).then_some("picked.txt");
    if let Some(path) = path {
        write_tie_text(&data.join(path), &header, picked.iter().map(|k| ties[*k].clone()))?;
    }
    let file = data.join("case.toml");
    std::fs::write(&file, project_of(&std::fs::read_to_string(project)?, path, case.odometer)?)?;
    let out = data.join("case");
    tieline(&["solve", "--quiet", "--out", text(&out)?, text(&file)?])?;
    Ok(out)
}

/// Line 5: the table of ablations, as Markdown, and what must hold of it.
pub(crate) fn ablations() -> Result<Vec<Row>> {
    let mut found: Vec<Vec<Errors>> = CASES.iter().map(|_| Vec::new()).collect();
    let (mut good, mut good_with) = (Vec::new(), Vec::new());
    for seed in 1..=seeds() {
        let folder = tempfile::tempdir()?;
        let project = simulate("loop113", seed, folder.path(), |t| t)?;
        let (data, out) = (folder.path().join("data"), folder.path().join("out"));
        tieline(&["run", "--quiet", "--out", text(&out)?, text(&project)?])?;
        let window = windows(&data.join("truth/outages.csv"), 0)?.first().copied().context("an outage")?;
        for (case, errors_of) in CASES.iter().zip(&mut found) {
            errors_of.push(errors(&data, &solve(&project, &out, case, window)?)?);
        }
        let clear = tempfile::tempdir()?;
        let no_outage = |t: String| t.replace("[[gnss.outage]]\nstart_s = 180.0\nlength_s = 113.0\n", "");
        let project = simulate("loop113", seed, clear.path(), no_outage)?;
        let (data, out) = (clear.path().join("data"), clear.path().join("out"));
        tieline(&["run", "--quiet", "--out", text(&out)?, text(&project)?])?;
        good.push(errors_within(&data, &solved(&data)?, &[window])?);
        good_with.push(errors_within(&data, &solved(&out)?, &[window])?);
        println!("seed {seed} done");
    }
    let middle = |of: &[Errors], k: usize| median(&mut of.iter().map(|e| e.largest_ned_m[k]).collect::<Vec<_>>());
    println!("| largest error in the outage, median of {} seeds | north | east | down |\n|---|---|---|---|", seeds());
    let names = CASES.iter().map(|c| c.name).chain(["good GNSS in both passes, handed out", "the same, all ties"]);
    for (name, of) in names.zip(found.iter().chain([&good, &good_with])) {
        println!("| {name} | {:.3} m | {:.3} m | {:.3} m |", middle(of, 0), middle(of, 1), middle(of, 2));
    }
    let largest = |of: &[Errors]| (0..3).map(|k| middle(of, k)).fold(0.0, f64::max);
    Ok(vec![
        Row::at_most("loop113: all ties over none", largest(&found[7]) / largest(&found[0]), 0.5, ""),
        Row::at_most("loop113: all loop ties over one", largest(&found[5]) / largest(&found[1]), 1.0, ""),
        Row::at_most("loop113: with good GNSS, all ties over none", largest(&good_with) / largest(&good), 1.0, ""),
    ])
}
