//! The GRS 80 / WGS 84 ellipsoid: radii of curvature and geodetic ↔ Cartesian (ECEF) coordinates.
//!
//! Source: Torge, *Geodesy*, 3rd ed., section 4.1.3 (radii 4.13, 4.15; Cartesian 4.27).

use nalgebra::{Matrix3, Vector3};

/// Semi-major axis of WGS 84 \[m\].
pub const SEMI_MAJOR_AXIS_M: f64 = 6_378_137.0;
/// Flattening of WGS 84 (GRS 80 differs in the eleventh digit).
pub const FLATTENING: f64 = 1.0 / 298.257_223_563;
/// First eccentricity squared of WGS 84.
pub const ECCENTRICITY_SQUARED: f64 = FLATTENING * (2.0 - FLATTENING);

/// Rotation rate of the earth \[rad/s\].
pub const EARTH_RATE_RADPS: f64 = 7.292_115e-5;

/// Normal gravity \[m/s²\] at a geodetic latitude \[rad\] and ellipsoidal height \[m\], along the ellipsoid's normal.
///
/// Somigliana's formula and its second-order continuation upwards (NIMA TR 8350.2, 3rd ed., equations 4-1 and 4-3).
#[must_use]
pub fn normal_gravity_mps2(latitude_rad: f64, height_m: f64) -> f64 {
    const AT_EQUATOR: f64 = 9.780_325_335_9;
    const SOMIGLIANA_K: f64 = 0.001_931_852_652_41;
    const GRAVITY_RATIO_M: f64 = 0.003_449_786_506_84;
    let s2 = latitude_rad.sin().powi(2);
    let on_ellipsoid = AT_EQUATOR * (1.0 + SOMIGLIANA_K * s2) / (1.0 - ECCENTRICITY_SQUARED * s2).sqrt();
    let h = height_m / SEMI_MAJOR_AXIS_M;
    on_ellipsoid * (1.0 - 2.0 * (1.0 + FLATTENING + GRAVITY_RATIO_M - 2.0 * FLATTENING * s2) * h + 3.0 * h * h)
}

/// Earth rate in north, east, down \[rad/s\] at a latitude \[rad\].
#[must_use]
pub fn earth_rate_ned_radps(latitude_rad: f64) -> Vector3<f64> {
    let (sin, cos) = latitude_rad.sin_cos();
    Vector3::new(EARTH_RATE_RADPS * cos, 0.0, -EARTH_RATE_RADPS * sin)
}

/// Transport rate in north, east, down \[rad/s\]: how the navigation frame turns as it moves over the ellipsoid.
#[must_use]
pub fn transport_rate_ned_radps(geodetic: &Vector3<f64>, velocity_ned_mps: &Vector3<f64>) -> Vector3<f64> {
    let north = prime_vertical_radius_m(geodetic.x) + geodetic.z;
    let meridian = meridian_radius_m(geodetic.x) + geodetic.z;
    let (vn, ve) = (velocity_ned_mps.x, velocity_ned_mps.y);
    Vector3::new(ve / north, -vn / meridian, -ve * geodetic.x.tan() / north)
}

/// Radius of curvature in the meridian \[m\] at a geodetic latitude \[rad\].
#[must_use]
pub fn meridian_radius_m(latitude_rad: f64) -> f64 {
    let w2 = 1.0 - ECCENTRICITY_SQUARED * latitude_rad.sin().powi(2);
    SEMI_MAJOR_AXIS_M * (1.0 - ECCENTRICITY_SQUARED) / (w2 * w2.sqrt())
}

/// Radius of curvature in the prime vertical \[m\] at a geodetic latitude \[rad\].
#[must_use]
pub fn prime_vertical_radius_m(latitude_rad: f64) -> f64 {
    SEMI_MAJOR_AXIS_M / (1.0 - ECCENTRICITY_SQUARED * latitude_rad.sin().powi(2)).sqrt()
}

/// Earth-centred Cartesian coordinates \[m\] of latitude \[rad\], longitude \[rad\] and ellipsoidal height \[m\].
#[must_use]
pub fn ecef_from_geodetic(geodetic: &Vector3<f64>) -> Vector3<f64> {
    let (latitude_rad, longitude_rad, height_m) = (geodetic.x, geodetic.y, geodetic.z);
    let n = prime_vertical_radius_m(latitude_rad);
    let rho = (n + height_m) * latitude_rad.cos();
    Vector3::new(
        rho * longitude_rad.cos(),
        rho * longitude_rad.sin(),
        (n * (1.0 - ECCENTRICITY_SQUARED) + height_m) * latitude_rad.sin(),
    )
}

/// Latitude \[rad\], longitude \[rad\], ellipsoidal height \[m\] of earth-centred Cartesian coordinates \[m\].
///
/// Bowring's formula with one correction step: exact to a nanometre below 10 km of height.
#[must_use]
pub fn geodetic_from_ecef(ecef_m: &Vector3<f64>) -> Vector3<f64> {
    let semi_minor = SEMI_MAJOR_AXIS_M * (1.0 - FLATTENING);
    let rho = ecef_m.x.hypot(ecef_m.y);
    let second_eccentricity = ECCENTRICITY_SQUARED / (1.0 - ECCENTRICITY_SQUARED);
    let mut reduced = (ecef_m.z * SEMI_MAJOR_AXIS_M).atan2(rho * semi_minor);
    let mut latitude_rad = 0.0;
    for _ in 0..2 {
        latitude_rad = (ecef_m.z + second_eccentricity * semi_minor * reduced.sin().powi(3))
            .atan2(rho - ECCENTRICITY_SQUARED * SEMI_MAJOR_AXIS_M * reduced.cos().powi(3));
        reduced = ((1.0 - FLATTENING) * latitude_rad.sin()).atan2(latitude_rad.cos());
    }
    let (sin, cos) = latitude_rad.sin_cos();
    let n = prime_vertical_radius_m(latitude_rad);
    let height_m = rho * cos + ecef_m.z * sin - n * (1.0 - ECCENTRICITY_SQUARED * sin * sin);
    Vector3::new(latitude_rad, ecef_m.y.atan2(ecef_m.x), height_m)
}

/// Rotation that turns earth-centred axes into north, east, down at a latitude and longitude \[rad\].
#[must_use]
pub fn ned_from_ecef(latitude_rad: f64, longitude_rad: f64) -> Matrix3<f64> {
    let (sp, cp) = latitude_rad.sin_cos();
    let (sl, cl) = longitude_rad.sin_cos();
    Matrix3::new(-sp * cl, -sp * sl, cp, -sl, cl, 0.0, -cp * cl, -cp * sl, -sp)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_radii_of_curvature_meet_at_the_pole() {
        let pole = std::f64::consts::FRAC_PI_2;
        assert!((meridian_radius_m(pole) - prime_vertical_radius_m(pole)).abs() < 1e-6);
        // Torge, table 4.1 (GRS 80): polar radius of curvature 6 399 593.6259 m.
        assert!((meridian_radius_m(pole) - 6_399_593.626).abs() < 1e-3);
    }

    #[test]
    fn gravity_is_that_of_the_tables() {
        // NIMA TR 8350.2, table 3.4: 9.7803253359 at the equator, 9.8321849378 at the poles
        assert!((normal_gravity_mps2(0.0, 0.0) - 9.780_325_335_9).abs() < 1e-10);
        assert!((normal_gravity_mps2(std::f64::consts::FRAC_PI_2, 0.0) - 9.832_184_937_8).abs() < 1e-9);
        let gradient = normal_gravity_mps2(0.8, 1.0) - normal_gravity_mps2(0.8, 0.0);
        assert!((gradient + 3.086e-6).abs() < 2e-8, "{gradient}");
    }

    #[test]
    fn cartesian_coordinates_go_there_and_back() {
        for (lat, lon, h) in [(0.3_f64, 1.0_f64, 120.0_f64), (-1.2, -2.9, 8_900.0), (1.57, 0.1, -50.0), (0.0, 0.0, 0.0)]
        {
            let start = Vector3::new(lat, lon, h);
            let back = geodetic_from_ecef(&ecef_from_geodetic(&start));
            assert!(
                (back.x - lat).abs() < 1e-14 && (back.y - lon).abs() < 1e-14 && (back.z - h).abs() < 1e-7,
                "{back}"
            );
        }
    }

    #[test]
    fn cartesian_coordinates_agree_with_the_geodesy_crate() {
        use geodesy::prelude::{Coor3D, Ellipsoid, GeoCart};
        let wgs84 = Ellipsoid::named("WGS84").expect("a built-in ellipsoid");
        let (lat, lon, h) = (55.0_f64.to_radians(), 12.0_f64.to_radians(), 100.0);
        let theirs = wgs84.cartesian(&Coor3D::raw(lon, lat, h));
        let ours = ecef_from_geodetic(&Vector3::new(lat, lon, h));
        assert!((ours - Vector3::new(theirs.0[0], theirs.0[1], theirs.0[2])).norm() < 1e-6);
    }

    #[test]
    fn north_east_down_is_a_right_handed_rotation() {
        let r = ned_from_ecef(0.7, -1.9);
        assert!((r.determinant() - 1.0).abs() < 1e-14);
        assert!((r * r.transpose() - Matrix3::identity()).norm() < 1e-14);
    }
}
