//! An input file: LAS, LAZ and COPC alike, read chunk by chunk by any number of threads.

use std::cell::RefCell;
use std::ops::Range;
use std::path::Path;

use super::chunks::{self, Chunk, TablePlace};
use super::codec::{LASZIP_RECORD_ID, LASZIP_USER_ID, LazCodec, Wanted};
use super::columns::Columns;
use super::error::LasError;
use super::header::{HEADER_SIZE, LasHeader};
use super::input::Input;
use super::layout::RecordLayout;
use super::vlr::{VlrSummary, read_list};

thread_local! {
    /// Compressed bytes of the chunk that a thread works on.
    static COMPRESSED: RefCell<Vec<u8>> = const { RefCell::new(Vec::new()) };
}

/// An open LAS, LAZ or COPC file whose header, sizes and chunk table have been checked.
///
/// # Examples
/// ```no_run
/// use tieline_io::las::{Columns, LasFile};
///
/// let file = LasFile::open("strip_001.laz".as_ref())?;
/// let (mut records, mut columns) = (Vec::new(), Columns::default());
/// for chunk in 0..file.chunk_count() {
///     file.read_columns(chunk, &mut records, &mut columns)?;
/// }
/// # Ok::<(), tieline_io::las::LasError>(())
/// ```
#[derive(Debug)]
pub struct LasFile {
    input: Input,
    header: LasHeader,
    layout: RecordLayout,
    codec: Option<LazCodec>,
    chunks: Vec<Chunk>,
    table: Option<TablePlace>,
}

impl LasFile {
    /// Opens a file and checks all that can be checked without decoding points.
    ///
    /// # Errors
    /// One variant of [`LasError`] per damage; never panics, never reserves memory by an unchecked number.
    pub fn open(path: &Path) -> Result<Self, LasError> {
        let input = Input::open(path)?;
        let head = input.read_vec(0, input.length().min(u64::from(HEADER_SIZE[4])))?;
        let mut header = LasHeader::parse(path, &head, input.length())?;
        let vlr_end = header.point_data_offset;
        let mut records = read_list(&input, header.vlr_count, u64::from(header.header_size), vlr_end, false)?;
        let laszip = records.iter().position(|(summary, _)| summary.is(LASZIP_USER_ID, LASZIP_RECORD_ID));
        let laszip = laszip.map(|index| records[index].1.clone());
        if header.evlr_count > 0 {
            records.extend(read_list(&input, header.evlr_count, header.evlr_start, input.length(), true)?);
        }
        header.take_records(records);

        let layout = RecordLayout::new(header.point_format, header.record_length)
            .ok_or_else(|| LasError::UnknownPointFormat { path: path.into(), format: header.point_format })?;
        header.extra_bytes_per_point =
            header.record_length - RecordLayout::standard_length(header.point_format).unwrap_or(0);
        if !header.is_compressed {
            let chunks = chunks::of_las(&input, &header, layout)?;
            return Ok(Self { input, header, layout, codec: None, chunks, table: None });
        }
        let unusable = |reason| LasError::LaszipRecord { path: path.into(), reason };
        let laszip = laszip.ok_or_else(|| unusable("the points are compressed, but it is missing".to_owned()))?;
        let codec = LazCodec::from_record(&laszip, layout).map_err(unusable)?;
        let (chunks, table) = chunks::of_laz(&input, &header, &codec)?;
        Ok(Self { input, header, layout, codec: Some(codec), chunks, table })
    }

    /// Path that the file was opened with.
    #[must_use]
    pub fn path(&self) -> &Path {
        self.input.path()
    }

    /// Length of the file \[bytes\].
    #[must_use]
    pub fn file_length(&self) -> u64 {
        self.input.length()
    }

    /// What the file says about itself.
    #[must_use]
    pub fn header(&self) -> &LasHeader {
        &self.header
    }

    /// Where the fields lie in a record.
    #[must_use]
    pub fn layout(&self) -> RecordLayout {
        self.layout
    }

    /// Number of LAZ chunks; of blocks of 50 000 points in an uncompressed file.
    #[must_use]
    pub fn chunk_count(&self) -> usize {
        self.chunks.len()
    }

    /// Indices of the points of a chunk; empty for a chunk that the file does not have.
    #[must_use]
    pub fn chunk_points(&self, chunk: usize) -> Range<u64> {
        self.chunks.get(chunk).map_or(0..0, |chunk| chunk.points.clone())
    }

    /// Reads the raw, uncompressed records of a chunk into `records`, whose memory is reused.
    ///
    /// # Errors
    /// When the chunk is corrupt, the file cannot be read, or there is no such chunk.
    pub fn read_chunk(&self, chunk: usize, records: &mut Vec<u8>) -> Result<(), LasError> {
        self.read(chunk, u64::MAX, Wanted::Everything, records)
    }

    /// Reads the columns of a chunk; `records` is working memory, and its memory and that of the columns is reused.
    ///
    /// The fastest way to columns: compressed colours, waveform references and extra bytes of formats 6 to 10 are not
    /// decoded, so `records` is not to be written out.
    ///
    /// # Errors
    /// As [`LasFile::read_chunk`].
    pub fn read_columns(&self, chunk: usize, records: &mut Vec<u8>, columns: &mut Columns) -> Result<(), LasError> {
        self.read(chunk, u64::MAX, Wanted::Columns, records)?;
        columns.fill(records, self.layout);
        Ok(())
    }

    /// Reads the records of the first `most` points of a chunk: a cheap sample.
    ///
    /// # Errors
    /// As [`LasFile::read_chunk`].
    pub fn read_chunk_start(&self, chunk: usize, most: u64, records: &mut Vec<u8>) -> Result<(), LasError> {
        self.read(chunk, most, Wanted::Everything, records)
    }

    #[allow(clippy::cast_possible_truncation)] // sizes of chunks were checked when the file was opened
    fn read(&self, chunk: usize, most: u64, wanted: Wanted, records: &mut Vec<u8>) -> Result<(), LasError> {
        let place = self.chunks.get(chunk).ok_or_else(|| LasError::NoSuchChunk {
            path: self.path().into(),
            chunk,
            count: self.chunks.len(),
        })?;
        let points = place.points.end - place.points.start;
        records.resize(points.min(most) as usize * self.layout.record_length, 0);
        let Some(codec) = &self.codec else {
            return self.input.read(records, place.bytes.start);
        };
        COMPRESSED.with_borrow_mut(|compressed| {
            compressed.resize((place.bytes.end - place.bytes.start) as usize, 0);
            self.input.read(compressed, place.bytes.start)?;
            codec.decode(compressed, points, wanted, records).map_err(|reason| LasError::CorruptChunk {
                path: self.path().into(),
                chunk,
                first_point: place.points.start,
                last_point: place.points.end - 1,
                reason,
            })
        })
    }

    /// The contents of a variable-length record; empty where the file has none of this definer and number.
    ///
    /// # Errors
    /// When the file cannot be read.
    pub fn record(&self, user_id: &str, record_id: u16) -> Result<Vec<u8>, LasError> {
        match self.header.vlrs.iter().find(|summary| summary.is(user_id, record_id)) {
            Some(summary) => self.input.read_vec(summary.contents_start(), summary.length),
            None => Ok(Vec::new()),
        }
    }

    pub(super) fn input(&self) -> &Input {
        &self.input
    }

    pub(super) fn codec(&self) -> Option<&LazCodec> {
        self.codec.as_ref()
    }

    pub(super) fn table(&self) -> Option<TablePlace> {
        self.table
    }

    /// Records before the points.
    pub(super) fn plain_records(&self) -> impl Iterator<Item = &VlrSummary> {
        self.header.vlrs.iter().filter(|summary| !summary.is_extended)
    }
}
