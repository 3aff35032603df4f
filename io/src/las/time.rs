//! Which GPS time a file holds: its global-encoding bit is asked, its values decide.

use tieline_filter::TimeEncoding;

use super::bytes::f64_at;
use super::error::LasError;
use super::file::LasFile;

/// Chunks that are sampled, spread over the file.
const SAMPLED_CHUNKS: usize = 9;
/// Points that are looked at in each of them.
const SAMPLED_POINTS: u64 = 200;
/// Seconds of week stay below this \[s\]: a week of 604 800 s, and a day and more past its end.
const LONGEST_WEEK_S: f64 = 700_000.0;
/// Adjusted times stay below this \[s\] until 2043; above lie GPS or Unix seconds from which 10⁹ was not taken.
const LATEST_ADJUSTED_S: f64 = 1.0e9;

/// How the time of a file is to be read.
#[derive(Debug, Clone, PartialEq)]
pub struct TimeGuess {
    /// The encoding that the values show; `None` where no time can be used: the format has none, or it never changes.
    pub encoding: Option<TimeEncoding>,
    /// The encoding that the global-encoding bit of the header claims.
    pub claimed: TimeEncoding,
    /// A sentence for the user where the values contradict the bit or cannot be used.
    pub note: Option<String>,
    /// Least and greatest time \[s\] of the sample, as the file holds it; `None` where there is no finite one.
    pub sampled_range_s: Option<[f64; 2]>,
}

/// Recognises the time of a file by up to 200 points at the start of up to nine of its chunks.
///
/// # Errors
/// When a sampled chunk cannot be read.
pub fn guess_time(file: &LasFile) -> Result<TimeGuess, LasError> {
    let claimed = match file.header().says_adjusted_time() {
        true => TimeEncoding::AdjustedStandard,
        false => TimeEncoding::SecondsOfWeek,
    };
    let Some(position) = file.layout().gps_time else {
        let note = format!("point format {} has no GPS time", file.header().point_format);
        return Ok(TimeGuess { encoding: None, claimed, note: Some(note), sampled_range_s: None });
    };
    let (mut times_s, mut records) = (Vec::new(), Vec::new());
    let last = file.chunk_count() - 1; // a file without points, so without chunks, is never opened
    let samples = SAMPLED_CHUNKS.min(last + 1);
    let mut guess = guess_from_times(&[], claimed);
    for most in [SAMPLED_POINTS, u64::MAX] {
        times_s.clear();
        for sample in 0..samples {
            file.read_chunk_start(last * sample / (samples - 1).max(1), most, &mut records)?;
            times_s.extend(records.chunks_exact(file.layout().record_length).map(|record| f64_at(record, position)));
        }
        guess = guess_from_times(&times_s, claimed);
        if guess.encoding.is_some() {
            break; // else a coarse clock may have stood still for a thousand points: look at whole chunks
        }
    }
    Ok(guess)
}

/// Recognises the encoding of raw GPS times \[s\] beside the one that the header claims.
#[must_use]
pub fn guess_from_times(times_s: &[f64], claimed: TimeEncoding) -> TimeGuess {
    let finite = || times_s.iter().copied().filter(|time_s| time_s.is_finite());
    let least = finite().fold(f64::INFINITY, f64::min);
    let greatest = finite().fold(f64::NEG_INFINITY, f64::max);
    let answer = |encoding, note| TimeGuess {
        encoding,
        claimed,
        note,
        sampled_range_s: (least <= greatest).then_some([least, greatest]),
    };
    if least > greatest {
        return answer(None, Some("its GPS times are not finite numbers".to_owned()));
    }
    if times_s.len() > 1 && (greatest - least).abs() <= 0.0 {
        return answer(None, Some(format!("its GPS time never changes: {least} s at every point looked at")));
    }
    let (mut used, mut far, mut negative) = (0_usize, 0_usize, 0_usize);
    for time_s in finite().filter(|time_s| time_s.abs() > 0.0) {
        used += 1;
        far += usize::from(time_s.abs() > LONGEST_WEEK_S);
        negative += usize::from(time_s < 0.0);
    }
    let is_adjusted = 2 * far > used || 2 * negative > used;
    let found = if is_adjusted { TimeEncoding::AdjustedStandard } else { TimeEncoding::SecondsOfWeek };
    let note = if greatest >= LATEST_ADJUSTED_S {
        Some(format!(
            "its GPS times reach {greatest:.0} s, which as adjusted standard time is after the year 2043: \
             they look like GPS or Unix seconds from which 1e9 was not taken; dates will be wrong, differences are not"
        ))
    } else if found == claimed {
        None
    } else {
        Some(format!(
            "its global-encoding bit says {}, but its GPS times from {least:.3} to {greatest:.3} s are {}: \
             the values are believed",
            name(claimed),
            name(found)
        ))
    };
    answer(Some(found), note)
}

fn name(encoding: TimeEncoding) -> &'static str {
    match encoding {
        TimeEncoding::AdjustedStandard => "adjusted standard time",
        TimeEncoding::SecondsOfWeek => "seconds of week",
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use TimeEncoding::{AdjustedStandard, SecondsOfWeek};

    #[test]
    fn values_that_agree_with_the_bit_need_no_note() {
        assert_eq!(guess_from_times(&[347_063.2, 347_084.1], SecondsOfWeek).note, None);
        let guess = guess_from_times(&[306_235_306.0, 306_235_309.0], AdjustedStandard);
        assert_eq!((guess.encoding, guess.note), (Some(AdjustedStandard), None));
    }

    #[test]
    fn values_win_over_a_bit_that_contradicts_them() {
        let guess = guess_from_times(&[306_235_306.0, 306_235_309.0], SecondsOfWeek);
        assert_eq!(guess.encoding, Some(AdjustedStandard));
        assert!(guess.note.expect("a note").contains("believed"));
        let guess = guess_from_times(&[413_162.6, 413_167.0], AdjustedStandard);
        assert_eq!(guess.encoding, Some(SecondsOfWeek));
        assert!(guess.note.is_some());
    }

    #[test]
    fn a_flight_past_the_end_of_the_week_still_holds_seconds_of_week() {
        assert_eq!(guess_from_times(&[604_700.0, 605_900.0], SecondsOfWeek).encoding, Some(SecondsOfWeek));
    }

    #[test]
    fn adjusted_times_before_september_2011_are_negative() {
        let guess = guess_from_times(&[-50_000_000.0, -49_999_000.0], AdjustedStandard);
        assert_eq!((guess.encoding, guess.note), (Some(AdjustedStandard), None));
        assert_eq!(guess_from_times(&[-500.0, -400.0], SecondsOfWeek).encoding, Some(AdjustedStandard));
    }

    #[test]
    fn times_that_cannot_be_used_are_said_aloud() {
        for times_s in [[0.0, 0.0], [5.0, 5.0], [f64::NAN, f64::INFINITY]] {
            let guess = guess_from_times(&times_s, SecondsOfWeek);
            assert_eq!(guess.encoding, None);
            assert!(guess.note.is_some());
        }
        let guess = guess_from_times(&[1_690_000_000.0, 1_690_000_100.0], AdjustedStandard);
        assert!(guess.note.expect("a note").contains("2043"));
    }
}
