//! Curves of the range bias as the summary has them; keys are public.

use serde::{Deserialize, Serialize};

use crate::report::nullable;

/// The range bias of a scanner: measured less true range.
#[derive(Debug, Clone, Default, Serialize, Deserialize)]
pub struct CurveSummary {
    /// Scanner, 0-based.
    pub scanner: usize,
    /// Ranges \[m\].
    #[serde(deserialize_with = "nullable::numbers")]
    pub range_m: Vec<f64>,
    /// Bias \[m\].
    #[serde(deserialize_with = "nullable::numbers")]
    pub bias_m: Vec<f64>,
    /// Its standard deviation \[m\].
    #[serde(deserialize_with = "nullable::numbers")]
    pub sigma_m: Vec<f64>,
}

/// The range bias of a scanner over something else than the range: measured less true range.
#[derive(Debug, Clone, Default, Serialize, Deserialize)]
pub struct OverCurveSummary {
    /// Scanner, 0-based.
    pub scanner: usize,
    /// `incidence` or `intensity`.
    pub over: String,
    /// Angles between beam and normal \[deg\], or intensities as the strips have them.
    #[serde(deserialize_with = "nullable::numbers")]
    pub at: Vec<f64>,
    /// Bias \[m\].
    #[serde(deserialize_with = "nullable::numbers")]
    pub bias_m: Vec<f64>,
    /// Its standard deviation \[m\].
    #[serde(deserialize_with = "nullable::numbers")]
    pub sigma_m: Vec<f64>,
}
