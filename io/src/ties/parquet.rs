//! `ties.parquet`: snappy, row groups of bounded size, the same bytes for the same table.

use std::fs::File;
use std::path::Path;
use std::sync::Arc;

use parquet::basic::{Compression, Type as PhysicalType};
use parquet::column::reader::ColumnReader;
use parquet::data_type::{BoolType, ByteArray, ByteArrayType, DataType, DoubleType, Int32Type, Int64Type};
use parquet::errors::ParquetError;
use parquet::file::properties::WriterProperties;
use parquet::file::reader::{FileReader, RowGroupReader, SerializedFileReader};
use parquet::file::writer::{SerializedColumnWriter, SerializedFileWriter};
use parquet::schema::parser::parse_message_type;

use super::columns::{Column, ColumnMut};
use super::error::TieFileError;
use super::table::TieTable;
use crate::output::WholeFile;

/// Rows of a row group.
const GROUP_ROWS: usize = 1 << 16;

/// Writes `ties.parquet`, whole or not at all.
///
/// # Errors
/// [`TieFileError`] when the disk refuses.
pub fn write_parquet(path: &Path, table: &TieTable) -> Result<(), TieFileError> {
    let io = |source| TieFileError::Io { path: path.to_path_buf(), source };
    let mut file = WholeFile::create(path).map_err(io)?;
    write_groups(&mut file, table).map_err(|error| match error {
        ParquetError::External(source) => match source.downcast::<std::io::Error>() {
            Ok(source) => TieFileError::Io { path: path.to_path_buf(), source: *source },
            Err(other) => damaged(path, &ParquetError::External(other)),
        },
        other => damaged(path, &other),
    })?;
    file.finish().map_err(io)
}

fn damaged(path: &Path, error: &ParquetError) -> TieFileError {
    TieFileError::Parquet { path: path.to_path_buf(), reason: error.to_string() }
}

fn write_groups(file: &mut WholeFile, table: &TieTable) -> Result<(), ParquetError> {
    let columns = table.columns();
    let fields = columns.iter().map(|(name, column)| {
        let (kind, logical) = column.parquet_type();
        format!("{kind} {name}{logical};")
    });
    let schema = Arc::new(parse_message_type(&format!("message ties {{ {} }}", fields.collect::<String>()))?);
    let properties = WriterProperties::builder()
        .set_compression(Compression::SNAPPY)
        .set_created_by(format!("tieline {}", env!("CARGO_PKG_VERSION")))
        .build();
    let mut writer = SerializedFileWriter::new(file.writer(), schema, Arc::new(properties))?;
    for start in (0..table.len()).step_by(GROUP_ROWS) {
        let rows = start..(start + GROUP_ROWS).min(table.len());
        let mut group = writer.next_row_group()?;
        for (_, column) in &columns {
            if let Some(mut out) = group.next_column()? {
                write_column(&mut out, column, rows.clone())?;
                out.close()?;
            }
        }
        group.close()?;
    }
    writer.close()?;
    Ok(())
}

fn write_column(
    out: &mut SerializedColumnWriter<'_>,
    column: &Column<'_>,
    rows: std::ops::Range<usize>,
) -> Result<(), ParquetError> {
    match column {
        Column::Long(values) => out.typed::<Int64Type>().write_batch(&values[rows], None, None)?,
        Column::Int(values) => out.typed::<Int32Type>().write_batch(&values[rows], None, None)?,
        Column::Flag(values) => out.typed::<BoolType>().write_batch(&values[rows], None, None)?,
        Column::Text(texts) => {
            let values: Vec<ByteArray> = rows.map(|row| ByteArray::from(texts.get(row))).collect();
            out.typed::<ByteArrayType>().write_batch(&values, None, None)?
        }
        Column::Double(values) => {
            let values = &values[rows];
            let known: Vec<f64> = values.iter().copied().filter(|v| !v.is_nan()).collect();
            let levels: Vec<i16> = values.iter().map(|v| i16::from(!v.is_nan())).collect();
            out.typed::<DoubleType>().write_batch(&known, Some(&levels), None)?
        }
    };
    Ok(())
}

/// Reads `ties.parquet`.
///
/// The library asserts on some damaged files where it should refuse them; such a panic is caught and becomes an
/// error like every other.
///
/// # Errors
/// [`TieFileError`] names the file and the column.
pub(super) fn read_parquet(path: &Path) -> Result<TieTable, TieFileError> {
    std::panic::catch_unwind(|| read_groups(path))
        .unwrap_or_else(|_| Err(damaged(path, &ParquetError::General("its parts contradict each other".into()))))
}

fn read_groups(path: &Path) -> Result<TieTable, TieFileError> {
    let io = |source| TieFileError::Io { path: path.to_path_buf(), source };
    let file = File::open(path).map_err(io)?;
    let length_bytes = file.metadata().map_err(io)?.len();
    let reader = SerializedFileReader::new(file).map_err(|error| damaged(path, &error))?;
    check_places(&reader, length_bytes).map_err(|error| damaged(path, &error))?;
    let schema = reader.metadata().file_metadata().schema_descr_ptr();
    let mut table = TieTable::default();
    for group in 0..reader.num_row_groups() {
        let group = reader.get_row_group(group).map_err(|error| damaged(path, &error))?;
        for (name, column) in table.columns_mut() {
            let index = schema.columns().iter().position(|c| c.name() == name);
            let index = index.ok_or(TieFileError::MissingColumn { path: path.to_path_buf(), column: name })?;
            let descriptor = schema.column(index);
            let expected = match column {
                ColumnMut::Long(_) => PhysicalType::INT64,
                ColumnMut::Int(_) => PhysicalType::INT32,
                ColumnMut::Double(_) => PhysicalType::DOUBLE,
                ColumnMut::Flag(_) => PhysicalType::BOOLEAN,
                ColumnMut::Text(_) => PhysicalType::BYTE_ARRAY,
            };
            let found = descriptor.physical_type();
            if found != expected || descriptor.max_rep_level() > 0 || descriptor.max_def_level() > 1 {
                let (path, found) = (path.to_path_buf(), format!("{found}"));
                return Err(TieFileError::ColumnType { path, column: name, found, expected: type_name(expected) });
            }
            read_column(group.as_ref(), index, column).map_err(|error| damaged(path, &error))?;
        }
    }
    let rows = table.len();
    let whole = table.columns().iter().all(|(_, column)| length(column) == rows);
    match whole {
        true => Ok(table),
        false => Err(damaged(path, &ParquetError::General("columns of different length".into()))),
    }
}

/// Every column chunk must lie inside the file: the library takes that for granted.
fn check_places(reader: &SerializedFileReader<File>, length_bytes: u64) -> Result<(), ParquetError> {
    let inside = |start: i64, length: i64| {
        let end = u64::try_from(start).ok().zip(u64::try_from(length).ok()).and_then(|(s, l)| s.checked_add(l));
        end.is_some_and(|end| end <= length_bytes)
    };
    for group in reader.metadata().row_groups() {
        for chunk in group.columns() {
            let start = chunk.dictionary_page_offset().unwrap_or(chunk.data_page_offset());
            if !inside(start, chunk.compressed_size()) || !inside(chunk.data_page_offset(), 0) || chunk.num_values() < 0
            {
                return Err(ParquetError::General("a column lies outside of the file".into()));
            }
        }
    }
    Ok(())
}

fn type_name(physical: PhysicalType) -> &'static str {
    match physical {
        PhysicalType::INT64 => "INT64",
        PhysicalType::INT32 => "INT32",
        PhysicalType::DOUBLE => "DOUBLE",
        PhysicalType::BOOLEAN => "BOOLEAN",
        _ => "BYTE_ARRAY",
    }
}

fn length(column: &Column<'_>) -> usize {
    match column {
        Column::Long(values) => values.len(),
        Column::Int(values) => values.len(),
        Column::Double(values) => values.len(),
        Column::Flag(values) => values.len(),
        Column::Text(values) => values.len(),
    }
}

fn read_column(group: &dyn RowGroupReader, index: usize, column: ColumnMut<'_>) -> Result<(), ParquetError> {
    match (group.get_column_reader(index)?, column) {
        (ColumnReader::Int64ColumnReader(mut reader), ColumnMut::Long(out)) => read_all(&mut reader, |value| {
            out.push(value.copied().unwrap_or_default());
            Ok(())
        }),
        (ColumnReader::Int32ColumnReader(mut reader), ColumnMut::Int(out)) => read_all(&mut reader, |value| {
            out.push(value.copied().unwrap_or_default());
            Ok(())
        }),
        (ColumnReader::DoubleColumnReader(mut reader), ColumnMut::Double(out)) => read_all(&mut reader, |value| {
            out.push(value.copied().unwrap_or(f64::NAN));
            Ok(())
        }),
        (ColumnReader::BoolColumnReader(mut reader), ColumnMut::Flag(out)) => read_all(&mut reader, |value| {
            out.push(value.copied().unwrap_or_default());
            Ok(())
        }),
        (ColumnReader::ByteArrayColumnReader(mut reader), ColumnMut::Text(out)) => read_all(&mut reader, |value| {
            out.push(value.map_or(Ok(""), |text| text.as_utf8())?);
            Ok(())
        }),
        _ => Err(ParquetError::General("the column has changed its type".into())),
    }
}

/// Reads a column batch by batch; `push` is given `None` for a null.
fn read_all<T: DataType>(
    reader: &mut parquet::column::reader::ColumnReaderImpl<T>,
    mut push: impl FnMut(Option<&T::T>) -> Result<(), ParquetError>,
) -> Result<(), ParquetError> {
    let (mut levels, mut values) = (Vec::new(), Vec::new());
    loop {
        levels.clear();
        values.clear();
        let (records, ..) = reader.read_records(GROUP_ROWS, Some(&mut levels), None, &mut values)?;
        if records == 0 {
            return Ok(());
        }
        if levels.is_empty() {
            values.iter().try_for_each(|value| push(Some(value)))?;
            continue;
        }
        let mut known = values.iter();
        for level in &levels {
            push(if *level > 0 { known.next() } else { None })?;
        }
    }
}
