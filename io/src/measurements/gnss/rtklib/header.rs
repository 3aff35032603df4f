//! The header of an RTKLIB solution: time system, kind of position, columns, place of the base.

use std::path::Path;

use nalgebra::Vector3;
use tieline_filter::earth::geodetic_from_ecef;

use super::{number, sexagesimal, slot, tokens};
use crate::delimited::Line;
use crate::measurements::MeasurementFileError;
use crate::measurements::gnss::calendar::TimeSystem;

/// Numbers in a row.
pub(super) const SLOTS: usize = slot::ROOT_VELOCITY + 3;

/// What the first three columns are.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Position {
    /// Latitude, longitude \[deg\], height \[m\].
    Degrees,
    /// The same in degrees, minutes, seconds: seven fields.
    Sexagesimal,
    /// Earth-centred, earth-fixed \[m\].
    Cartesian,
    /// East, north, up from the base \[m\].
    Baseline,
}

/// How a line becomes a row, after its time.
#[derive(Debug, Clone)]
pub(super) struct Layout {
    pub(super) position: Position,
    /// Names of the columns.
    pub(super) names: Vec<String>,
    /// The place of each column in a row; `None` for one that is not used.
    pub(super) columns: Vec<Option<usize>>,
    /// Whether a header names the columns.
    stated: bool,
}

/// What the header has said so far.
#[derive(Debug)]
pub(super) struct Header {
    pub(super) system: TimeSystem,
    pub(super) layout: Option<Layout>,
    /// Latitude, longitude \[rad\], height \[m\] of the base.
    pub(super) reference: Option<Vector3<f64>>,
}

impl Default for Header {
    fn default() -> Self {
        Self { system: TimeSystem::Gps, layout: None, reference: None }
    }
}

/// Whether a line names the columns of a solution.
pub(in crate::measurements::gnss) fn is_header(line: &str) -> bool {
    line.starts_with('%') && line.contains("ns") && position_of(line).is_some()
}

fn position_of(line: &str) -> Option<Position> {
    tokens(line).find_map(|token| match token {
        "latitude(deg)" => Some(Position::Degrees),
        "latitude(d'\")" => Some(Position::Sexagesimal),
        "x-ecef(m)" => Some(Position::Cartesian),
        "e-baseline(m)" => Some(Position::Baseline),
        _ => None,
    })
}

impl Header {
    /// Takes in a line that starts with `%`.
    pub(super) fn update(&mut self, line: &Line<'_>, path: &Path) -> Result<(), MeasurementFileError> {
        let text = line.text.trim_start_matches('%').trim();
        if let Some((_, after)) = text.split_once("lat/lon/height=") {
            let frame = after.split([',', ')']).next().unwrap_or_default();
            if !frame.eq_ignore_ascii_case("WGS84/ellipsoidal") && !frame.eq_ignore_ascii_case("CGCS2000/ellipsoidal") {
                let found = frame.chars().take(60).collect();
                return Err(MeasurementFileError::WrongDatum { path: path.to_path_buf(), line: line.number, found });
            }
        } else if let Some((_, after)) = text.split_once("ref pos") {
            self.reference = reference(after.trim_start_matches([' ', ':'])).or(self.reference);
        } else if is_header(line.text) {
            let mut labels = tokens(text).peekable();
            if let Some(system) = labels.peek().and_then(|label| TimeSystem::of(label)) {
                self.system = system;
            }
            let first = |label: &&str| position_of(&format!("% {label}")).is_some();
            let position = position_of(text).unwrap_or(Position::Degrees);
            self.layout = Some(Layout::new(position, labels.skip_while(|label| !first(label)), true));
        }
        Ok(())
    }

    /// What a user should be told; `added_s` are the leap seconds.
    pub(super) fn notes(&self, path: &Path, added_s: Option<f64>) -> Vec<String> {
        let mut notes = Vec::new();
        let path = path.display();
        if let Some(added_s) = added_s {
            let system = self.system.name();
            notes.push(format!(
                "{path}: times are {system}; they were turned into GPS time with {added_s} leap seconds"
            ));
        }
        if self.layout.as_ref().is_some_and(|layout| !layout.stated) {
            notes.push(format!(
                "{path}: no header names the columns; taken for GPS time, WGS 84 and ellipsoidal heights in RTKLIB's order"
            ));
        }
        if self.layout.as_ref().is_some_and(|layout| layout.has_part_of_velocity() && !layout.has_velocity()) {
            notes.push(format!("{path}: velocities are left out: they come without their accuracies"));
        }
        notes
    }
}

/// The place of the base: latitude, longitude, height or x, y, z.
fn reference(text: &str) -> Option<Vector3<f64>> {
    let values = tokens(text).map(number).collect::<Option<Vec<f64>>>()?;
    let place = match *values.as_slice() {
        [x, y, z] if Vector3::new(x, y, z).norm() > 5.4e6 => geodetic_from_ecef(&Vector3::new(x, y, z)),
        [lat, lon, h] => Vector3::new(lat.to_radians(), lon.to_radians(), h),
        [d1, m1, s1, d2, m2, s2, h] => {
            Vector3::new(sexagesimal([d1, m1, s1]).to_radians(), sexagesimal([d2, m2, s2]).to_radians(), h)
        }
        _ => return None,
    };
    (place.x.abs() <= std::f64::consts::FRAC_PI_2 && place.iter().all(|v| v.is_finite())).then_some(place)
}

/// Names as RTKLIB writes them, latitude, longitude, height with velocity, for a file without a header.
const GEODETIC_NAMES: &str = "latitude(deg) longitude(deg) height(m) Q ns sdn(m) sde(m) sdu(m) sdne(m) sdeu(m) \
     sdun(m) age(s) ratio vn(m/s) ve(m/s) vu(m/s) sdvn sdve sdvu sdvne sdveu sdvun";
/// The same for x, y, z.
const CARTESIAN_NAMES: &str = "x-ecef(m) y-ecef(m) z-ecef(m) Q ns sdx(m) sdy(m) sdz(m) sdxy(m) sdyz(m) sdzx(m) \
     age(s) ratio vx(m/s) vy(m/s) vz(m/s) sdvx sdvy sdvz sdvxy sdvyz sdvzx";

impl Layout {
    /// The columns by their names.
    fn new<'t>(position: Position, labels: impl Iterator<Item = &'t str>, stated: bool) -> Self {
        let names: Vec<String> = labels.map(str::to_string).collect();
        let axes = match position {
            Position::Cartesian => ['x', 'y', 'z'],
            _ => ['e', 'n', 'u'],
        };
        let mut columns: Vec<Option<usize>> = Vec::new();
        for (index, name) in names.iter().enumerate() {
            let place = if index < 3 { Some(slot::POSITION + index) } else { place(name, axes) };
            // RTKLIB's header of degrees, minutes, seconds calls the covariance of up and north "sdue"
            let free = |place: &usize| !columns.contains(&Some(*place));
            let place = place.filter(free).or_else(|| (name == "sdue(m)").then_some(slot::ROOT + 1).filter(free));
            columns.push(place);
        }
        Self { position, names, columns, stated }
    }

    /// The columns by the number of fields after the time.
    pub(super) fn by_count(count: usize, line: &Line<'_>, path: &Path) -> Result<Self, MeasurementFileError> {
        let (position, columns) = match count {
            5 | 8 | 11 | 13 | 22 => match first_three(line) {
                Some(v) if v.norm() > 5.4e6 => (Position::Cartesian, count),
                _ => (Position::Degrees, count),
            },
            17 | 26 => (Position::Sexagesimal, count - 4),
            _ => {
                let (path, line, found) = (path.to_path_buf(), line.number, count + 2);
                return Err(MeasurementFileError::FieldCount { path, line, found, expected: 15 });
            }
        };
        let names = match position {
            Position::Cartesian => CARTESIAN_NAMES,
            _ => GEODETIC_NAMES,
        };
        Ok(Self::new(position, names.split_whitespace().take(columns), false))
    }

    /// Fields of a line, its time included.
    pub(super) fn fields(&self) -> usize {
        let more = if self.position == Position::Sexagesimal { 4 } else { 0 };
        2 + self.columns.len() + more
    }

    /// Whether the columns hold a velocity and its sigmas.
    pub(super) fn has_velocity(&self) -> bool {
        (slot::VELOCITY..slot::ROOT_VELOCITY).all(|slot| self.columns.contains(&Some(slot)))
    }

    fn has_part_of_velocity(&self) -> bool {
        (slot::VELOCITY..slot::SIGMA_VELOCITY).any(|slot| self.columns.contains(&Some(slot)))
    }
}

fn first_three(line: &Line<'_>) -> Option<Vector3<f64>> {
    let mut fields = tokens(line.text).skip(2).map(number);
    Some(Vector3::new(fields.next()??, fields.next()??, fields.next()??))
}

/// The place of a column after the position, in a frame whose axes have these letters.
fn place(name: &str, axes: [char; 3]) -> Option<usize> {
    let name = name.split('(').next().unwrap_or_default();
    let axis = |letter: char| axes.iter().position(|&a| a == letter);
    let one_or_two = |letters: &str, one: usize, two: usize| {
        let mut letters = letters.chars();
        match (letters.next(), letters.next(), letters.next()) {
            (Some(a), None, _) => Some(one + axis(a)?),
            (Some(a), Some(b), None) => match (axis(a)?, axis(b)?) {
                (0, 1) | (1, 0) => Some(two),
                (1, 2) | (2, 1) => Some(two + 1),
                (0, 2) | (2, 0) => Some(two + 2),
                _ => None,
            },
            _ => None,
        }
    };
    if name == "Q" {
        Some(slot::QUALITY)
    } else if let Some(letters) = name.strip_prefix("sdv") {
        one_or_two(letters, slot::SIGMA_VELOCITY, slot::ROOT_VELOCITY)
    } else if let Some(letters) = name.strip_prefix("sd") {
        one_or_two(letters, slot::SIGMA, slot::ROOT)
    } else {
        name.strip_prefix('v').and_then(|letter| {
            let mut letters = letter.chars();
            letters.next().and_then(axis).filter(|_| letters.next().is_none()).map(|axis| slot::VELOCITY + axis)
        })
    }
}
