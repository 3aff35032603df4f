//! `ties.txt`: ties as plain text, for smoothers of any origin.
//!
//! A header of `# key: value` lines says time base and frames; then one row a sighting, the rows of a tie together and in order of time. A tie
//! says that `u · (p + C l)` is the same for all its sightings but for their noise: position `p` and attitude `C` of the IMU at the time of the
//! sighting, body vector `l` from the IMU to the feature (calibration applied), unit directions `u` fixed to the earth.
//!
//! ```
//! use tieline_io::ties::text::{TieTextHeader, TieTextReader, write_to};
//! let text = "# tieline ties 1\n# week: 2330\n# time: gps\n# units: m s\n# directions: ecef\n# body: frd\n# calibration: applied\n\
//!             0 pass_to_pass surface_line 1 100.5 0 1.0 -2.0 2.5 1 1 0 0 1 1e-4\n\
//!             0 pass_to_pass surface_line 1 160.5 0 0.5 -2.5 2.5 1 1 0 0 1 1e-4\n";
//! let reader = TieTextReader::new(text.as_bytes(), "ties.txt".as_ref())?;
//! assert_eq!(reader.header().week, Some(2330));
//! let ties: Vec<_> = reader.collect::<Result<_, _>>()?;
//! assert_eq!(ties[0].sightings[1].time_s, 160.5);
//! write_to(&mut Vec::new(), &TieTextHeader { week: Some(2330), datum: None }, &ties)?;
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod error;
mod read;
mod write;

use nalgebra::{Matrix3, Vector3};
use tieline_filter::{FilterTie, Sighting, TieClass, TieKind};

pub use error::{RowFault, TieTextError};
pub use read::TieTextReader;
pub use write::{write_tie_text, write_to};

/// How every file begins.
pub const MAGIC: &str = "# tieline ties";
/// Version of the format.
pub const VERSION: u32 = 1;

/// What a header says beyond what is the same in every file.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct TieTextHeader {
    /// GPS week that times count from; `None` where nobody knew it.
    pub week: Option<u32>,
    /// Reference system of the survey, for people.
    pub datum: Option<String>,
}

/// One sighting.
#[derive(Debug, Clone, PartialEq)]
pub struct TextSighting {
    /// GPS seconds of the header's week, running on past its end \[s\].
    pub time_s: f64,
    /// Scanner, 0-based.
    pub scanner: u16,
    /// From the IMU to the feature, calibration applied, body axes (forward, right, down) \[m\].
    pub body_vector_m: Vector3<f64>,
    /// Covariance along the directions \[m²\]; only the first rows and columns count, the rest is 0.
    pub covariance_m2: Matrix3<f64>,
    /// Whether the solution that it comes from used it.
    pub used: bool,
    /// Weight that it had there, 0 to 1: its covariance counted as divided by it.
    pub weight: f64,
}

/// One tie.
#[derive(Debug, Clone, PartialEq)]
pub struct TextTie {
    /// Number, unique in the file.
    pub id: u64,
    /// What it binds.
    pub class: TieClass,
    /// What it is; never a submap or control.
    pub kind: TieKind,
    /// One to three unit vectors at right angles to each other, earth-centred, earth-fixed axes.
    pub directions: Vec<Vector3<f64>>,
    /// Two or more, in order of time.
    pub sightings: Vec<TextSighting>,
}

impl TextTie {
    /// The tie for the smoother: sightings in use, their covariance divided by their weight, their times moved by
    /// `shift_s`; `None` when fewer than two are in use.
    #[must_use]
    pub fn for_smoother(&self, shift_s: f64) -> Option<FilterTie> {
        let sightings: Vec<Sighting> = self
            .sightings
            .iter()
            .filter(|s| s.used)
            .map(|s| Sighting {
                time_s: s.time_s + shift_s,
                body_vector_m: s.body_vector_m,
                covariance_m2: s.covariance_m2 / s.weight,
                by_constant: Vec::new(),
            })
            .collect();
        let (id, kind, directions) = (self.id, self.kind, self.directions.clone());
        (sightings.len() >= 2).then_some(FilterTie { id, kind, directions, sightings, known_m: None })
    }
}

/// The lines of a header that are the same in every file: key, first word of its value, the rest for people.
const FRAMES: [(&str, &str, &str); 5] = [
    ("time", "gps", "seconds of that week, running on past its end; no leap seconds"),
    ("units", "m", "for lengths, m² for covariances, s for times"),
    ("directions", "ecef", "unit vectors fixed to the earth: earth-centred, earth-fixed axes"),
    ("body", "frd", "forward, right, down; vectors lead from the IMU to the feature"),
    ("calibration", "applied", "mounting, lever arm, latency and range correction are in the body vectors"),
];

/// The columns of ties of rank 1.
const COLUMNS: &str =
    "tie_id class kind rank time_s scanner body_x_m body_y_m body_z_m used weight u_x u_y u_z covariance_m2";
/// Columns before the directions.
const FIXED_COLUMNS: usize = 11;

/// Columns of a row of a rank.
const fn columns_of(rank: usize) -> usize {
    FIXED_COLUMNS + 3 * rank + rank * (rank + 1) / 2
}
