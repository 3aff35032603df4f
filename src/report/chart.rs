//! Charts of curves and bands over a common axis, in panels one below the other, as SVG inside the page.

use std::fmt::Write as _;

use super::html::escape;
use super::number::{fixed, tick_step};

const WIDTH: f64 = 460.0;
const LEFT: f64 = 56.0;
const RIGHT: f64 = 10.0;
const TOP: f64 = 8.0;
const BETWEEN: f64 = 12.0;
const BOTTOM: f64 = 40.0;

/// How a curve is drawn.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Mark {
    /// A line.
    Line,
    /// A line with a dot at each value.
    Dots,
    /// Dots that no line joins.
    Scatter,
    /// A filled area down to zero.
    Area,
}

/// A curve; it is broken where a value is not known.
#[derive(Debug, Clone)]
pub(crate) struct Curve {
    /// Class of the style.
    pub(crate) class: &'static str,
    /// How it is drawn.
    pub(crate) mark: Mark,
    /// x and y.
    pub(crate) points: Vec<(f64, f64)>,
}

/// An area between two curves.
#[derive(Debug, Clone)]
pub(crate) struct Band {
    /// Class of the style.
    pub(crate) class: &'static str,
    /// x, low, high.
    pub(crate) points: Vec<(f64, f64, f64)>,
}

/// A panel with a y axis of its own.
#[derive(Debug, Clone, Default)]
pub(crate) struct Panel {
    /// What the y axis shows, with its unit.
    pub(crate) axis: String,
    /// Height \[px\].
    pub(crate) height: f64,
    /// Least and greatest y; found from the values when they are equal.
    pub(crate) limits: (f64, f64),
    /// Bands, behind the curves.
    pub(crate) bands: Vec<Band>,
    /// Curves.
    pub(crate) curves: Vec<Curve>,
}

/// A chart.
#[derive(Debug, Clone, Default)]
pub(crate) struct Chart {
    /// What it is, for those who cannot see it.
    pub(crate) label: String,
    /// What the x axis shows, with its unit.
    pub(crate) axis: String,
    /// Least and greatest x.
    pub(crate) limits: (f64, f64),
    /// Stretches of x that are shaded.
    pub(crate) shaded: Vec<(f64, f64)>,
    /// Panels from the top.
    pub(crate) panels: Vec<Panel>,
    /// Legend: shape (`line`, `fill`, `band`, `shade`, `dot`), class, words.
    pub(crate) legend: Vec<(&'static str, &'static str, String)>,
}

impl Panel {
    /// The limits of the axis, a little beyond the values.
    fn range(&self) -> Option<(f64, f64)> {
        if self.limits.1 > self.limits.0 {
            return Some(self.limits);
        }
        let of_bands = self.bands.iter().flat_map(|b| &b.points).flat_map(|p| [p.1, p.2]);
        let values = self.curves.iter().flat_map(|c| &c.points).map(|p| p.1).chain(of_bands);
        let (low, high) = values
            .filter(|v| v.is_finite())
            .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), v| (low.min(v), high.max(v)));
        if low > high {
            return None;
        }
        let (low, high) = (low.min(0.0), high.max(0.0));
        let spare = 0.06 * (high - low).max(1e-9);
        Some((if low < 0.0 { low - spare } else { 0.0 }, if high > 0.0 { high + spare } else { 0.0 }))
            .filter(|r| r.1 > r.0)
            .or(Some((-1.0, 1.0)))
    }

    fn svg(&self, svg: &mut String, chart: &Chart, (top, last): (f64, bool)) {
        let Some((low, high)) = self.range() else { return };
        let (width, height) = (WIDTH - LEFT - RIGHT, self.height);
        let x = |v: f64| (v - chart.limits.0) / (chart.limits.1 - chart.limits.0) * width;
        let y = |v: f64| height - (v - low) / (high - low) * height;
        for (value, step) in ticks((low, high), (height / 26.0).max(2.0)) {
            let class = if value == 0.0 { "zero" } else { "grid" };
            let at = top + y(value);
            let _ = writeln!(
                svg,
                "<path class=\"{class}\" d=\"M{LEFT} {at:.1}h{width}\"/><text x=\"{}\" y=\"{:.1}\" text-anchor=\"end\">{}</text>",
                LEFT - 6.0,
                at + 4.0,
                fixed(value, decimals(step))
            );
        }
        for (value, step) in ticks(chart.limits, 7.0) {
            let at = LEFT + x(value);
            let class = if value == 0.0 && chart.limits.0 < 0.0 { "zero" } else { "grid" };
            let _ = write!(svg, "<path class=\"{class}\" d=\"M{at:.1} {top:.1}v{height}\"/>");
            if last {
                let _ = write!(
                    svg,
                    "<text x=\"{at:.1}\" y=\"{:.1}\" text-anchor=\"middle\">{}</text>",
                    top + height + 15.0,
                    fixed(value, decimals(step))
                );
            }
            svg.push('\n');
        }
        // an inner picture cuts off what lies beyond the axes
        let _ = writeln!(svg, "<svg x=\"{LEFT}\" y=\"{top:.1}\" width=\"{width}\" height=\"{height}\">");
        for (from, to) in &chart.shaded {
            let (from, to) = (x(*from).clamp(0.0, width), x(*to).clamp(0.0, width));
            if to > from {
                let _ = writeln!(
                    svg,
                    "<rect class=\"shade\" x=\"{from:.1}\" y=\"0\" width=\"{:.1}\" height=\"{height}\"/>",
                    to - from
                );
            }
        }
        for band in &self.bands {
            for piece in band.points.split(|p| !(p.0.is_finite() && p.1.is_finite() && p.2.is_finite())) {
                if piece.len() > 1 {
                    let there: Vec<(f64, f64)> = piece.iter().map(|p| (x(p.0), y(p.2))).collect();
                    let back: Vec<(f64, f64)> = piece.iter().rev().map(|p| (x(p.0), y(p.1))).collect();
                    let path = format!("{}L{}", path(&there), &path(&back)[1..]);
                    let _ = writeln!(svg, "<path class=\"band {}\" d=\"{path}Z\"/>", band.class);
                }
            }
        }
        for curve in &self.curves {
            for piece in curve.points.split(|p| !(p.0.is_finite() && p.1.is_finite())).filter(|p| !p.is_empty()) {
                let points: Vec<(f64, f64)> = piece.iter().map(|p| (x(p.0), y(p.1))).collect();
                let class = curve.class;
                if curve.mark == Mark::Area {
                    let (first, end) = (points[0].0, points[points.len() - 1].0);
                    let _ = writeln!(
                        svg,
                        "<path class=\"fill {class}\" d=\"{}L{end:.1} {1:.1}H{first:.1}Z\"/>",
                        path(&points),
                        y(0.0)
                    );
                    continue;
                }
                if curve.mark != Mark::Scatter {
                    let _ = writeln!(svg, "<path class=\"line {class}\" d=\"{}\"/>", path(&points));
                }
                if matches!(curve.mark, Mark::Dots | Mark::Scatter) {
                    let dots: String = points.iter().map(|p| format!("M{:.1} {:.1}h0", p.0, p.1)).collect();
                    let _ = writeln!(svg, "<path class=\"dots {class}\" d=\"{dots}\"/>");
                }
            }
        }
        let _ = writeln!(
            svg,
            "</svg><text class=\"axis\" transform=\"translate(12 {:.1}) rotate(-90)\" text-anchor=\"middle\">{}</text>",
            top + 0.5 * height,
            escape(&self.axis)
        );
    }
}

impl Chart {
    /// The chart with its legend; nothing when there is nothing to show.
    pub(crate) fn html(&self) -> String {
        let known = self.limits.0.is_finite() && self.limits.1.is_finite() && self.limits.1 > self.limits.0;
        let panels: Vec<&Panel> = self.panels.iter().filter(|p| p.range().is_some()).collect();
        if !known || panels.is_empty() {
            return String::new();
        }
        let inner: f64 = panels.iter().map(|p| p.height + BETWEEN).sum::<f64>() - BETWEEN;
        let height = TOP + inner + BOTTOM;
        let mut svg = format!(
            "<svg class=\"chart\" viewBox=\"0 0 {WIDTH} {height}\" role=\"img\" aria-label=\"{}\">\n",
            escape(&self.label)
        );
        let mut top = TOP;
        for (i, panel) in panels.iter().enumerate() {
            panel.svg(&mut svg, self, (top, i + 1 == panels.len()));
            top += panel.height + BETWEEN;
        }
        let _ = writeln!(
            svg,
            "<text class=\"axis\" x=\"{}\" y=\"{:.1}\" text-anchor=\"middle\">{}</text>\n</svg>",
            0.5 * (LEFT + WIDTH - RIGHT),
            height - 6.0,
            escape(&self.axis)
        );
        svg + &legend(&self.legend)
    }
}

/// A legend: shape, class, words.
pub(crate) fn legend(entries: &[(&'static str, &'static str, String)]) -> String {
    if entries.is_empty() {
        return String::new();
    }
    let items: String = entries
        .iter()
        .map(|(shape, class, words)| format!("<li><i class=\"{shape} {class}\"></i>{}</li>\n", escape(words)))
        .collect();
    format!("<ul class=\"legend\">\n{items}</ul>\n")
}

/// Round values within limits, with the step between them.
fn ticks((low, high): (f64, f64), wanted: f64) -> Vec<(f64, f64)> {
    let step = tick_step(high - low, wanted);
    let first = (low / step - 1e-9).ceil();
    let mut ticks = Vec::new();
    let mut number = first;
    while number * step <= high + 1e-9 * step && ticks.len() < 50 {
        // minus zero is zero
        ticks.push((if number.abs() < 0.5 { 0.0 } else { number * step }, step));
        number += 1.0;
    }
    ticks
}

/// Decimals that tell ticks apart.
#[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // 0 to 6
fn decimals(step: f64) -> usize {
    (-step.log10().floor()).clamp(0.0, 6.0) as usize
}

fn path(points: &[(f64, f64)]) -> String {
    let mut path = String::with_capacity(points.len() * 12);
    for (i, (x, y)) in points.iter().enumerate() {
        // far beyond the axes digits only cost
        let _ = write!(path, "{}{x:.1} {:.1}", if i == 0 { "M" } else { "L" }, y.clamp(-9999.0, 9999.0));
    }
    path
}

#[cfg(test)]
mod tests {
    use super::*;

    fn chart(points: Vec<(f64, f64)>) -> Chart {
        let curve = Curve { class: "after", mark: Mark::Dots, points };
        let panel = Panel { axis: String::from("up, <mm>"), height: 90.0, curves: vec![curve], ..Panel::default() };
        Chart {
            label: String::from("a \"chart\""),
            axis: String::from("time, s"),
            limits: (0.0, 10.0),
            shaded: vec![(2.0, 4.0), (20.0, 30.0)],
            panels: vec![panel],
            legend: vec![("line", "after", String::from("<new>"))],
        }
    }

    #[test]
    fn a_curve_breaks_where_nothing_is_known() {
        let html = chart(vec![(0.0, 1.0), (1.0, 2.0), (2.0, f64::NAN), (3.0, 1.0), (4.0, 1.5)]).html();
        assert_eq!(html.matches("class=\"line after\" d=").count(), 2);
        assert_eq!(html.matches("class=\"shade\"").count(), 1, "what lies beyond is not shaded");
        assert!(!html.contains("NaN") && html.contains("up, &lt;mm&gt;") && html.contains("&lt;new&gt;"));
    }

    #[test]
    fn nothing_known_is_no_chart() {
        assert!(chart(vec![(0.0, f64::NAN)]).html().is_empty());
        assert!(Chart { limits: (f64::NAN, 1.0), ..chart(vec![(0.0, 1.0)]) }.html().is_empty());
    }

    #[test]
    fn zero_everywhere_has_axes() {
        assert!(chart(vec![(0.0, 0.0), (5.0, 0.0)]).html().contains(">0</text>"));
    }

    #[test]
    fn ticks_are_round_and_inside() {
        let values: Vec<f64> = ticks((-3.2, 11.0), 4.0).iter().map(|t| t.0).collect();
        assert_eq!(values, [0.0, 5.0, 10.0]);
        assert_eq!(decimals(0.5), 1);
        assert_eq!(decimals(20.0), 0);
    }
}
