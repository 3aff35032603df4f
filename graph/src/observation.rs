//! A surface line, or one direction of a tie of two places, as the adjustment sees it.

use nalgebra::Vector3;
use tieline_filter::Pose;

/// One end of a surface line: a plane seen from one pose, offset from the common point of the line.
#[derive(Debug, Clone, PartialEq)]
pub struct LineEnd {
    /// Index of the strip; `None` for a known surface (control).
    pub strip: Option<usize>,
    /// Index of the calibration block (scanner and mission).
    pub calibration: usize,
    /// Survey time \[s\].
    pub time_s: f64,
    /// Pose of the IMU, in the frame of the points.
    pub pose: Pose,
    /// Nominal lever arm, body frame \[m\].
    pub lever_arm_m: Vector3<f64>,
    /// The point of the plane nearest to the common point, as the cloud has it (before any correction) \[m\].
    pub point_m: Vector3<f64>,
    /// Offset of the plane, after the present corrections, from the common point along the normal \[m\].
    pub offset_m: f64,
    /// Its sigma, a priori \[m\].
    pub sigma_m: f64,
    /// Where the offset depends on displacements of several places, each along a vector of its own: `offset = Σ along·Δ`
    /// instead of `normal·Δ` at `point_m`. Empty for a plane.
    pub parts: Vec<EndPart>,
}

/// One of the places whose displacements make the offset of an end.
#[derive(Debug, Clone, PartialEq)]
pub struct EndPart {
    /// Survey time \[s\].
    pub time_s: f64,
    /// Pose of the IMU, in the frame of the points.
    pub pose: Pose,
    /// The place before any correction \[m\].
    pub point_m: Vector3<f64>,
    /// Derivative of the offset by the displacement of this place, map axes.
    pub along: Vector3<f64>,
}

/// A surface line: two ends or more, one common normal; the offset of the surface itself is eliminated. A direction of a
/// tie of two places is one, too: its normal is that direction.
#[derive(Debug, Clone, PartialEq)]
pub struct Line {
    /// Common unit normal, map axes.
    pub normal: Vector3<f64>,
    /// Tie class, an index into the variance components.
    pub class: usize,
    /// Held out of the solution, to judge it.
    pub held_out: bool,
    /// Held out of every solution, those of a cross-validation as well.
    pub judges_only: bool,
    /// The tie that this is a direction of: lines with the same number stand together and share their fate.
    pub tie: Option<usize>,
    /// Ends.
    pub ends: Vec<LineEnd>,
}
