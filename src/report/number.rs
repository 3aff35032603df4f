//! Numbers as people read them: units on request, a true minus sign, thousands apart, and a dash for what is not known.

/// Stands for a number that is not known or not determined.
pub(crate) const UNKNOWN: &str = "–";

/// Number with the given decimals; "–" when it is not finite.
pub(crate) fn fixed(value: f64, decimals: usize) -> String {
    if !value.is_finite() {
        return String::from(UNKNOWN);
    }
    let text = format!("{:.decimals$}", value.abs());
    let (whole, fraction) = text.split_once('.').unwrap_or((&text, ""));
    let zero = text.chars().all(|c| matches!(c, '0' | '.'));
    let sign = if value < 0.0 && !zero { "−" } else { "" };
    let point = if fraction.is_empty() { "" } else { "." };
    format!("{sign}{}{point}{fraction}", grouped(whole))
}

/// As [`fixed`], with a plus sign before what is above zero.
pub(crate) fn signed(value: f64, decimals: usize) -> String {
    let text = fixed(value, decimals);
    let plus = value > 0.0 && value.is_finite() && text.chars().any(|c| matches!(c, '1'..='9'));
    if plus { format!("+{text}") } else { text }
}

/// Metres shown as millimetres, one decimal.
pub(crate) fn mm(value_m: f64) -> String {
    fixed(value_m * 1e3, 1)
}

/// As [`mm`], with a plus sign before what is above zero.
pub(crate) fn signed_mm(value_m: f64) -> String {
    signed(value_m * 1e3, 1)
}

/// Counts with thin spaces between thousands.
pub(crate) fn count(value: u64) -> String {
    grouped(&value.to_string())
}

/// Counts of things in memory.
pub(crate) fn length(value: usize) -> String {
    grouped(&value.to_string())
}

/// `1 strip`, `2 strips`.
pub(crate) fn counted(value: usize, one: &str, many: &str) -> String {
    format!("{} {}", length(value), if value == 1 { one } else { many })
}

/// Digits in groups of three, apart by a narrow no-break space.
fn grouped(digits: &str) -> String {
    if digits.len() < 5 {
        return digits.to_string();
    }
    let mut out = String::with_capacity(digits.len() + 4);
    for (i, digit) in digits.chars().enumerate() {
        if i > 0 && (digits.len() - i).is_multiple_of(3) {
            out.push('\u{202f}');
        }
        out.push(digit);
    }
    out
}

/// Enough decimals to show two digits of `sigma`, from 0 to 6.
#[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // clamped
pub(crate) fn decimals_for(sigma: f64) -> usize {
    if !sigma.is_finite() || sigma <= 0.0 {
        return 4;
    }
    (1.0 - sigma.log10().floor()).clamp(0.0, 6.0) as usize
}

/// A span of time, `12.3 s` or `4 min 05 s` or `1 h 02 min`.
pub(crate) fn duration(seconds: f64) -> String {
    if !seconds.is_finite() || seconds < 0.0 {
        return String::from(UNKNOWN);
    }
    if seconds < 99.95 {
        return format!("{} s", fixed(seconds, if seconds < 9.995 { 2 } else { 1 }));
    }
    let minutes = (seconds / 60.0).floor();
    if minutes < 100.0 {
        return format!("{minutes:.0} min {:02.0} s", (seconds - 60.0 * minutes).floor());
    }
    format!("{:.0} h {:02.0} min", (minutes / 60.0).floor(), minutes % 60.0)
}

/// A number of bytes in MiB or GiB.
#[allow(clippy::cast_precision_loss)]
pub(crate) fn bytes(value: u64) -> String {
    let mebibytes = value as f64 / f64::from(1_u32 << 20);
    if mebibytes < 1024.0 {
        format!("{} MiB", fixed(mebibytes, 0))
    } else {
        format!("{} GiB", fixed(mebibytes / 1024.0, 2))
    }
}

/// The next round number (1, 1.5, 2, 2.5, 3, 4, 5, 6, 8 × 10ⁿ) not below a positive number.
pub(crate) fn round_up(value: f64) -> f64 {
    let decade = 10_f64.powf(value.log10().floor());
    let steps = [1.0, 1.5, 2.0, 2.5, 3.0, 4.0, 5.0, 6.0, 8.0, 10.0];
    steps.iter().map(|s| s * decade).find(|s| *s >= value * (1.0 - 1e-9)).unwrap_or(value)
}

/// The distance between ticks that makes about `wanted` of them over `span`.
pub(crate) fn tick_step(span: f64, wanted: f64) -> f64 {
    let rough = span / wanted;
    let decade = 10_f64.powf(rough.log10().floor());
    [1.0, 2.0, 5.0, 10.0].iter().map(|s| s * decade).find(|s| *s >= rough * (1.0 - 1e-9)).unwrap_or(rough)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_read_well() {
        assert_eq!(fixed(-1234.56, 1), "−1234.6");
        assert_eq!(fixed(-12_345.678, 2), "−12\u{202f}345.68");
        assert_eq!(fixed(-0.001, 1), "0.0");
        assert_eq!(fixed(f64::NAN, 1), "–");
        assert_eq!(signed(0.04, 1), "0.0");
        assert_eq!(signed(0.06, 1), "+0.1");
        assert_eq!(signed(f64::INFINITY, 1), "–");
        assert_eq!(mm(0.012_34), "12.3");
        assert_eq!(count(1_234_567), "1\u{202f}234\u{202f}567");
        assert_eq!(counted(1, "strip", "strips"), "1 strip");
    }

    #[test]
    fn spans_of_time_and_bytes_read_well() {
        assert_eq!(duration(0.456), "0.46 s");
        assert_eq!(duration(245.9), "4 min 05 s");
        assert_eq!(duration(7320.0), "2 h 02 min");
        assert_eq!(bytes(200 << 20), "200 MiB");
        assert_eq!(bytes(3 << 29), "1.50 GiB");
    }

    #[test]
    fn decimals_show_two_digits_of_the_sigma() {
        assert_eq!(decimals_for(0.001_2), 4);
        assert_eq!(decimals_for(0.9), 2);
        assert_eq!(decimals_for(25.0), 0);
        assert_eq!(decimals_for(f64::NAN), 4);
    }

    #[test]
    fn round_numbers_are_not_below() {
        assert!((round_up(2.1) - 2.5).abs() < 1e-12);
        assert!((round_up(0.03) - 0.03).abs() < 1e-12);
        assert!((round_up(9.0) - 10.0).abs() < 1e-12);
        assert!((tick_step(100.0, 5.0) - 20.0).abs() < 1e-12);
    }
}
