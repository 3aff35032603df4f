//! What stands and lies in the streets.

use serde::{Deserialize, Serialize};

/// `[scene]`
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct SceneOptions {
    /// Height of the hills above the mean \[m\].
    pub hill_m: f64,
    /// Length of the shortest of them \[m\].
    pub hill_length_m: f64,
    /// Slope of the road across, at the gutter.
    pub cross_slope: f64,
    /// Height of the curbs \[m\].
    pub curb_m: f64,
    /// Radius of the corners where streets meet \[m\].
    pub corner_radius_m: f64,
    /// Ground beyond the building line or, in open streets, beyond the pavement \[m\].
    pub verge_m: f64,
    /// Least and largest height of the façades \[m\].
    pub facade_height_m: [f64; 2],
    /// Least and largest depth of windows and doors in the façades \[m\].
    pub recess_m: [f64; 2],
    /// Share of the building line that is left open.
    pub gap_share: f64,
    /// Distance between lamp posts along each side \[m\].
    pub pole_spacing_m: f64,
    /// Distance between trees along each side \[m\].
    pub tree_spacing_m: f64,
    /// Distance between manhole covers along the street \[m\].
    pub manhole_spacing_m: f64,
    /// Distance between asphalt patches along the street \[m\].
    pub patch_spacing_m: f64,
    /// Distance between zebra crossings along the street \[m\].
    pub zebra_spacing_m: f64,
    /// Distance between arrows along the street \[m\].
    pub arrow_spacing_m: f64,
    /// Distance between cars parked at the curb along each side, other ones in each pass \[m\].
    pub parked_spacing_m: f64,
    /// Time between two cars that meet the vehicle \[s\].
    pub traffic_s: f64,
    /// Roughness of asphalt, one sigma \[m\]; grass is ten times as rough.
    pub roughness_m: f64,
}

impl Default for SceneOptions {
    fn default() -> Self {
        Self {
            hill_m: 2.0,
            hill_length_m: 160.0,
            cross_slope: 0.025,
            curb_m: 0.12,
            corner_radius_m: 8.0,
            verge_m: 6.0,
            facade_height_m: [8.0, 20.0],
            recess_m: [0.10, 0.20],
            gap_share: 0.08,
            pole_spacing_m: 27.0,
            tree_spacing_m: 34.0,
            manhole_spacing_m: 21.0,
            patch_spacing_m: 30.0,
            zebra_spacing_m: 70.0,
            arrow_spacing_m: 55.0,
            parked_spacing_m: 30.0,
            traffic_s: 12.0,
            roughness_m: 0.001,
        }
    }
}
