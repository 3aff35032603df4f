//! How the scanners are mounted, roughly, and how well that is known.

use anyhow::{Context, Result, bail};
use nalgebra::{Rotation3, UnitQuaternion, Vector3};
use tieline_io::extrinsics::{ScannerExtrinsics, read_extrinsics};

use crate::project::{ExtrinsicsSection, Project, ScannerSection};

/// A scanner on the vehicle.
#[derive(Debug, Clone, PartialEq)]
pub struct Head {
    /// Number, as in the points.
    pub scanner: u16,
    /// Name, such as "left"; its number when it has none.
    pub name: String,
    /// Rough mounting.
    pub body_from_scanner: UnitQuaternion<f64>,
    /// Rough lever arm, body frame \[m\].
    pub lever_arm_m: Vector3<f64>,
}

/// The scanners of a vehicle.
#[derive(Debug, Clone, PartialEq)]
pub struct Mounts {
    /// Scanners, by number.
    pub heads: Vec<Head>,
    /// Index of the one that the others are calibrated against.
    pub reference: usize,
    /// Prior sigma of each angle \[rad\].
    pub boresight_sigma_rad: f64,
    /// Prior sigma of each component of a lever arm \[m\].
    pub lever_arm_sigma_m: f64,
    /// The same mounting with the file's degrees taken for radians, to find that mistake by the misfit.
    pub if_radians: Option<Vec<UnitQuaternion<f64>>>,
}

impl Mounts {
    /// The mounts of a project: from the table of extrinsics, else from `[[platform.scanner]]`.
    ///
    /// # Errors
    /// What cannot be read or used, with its remedy.
    pub fn of(project: &Project) -> Result<Self> {
        let section = project.extrinsics.clone().unwrap_or_default();
        let platform = &project.platform.scanner;
        let mut heads: Vec<Head>;
        let mut if_radians = None;
        if let Some(path) = &section.path {
            let path = project.resolve(path);
            let rows = read_extrinsics(&path)?;
            let known: Vec<u16> = rows.iter().map(|r| r.scanner).collect();
            if !known.contains(&section.reference) {
                bail!(
                    "{}: extrinsics.reference = {} is not among its scanners {known:?}; name one of them",
                    path.display(),
                    section.reference
                );
            }
            heads = rows.iter().map(|r| head(r, &section, platform)).collect();
            if rows.iter().any(|r| r.angles_deg.is_some()) {
                if_radians =
                    Some(rows.iter().map(|r| head(&radians(r), &section, platform).body_from_scanner).collect());
            }
        } else if platform.is_empty() {
            bail!(
                "stations need the rough mounting of their scanners: give [extrinsics] path, or [[platform.scanner]]"
            );
        } else {
            heads = platform.iter().map(of_platform).collect();
        }
        let mut order: Vec<usize> = (0..heads.len()).collect();
        order.sort_by_key(|i| heads[*i].scanner);
        if_radians = if_radians.map(|all: Vec<_>| order.iter().map(|i| all[*i]).collect());
        heads.sort_by_key(|h| h.scanner);
        let reference = heads.iter().position(|h| h.scanner == section.reference).with_context(|| {
            format!("extrinsics.reference = {}: [[platform.scanner]] has no scanner of this id", section.reference)
        })?;
        Ok(Self {
            heads,
            reference,
            boresight_sigma_rad: section.boresight_sigma_deg.to_radians(),
            lever_arm_sigma_m: section.lever_arm_sigma_m,
            if_radians,
        })
    }

    /// Index of the calibration block of a scanner; `None` for the reference.
    #[must_use]
    pub fn block(&self, head: usize) -> Option<usize> {
        (head != self.reference).then(|| head - usize::from(head > self.reference))
    }

    /// Scanners that are calibrated, by calibration block.
    pub fn calibrated(&self) -> impl Iterator<Item = &Head> {
        self.heads.iter().enumerate().filter(|(i, _)| *i != self.reference).map(|(_, h)| h)
    }
}

fn of_platform(section: &ScannerSection) -> Head {
    let [roll, pitch, yaw] = section.mounting_deg.map(f64::to_radians);
    let boresight = Rotation3::new(Vector3::from(section.boresight_deg).map(f64::to_radians));
    Head {
        scanner: section.id,
        name: section.id.to_string(),
        body_from_scanner: UnitQuaternion::from(boresight) * UnitQuaternion::from_euler_angles(roll, pitch, yaw),
        lever_arm_m: Vector3::from(section.lever_arm_m),
    }
}

/// A row of the table in the body frame: that of the reference's own mounting, else of its axes, at its place.
fn head(row: &ScannerExtrinsics, section: &ExtrinsicsSection, platform: &[ScannerSection]) -> Head {
    let (body_from_reference, reference_m) =
        platform.iter().find(|s| s.id == section.reference).map(of_platform).map_or_else(
            || {
                let axes = Rotation3::from_matrix_unchecked(section.axes.body_from_sensor());
                (UnitQuaternion::from(axes), Vector3::zeros())
            },
            |head| (head.body_from_scanner, head.lever_arm_m),
        );
    Head {
        scanner: row.scanner,
        name: if row.name.is_empty() { row.scanner.to_string() } else { row.name.clone() },
        body_from_scanner: body_from_reference * row.reference_from_scanner,
        lever_arm_m: reference_m + body_from_reference * row.position_m,
    }
}

/// A row with its degrees taken for radians.
fn radians(row: &ScannerExtrinsics) -> ScannerExtrinsics {
    let mut row = row.clone();
    if let Some([roll, pitch, yaw]) = row.angles_deg {
        row.reference_from_scanner = UnitQuaternion::from_euler_angles(roll, pitch, yaw);
    }
    row
}
