//! Maps of the ties with legend, scale bar and the coordinates of the corners.

use std::fmt::Write as _;

use crate::report::colour::{HELD_OUT, OUTLIER, USED, css, diverging_css};
use crate::report::data::TiePoint;
use crate::report::html::{data_uri, escape, section};
use crate::report::maps::{Picture, Pictures};
use crate::report::number::{fixed, length, mm, tick_step};

const LEAD: &str = "North is up. Heights are compared on surfaces less than 60° steep: a cell shows the median height difference \
of its ties, second strip minus first of each pair, so that neighbouring cells of different pairs may differ in sign. Streaks \
along a strip point at drifts, one colour over a whole overlap at a constant error, one colour in a few cells at change or \
vegetation. The same maps lie in the folder rasters, georeferenced.";

/// The section; nothing without a picture.
pub(crate) fn html(pictures: &Pictures, points: &[TiePoint]) -> String {
    let mut body = String::new();
    if let Some(picture) = &pictures.ties {
        body += &map("Ties by class", picture, &classes(points));
    }
    let values = [
        ("Height differences before", &pictures.dz_before),
        ("Height differences after, same colours", &pictures.dz_after),
        ("Height differences after, finer colours", &pictures.dz_after_fine),
    ];
    for (caption, picture) in values {
        if let Some(picture) = picture {
            body += &map(caption, picture, &scale(picture.limit_m.unwrap_or(0.0)));
        }
    }
    if body.is_empty() {
        body
    } else {
        section("maps", "Maps", LEAD, &format!("<div class=\"figures\">\n{body}</div>\n"))
    }
}

fn map(caption: &str, picture: &Picture, legend: &str) -> String {
    let grid = &picture.grid;
    let [width_m, height_m] = grid.size_m();
    let bar_m = tick_step(width_m, 4.0);
    let bar = if bar_m >= 1000.0 { format!("{} km", fixed(bar_m / 1000.0, 0)) } else { format!("{bar_m} m") };
    let class = if picture.limit_m.is_some() { "map cells" } else { "map" };
    let cell = if picture.limit_m.is_some() { format!(", cells of {} m", grid.cell_m) } else { String::new() };
    let mut out = format!("<figure><figcaption>{}</figcaption>\n", escape(caption));
    let _ = writeln!(
        out,
        "<div class=\"frame\" style=\"max-width:{:.1}vh\"><img class=\"{class}\" width=\"{}\" height=\"{}\" alt=\"Map: {}\" src=\"{}\">",
        (75.0 * width_m / height_m).max(20.0),
        grid.columns,
        grid.rows,
        escape(caption),
        data_uri("image/png", &picture.png)
    );
    let _ = write!(
        out,
        "<div class=\"scalebar\" style=\"width:{:.2}%\">{bar}</div></div>\n{legend}",
        100.0 * bar_m / width_m
    );
    let _ = writeln!(
        out,
        "<p class=\"note\">East {} to {} m, north {} to {} m{cell}</p></figure>",
        fixed(grid.west_m, 0),
        fixed(grid.west_m + width_m, 0),
        fixed(grid.north_m - height_m, 0),
        fixed(grid.north_m, 0)
    );
    out
}

/// Classes of ties with their numbers.
fn classes(points: &[TiePoint]) -> String {
    let number = |class: fn(&TiePoint) -> bool| points.iter().filter(|p| class(p)).count();
    let rows = [
        ("used", USED, number(|p| !p.held_out && !p.outlier)),
        ("held out", HELD_OUT, number(|p| p.held_out && !p.outlier)),
        ("outlier", OUTLIER, number(|p| p.outlier)),
    ];
    let mut out = String::from("<ul class=\"legend\">\n");
    for (name, colour, n) in rows {
        let _ =
            writeln!(out, "<li><i class=\"dot\" style=\"background:{}\"></i>{name} ({})</li>", css(colour), length(n));
    }
    out.push_str("</ul>\n");
    out
}

/// The colour scale from minus to plus its limit.
fn scale(limit_m: f64) -> String {
    format!(
        "<div class=\"scale\"><i style=\"background:{}\"></i><p><span>−{1} mm</span><span>0</span><span>+{1} mm</span></p></div>\n",
        diverging_css(),
        mm(limit_m)
    )
}
