//! The strips: delivered points, and beside them the true ones in the same order.

use std::path::Path;

use nalgebra::{Matrix3, Vector3};
use rayon::prelude::*;
use tieline_filter::TimeEncoding;
use tieline_filter::time::{ADJUSTED_OFFSET_S, SECONDS_PER_WEEK};
use tieline_io::crs::Crs;
use tieline_io::las::{Columns, LasWriter, LasWriterOptions};

use super::super::survey::DriveSurvey;
use super::truth::RangeHistogram;
use crate::error::SimulateError;
use crate::output::StripReport;
use crate::survey::Echo;

/// Blocks that are simulated together: bounds the memory.
const BATCH: usize = 32;
/// Step of the differences that the projection about a place is made of \[m\].
const STEP_M: f64 = 60.0;

/// Writes all strips.
pub(super) fn write(
    survey: &DriveSurvey,
    out: &Path,
    histogram: &mut RangeHistogram,
    progress: &mut dyn FnMut(u64, u64),
) -> Result<Vec<StripReport>, SimulateError> {
    let projection = Projection::new(survey)?;
    let blocks_of_all: usize = (0..survey.laps_s().len()).map(|lap| survey.blocks(lap)).sum();
    let (mut done, total) = (0, survey.pulses());
    let mut strips = Vec::new();
    for (lap, &span_s) in survey.laps_s().iter().enumerate() {
        let name = format!("pass{}.laz", lap + 1);
        let number = u16::try_from(lap + 1).unwrap_or(u16::MAX);
        let path = out.join("strips").join(&name);
        let mut writer = LasWriter::create(&path, projection.options(survey, number))?;
        let mut true_writer = match survey.scenario().output.true_points {
            true => {
                let path = out.join("truth").join("strips").join(&name);
                Some(LasWriter::create(&path, projection.options(survey, number))?)
            }
            false => None,
        };
        let mut points = 0;
        let blocks: Vec<usize> = (0..survey.blocks(lap)).collect();
        for batch in blocks.chunks(BATCH) {
            let columns: Vec<Result<Block, SimulateError>> =
                batch.par_iter().map(|&block| columns(survey, lap, block, &projection, number)).collect();
            for block in columns {
                let block = block?;
                points += block.delivered.len() as u64;
                histogram.add(&block.ranges_m);
                writer.write(&block.delivered)?;
                if let (Some(writer), Some(truth)) = (&mut true_writer, &block.truth) {
                    writer.write(truth)?;
                }
            }
            done += batch.len();
            progress(total * done as u64 / blocks_of_all.max(1) as u64, total);
        }
        writer.finish()?;
        if let Some(writer) = true_writer {
            writer.finish()?;
        }
        strips.push(StripReport { path, points, span_s });
    }
    Ok(strips)
}

/// Points of a block.
struct Block {
    delivered: Columns,
    truth: Option<Columns>,
    ranges_m: Vec<(u8, f64)>,
}

fn columns(
    survey: &DriveSurvey,
    lap: usize,
    block: usize,
    projection: &Projection,
    number: u16,
) -> Result<Block, SimulateError> {
    let echoes = survey.block(lap, block);
    let about = projection.about(&survey.place_of_block(lap, block))?;
    let scale_m = survey.scenario().output.scale_m;
    let with_points = |point_of: fn(&Echo) -> &Vector3<f64>| {
        let mut columns = Columns::default();
        for echo in &echoes {
            let map_m = about.map_m(point_of(echo));
            let stored = |axis: usize| step((map_m[axis] - projection.offset_m[axis]) / scale_m);
            columns.x.push(stored(0));
            columns.y.push(stored(1));
            columns.z.push(stored(2));
            columns.gps_time.push(echo.time_s + projection.shift_s);
            columns.return_number.push(echo.return_number);
            columns.number_of_returns.push(echo.number_of_returns);
            columns.scanner_channel.push(echo.scanner);
            columns.user_data.push(echo.scanner);
            columns.scan_angle_deg.push(degrees(echo.scan_angle_rad));
            columns.point_source_id.push(number);
        }
        columns
    };
    let mut delivered = with_points(|echo| &echo.delivered_m);
    delivered.intensity = echoes.iter().map(|e| e.intensity).collect();
    let truth = survey.scenario().output.true_points.then(|| {
        let mut truth = with_points(|echo| &echo.true_m);
        truth.classification = echoes.iter().map(|e| e.class).collect();
        truth
    });
    Ok(Block { delivered, truth, ranges_m: echoes.iter().map(|e| (e.scanner, e.range_m)).collect() })
}

#[allow(clippy::cast_possible_truncation)] // saturates far outside of any street
fn step(steps: f64) -> i32 {
    steps.round() as i32
}

#[allow(clippy::cast_possible_truncation)] // a scan angle needs no more
fn degrees(radians: f64) -> f32 {
    radians.to_degrees() as f32
}

/// From the axes at the origin to the strips' system.
pub(super) struct Projection {
    local: Crs,
    map: Crs,
    offset_m: [f64; 3],
    /// Adjusted standard time minus seconds of week \[s\].
    shift_s: f64,
}

impl Projection {
    pub(super) fn new(survey: &DriveSurvey) -> Result<Self, SimulateError> {
        let scenario = survey.scenario();
        let shift_s = f64::from(scenario.week) * SECONDS_PER_WEEK - ADJUSTED_OFFSET_S;
        let mut projection =
            Self { local: scenario.local_crs()?, map: scenario.strip_crs()?, offset_m: [0.0; 3], shift_s };
        let middle = projection.map_m(&Vector3::zeros())?;
        let round = |v: f64| (v / 1000.0).round() * 1000.0;
        projection.offset_m = [round(middle.x), round(middle.y), 0.0];
        Ok(projection)
    }

    /// A point in the strips' system, exactly \[m\].
    pub(super) fn map_m(&self, local_m: &Vector3<f64>) -> Result<Vector3<f64>, SimulateError> {
        Ok(self.map.map_from_geodetic(&self.local.geodetic_from_map(local_m)?)?)
    }

    /// The projection about a place, as a polynomial of the second degree: within 200 m good to a micrometre.
    fn about(&self, place_m: &Vector3<f64>) -> Result<Polynomial, SimulateError> {
        let at = |offset: Vector3<f64>| self.map_m(&(place_m + offset));
        let value = at(Vector3::zeros())?;
        let unit = |axis: usize| Vector3::ith(axis, STEP_M);
        let mut first = Matrix3::zeros();
        let mut second = [[Vector3::zeros(); 3]; 3];
        let mut ahead = [Vector3::zeros(); 3];
        for i in 0..3 {
            let back = at(-unit(i))?;
            ahead[i] = at(unit(i))?;
            first.set_column(i, &((ahead[i] - back) / (2.0 * STEP_M)));
            second[i][i] = (ahead[i] + back - value * 2.0) / (2.0 * STEP_M * STEP_M);
        }
        for (i, j) in [(0, 1), (0, 2), (1, 2)] {
            // what is left over at the corner when both squares and slopes are taken off
            let corner = at(unit(i) + unit(j))?;
            second[i][j] = (corner - ahead[i] - ahead[j] + value) / (STEP_M * STEP_M);
        }
        Ok(Polynomial { place_m: *place_m, value, first, second })
    }

    fn options(&self, survey: &DriveSurvey, number: u16) -> LasWriterOptions {
        LasWriterOptions {
            scale: [survey.scenario().output.scale_m; 3],
            offset: self.offset_m,
            time: TimeEncoding::AdjustedStandard,
            wkt: self.map.epsg().and_then(utm_wkt),
            system_identifier: "simulated".into(),
            file_source_id: number,
            ..LasWriterOptions::default()
        }
    }
}

/// Value, slopes and curvatures at a place.
struct Polynomial {
    place_m: Vector3<f64>,
    value: Vector3<f64>,
    first: Matrix3<f64>,
    second: [[Vector3<f64>; 3]; 3],
}

impl Polynomial {
    fn map_m(&self, local_m: &Vector3<f64>) -> Vector3<f64> {
        let d = local_m - self.place_m;
        let s = &self.second;
        self.value
            + self.first * d
            + s[0][0] * (d.x * d.x)
            + s[1][1] * (d.y * d.y)
            + s[2][2] * (d.z * d.z)
            + s[0][1] * (d.x * d.y)
            + s[0][2] * (d.x * d.z)
            + s[1][2] * (d.y * d.z)
    }
}

/// WGS 84 / UTM as the header of a strip names it.
fn utm_wkt(epsg: u32) -> Option<String> {
    let (zone, letter, false_northing) = match epsg {
        32601..=32660 => (epsg - 32600, 'N', 0),
        32701..=32760 => (epsg - 32700, 'S', 10_000_000),
        _ => return None,
    };
    let meridian = i64::from(zone) * 6 - 183;
    Some(format!(
        "PROJCS[\"WGS 84 / UTM zone {zone}{letter}\",GEOGCS[\"WGS 84\",DATUM[\"WGS_1984\",\
         SPHEROID[\"WGS 84\",6378137,298.257223563,AUTHORITY[\"EPSG\",\"7030\"]],AUTHORITY[\"EPSG\",\"6326\"]],\
         PRIMEM[\"Greenwich\",0,AUTHORITY[\"EPSG\",\"8901\"]],\
         UNIT[\"degree\",0.0174532925199433,AUTHORITY[\"EPSG\",\"9122\"]],AUTHORITY[\"EPSG\",\"4326\"]],\
         PROJECTION[\"Transverse_Mercator\"],PARAMETER[\"latitude_of_origin\",0],\
         PARAMETER[\"central_meridian\",{meridian}],PARAMETER[\"scale_factor\",0.9996],\
         PARAMETER[\"false_easting\",500000],PARAMETER[\"false_northing\",{false_northing}],\
         UNIT[\"metre\",1,AUTHORITY[\"EPSG\",\"9001\"]],AXIS[\"Easting\",EAST],AXIS[\"Northing\",NORTH],\
         AUTHORITY[\"EPSG\",\"{epsg}\"]]"
    ))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_polynomial_is_the_projection_to_a_micrometre() {
        let origin = Vector3::new(59.34_f64.to_radians(), 17.94_f64.to_radians(), 45.0);
        let projection = Projection {
            local: Crs::local(origin).expect("a place"),
            map: Crs::parse("EPSG:32633").expect("a code"),
            offset_m: [0.0; 3],
            shift_s: 0.0,
        };
        let place = Vector3::new(700.0, -400.0, 12.0);
        let about = projection.about(&place).expect("near");
        for offset in [[90.0, 40.0, 10.0], [-60.0, 80.0, -3.0], [120.0, -120.0, 60.0]] {
            let point = place + Vector3::from(offset);
            let exact = projection.map_m(&point).expect("near");
            assert!((about.map_m(&point) - exact).norm() < 1e-6, "{}", (about.map_m(&point) - exact).norm());
        }
    }
}
