//! A surface line as the adjustment sees it.

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
}

/// A surface line: two ends or more, one common normal; the offset of the surface itself is eliminated.
#[derive(Debug, Clone, PartialEq)]
pub struct Line {
    /// Common unit normal, map axes.
    pub normal: Vector3<f64>,
    /// Tie class, an index into the variance components.
    pub class: usize,
    /// Held out of the solution, to judge it.
    pub held_out: bool,
    /// Ends.
    pub ends: Vec<LineEnd>,
}
