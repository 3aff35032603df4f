//! Finds planar ties between overlapping laser strips: one pass over the points, patches, surface lines.
//!
//! The main path, top down: [`Accumulator`] sums points into cells → [`TileMerge`] gives them tile by tile →
//! [`patches_of_tile`] → [`pair`] → rejection and [`selection`](select). Matching never knows a file format.

mod accumulate;
mod block;
mod cell;
pub mod geometry;
mod heads;
mod level_flight;
mod moments;
mod patch;
mod planar;
mod reject;
mod runs;
mod select;
mod sensor_path;
mod sketch;
mod strip;
mod surface_line;
mod tile;
pub mod xyz;

pub use accumulate::{Accumulator, GridOptions, PassCounts};
pub use block::{CONTROL_FILE, PointBlock, PointFilter, Returns, ScannerField, SourceKey, SourceRule};
pub use cell::{Cell, CellKey, Place};
pub use heads::{Gate, HeadPairs, pair_heads};
pub use level_flight::{ASSUMED_HEIGHT_M, level_path};
pub use moments::Moments;
pub use patch::{Patch, Sighting};
pub use planar::{PlanarOptions, planar_patches};
pub use reject::{RejectOptions, reject_by_distance};
pub use runs::{Run, TileMerge};
pub use select::{Spacing, is_held_out, is_place_held_out, normal_bin, select};
pub use sensor_path::{PathRefused, PathSource, SensorPath, path_from_return_pairs};
pub use sketch::{BinSketch, ReturnPair, SamplePoint, Sketches, mix};
pub use strip::{Strip, StripIndex, StripOptions};
pub use surface_line::{
    End, Measurement, PairingOptions, Rejection, RowEnd, SurfaceLine, compare, line_of, measure, pair, pair_rows,
};
pub use tile::{PatchOptions, patches_of_tile};
