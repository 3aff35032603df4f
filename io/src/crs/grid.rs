//! Convergence and scale of a map projection, from the projection itself.

use nalgebra::{Matrix2, Vector2, Vector3};
use tieline_filter::earth::{meridian_radius_m, prime_vertical_radius_m};

use super::error::CrsError;
use super::projection::{Crs, CrsKind};

/// Step of the differences \[m at the height of the place\]: the truncation of the five-point formula is then 1e-17, and the
/// rounding of coordinates (1e-9 m) 1e-12.
const STEP_M: f64 = 1000.0;

/// How a projection turns and stretches at a place.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GridPoint {
    /// Bearing of grid north from true north \[rad\], positive when grid north lies east of true north.
    pub convergence_rad: f64,
    /// Map metres per metre in the level plane of the place: the projection's scale on the ellipsoid over `1 + h / R`,
    /// 16 ppm less for every 100 m of height (`docs/decisions/0017-map-distances-at-their-height.md`).
    pub scale: f64,
    /// What is left when turn and scale are taken out, relative to the scale: zero for a conformal projection, some
    /// 1e-3 for an equal-area one.
    pub distortion: f64,
}

impl Crs {
    /// Convergence and scale at a latitude \[rad\], longitude \[rad\] and height \[m\]; exact to 1e-10. For a
    /// projection that is not conformal, the similarity that fits best. A local system has neither: its trajectory is turned instead.
    ///
    /// # Errors
    /// As [`Crs::map_from_geodetic`].
    pub fn grid_at(&self, geodetic: &Vector3<f64>) -> Result<GridPoint, CrsError> {
        if self.kind == CrsKind::Local {
            return Ok(GridPoint { convergence_rad: 0.0, scale: 1.0, distortion: 0.0 });
        }
        let north_rad = STEP_M / (meridian_radius_m(geodetic.x) + geodetic.z);
        let east_rad = STEP_M / ((prime_vertical_radius_m(geodetic.x) + geodetic.z) * geodetic.x.cos());
        let along_north = self.derivative(geodetic, north_rad, 0.0)?;
        let along_east = self.derivative(geodetic, 0.0, east_rad)?;
        Ok(similarity(&Matrix2::from_columns(&[along_north, along_east])))
    }

    /// Map metres per metre at the height of the place, by five-point differences.
    fn derivative(&self, centre: &Vector3<f64>, dlat: f64, dlon: f64) -> Result<Vector2<f64>, CrsError> {
        let at = |steps: f64| {
            let point = Vector3::new(centre.x + steps * dlat, centre.y + steps * dlon, centre.z);
            self.map_from_geodetic(&point).map(|map| map.xy())
        };
        Ok(((at(1.0)? - at(-1.0)?) * 8.0 - (at(2.0)? - at(-2.0)?)) / (12.0 * STEP_M))
    }
}

/// Turn and scale of the Jacobian d(E, N) / d(north, east):
/// `[[-k sin γ, k cos γ], [k cos γ, k sin γ]]` plus the rest.
fn similarity(jacobian: &Matrix2<f64>) -> GridPoint {
    let cos = 0.5 * (jacobian[(0, 1)] + jacobian[(1, 0)]);
    let sin = 0.5 * (jacobian[(1, 1)] - jacobian[(0, 0)]);
    let scale = cos.hypot(sin);
    let rest = jacobian - Matrix2::new(-sin, cos, cos, sin);
    GridPoint { convergence_rad: sin.atan2(cos), scale, distortion: rest.norm() / scale / std::f64::consts::SQRT_2 }
}
