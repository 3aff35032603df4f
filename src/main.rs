//! The `tieline` program.
use std::path::PathBuf;
use tieline::job::*;
fn main() -> anyhow::Result<()> {
    let args: Vec<String> = std::env::args().collect();
    let project = tieline::project::Project::load(std::path::Path::new(&args[1]))?;
    let out = PathBuf::from(&args[2]);
    let options = JobOptions {
        out: out.clone(),
        memory_bytes: DEFAULT_MEMORY_BYTES,
        progress: tieline::progress::Progress::new(false),
    };
    let mut clock = Clock::default();
    let m = match_strips(&project, &options, &mut clock)?;
    for n in m.survey.notes.iter().chain(&m.poses.notes) {
        println!("note {n}");
    }
    for s in &m.settings.list {
        println!("{} = {} ({})", s.key, s.value, s.reason);
    }
    for r in &m.poses.reports {
        println!("{r:?}");
    }
    println!(
        "patches {} found {} selected {} rejected {:?}",
        m.ties.patches,
        m.ties.found,
        m.ties.selected.len(),
        m.ties.rejected
    );
    let s = solve_strips(&project, &m, &mut clock)?;
    for t in &s.trials {
        println!("{t:?}");
    }
    println!(
        "class {:?} sigma0 {} common {} used {} cond {}",
        s.adjustment.class_scale,
        s.adjustment.sigma0,
        s.adjustment.common_mode_factor,
        s.adjustment.used_lines,
        s.adjustment.observability.condition
    );
    for (i, p) in s.parameters().iter().enumerate() {
        let k = if p.is_angle { 180.0 / std::f64::consts::PI } else { 1.0 };
        println!(
            "{:?} {} = {:.5} ± {:.5} (prior {:.5}) observed {:.2}",
            p.block,
            p.name,
            s.model.state()[i] * k,
            s.adjustment.covariance[(i, i)].sqrt() * k,
            p.prior_sigma * k,
            s.adjustment.observability.share[i]
        );
    }
    let f = correct_strips(&project, &m, &s, &out, options.progress, &mut clock)?;
    for f in f {
        println!("{f:?}");
    }
    println!("{:?}", clock.timing(m.points));
    Ok(())
}
