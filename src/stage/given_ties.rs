//! Ties of a file (`[ties]`) for the smoother, on the clock of the measurements.

use anyhow::{Context, Result, bail};
use tieline_filter::time::SECONDS_PER_WEEK;
use tieline_filter::{FilterTie, SurveyClock};
use tieline_io::ties::text::TieTextReader;

use crate::project::Project;

/// Reads the ties of a project, none without `[ties] path`; `span_s` is that of the IMU on the clock.
///
/// # Errors
/// File, line and remedy of what cannot be read; when no tie lies within the IMU's time.
pub fn load(
    project: &Project,
    clock: &SurveyClock,
    span_s: (f64, f64),
    notes: &mut Vec<String>,
) -> Result<Vec<FilterTie>> {
    let Some(path) = project.ties.as_ref().and_then(|t| t.path.as_ref()) else { return Ok(Vec::new()) };
    let path = project.resolve(path);
    let reader = TieTextReader::open(&path).context("[ties]")?;
    let week = reader.header().week;
    let shift_s = match (week, clock.reference_week) {
        (Some(file), Some(clock)) => (f64::from(file) - f64::from(clock)) * SECONDS_PER_WEEK,
        _ => 0.0,
    };
    let (mut ties, mut read) = (Vec::new(), 0);
    let (mut first_s, mut last_s, mut within) = (f64::INFINITY, f64::NEG_INFINITY, 0);
    for tie in reader {
        let tie = tie.context("[ties]")?;
        read += 1;
        let times = || tie.sightings.iter().map(|s| s.time_s);
        first_s = times().fold(first_s, f64::min);
        last_s = times().fold(last_s, f64::max);
        within += usize::from(times().all(|t| (span_s.0..=span_s.1).contains(&(t + shift_s))));
        ties.extend(tie.for_smoother(shift_s));
    }
    if read == 0 {
        bail!("{}: it holds no tie; export it again, or take ties.path out of the project", path.display());
    }
    let named = |week: Option<u32>| week.map_or_else(|| String::from("an unknown week"), |w| format!("week {w}"));
    if within == 0 {
        bail!(
            "{}: its ties are of {first_s:.1} s to {last_s:.1} s in {}, the IMU is of {:.1} s to {:.1} s in {}: another drive, or the \
             wrong week; mend \"# week:\" in the file or project.week",
            path.display(),
            named(week),
            span_s.0,
            span_s.1,
            named(clock.reference_week)
        );
    }
    if week.is_none() || clock.reference_week.is_none() {
        notes.push(format!("{}: taken to be of the same week as the IMU", path.display()));
    }
    let (unused, beyond) = (read - ties.len(), read - within);
    let mut note = format!("{}: {read} ties", path.display());
    if unused > 0 {
        note += &format!(", {unused} of them marked as not used");
    }
    if beyond > 0 {
        note += &format!(", {beyond} not wholly within the time of the IMU and left out");
    }
    notes.push(note);
    notes.push(String::from(
        "the constants of the scanners in these ties are taken as known: sigmas do not hold theirs, which matters most for heading",
    ));
    Ok(ties)
}
