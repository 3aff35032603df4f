//! Differences over time as SVG: positions above, attitudes below.

use anyhow::{Result, anyhow};
use plotters::prelude::*;

use super::diff::{NAMES, Row};

/// Size of the picture \[px\].
const SIZE: (u32, u32) = (960, 720);
/// Columns of pixels that a line has: each shows its least and greatest value.
const COLUMNS: usize = 900;
/// Told apart in print and by colour-blind readers.
const COLOURS: [RGBColor; 3] = [RGBColor(0, 114, 178), RGBColor(213, 94, 0), RGBColor(0, 158, 115)];

/// The picture of `B - A`.
pub(super) fn plot(rows: &[Row]) -> Result<String> {
    let mut svg = String::new();
    {
        let area = SVGBackend::with_string(&mut svg, SIZE).into_drawing_area();
        draw(&area, rows).map_err(|error| anyhow!("drawing the differences: {error}"))?;
    }
    Ok(svg)
}

type Area<'a> = DrawingArea<SVGBackend<'a>, plotters::coord::Shift>;

fn draw(area: &Area<'_>, rows: &[Row]) -> Result<(), Box<dyn std::error::Error>> {
    area.fill(&WHITE)?;
    let (above, below) = area.split_vertically(SIZE.1 / 2);
    panel(&above, rows, 0, "position, B - A [m]")?;
    panel(&below, rows, 3, "attitude, B - A [deg]")?;
    area.present()?;
    Ok(())
}

fn panel(area: &Area<'_>, rows: &[Row], first: usize, caption: &str) -> Result<(), Box<dyn std::error::Error>> {
    let (start_s, end_s) = (rows[0].time_s, rows[rows.len() - 1].time_s.max(rows[0].time_s + 1e-3));
    let room_for_legend_s = 0.18 * (end_s - start_s);
    let values = || rows.iter().flat_map(|r| r.values[first..first + 3].iter().copied());
    let low = values().fold(0.0, f64::min);
    let high = values().fold(0.0, f64::max);
    let margin = (0.05 * (high - low)).max(1e-6);
    let mut chart = ChartBuilder::on(area)
        .margin(12)
        .caption(caption, ("sans-serif", 16))
        .x_label_area_size(34)
        .y_label_area_size(72)
        .build_cartesian_2d(start_s..end_s + room_for_legend_s, (low - margin)..(high + margin))?;
    chart.configure_mesh().x_desc("GPS time [s]").light_line_style(WHITE).draw()?;
    for (k, colour) in COLOURS.iter().enumerate() {
        for (number, piece) in pieces(rows).into_iter().enumerate() {
            let series = chart.draw_series(LineSeries::new(thinned(piece, first + k), colour))?;
            if number == 0 {
                let sample = move |(x, y)| PathElement::new([(x, y), (x + 18, y)], *colour);
                series.label(NAMES[first + k]).legend(sample);
            }
        }
    }
    chart.configure_series_labels().background_style(WHITE.mix(0.8)).border_style(BLACK).draw()?;
    Ok(())
}

/// Rows between gaps: no line is drawn over times that were not compared.
fn pieces(rows: &[Row]) -> Vec<&[Row]> {
    let mut intervals: Vec<f64> = rows.windows(2).map(|r| r[1].time_s - r[0].time_s).collect();
    if intervals.is_empty() {
        return vec![rows];
    }
    let middle = intervals.len() / 2;
    let longest_s = (5.0 * *intervals.select_nth_unstable_by(middle, f64::total_cmp).1).max(0.5);
    rows.chunk_by(|a, b| b.time_s - a.time_s <= longest_s).collect()
}

/// Least and greatest value of each column of pixels: no peak is lost, and the file stays small.
fn thinned(rows: &[Row], component: usize) -> Vec<(f64, f64)> {
    let point = |r: &Row| (r.time_s, r.values[component]);
    let per_column = rows.len().div_ceil(COLUMNS);
    if per_column <= 2 {
        return rows.iter().map(point).collect();
    }
    let mut line = Vec::with_capacity(2 * COLUMNS);
    for column in rows.chunks(per_column) {
        let by_value = |a: &&Row, b: &&Row| a.values[component].total_cmp(&b.values[component]);
        let ends = column.iter().min_by(by_value).zip(column.iter().max_by(by_value));
        if let Some((least, greatest)) = ends {
            let (a, b) = if least.time_s <= greatest.time_s { (least, greatest) } else { (greatest, least) };
            line.extend([point(a), point(b)]);
        }
    }
    line
}
