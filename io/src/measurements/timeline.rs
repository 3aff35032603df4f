//! Times as they come from a file: checked, counted on over a week's end, put in order.

use std::path::{Path, PathBuf};

use tieline_filter::time::SECONDS_PER_WEEK;
use tieline_filter::{GnssFix, ImuSample, KnownPoint, OdometerSample, TimeEncoding};

use super::error::MeasurementFileError;
use crate::trajectory::{LATEST_ADJUSTED_S, LONGEST_WEEK_TIME_S, Place};

/// A file may pause this long over a week's end \[s\]; a longer jump back is no rollover.
const LONGEST_PAUSE_S: f64 = 86_400.0;

/// Something with a time.
pub(super) trait Timed {
    /// Its time \[s\].
    fn time_s(&self) -> f64;
    /// Moves it in time \[s\].
    fn shift_s(&mut self, by_s: f64);
}

macro_rules! timed {
    ($($kind:ty),*) => {
        $(impl Timed for $kind {
            fn time_s(&self) -> f64 {
                self.time_s
            }
            fn shift_s(&mut self, by_s: f64) {
                self.time_s += by_s;
            }
        })*
    };
}
timed!(ImuSample, GnssFix, OdometerSample, KnownPoint);

/// How the times of a file are to be read, and what a user should be told about them.
#[derive(Debug)]
pub(super) struct Settled {
    pub(super) time_encoding: TimeEncoding,
    pub(super) week: Option<u32>,
    pub(super) notes: Vec<String>,
}

/// The times of a file in the making.
#[derive(Debug)]
pub(super) struct Timeline {
    path: PathBuf,
    /// How far an epoch may lie behind the latest before it \[s\].
    disorder_s: f64,
    /// Whether the file says that its times are adjusted standard time.
    adjusted: bool,
    first_week: Option<f64>,
    last_week: Option<f64>,
    rollover_s: f64,
    latest_s: f64,
    disordered: u64,
    first_disordered: Option<(Place, f64)>,
}

impl Timeline {
    /// No times yet; the errors will name `path`.
    pub(super) fn new(path: &Path, disorder_s: f64, adjusted: bool) -> Self {
        Self {
            path: path.to_path_buf(),
            disorder_s,
            adjusted,
            first_week: None,
            last_week: None,
            rollover_s: 0.0,
            latest_s: f64::NEG_INFINITY,
            disordered: 0,
            first_disordered: None,
        }
    }

    /// A time of the file on one clock \[s\]: seconds since the start of the first week, or adjusted standard time.
    ///
    /// `week` is NaN where the file has none.
    pub(super) fn place(&mut self, place: Place, time_s: f64, week: f64) -> Result<f64, MeasurementFileError> {
        if !time_s.is_finite() {
            let (path, column) = (self.path.clone(), String::from("time"));
            return Err(MeasurementFileError::NotFinite { path, place, column });
        }
        if time_s.abs() >= LATEST_ADJUSTED_S {
            return Err(MeasurementFileError::TimeUnknown { path: self.path.clone(), place, time_s });
        }
        if week.is_finite() {
            self.last_week = Some(self.checked_week(place, week)?);
        }
        let of_week = !self.adjusted && time_s.abs() < LONGEST_WEEK_TIME_S;
        let placed_s = match self.last_week {
            Some(week) if of_week => time_s + (week - *self.first_week.get_or_insert(week)) * SECONDS_PER_WEEK,
            _ if of_week => self.counted_on_s(time_s),
            _ => time_s,
        };
        if placed_s < self.latest_s - self.disorder_s {
            let (path, previous_s) = (self.path.clone(), self.latest_s);
            return Err(MeasurementFileError::TimeBackwards { path, place, time_s: placed_s, previous_s });
        }
        if placed_s < self.latest_s {
            self.disordered += 1;
            self.first_disordered.get_or_insert((place, placed_s));
        }
        self.latest_s = self.latest_s.max(placed_s);
        Ok(placed_s)
    }

    fn checked_week(&self, place: Place, week: f64) -> Result<f64, MeasurementFileError> {
        match (0.0..=10_000.0).contains(&week) && week.fract() == 0.0 {
            true => Ok(week),
            false => {
                let (path, column, expected) = (self.path.clone(), "gps_week", "a whole number up to 10000");
                Err(MeasurementFileError::Absurd { path, place, column, value: week, expected })
            }
        }
    }

    /// Seconds of week that fall back by a week go on counting; one that came late still belongs to the old week.
    fn counted_on_s(&mut self, time_s: f64) -> f64 {
        let counted_s = time_s + self.rollover_s;
        if !self.latest_s.is_finite() || self.latest_s >= LONGEST_WEEK_TIME_S {
            return counted_s;
        }
        let ahead_s = counted_s - self.latest_s;
        let weeks = (-ahead_s / SECONDS_PER_WEEK).round();
        let pause_s = ahead_s + weeks * SECONDS_PER_WEEK;
        let late = self.disorder_s.min(60.0);
        if weeks >= 1.0 && (-late..=LONGEST_PAUSE_S).contains(&pause_s) {
            self.rollover_s += weeks * SECONDS_PER_WEEK;
            counted_s + weeks * SECONDS_PER_WEEK
        } else if self.rollover_s > 0.0 && weeks <= -1.0 && (-late..=0.0).contains(&pause_s) {
            counted_s + weeks * SECONDS_PER_WEEK
        } else {
            counted_s
        }
    }

    /// Puts samples in order and drops those at the time of another, if `single` asks for it; the earlier line stays.
    pub(super) fn settle<T: Timed>(self, samples: &mut Vec<T>, single: bool) -> Settled {
        let mut notes = Vec::new();
        let name = self.path.display();
        if let Some((place, time_s)) = self.first_disordered {
            samples.sort_by(|a, b| a.time_s().total_cmp(&b.time_s()));
            notes.push(format!(
                "{name}: {} epochs came after later ones, the first at {place} ({time_s} s); they were sorted by time",
                self.disordered
            ));
        }
        let mut week = self.first_week;
        if let (Some(first_week), Some(first)) = (&mut week, samples.first()) {
            // a file that began late in its order: the week is that of the earliest epoch
            let weeks = (first.time_s() / SECONDS_PER_WEEK).floor().min(0.0);
            if weeks < 0.0 && *first_week + weeks >= 0.0 {
                *first_week += weeks;
                samples.iter_mut().for_each(|sample| sample.shift_s(-weeks * SECONDS_PER_WEEK));
            }
        }
        if single {
            let (before, mut first) = (samples.len(), None);
            samples.dedup_by(|later, earlier| {
                let same = later.time_s() <= earlier.time_s();
                if same {
                    first.get_or_insert(later.time_s());
                }
                same
            });
            if let Some(time_s) = first {
                notes.push(format!(
                    "{name}: {} epochs had the time of the one before them and were dropped, the first at {time_s} s",
                    before - samples.len()
                ));
            }
        }
        if self.rollover_s > 0.0 {
            notes.push(format!(
                "{name}: seconds of week fell back at the week's end and were counted on past {SECONDS_PER_WEEK} s"
            ));
        }
        let negative = samples.first().is_some_and(|sample| sample.time_s() < 0.0);
        let is_adjusted = week.is_none() && (self.adjusted || negative || self.latest_s >= LONGEST_WEEK_TIME_S);
        let time_encoding = match is_adjusted {
            true => TimeEncoding::AdjustedStandard,
            false => TimeEncoding::SecondsOfWeek,
        };
        Settled { time_encoding, week: week.map(whole_week), notes }
    }
}

/// A week, checked before to be a whole number of up to 10 000.
#[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)]
fn whole_week(week: f64) -> u32 {
    week as u32
}
