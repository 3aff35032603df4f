//! Dates and weeks of the time systems that RTKLIB writes, turned into GPS time.

use tieline_filter::GpsTime;

/// Days of a week, and seconds of a day.
const WEEK_DAYS: i64 = 7;
const DAY_S: f64 = 86_400.0;
/// TAI minus GPS time \[s\].
const TAI_MINUS_GPS_S: f64 = 19.0;

/// A time system.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum TimeSystem {
    Gps,
    Utc,
    /// Japan: UTC + 9 h.
    Jst,
    /// Beijing: UTC + 8 h.
    Bjt,
}

impl TimeSystem {
    /// The system of a label in the header.
    pub(super) fn of(label: &str) -> Option<Self> {
        match label {
            "GPST" => Some(Self::Gps),
            "UTC" => Some(Self::Utc),
            "JST" => Some(Self::Jst),
            "BJT" => Some(Self::Bjt),
            _ => None,
        }
    }

    /// Its name.
    pub(super) fn name(self) -> &'static str {
        match self {
            Self::Gps => "GPS time",
            Self::Utc => "UTC",
            Self::Jst => "JST (UTC + 9 h)",
            Self::Bjt => "BJT (UTC + 8 h)",
        }
    }

    fn ahead_of_utc_s(self) -> f64 {
        match self {
            Self::Gps | Self::Utc => 0.0,
            Self::Jst => 9.0 * 3600.0,
            Self::Bjt => 8.0 * 3600.0,
        }
    }
}

/// A moment of some time system.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Moment {
    /// Since 1980-01-06.
    pub(super) day: i64,
    /// Of the day; may run past its end.
    pub(super) second: f64,
}

impl Moment {
    /// The moment of a date `yyyy/mm/dd` (or with `-`) and a time `hh:mm:ss.sss`.
    pub(super) fn of_date(date: &str, time: &str) -> Option<Self> {
        let mut date = date.split(['/', '-']).map(|part| part.parse::<i64>().ok());
        let (year, month, day) = (date.next()??, date.next()??, date.next()??);
        let mut time = time.split(':');
        let hour = time.next()?.parse::<u32>().ok()?;
        let minute = time.next()?.parse::<u32>().ok()?;
        let second = time.next()?.parse::<f64>().ok()?;
        if !(1980..=2170).contains(&year) {
            return None;
        }
        let long = [31, if is_leap(year) { 29 } else { 28 }, 31, 30, 31, 30, 31, 31, 30, 31, 30, 31];
        let last = usize::try_from(month).ok().and_then(|month| long.get(month.checked_sub(1)?))?;
        let valid = (1..=*last).contains(&day)
            && hour <= 24
            && minute <= 60
            && (0.0..=61.0).contains(&second)
            && date.next().is_none()
            && time.next().is_none();
        let day = days_since_1970(year, month, day) - days_since_1970(1980, 1, 6);
        let second = f64::from(hour * 3600 + minute * 60) + second;
        (valid && day >= 0).then_some(Self { day, second })
    }

    /// The moment of a week and its seconds.
    pub(super) fn of_week(week: &str, seconds: &str) -> Option<Self> {
        let week = week.parse::<i64>().ok().filter(|week| (0..=10_000).contains(week))?;
        let seconds = seconds.parse::<f64>().ok().filter(|s| (0.0..=2.0 * 604_800.0).contains(s))?;
        let day = (seconds / DAY_S).floor();
        #[allow(clippy::cast_possible_truncation)] // at most 14
        Some(Self { day: week * WEEK_DAYS + day as i64, second: seconds - day * DAY_S })
    }

    /// GPS week and seconds of it, as f64, and the leap seconds that were added.
    pub(super) fn gps(self, system: TimeSystem, leap: &mut LeapSeconds) -> (f64, f64, f64) {
        let mut moment = self;
        moment.second -= system.ahead_of_utc_s();
        if moment.second < 0.0 {
            moment.day -= 1;
            moment.second += DAY_S;
        }
        let added_s = if system == TimeSystem::Gps { 0.0 } else { leap.of_day(moment.day) };
        #[allow(clippy::cast_precision_loss)] // days since 1980
        let (week, day) = (moment.day.div_euclid(WEEK_DAYS) as f64, moment.day.rem_euclid(WEEK_DAYS) as f64);
        (week, day * DAY_S + moment.second + added_s, added_s)
    }
}

/// GPS time minus UTC, looked up once a day.
#[derive(Debug, Default)]
pub(super) struct LeapSeconds {
    last: Option<(i64, f64)>,
}

impl LeapSeconds {
    /// Of a day in UTC since 1980-01-06: it does not change within one.
    fn of_day(&mut self, day: i64) -> f64 {
        match self.last {
            Some((last, leap_s)) if last == day => leap_s,
            _ => {
                let week = u32::try_from(day.div_euclid(WEEK_DAYS)).unwrap_or(0);
                #[allow(clippy::cast_precision_loss)] // 0 to 6
                let noon_s = day.rem_euclid(WEEK_DAYS) as f64 * DAY_S + DAY_S / 2.0;
                let epoch = GpsTime { week, seconds_of_week: noon_s }.epoch();
                let leap_s = epoch.leap_seconds(true).map_or(0.0, |tai_minus_utc| tai_minus_utc - TAI_MINUS_GPS_S);
                self.last = Some((day, leap_s));
                leap_s
            }
        }
    }
}

fn is_leap(year: i64) -> bool {
    year % 4 == 0 && (year % 100 != 0 || year % 400 == 0)
}

/// Days of the Gregorian calendar, by counting years from March on so that the leap day comes last.
fn days_since_1970(year: i64, month: i64, day: i64) -> i64 {
    let year = if month <= 2 { year - 1 } else { year };
    let (era, of_era) = (year.div_euclid(400), year.rem_euclid(400));
    let of_year = (153 * ((month + 9) % 12) + 2) / 5 + day - 1;
    era * 146_097 + of_era * 365 + of_era / 4 - of_era / 100 + of_year - 719_468
}

#[cfg(test)]
mod tests {
    use super::*;

    fn gps(date: &str, time: &str, system: TimeSystem) -> (f64, f64, f64) {
        Moment::of_date(date, time).expect("a date").gps(system, &mut LeapSeconds::default())
    }

    #[test]
    fn dates_fall_into_their_weeks() {
        // X-Val: README of drive0708, 2025/07/08 19:34:18.499 GPST is week 2374, 243258.499 s.
        assert_eq!(gps("1980/01/06", "00:00:00.000", TimeSystem::Gps), (0.0, 0.0, 0.0));
        let (week, seconds, _) = gps("2025/07/08", "19:34:18.499", TimeSystem::Gps);
        assert!((week - 2374.0).abs() < 1e-9 && (seconds - 243_258.499).abs() < 1e-9, "{week} {seconds}");
        let (week, seconds, _) = gps("2000/02/29", "12:00:00", TimeSystem::Gps);
        assert_eq!((week, seconds), (1051.0, 2.0 * 86_400.0 + 43_200.0)); // a Tuesday
    }

    #[test]
    fn utc_gains_the_leap_seconds_of_its_day() {
        // X-Val: IERS bulletin C: 16 s until 2015-06-30, 17 s until 2016-12-31, 18 s since.
        for (date, time, leap_s) in [
            ("2015/06/30", "23:59:59", 16.0),
            ("2015/07/01", "00:00:00", 17.0),
            ("2016/12/31", "23:59:60.5", 17.0),
            ("2017/01/01", "00:00:00", 18.0),
            ("2025/07/08", "19:34:00", 18.0),
        ] {
            assert!((gps(date, time, TimeSystem::Utc).2 - leap_s).abs() < 1e-12, "{date}");
        }
        let gap = |a: (f64, f64, f64), b: (f64, f64, f64)| (b.0 - a.0) * 604_800.0 + b.1 - a.1;
        let before = gps("2016/12/31", "23:59:60.5", TimeSystem::Utc);
        let after = gps("2017/01/01", "00:00:00.0", TimeSystem::Utc);
        assert!((gap(before, after) - 0.5).abs() < 1e-9);
    }

    #[test]
    fn the_east_is_ahead_of_utc() {
        let utc = gps("2024/03/01", "00:30:00", TimeSystem::Utc);
        assert_eq!(gps("2024/03/01", "09:30:00", TimeSystem::Jst), utc);
        assert_eq!(gps("2024/03/01", "08:30:00", TimeSystem::Bjt), utc);
        assert_eq!(gps("2024/02/29", "23:59:00", TimeSystem::Jst), gps("2024/02/29", "14:59:00", TimeSystem::Utc));
    }

    #[test]
    fn dates_that_do_not_exist_are_refused() {
        for (date, time) in [
            ("2023/02/29", "00:00:00"),
            ("2024/13/01", "00:00:00"),
            ("2024/00/01", "00:00:00"),
            ("1979/12/31", "00:00:00"),
            ("1980/01/05", "00:00:00"),
            ("2024/01/01", "25:00:00"),
            ("2024/01/01", "00:00"),
            ("2024/01", "00:00:00"),
            ("2024/01/01/01", "00:00:00"),
            ("2024/01/01", "00:00:nan"),
            ("9223372036854775807/01/01", "00:00:00"),
        ] {
            assert_eq!(Moment::of_date(date, time), None, "{date} {time}");
        }
        assert_eq!(Moment::of_week("2300", "-1"), None);
        assert_eq!(Moment::of_week("2300.5", "1"), None);
        assert_eq!(Moment::of_week("2300", "86401.5"), Some(Moment { day: 16_101, second: 1.5 }));
    }
}
