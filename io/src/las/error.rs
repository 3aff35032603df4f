//! What can be wrong with a LAS or LAZ file, each with its remedy.

use std::error::Error;
use std::io;
use std::path::PathBuf;

/// An error of [`crate::las`]: names the file, the place, what was found, what was expected, and the way out.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum LasError {
    /// The operating system refused a read or a write.
    #[error("{}: cannot {action}: {source}", path.display())]
    Io {
        /// File that was worked on.
        path: PathBuf,
        /// What was tried.
        action: &'static str,
        /// The operating system's answer.
        source: io::Error,
    },
    /// The first four bytes are not `LASF`.
    #[error(
        "{}: not a LAS or LAZ file: it starts with {found:?} where \"LASF\" was due; \
         name a .las, .laz or .copc.laz file", path.display()
    )]
    NotLas {
        /// The file.
        path: PathBuf,
        /// Its first bytes as text.
        found: String,
    },
    /// A LAS version that is not 1.0 to 1.4.
    #[error(
        "{}: LAS {major}.{minor} is not supported (1.0 to 1.4 are); \
         convert to 1.4 first, for instance with `pdal translate IN OUT --writers.las.minor_version=4`", path.display()
    )]
    UnsupportedVersion {
        /// The file.
        path: PathBuf,
        /// Major version found.
        major: u8,
        /// Minor version found.
        minor: u8,
    },
    /// A point format above 10.
    #[error(
        "{}: point format {format} is unknown (0 to 10 are defined); \
         the header is damaged, or the file must be converted to format 6 first", path.display()
    )]
    UnknownPointFormat {
        /// The file.
        path: PathBuf,
        /// Format found, compression bit removed.
        format: u8,
    },
    /// The file is shorter than its header.
    #[error(
        "{}: the header is cut short: {found} bytes where {expected} were due; copy the file again", path.display()
    )]
    HeaderCut {
        /// The file.
        path: PathBuf,
        /// Bytes in the file.
        found: u64,
        /// Bytes of a header of this version.
        expected: u64,
    },
    /// A size or position in the header cannot be right.
    #[error(
        "{}: header field \"{field}\" is {found}, expected {expected}; \
         the header is damaged: copy the file again or repair it with `lasinfo -repair`", path.display()
    )]
    HeaderField {
        /// The file.
        path: PathBuf,
        /// Name of the field in the LAS specification.
        field: &'static str,
        /// Value found.
        found: String,
        /// What it should be.
        expected: String,
    },
    /// A coordinate scale of zero, negative, or not finite.
    #[error(
        "{}: the {axis} scale factor is {found}, expected a positive number such as 0.001; \
         write the file anew from its source", path.display()
    )]
    Scale {
        /// The file.
        path: PathBuf,
        /// `x`, `y` or `z`.
        axis: char,
        /// Value found.
        found: f64,
    },
    /// A coordinate offset or a bound of the header that is not finite.
    #[error(
        "{}: header field \"{field}\" is {found}, expected a finite number of metres; \
         repair the header, for instance with `lasinfo -repair_bb`", path.display()
    )]
    NotFinite {
        /// The file.
        path: PathBuf,
        /// Name of the field.
        field: &'static str,
        /// Value found.
        found: f64,
    },
    /// Records shorter than their point format.
    #[error(
        "{}: point records have {found} bytes, but point format {format} needs at least {expected}; \
         the header is damaged: write the file anew from its source", path.display()
    )]
    RecordLength {
        /// The file.
        path: PathBuf,
        /// Point format.
        format: u8,
        /// Record length found, bytes.
        found: u16,
        /// Least record length of the format, bytes.
        expected: u16,
    },
    /// A header that counts no points.
    #[error("{}: the file has no points; leave it out of the strips", path.display())]
    NoPoints {
        /// The file.
        path: PathBuf,
    },
    /// An uncompressed file that ends before its last point.
    #[error(
        "{}: truncated: the header promises {expected} points, the file has room for {found}; \
         copy the file again", path.display()
    )]
    Truncated {
        /// The file.
        path: PathBuf,
        /// Points promised by the header.
        expected: u64,
        /// Whole point records in the file.
        found: u64,
    },
    /// A compressed file that ends before its chunk table.
    #[error(
        "{}: truncated: its chunk table is due at byte {expected}, but the file ends at byte {found}; \
         copy the file again", path.display()
    )]
    TruncatedLaz {
        /// The file.
        path: PathBuf,
        /// Position \[bytes\] that the chunk table should have.
        expected: u64,
        /// Length \[bytes\] of the file.
        found: u64,
    },
    /// The chunk table contradicts the header or the size of the file.
    #[error(
        "{}: the LAZ chunk table is corrupt: {found}, expected {expected}; \
         copy the file again or rebuild it with `laszip -i IN -o OUT`", path.display()
    )]
    ChunkTable {
        /// The file.
        path: PathBuf,
        /// What it says.
        found: String,
        /// What it should say.
        expected: String,
    },
    /// The record that describes the compression is missing or contradicts the header.
    #[error(
        "{}: the LASzip record cannot be used: {reason}; write the file anew with `laszip`", path.display()
    )]
    LaszipRecord {
        /// The file.
        path: PathBuf,
        /// What is wrong with it.
        reason: String,
    },
    /// A variable-length record that runs past its place.
    #[error(
        "{}: {kind} {index} is cut short: it ends at byte {expected}, its place ends at byte {found}; \
         the header is damaged or the file is truncated: copy it again", path.display()
    )]
    VariableRecord {
        /// The file.
        path: PathBuf,
        /// `VLR` or `EVLR`.
        kind: &'static str,
        /// 0-based number of the record.
        index: u32,
        /// Where the record would end, byte position.
        expected: u64,
        /// Where it must end at the latest, byte position.
        found: u64,
    },
    /// A compressed chunk that cannot be decoded.
    #[error(
        "{}: chunk {chunk} (points {first_point} to {last_point}) is corrupt: {reason}; \
         copy the file again", path.display()
    )]
    CorruptChunk {
        /// The file.
        path: PathBuf,
        /// 0-based number of the chunk.
        chunk: usize,
        /// Index of its first point.
        first_point: u64,
        /// Index of its last point.
        last_point: u64,
        /// What the decoder said.
        reason: String,
    },
    /// A chunk that the file does not have.
    #[error("{}: chunk {chunk} was asked for, the file has {count}", path.display())]
    NoSuchChunk {
        /// The file.
        path: PathBuf,
        /// 0-based number asked for.
        chunk: usize,
        /// Chunks of the file.
        count: usize,
    },
    /// A coordinate that does not fit into 32 bits at the scale and offset of the output.
    #[error(
        "{}: point {point}: {axis} = {coordinate_m} m does not fit scale {scale} and offset {offset_m}; \
         take an offset nearer to the points, or look for a wrong trajectory or correction", path.display()
    )]
    Overflow {
        /// File being written.
        path: PathBuf,
        /// Index of the point in its file.
        point: u64,
        /// `x`, `y` or `z`.
        axis: char,
        /// Coordinate \[m\], possibly not finite.
        coordinate_m: f64,
        /// Scale of the output.
        scale: f64,
        /// Offset \[m\] of the output.
        offset_m: f64,
    },
    /// The caller's edit of a block of points failed.
    #[error("{}: points from {first_point} on: {source}", path.display())]
    Edit {
        /// File being read.
        path: PathBuf,
        /// Index of the first point of the block.
        first_point: u64,
        /// The caller's error.
        source: Box<dyn Error + Send + Sync>,
    },
    /// Options or columns that cannot be written as LAS.
    #[error("{}: cannot be written: {what}: {found}, expected {expected}", path.display())]
    Unwritable {
        /// File being written.
        path: PathBuf,
        /// Option or column.
        what: &'static str,
        /// Value given.
        found: String,
        /// What it should be.
        expected: String,
    },
    /// The compressor failed.
    #[error("{}: points from {first_point} on cannot be compressed: {reason}", path.display())]
    Compress {
        /// File being written.
        path: PathBuf,
        /// Index of the first point of the chunk.
        first_point: u64,
        /// What the encoder said.
        reason: String,
    },
}
