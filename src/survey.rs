//! A survey opened: its files, their clock, their reference system. Everything that can be wrong is found here,
//! before long work starts.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, anyhow, bail};
use nalgebra::Vector3;
use tieline_filter::{SurveyClock, TimeEncoding};
use tieline_io::crs::{Crs, CrsKind};
use tieline_io::las::{LasFile, guess_time};
use tieline_matching::CONTROL_FILE;

use crate::project::{ControlKind, Project, TimeChoice};

/// One file of strips, or of a control surface.
#[derive(Debug)]
pub struct SurveyFile {
    /// The file.
    pub las: LasFile,
    /// Its number: the place in the list, or [`CONTROL_FILE`] and up.
    pub number: u16,
    /// Added to its times to have survey time \[s\].
    pub time_shift_s: f64,
    /// How its times are to be read.
    pub encoding: TimeEncoding,
    /// Number of the `[[strips]]` section it came from.
    pub section: usize,
    /// Least and greatest time \[s\] of a sample, as in the file.
    pub sampled_range_s: Option<[f64; 2]>,
}

/// A survey: files, clock, reference system, local origin.
#[derive(Debug)]
pub struct Survey {
    /// Files, control surfaces last.
    pub files: Vec<SurveyFile>,
    /// The clock of all columns.
    pub clock: SurveyClock,
    /// The reference system, when it is known.
    pub crs: Option<Crs>,
    /// Map coordinates of the local origin \[m\].
    pub origin_m: [f64; 3],
    /// What a user should be told.
    pub notes: Vec<String>,
}

impl Survey {
    /// Opens the files of a project and settles clock and reference system.
    ///
    /// # Errors
    /// The first thing that cannot be used, with the file or key and a remedy.
    pub fn open(project: &Project) -> Result<Self> {
        let mut notes = Vec::new();
        let mut files = Vec::new();
        let mut seen = BTreeSet::new();
        for (section, strips) in project.strips.iter().enumerate() {
            let paths = expand(project, &strips.path).with_context(|| format!("strips.path = \"{}\"", strips.path))?;
            for path in paths {
                if !seen.insert(path.clone()) {
                    bail!("{}: named by two [[strips]] sections; name it once", path.display());
                }
                files.push(open(&path, section, project.project.time, &mut notes)?);
            }
        }
        let strips = files.len();
        for control in project.control.iter().filter(|c| c.kind == ControlKind::Surface) {
            for path in
                expand(project, &control.path).with_context(|| format!("control.path = \"{}\"", control.path))?
            {
                let las = LasFile::open(&path)?;
                let (time_shift_s, encoding) = (0.0, TimeEncoding::SecondsOfWeek);
                files.push(SurveyFile { las, number: 0, time_shift_s, encoding, section: 0, sampled_range_s: None });
            }
        }
        for (i, file) in files.iter_mut().enumerate() {
            let place = if i < strips { i } else { usize::from(CONTROL_FILE) + i - strips };
            file.number = u16::try_from(place).map_err(|_| anyhow!("more than 32 768 files in one survey"))?;
        }
        let clock = settle_clock(&mut files[..strips], project, &mut notes)?;
        let crs = settle_crs(&files, project, &mut notes)?;
        check_coordinates(&files, crs.as_ref())?;
        let origin_m = local_origin(&files);
        Ok(Self { files, clock, crs, origin_m, notes })
    }

    /// Points in all strip files, by their headers.
    #[must_use]
    pub fn points(&self) -> u64 {
        self.strip_files().map(|f| f.las.header().point_count).sum()
    }

    /// The files of strips, without control surfaces.
    pub fn strip_files(&self) -> impl Iterator<Item = &SurveyFile> {
        self.files.iter().filter(|f| f.number < CONTROL_FILE)
    }

    /// The local origin as a vector \[m\].
    #[must_use]
    pub fn origin(&self) -> Vector3<f64> {
        Vector3::from(self.origin_m)
    }
}

/// Files that a path or pattern of the project names, sorted.
///
/// # Errors
/// When there is none, or the pattern is not one.
pub fn expand(project: &Project, pattern: &str) -> Result<Vec<PathBuf>> {
    let full = project.resolve(pattern);
    if full.is_file() {
        return Ok(vec![full]);
    }
    if full.is_dir() {
        bail!("{} is a folder; name its files by a pattern, such as \"{pattern}/*.laz\"", full.display());
    }
    let text = full.to_str().context("the path is not UTF-8")?;
    let mut paths: Vec<PathBuf> = glob::glob(text).context("not a file pattern")?.filter_map(Result::ok).collect();
    paths.retain(|p| p.is_file());
    paths.sort();
    if paths.is_empty() {
        bail!("no file is found at {}; paths are relative to the project file", full.display());
    }
    Ok(paths)
}

fn open(path: &Path, section: usize, choice: TimeChoice, notes: &mut Vec<String>) -> Result<SurveyFile> {
    let las = LasFile::open(path)?;
    let guess = guess_time(&las)?;
    let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
    if let Some(note) = &guess.note {
        notes.push(format!("{name}: {note}"));
    }
    let encoding = match (choice, guess.encoding) {
        (TimeChoice::Adjusted, Some(_)) => TimeEncoding::AdjustedStandard,
        (TimeChoice::GpsWeek, Some(_)) => TimeEncoding::SecondsOfWeek,
        (TimeChoice::Auto, Some(encoding)) => encoding,
        (_, None) => bail!(
            "{}: {}; corrections over time need the GPS time of every point, so export the strips with it",
            path.display(),
            guess.note.unwrap_or_else(|| String::from("the points have no usable GPS time"))
        ),
    };
    Ok(SurveyFile { las, number: 0, time_shift_s: 0.0, encoding, section, sampled_range_s: guess.sampled_range_s })
}

/// One clock for all files: the week of the earliest adjusted time, or the week that the project names.
fn settle_clock(files: &mut [SurveyFile], project: &Project, notes: &mut Vec<String>) -> Result<SurveyClock> {
    let mut earliest_s = f64::INFINITY;
    let mut of_week = None;
    for file in files.iter() {
        if file.encoding == TimeEncoding::AdjustedStandard {
            if let Some([least_s, _]) = file.sampled_range_s {
                earliest_s = earliest_s.min(least_s);
            }
        } else {
            of_week.get_or_insert_with(|| file.las.path().display().to_string());
        }
    }
    let clock = match project.project.week {
        Some(week) => SurveyClock { reference_week: Some(week) },
        None if earliest_s.is_finite() => SurveyClock::from_adjusted_s(earliest_s),
        None => SurveyClock { reference_week: None },
    };
    if let (true, Some(file), None) = (earliest_s.is_finite(), of_week, project.project.week) {
        bail!("{file} holds seconds of week and other files adjusted GPS time; say which week with project.week");
    }
    if clock.reference_week.is_none() {
        notes.push(String::from("times are seconds of week of an unnamed GPS week (project.week names it)"));
    }
    for file in files {
        file.time_shift_s = clock.shift_s(file.encoding).context("adjusted time without a week")?;
    }
    Ok(clock)
}

/// The reference system of the project, else the one that all files agree on.
fn settle_crs(files: &[SurveyFile], project: &Project, notes: &mut Vec<String>) -> Result<Option<Crs>> {
    let mut found: Option<(Crs, String)> = None;
    for file in files {
        let header = file.las.header();
        let name = file.las.path().display().to_string();
        let crs = match (&header.wkt, header.epsg) {
            (Some(wkt), _) => Crs::parse(wkt),
            (None, Some(code)) => Crs::from_epsg(code),
            (None, None) => continue,
        };
        match (crs, &found) {
            (Ok(crs), None) => found = Some((crs, name)),
            (Ok(crs), Some((first, first_name))) if !crs.is_same(first) => bail!(
                "two reference systems in one survey: {first_name} is in {}, {name} in {}; bring them into one first",
                first.name(),
                crs.name()
            ),
            (Ok(_), Some(_)) => {}
            (Err(error), _) if project.project.crs.is_none() => {
                notes.push(format!("{name}: its reference system cannot be used ({error}); set project.crs"));
            }
            (Err(_), _) => {}
        }
    }
    let Some(text) = &project.project.crs else {
        match &found {
            Some((crs, _)) => notes.push(format!("reference system {} from the strips' headers", crs.name())),
            None => notes.push(String::from("no reference system is named: coordinates are taken as local metres")),
        }
        return Ok(found.map(|(crs, _)| crs));
    };
    let mut crs = Crs::parse(text).with_context(|| format!("project.crs = \"{text}\""))?;
    if let Some([latitude_deg, longitude_deg, height_m]) = project.project.origin {
        crs = crs.with_origin(Vector3::new(latitude_deg.to_radians(), longitude_deg.to_radians(), height_m))?;
    }
    if let Some((of_files, name)) = &found
        && !of_files.is_same(&crs)
        && crs.kind() != CrsKind::Local
    {
        bail!("project.crs is {}, but {name} says {}; correct one of the two", crs.name(), of_files.name());
    }
    Ok(Some(crs))
}

fn check_coordinates(files: &[SurveyFile], crs: Option<&Crs>) -> Result<()> {
    if let Some(crs) = crs.filter(|c| c.kind() == CrsKind::Geographic) {
        bail!("the strips are in {} (degrees); project them to metres first, for instance to UTM", crs.name());
    }
    let in_degrees = |f: &SurveyFile| {
        let h = f.las.header();
        h.min[0] >= -180.0 && h.max[0] <= 180.0 && h.min[1] >= -90.0 && h.max[1] <= 90.0 && h.scale[0] < 1e-5
    };
    if let Some(file) = files.iter().find(|f| in_degrees(f)) {
        bail!("{}: coordinates look like degrees; project them to metres first", file.las.path().display());
    }
    Ok(())
}

/// Middle of all files, to whole kilometres (and 100 m of height): differences stay small, the numbers readable.
fn local_origin(files: &[SurveyFile]) -> [f64; 3] {
    std::array::from_fn(|k| {
        let low = files.iter().map(|f| f.las.header().min[k]).fold(f64::INFINITY, f64::min);
        let high = files.iter().map(|f| f.las.header().max[k]).fold(f64::NEG_INFINITY, f64::max);
        let step = if k == 2 { 100.0 } else { 1000.0 };
        (0.5 * (low + high) / step).round() * step
    })
}

impl Survey {
    /// Puts other files in place of the strips: the corrected ones, for instance. Clock and origin stay.
    ///
    /// # Errors
    /// When a file cannot be opened, or their number differs while files tell strips apart.
    pub fn replace_files(&mut self, paths: &[PathBuf]) -> Result<()> {
        let mut files = Vec::new();
        for (number, path) in paths.iter().enumerate() {
            let name = path.file_name();
            let old = self.strip_files().find(|f| f.las.path().file_name() == name);
            let mut notes = Vec::new();
            let mut file = open(path, old.map_or(0, |f| f.section), TimeChoice::Auto, &mut notes)?;
            file.number = old.map_or_else(|| u16::try_from(number).unwrap_or(0), |f| f.number);
            file.time_shift_s = self.clock.shift_s(file.encoding).context("adjusted time without a week")?;
            files.push(file);
        }
        self.files = files;
        Ok(())
    }
}
