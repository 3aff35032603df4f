//! Writes the report's files, each whole or not at all.

use std::fs;
use std::io;
use std::path::{Path, PathBuf};

use tieline_io::output::write_whole;

use super::data::{Summary, TiePoint};
use super::maps::Picture;
use super::{geotiff, maps, page};

/// What can go wrong while a report is written.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ReportError {
    /// A file or folder cannot be written.
    #[error("cannot write {}: {source}; is there room, and may this folder be written to?", path.display())]
    Write {
        /// The file or folder.
        path: PathBuf,
        /// Cause.
        source: io::Error,
    },
    /// The summary cannot be written as JSON.
    #[error("cannot write the summary as JSON: {0}")]
    Json(#[from] serde_json::Error),
    /// A map cannot be encoded as PNG.
    #[error("cannot draw a map: {0}")]
    Picture(#[from] image::ImageError),
    /// A map cannot be encoded as `GeoTIFF`.
    #[error("cannot write a raster: {0}")]
    Raster(#[from] tiff::TiffError),
}

/// Writes `report.html`, `summary.json` and `rasters/` into a folder, which is created.
///
/// Rasters of an earlier report are replaced, or removed where there is nothing to show any more; other files stay.
///
/// # Errors
/// When a file cannot be written; what had been there under its name is then still there.
pub fn write_all(folder: &Path, summary: &Summary, points: &[TiePoint], epsg: Option<u32>) -> Result<(), ReportError> {
    let maps = maps::draw(points)?;
    let rasters = folder.join("rasters");
    fs::create_dir_all(&rasters).map_err(|source| ReportError::Write { path: rasters.clone(), source })?;
    let pictures = &maps.pictures;
    for (name, picture) in [
        ("ties", &pictures.ties),
        ("dz_before", &pictures.dz_before),
        ("dz_after", &pictures.dz_after),
        ("dz_after_fine", &pictures.dz_after_fine),
    ] {
        replace(&rasters.join(format!("{name}.png")), picture.as_ref().map(|p| p.png.clone()))?;
        replace(&rasters.join(format!("{name}.pgw")), picture.as_ref().map(world_file))?;
    }
    for (name, raster) in [("dz_before", &maps.dz_before), ("dz_after", &maps.dz_after)] {
        let bytes = raster.as_ref().map(|raster| geotiff::encode(raster, epsg)).transpose()?;
        replace(&rasters.join(format!("{name}.tif")), bytes)?;
    }
    replace(&folder.join("summary.json"), Some(json(summary)?))?;
    replace(&folder.join("report.html"), Some(page::render(summary, points, pictures).into_bytes()))
}

/// The summary as JSON, for people too.
fn json(summary: &Summary) -> Result<Vec<u8>, serde_json::Error> {
    let mut bytes = serde_json::to_vec_pretty(summary)?;
    bytes.push(b'\n');
    Ok(bytes)
}

fn world_file(picture: &Picture) -> Vec<u8> {
    picture.grid.world_file().into_bytes()
}

/// Writes the file, or removes the one of an earlier report when there is nothing to write.
fn replace(path: &Path, bytes: Option<Vec<u8>>) -> Result<(), ReportError> {
    let result = match bytes {
        Some(bytes) => write_whole(path, &bytes),
        None => match fs::remove_file(path) {
            Err(error) if error.kind() != io::ErrorKind::NotFound => Err(error),
            _ => Ok(()),
        },
    };
    result.map_err(|source| ReportError::Write { path: path.to_path_buf(), source })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::report::example;

    fn names(folder: &Path) -> Vec<String> {
        let mut names: Vec<String> = fs::read_dir(folder)
            .expect("listed")
            .map(|entry| entry.expect("an entry").file_name().to_string_lossy().into_owned())
            .collect();
        names.sort();
        names
    }

    #[test]
    fn a_report_is_a_page_a_summary_and_maps() {
        let folder = tempfile::tempdir().expect("a folder");
        let (summary, points) = example::survey(10, 20_000);
        write_all(folder.path(), &summary, &points, Some(25_832)).expect("written");
        assert_eq!(names(folder.path()), ["rasters", "report.html", "summary.json"]);
        let rasters = folder.path().join("rasters");
        let expected =
            ["dz_after.pgw", "dz_after.png", "dz_after.tif", "dz_before.pgw", "dz_before.png", "dz_before.tif"];
        let found = names(&rasters);
        assert!(expected.iter().all(|name| found.iter().any(|f| f == name)), "{found:?}");
        assert!(found.iter().any(|f| f == "ties.png"));
        if let Ok(copy) = std::env::var("TIELINE_EXAMPLE_REPORT") {
            write_all(Path::new(&copy), &summary, &points, Some(25_832)).expect("written");
        }
    }

    #[test]
    fn a_summary_reads_back_with_what_was_not_determined() {
        let folder = tempfile::tempdir().expect("a folder");
        let (mut summary, points) = example::survey(4, 100);
        summary.strips[0].course_deg = f64::NAN;
        summary.calibration.parameters[0].prior_sigma = f64::INFINITY;
        write_all(folder.path(), &summary, &points, None).expect("written");
        let text = fs::read_to_string(folder.path().join("summary.json")).expect("read");
        let back: Summary = serde_json::from_str(&text).expect("a summary");
        assert_eq!(back.strips.len(), 4);
        assert!(back.strips[0].course_deg.is_nan() && back.pairs[1].shift_before_m[1].is_nan());
        let (found, expected) = (back.discrepancy.held_out_after, summary.discrepancy.held_out_after);
        assert!(found.n == expected.n && (found.rms_m - expected.rms_m).abs() < 1e-15);
    }

    #[test]
    fn maps_of_an_earlier_report_do_not_stay_beside_a_new_one() {
        let folder = tempfile::tempdir().expect("a folder");
        let (summary, points) = example::survey(4, 200);
        write_all(folder.path(), &summary, &points, None).expect("written");
        write_all(folder.path(), &summary, &[], None).expect("written");
        assert!(names(&folder.path().join("rasters")).is_empty());
    }

    #[test]
    fn a_folder_that_cannot_be_made_is_named() {
        let folder = tempfile::tempdir().expect("a folder");
        let file = folder.path().join("taken");
        fs::write(&file, b"a file").expect("written");
        let error = write_all(&file, &Summary::default(), &[], None).expect_err("no folder");
        assert!(error.to_string().contains("taken"), "{error}");
    }
}
