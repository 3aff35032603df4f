//! GPS time, the two encodings of LAS files, and the survey clock that the columns are kept in.
//!
//! LAS files hold GPS seconds of week *or* "adjusted standard" time (GPS seconds minus 10⁹); SBET holds seconds
//! of week; a Saturday-night flight runs past 604 800 s. All of it is turned on entry into seconds on one
//! [`SurveyClock`]: seconds since the start of a reference week. There a time is below 10⁷, so that an `f64`
//! keeps it to a nanosecond, and a subtraction of two times never loses digits.

use hifitime::{Duration, Epoch, TimeScale, Unit};

/// Seconds in a GPS week.
pub const SECONDS_PER_WEEK: f64 = 604_800.0;
/// What LAS subtracts from GPS seconds in its adjusted standard time.
pub const ADJUSTED_OFFSET_S: f64 = 1.0e9;

/// How the GPS time field of a file is to be read.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum TimeEncoding {
    /// GPS seconds since 1980-01-06 minus 10⁹ (LAS global encoding bit 0 set).
    AdjustedStandard,
    /// Seconds of an unnamed GPS week (may run past 604 800 s over a week's end).
    SecondsOfWeek,
}

/// A moment in GPS time: week since 1980-01-06 and seconds of that week.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GpsTime {
    /// GPS week, counted from 1980-01-06 without rollover.
    pub week: u32,
    /// Seconds of week, `0 ≤ s < 604 800`.
    pub seconds_of_week: f64,
}

impl GpsTime {
    /// The moment as a [`hifitime::Epoch`], for calendar dates and other time scales.
    #[must_use]
    pub fn epoch(&self) -> Epoch {
        let since = Duration::from_seconds(self.seconds_of_week) + i64::from(self.week) * 7 * Unit::Day;
        Epoch::from_duration(since, TimeScale::GPST)
    }

    /// Calendar date in UTC, `2021-05-28T10:15:06 UTC`, without the fraction of a second.
    #[must_use]
    pub fn utc_text(&self) -> String {
        let (year, month, day, hour, minute, second, _) = self.epoch().to_gregorian_utc();
        format!("{year:04}-{month:02}-{day:02}T{hour:02}:{minute:02}:{second:02} UTC")
    }
}

/// The clock that all columns of a survey are kept in: seconds since the start of its reference week.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct SurveyClock {
    /// The reference week; `None` when every source holds seconds of week and nobody said which.
    pub reference_week: Option<u32>,
}

impl SurveyClock {
    /// The clock whose reference week holds the given adjusted standard time \[s\].
    #[must_use]
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // weeks are small and not negative
    pub fn from_adjusted_s(adjusted_s: f64) -> Self {
        let week = ((adjusted_s + ADJUSTED_OFFSET_S) / SECONDS_PER_WEEK).floor().max(0.0);
        Self { reference_week: Some(week as u32) }
    }

    /// What must be added to a file's time \[s\] to have survey seconds; exact, for it is a whole number.
    ///
    /// `None` when the file holds adjusted time and the clock does not know its week.
    #[must_use]
    pub fn shift_s(&self, encoding: TimeEncoding) -> Option<f64> {
        match encoding {
            TimeEncoding::SecondsOfWeek => Some(0.0),
            TimeEncoding::AdjustedStandard => {
                self.reference_week.map(|week| ADJUSTED_OFFSET_S - f64::from(week) * SECONDS_PER_WEEK)
            }
        }
    }

    /// Week and seconds of week of a survey time \[s\]; `None` when the week is unknown.
    #[must_use]
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)]
    pub fn gps_time(&self, survey_s: f64) -> Option<GpsTime> {
        let weeks = (survey_s / SECONDS_PER_WEEK).floor();
        let week = f64::from(self.reference_week?) + weeks;
        (week >= 0.0).then_some(GpsTime { week: week as u32, seconds_of_week: survey_s - weeks * SECONDS_PER_WEEK })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn adjusted_time_keeps_every_bit_on_the_survey_clock() {
        let adjusted_s = 306_235_306.123_456_8_f64;
        let clock = SurveyClock::from_adjusted_s(adjusted_s);
        let shift = clock.shift_s(TimeEncoding::AdjustedStandard).expect("the week is known");
        let survey_s = adjusted_s + shift;
        assert!((0.0..SECONDS_PER_WEEK).contains(&survey_s));
        assert!((survey_s - shift).to_bits() == adjusted_s.to_bits());
    }

    #[test]
    fn a_known_survey_falls_on_its_known_day() {
        // als-ign-dual-scanner was flown on 28 May 2021 (its publisher's flight record).
        let adjusted_s = 306_235_306.0;
        let clock = SurveyClock::from_adjusted_s(adjusted_s);
        let shift = clock.shift_s(TimeEncoding::AdjustedStandard).expect("the week is known");
        let time = clock.gps_time(adjusted_s + shift).expect("the week is known");
        assert!(time.utc_text().starts_with("2021-05-28"), "{}", time.utc_text());
    }

    #[test]
    fn a_time_past_the_end_of_the_week_falls_into_the_next_one() {
        let clock = SurveyClock { reference_week: Some(2300) };
        let time = clock.gps_time(SECONDS_PER_WEEK + 5.0).expect("the week is known");
        assert_eq!(time.week, 2301);
        assert!((time.seconds_of_week - 5.0).abs() < 1e-9);
    }

    #[test]
    fn adjusted_time_is_refused_while_the_week_is_unknown() {
        assert!(SurveyClock { reference_week: None }.shift_s(TimeEncoding::AdjustedStandard).is_none());
    }
}
