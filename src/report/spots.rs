//! The contact sheet of matched spots: both windows, the correlation over shifts, and how sure the place is.

use std::fmt::Write as _;
use std::path::Path;

use anyhow::{Context, Result};
use tieline_io::output::write_whole;
use tieline_matching::xyz::texture::{Picture, SpotTie};

use super::html::{data_uri, escape, section};

/// Pixels along the edge of a picture on the page.
const SHOWN: usize = 120;
/// An ellipse is drawn so many standard deviations wide, and the surface is cut to so many metres about the peak: it would be a dot else.
const SIGMAS: f64 = 5.0;

const STYLE: &str = "body{font:14px/1.4 system-ui,sans-serif;margin:1.5rem;background:#fff;color:#222}h1{font-size:1.4rem}h2{font-size:1.1rem}\
.lead{color:#555;max-width:60rem}.sheet{display:flex;flex-wrap:wrap;gap:12px}figure{margin:0;padding:6px;border:1px solid #ddd;border-radius:4px;width:384px}\
figure div{display:flex;gap:6px}img,svg{width:120px;height:120px;image-rendering:pixelated;background:#eee}figcaption{font-size:12px;color:#444;margin-top:4px}";

/// Writes `spots.html`; nothing where no spot was looked for.
///
/// # Errors
/// When it cannot be written.
pub(crate) fn write(out: &Path, spots: &[SpotTie]) -> Result<()> {
    if spots.is_empty() {
        return Ok(());
    }
    let path = out.join("spots.html");
    write_whole(&path, page(spots)?.as_bytes()).with_context(|| format!("writing {}", path.display()))
}

fn page(spots: &[SpotTie]) -> Result<String> {
    let mut shown: Vec<&SpotTie> = spots.iter().filter(|s| s.picture.is_some()).collect();
    let size = |s: &SpotTie| s.covariance_m2.fixed_view::<2, 2>(0, 0).trace();
    shown.sort_by(|a, b| size(a).total_cmp(&size(b)).then(a.spot.cmp(&b.spot)));
    let sheet = |of: &dyn Fn(&SpotTie) -> bool| -> Result<String> {
        let mut html = String::from("<div class=\"sheet\">\n");
        for spot in shown.iter().filter(|s| of(s)) {
            html += &figure(spot)?;
        }
        Ok(html + "</div>\n")
    };
    let used = spots.iter().filter(|s| s.rejection.is_none()).count();
    let lead = format!(
        "Of each match: the spot as the first sighting has it, as the second has it (where it was found; gaps are blue), and the correlation over shifts from \
         none (black) to full (white) with the peak and its ellipse, {SIGMAS} standard deviations wide."
    );
    let mut body = section("best", "The best matches", &lead, &sheet(&|s| s.rejection.is_none())?);
    let mut reasons: Vec<_> = spots.iter().filter_map(|s| s.rejection).collect();
    reasons.sort_unstable();
    reasons.dedup();
    for reason in reasons {
        let count = spots.iter().filter(|s| s.rejection == Some(reason)).count();
        let heading = format!("Rejected: {} ({count})", reason.as_str());
        body += &section(reason.as_str(), &heading, "", &sheet(&|s| s.rejection == Some(reason))?);
    }
    let title = format!("Spots of pavement: {used} of {} matches are ties", spots.len());
    Ok(format!(
        "<!doctype html>\n<html lang=\"en\"><head><meta charset=\"utf-8\"><title>{0}</title><style>{STYLE}</style></head>\n<body>\n<h1>{0}</h1>\n{body}</body></html>\n",
        escape(&title)
    ))
}

fn figure(spot: &SpotTie) -> Result<String> {
    let Some(picture) = &spot.picture else { return Ok(String::new()) };
    let mut html = String::from("<figure><div>");
    for window in &picture.windows {
        let _ = write!(html, "<img alt=\"brightness\" src=\"{}\">", image(window, picture.side)?);
    }
    let _ = write!(html, "{}</div>", surface(spot, picture)?);
    let (shift_m, c) = (spot.shift_m(), &spot.covariance_m2);
    let mm = |v: f64| format!("{:.0}", 1e3 * v);
    let moved = if spot.correlation > 0.0 {
        format!(
            "shift {} {} {} mm, sigma {:.1} {:.1} {:.1} mm{}, correlation {:.2}, second {:.2}",
            mm(shift_m.x),
            mm(shift_m.y),
            mm(shift_m.z),
            1e3 * c[(0, 0)].sqrt(),
            1e3 * c[(1, 1)].sqrt(),
            1e3 * c[(2, 2)].sqrt(),
            free(spot),
            spot.correlation,
            spot.second
        )
    } else {
        String::from("no match")
    };
    let who = spot.ends.each_ref().map(|e| format!("scanner {} at {:.2} s", e.source.scanner(), e.time_s));
    let _ = writeln!(html, "<figcaption>{}<br>{moved}</figcaption></figure>", escape(&who.join(" / ")));
    Ok(html)
}

/// Which direction a match does not hold.
fn free(spot: &SpotTie) -> String {
    let of =
        |f: nalgebra::Vector3<f64>| format!(", not held along {:.0}°", f.x.atan2(f.y).to_degrees().rem_euclid(180.0));
    spot.free.map_or_else(String::new, of)
}

/// A square of grey values from the south-west as PNG, north up; zeros are gaps.
fn image(values: &[u8], side: usize) -> Result<String> {
    let side_px = u32::try_from(side).context("a picture's size")?;
    let picture = image::RgbImage::from_fn(side_px, side_px, |x, y| {
        let value = values.get((side - 1 - y as usize) * side + x as usize).copied().unwrap_or(0);
        if value == 0 { image::Rgb([90, 130, 200]) } else { image::Rgb([value; 3]) }
    });
    let mut png = std::io::Cursor::new(Vec::new());
    picture.write_to(&mut png, image::ImageFormat::Png).context("a picture of a spot")?;
    Ok(data_uri("image/png", png.get_ref()))
}

/// The correlation over shifts with its peak and ellipse.
#[allow(clippy::cast_precision_loss)]
fn surface(spot: &SpotTie, picture: &Picture) -> Result<String> {
    let side = picture.surface_side as f64;
    let address = image(&picture.surface, picture.surface_side)?;
    let (x, y) = (picture.peak[0] + 0.5, side - picture.peak[1] - 0.5);
    let plan = spot.covariance_m2.fixed_view::<2, 2>(0, 0).into_owned();
    let axes = plan.symmetric_eigen();
    let radius = |k: usize| SIGMAS * axes.eigenvalues[k].max(0.0).sqrt() / picture.cell_m;
    let angle_deg = -axes.eigenvectors[(1, 0)].atan2(axes.eigenvectors[(0, 0)]).to_degrees();
    Ok(format!(
        "<svg viewBox=\"0 0 {side} {side}\" width=\"{SHOWN}\"><image href=\"{address}\" width=\"{side}\" height=\"{side}\" \
         style=\"image-rendering:pixelated\"/><g transform=\"translate({x:.2} {y:.2}) rotate({angle_deg:.1})\" fill=\"none\" stroke=\"#e02020\" stroke-width=\"{0:.2}\">\
         <ellipse rx=\"{1:.2}\" ry=\"{2:.2}\"/></g></svg>",
        side / 100.0,
        radius(0).max(side / 60.0),
        radius(1).max(side / 60.0)
    ))
}
