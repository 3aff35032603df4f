//! Rasters as `GeoTIFF`: one band of 32-bit floats, deflated, placed by cell size and corner, with its reference system.

use std::io::Cursor;

use tiff::TiffResult;
use tiff::encoder::compression::DeflateLevel;
use tiff::encoder::{Compression, TiffEncoder, colortype::Gray32Float};
use tiff::tags::Tag;

use super::grid::Raster;

/// `GeoTIFF` 1.1, keys of the directory: model type, raster type, projected system.
const GT_MODEL_TYPE: u16 = 1024;
const GT_RASTER_TYPE: u16 = 1025;
const PROJECTED_CRS: u16 = 3072;
const MODEL_PROJECTED: u16 = 1;
const PIXEL_IS_AREA: u16 = 1;

/// The raster as the bytes of a `GeoTIFF`; cells without a value are NaN, which the file declares as its nodata value.
///
/// # Errors
/// When the encoder refuses, as for an empty raster.
pub fn encode(raster: &Raster, epsg: Option<u32>) -> TiffResult<Vec<u8>> {
    let grid = &raster.grid;
    let mut bytes = Cursor::new(Vec::new());
    let mut encoder = TiffEncoder::new(&mut bytes)?.with_compression(Compression::Deflate(DeflateLevel::Balanced));
    let mut image = encoder.new_image::<Gray32Float>(grid.columns, grid.rows)?;
    let directory = image.encoder();
    directory.write_tag(Tag::ModelPixelScaleTag, &[grid.cell_m, grid.cell_m, 0.0][..])?;
    directory.write_tag(Tag::ModelTiepointTag, &[0.0, 0.0, 0.0, grid.west_m, grid.north_m, 0.0][..])?;
    directory.write_tag(Tag::GeoKeyDirectoryTag, &keys(epsg)[..])?;
    directory.write_tag(Tag::GdalNodata, "nan")?;
    image.write_data(&raster.values)?;
    Ok(bytes.into_inner())
}

/// The key directory: version, revision, number of keys, then four numbers a key.
fn keys(epsg: Option<u32>) -> Vec<u16> {
    let mut keys = vec![[GT_MODEL_TYPE, 0, 1, MODEL_PROJECTED], [GT_RASTER_TYPE, 0, 1, PIXEL_IS_AREA]];
    if let Some(code) = epsg.and_then(|code| u16::try_from(code).ok()) {
        keys.push([PROJECTED_CRS, 0, 1, code]);
    }
    #[allow(clippy::cast_possible_truncation)] // two or three
    let mut directory = vec![1, 1, 1, keys.len() as u16];
    directory.extend(keys.into_iter().flatten());
    directory
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::report::grid::Grid;
    use tiff::decoder::{Decoder, DecodingResult};

    #[test]
    fn a_written_raster_reads_back_with_its_place_and_reference_system() {
        let grid = Grid { west_m: 465_000.0, north_m: 5_247_000.0, cell_m: 2.5, columns: 3, rows: 2 };
        let raster = Raster { grid, values: vec![0.01, f32::NAN, -0.02, 0.0, 0.5, f32::NAN] };
        let bytes = encode(&raster, Some(25_832)).expect("encoded");
        let mut decoder = Decoder::new(Cursor::new(bytes)).expect("a TIFF");
        assert_eq!(decoder.dimensions().expect("dimensions"), (3, 2));
        assert_eq!(decoder.get_tag_f64_vec(Tag::ModelPixelScaleTag).expect("scale"), [2.5, 2.5, 0.0]);
        assert_eq!(decoder.get_tag_f64_vec(Tag::ModelTiepointTag).expect("corner")[3..5], [465_000.0, 5_247_000.0]);
        let keys = decoder.get_tag_u16_vec(Tag::GeoKeyDirectoryTag).expect("keys");
        assert_eq!(keys[12..], [3072, 0, 1, 25_832]);
        let DecodingResult::F32(values) = decoder.read_image().expect("values") else { panic!("floats") };
        assert!(values[1].is_nan() && (values[4] - 0.5).abs() < 1e-9);
    }

    #[test]
    fn an_unknown_reference_system_is_left_out() {
        assert_eq!(keys(None).len(), 12);
        assert_eq!(keys(Some(1_000_000)).len(), 12);
    }
}
