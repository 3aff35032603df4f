//! Charts as SVG inside the page; colours come from the page's style, so that they follow light, dark and print.

use std::fmt::Write as _;

use super::html::escape;
use super::number::{fixed, tick_step};

/// A set of values of a histogram.
#[derive(Debug)]
pub(crate) struct Series<'a> {
    /// Name in the legend.
    pub(crate) name: &'a str,
    /// Class of the style: `before`, `after` or `held`.
    pub(crate) class: &'a str,
    /// Values \[m\].
    pub(crate) values_m: &'a [f64],
    /// Filled, or an outline only.
    pub(crate) filled: bool,
}

const WIDTH: f64 = 460.0;
const HEIGHT: f64 = 250.0;
const LEFT: f64 = 44.0;
const RIGHT: f64 = 10.0;
const TOP: f64 = 10.0;
const BOTTOM: f64 = 40.0;
const BINS: usize = 61;

/// Shares of the values in bins from `-limit` to `limit`, and the share beyond.
fn shares(values_m: &[f64], limit_m: f64) -> (Vec<f64>, f64) {
    let mut counts = vec![0_usize; BINS];
    let (mut total, mut beyond) = (0_usize, 0_usize);
    for value in values_m.iter().filter(|v| v.is_finite()) {
        total += 1;
        let position = (value / limit_m + 1.0) * 0.5 * BINS as f64;
        #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // inside the bins
        if position >= 0.0 && position < BINS as f64 {
            counts[position as usize] += 1;
        } else {
            beyond += 1;
        }
    }
    let share = |n: usize| if total == 0 { 0.0 } else { n as f64 / total as f64 };
    (counts.into_iter().map(share).collect(), share(beyond))
}

/// A histogram of several sets of values between plus and minus a limit, each as shares of its own number.
pub(crate) fn histogram(label: &str, limit_m: f64, series: &[Series<'_>]) -> String {
    let shown: Vec<(&Series<'_>, Vec<f64>, f64)> = series
        .iter()
        .filter(|s| s.values_m.iter().any(|v| v.is_finite()))
        .map(|s| {
            let (bins, beyond) = shares(s.values_m, limit_m);
            (s, bins, beyond)
        })
        .collect();
    if shown.is_empty() || !limit_m.is_finite() || limit_m <= 0.0 {
        return String::new();
    }
    let top = shown.iter().flat_map(|s| s.1.iter()).copied().fold(0.0, f64::max).max(0.005) * 1.06;
    let mut svg = format!(
        "<svg class=\"chart\" viewBox=\"0 0 {WIDTH} {HEIGHT}\" role=\"img\" aria-label=\"{}\">\n",
        escape(label)
    );
    axes(&mut svg, limit_m * 1e3, top * 100.0);
    for (series, bins, _) in &shown {
        let fill = if series.filled { "fill" } else { "line" };
        let _ = writeln!(svg, "<path class=\"{fill} {}\" d=\"{}\"/>", series.class, outline(bins, top));
    }
    svg.push_str("</svg>\n<ul class=\"legend\">\n");
    for (series, _, beyond) in &shown {
        let beyond =
            if *beyond > 0.0 { format!(", {} % beyond the chart", fixed(beyond * 100.0, 1)) } else { String::new() };
        let shape = if series.filled { "fill" } else { "line" };
        let _ = writeln!(svg, "<li><i class=\"{shape} {}\"></i>{}{beyond}</li>", series.class, escape(series.name));
    }
    svg.push_str("</ul>\n");
    svg
}

/// The step line around the bins, closed along the ground.
fn outline(bins: &[f64], top: f64) -> String {
    let step = (WIDTH - LEFT - RIGHT) / BINS as f64;
    let ground = HEIGHT - BOTTOM;
    let mut path = format!("M{LEFT:.1} {ground:.1}");
    for (i, share) in bins.iter().enumerate() {
        let y = ground - share / top * (ground - TOP);
        let _ = write!(path, "V{y:.1}H{:.1}", LEFT + step * (i as f64 + 1.0));
    }
    let _ = write!(path, "V{ground:.1}Z");
    path
}

/// Grid lines and numbers: millimetres along the ground, percent upwards.
fn axes(svg: &mut String, limit_mm: f64, top_percent: f64) {
    let ground = HEIGHT - BOTTOM;
    let x = |mm: f64| LEFT + (mm / limit_mm + 1.0) * 0.5 * (WIDTH - LEFT - RIGHT);
    let y = |percent: f64| ground - percent / top_percent * (ground - TOP);
    let step = tick_step(top_percent, 5.0);
    let mut tick = 0.0;
    while tick <= top_percent {
        let decimals = usize::from(step < 1.0);
        let _ = writeln!(
            svg,
            "<path class=\"grid\" d=\"M{LEFT} {0:.1}H{1}\"/><text x=\"{2}\" y=\"{3:.1}\" text-anchor=\"end\">{4}</text>",
            y(tick),
            WIDTH - RIGHT,
            LEFT - 6.0,
            y(tick) + 4.0,
            fixed(tick, decimals)
        );
        tick += step;
    }
    let step = tick_step(2.0 * limit_mm, 8.0);
    let decimals = usize::from(step < 1.0);
    let mut tick = -(limit_mm / step).floor() * step;
    while tick <= limit_mm * 1.000_001 {
        let class = if tick.abs() < step * 0.5 { "zero" } else { "grid" };
        let _ = writeln!(
            svg,
            "<path class=\"{class}\" d=\"M{0:.1} {TOP}V{ground}\"/><text x=\"{0:.1}\" y=\"{1}\" text-anchor=\"middle\">{2}</text>",
            x(tick),
            ground + 15.0,
            fixed(tick, decimals)
        );
        tick += step;
    }
    let _ = writeln!(
        svg,
        "<text class=\"axis\" x=\"{}\" y=\"{}\" text-anchor=\"middle\">difference along the normal, mm</text>",
        0.5 * (LEFT + WIDTH - RIGHT),
        HEIGHT - 6.0
    );
    let _ = writeln!(
        svg,
        "<text class=\"axis\" transform=\"translate(12 {}) rotate(-90)\" text-anchor=\"middle\">share of ties, %</text>",
        0.5 * (TOP + ground)
    );
}

/// Two values on a line about zero: before as a ring, after as a dot.
pub(crate) fn dumbbell(before: f64, after: f64, limit: f64) -> String {
    if !(before.is_finite() && after.is_finite() && limit > 0.0) {
        return String::new();
    }
    let x = |value: f64| 45.0 + (value / limit).clamp(-1.0, 1.0) * 40.0;
    format!(
        "<svg class=\"dumbbell\" viewBox=\"0 0 90 14\" aria-hidden=\"true\"><path class=\"zero\" d=\"M45 0V14\"/><path class=\"link\" d=\"M{0:.1} 7H{1:.1}\"/><circle class=\"before\" cx=\"{0:.1}\" cy=\"7\" r=\"3.5\"/><circle class=\"after\" cx=\"{1:.1}\" cy=\"7\" r=\"3.5\"/></svg>",
        x(before),
        x(after)
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shares_add_up_to_one_with_what_is_beyond() {
        let (bins, beyond) = shares(&[-0.02, 0.0, 0.001, 0.009_9, 0.5, f64::NAN], 0.01);
        assert!((beyond - 0.4).abs() < 1e-12);
        assert!((bins.iter().sum::<f64>() + beyond - 1.0).abs() < 1e-12);
        assert!((bins[BINS / 2] - 0.2).abs() < 1e-12 && (bins[BINS - 1] - 0.2).abs() < 1e-12);
    }

    #[test]
    fn nothing_to_show_is_no_chart() {
        let series = Series { name: "used", class: "after", values_m: &[f64::NAN], filled: true };
        assert!(histogram("ties", 0.01, &[series]).is_empty());
        assert!(dumbbell(f64::NAN, 0.0, 1.0).is_empty());
    }

    #[test]
    fn a_chart_names_its_series_and_what_lies_beyond() {
        let values = [0.001, -0.002, 0.5, 0.0];
        let series = Series { name: "used <1>", class: "after", values_m: &values, filled: true };
        let svg = histogram("ties", 0.01, &[series]);
        assert!(svg.contains("used &lt;1&gt;, 25.0 % beyond the chart") && !svg.contains("NaN"));
    }
}
