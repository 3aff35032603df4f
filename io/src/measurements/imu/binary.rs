//! Binary inertial measurements: seven little-endian f64 a record.

use std::io::{BufRead, Read};
use std::path::Path;

use nalgebra::Vector3;

use super::{ImuFile, ImuFormat, ImuKind, ImuReadOptions, Samples};
use crate::measurements::MeasurementFileError;
use crate::trajectory::Place;

/// Bytes of a record: time \[s\], then three increments of angle \[rad\] and three of velocity \[m/s\], or their rates.
pub const RECORD_BYTES: usize = 7 * 8;

pub(super) fn read(
    mut source: Box<dyn BufRead + '_>,
    path: &Path,
    options: &ImuReadOptions,
) -> Result<ImuFile, MeasurementFileError> {
    let kind = options.kind.unwrap_or(ImuKind::Increments);
    let mut samples = Samples::new(path, kind, &options.axes, false);
    let mut record = 0;
    while let Some(values) = next_record(&mut source, path, record)? {
        if record == 0 && !good(&values) && good(&values.map(|v| f64::from_bits(v.to_bits().swap_bytes()))) {
            return Err(MeasurementFileError::ByteOrder { path: path.to_path_buf() });
        }
        let vector = |at: usize| Vector3::new(values[at], values[at + 1], values[at + 2]);
        samples.push(Place::Record(record), [values[0], f64::NAN], &vector(1), &vector(4))?;
        record += 1;
    }
    let notes = match options.columns {
        Some(_) => vec![format!("{}: a binary file has no columns; their names are not used", path.display())],
        None => Vec::new(),
    };
    samples.finish(ImuFormat::Binary, notes)
}

/// Whether a record looks like a measurement: tells swapped bytes from good ones.
fn good(values: &[f64; 7]) -> bool {
    let number = |v: &f64| v.is_finite() && (*v == 0.0 || v.abs() > 1e-30) && v.abs() < 1e10;
    values.iter().all(number) && (values[0] == 0.0 || values[0].abs() > 1e-6)
}

fn next_record(source: &mut impl Read, path: &Path, record: u64) -> Result<Option<[f64; 7]>, MeasurementFileError> {
    let mut bytes = [0_u8; RECORD_BYTES];
    let mut found = 0;
    while found < bytes.len() {
        match source.read(&mut bytes[found..]) {
            Ok(0) => break,
            Ok(more) => found += more,
            Err(error) if error.kind() == std::io::ErrorKind::Interrupted => {}
            Err(error) => return Err(MeasurementFileError::io_at(path, Place::Record(record))(error)),
        }
    }
    match found {
        0 => Ok(None),
        RECORD_BYTES => {
            let mut values = [0.0; 7];
            for (value, bytes) in values.iter_mut().zip(bytes.chunks_exact(8)) {
                let mut eight = [0; 8];
                eight.copy_from_slice(bytes);
                *value = f64::from_le_bytes(eight);
            }
            Ok(Some(values))
        }
        _ => {
            let (path, expected) = (path.to_path_buf(), RECORD_BYTES);
            Err(MeasurementFileError::TruncatedRecord { path, record, found, expected })
        }
    }
}
