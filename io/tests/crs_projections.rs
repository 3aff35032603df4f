//! Map projections against PROJ, and trajectories into the map and back.

use nalgebra::Vector3;
use tieline_filter::earth::{
    ecef_from_geodetic, geodetic_from_ecef, meridian_radius_m, ned_from_ecef, prime_vertical_radius_m,
};
use tieline_filter::{PositionFrame, Trajectory, ned_from_body};
use tieline_io::crs::{Crs, CrsError, CrsKind};

fn geodetic(latitude_deg: f64, longitude_deg: f64, height_m: f64) -> Vector3<f64> {
    Vector3::new(latitude_deg.to_radians(), longitude_deg.to_radians(), height_m)
}

/// X-Val: pyproj 3.7, `Transformer.from_crs("EPSG:4979", code, always_xy=True)` and `Proj(code).get_factors`.
#[allow(clippy::type_complexity)]
const PUBLISHED: &[(&str, (f64, f64, f64), (f64, f64), (f64, f64))] = &[
    ("EPSG:25832", (55.0, 12.0, 100.0), (691_875.632_140, 6_098_907.825_005), (0.042_903_681_479, 1.000_051_680_937)),
    ("EPSG:25832", (47.3, 8.1, 900.0), (431_961.134_062, 5_238_895.635_512), (-0.011_544_452_199, 0.999_656_891_172)),
    ("EPSG:32633", (59.34, 17.94, 45.0), (667_206.391_654, 6_581_603.655_205), (0.044_149_728_621, 0.999_942_679_088)),
    ("EPSG:2154", (48.85, 2.35, 50.0), (652_301.564_831, 6_861_302.725_900), (-0.008_231_758_976, 0.999_887_800_281)),
    ("EPSG:2154", (43.3, 5.4, 100.0), (894_829.409_053, 6_247_498.204_342), (0.030_394_186_988, 1.000_595_001_683)),
];

#[test]
fn conformal_projections_agree_with_proj_in_coordinates_convergence_and_scale() {
    for &(code, (lat, lon, h), (east, north), (convergence, scale)) in PUBLISHED {
        let crs = Crs::parse(code).expect("a known code");
        let place = geodetic(lat, lon, h);
        let map = crs.map_from_geodetic(&place).expect("inside");
        assert!((map - Vector3::new(east, north, h)).norm() < 1e-5, "{code}: {map}");
        let back = crs.geodetic_from_map(&map).expect("inside");
        assert!((back - place).xy().norm() < 1e-13, "{code}: {}", (back - place));
        let grid = crs.grid_at(&place).expect("inside");
        assert!((grid.convergence_rad - convergence).abs() < 1e-9, "{code}: {grid:?}");
        // PROJ's own factors are numerical too: its two scales differ by 5e-11. They hold on the ellipsoid.
        let below = crs.grid_at(&geodetic(lat, lon, 0.0)).expect("inside");
        assert!((below.scale - scale).abs() < 1e-9, "{code}: {below:?}");
        assert!((below.convergence_rad - convergence).abs() < 1e-9, "{code}: {below:?}");
        assert!(below.distortion < 1e-9, "{code}: {below:?}");
        // At its height a length looks shorter in the map; the two radii differ by 0.3 % there.
        let (meridian, prime) = (meridian_radius_m(place.x), prime_vertical_radius_m(place.x));
        let expected = scale * 0.5 * (meridian / (meridian + h) + prime / (prime + h));
        assert!((grid.scale - expected).abs() < 1e-9, "{code}: {grid:?}, not {expected}");
    }
}

#[test]
fn swiss_coordinates_agree_with_proj_through_the_datum_shift() {
    // X-Val: pyproj 3.7, EPSG:4979 to EPSG:2056 and 21781: the height takes part in the shift of 674 m, 15 m, 405 m.
    for (code, place, east, north) in [
        ("EPSG:2056", geodetic(46.95, 7.44, 600.0), 2_600_104.102_701, 1_199_879.614_388),
        ("EPSG:2056", geodetic(47.3769, 8.5417, 450.0), 2_683_303.887_884, 1_247_925.617_105),
        ("EPSG:2056", geodetic(46.2, 6.15, 2000.0), 2_500_532.736_224, 1_117_323.309_195),
        ("EPSG:21781", geodetic(47.3769, 8.5417, 450.0), 683_303.887_884, 247_925.617_105),
    ] {
        let crs = Crs::parse(code).expect("a known code");
        let map = crs.map_from_geodetic(&place).expect("inside");
        assert!((map.xy() - nalgebra::Vector2::new(east, north)).norm() < 1e-5, "{code}: {map}");
        assert!((map.z - place.z).abs() < 1e-12, "heights stay");
        let back = crs.geodetic_from_map(&map).expect("inside");
        let miss = ecef_from_geodetic(&back) - ecef_from_geodetic(&place);
        assert!(miss.norm() < 1e-6, "{code}: {miss}");
    }
}

#[test]
fn an_equal_area_projection_has_the_mean_scale_and_says_how_far_it_is_from_conformal() {
    // X-Val: pyproj 3.7, EPSG:3005: E 1382469.607, N 1127447.615, scales 1.002707749 and 0.997299563.
    let crs = Crs::parse("EPSG:3005").expect("a known code");
    let place = geodetic(55.0, -120.0, 900.0);
    let map = crs.map_from_geodetic(&place).expect("inside");
    assert!((map - Vector3::new(1_382_469.607_017, 1_127_447.615_246, 900.0)).norm() < 1e-4, "{map}");
    let grid = crs.grid_at(&geodetic(55.0, -120.0, 0.0)).expect("inside");
    assert!((grid.convergence_rad - 0.084_755_552_339).abs() < 1e-9, "{grid:?}");
    assert!((grid.scale - 0.5 * (1.002_707_749_243 + 0.997_299_562_830)).abs() < 1e-8, "{grid:?}");
    assert!((grid.distortion - 0.002_704).abs() < 1e-5, "{grid:?}");
}

#[test]
fn codes_wkt_and_proj_strings_of_one_system_are_the_same_and_others_are_not() {
    let utm = Crs::parse("EPSG:25832").expect("a known code");
    let wkt = crs_definitions_wkt(25832);
    for same in ["+proj=utm +zone=32 +ellps=GRS80 +units=m +no_defs", "epsg:32632", "EPSG:25832+7837", wkt] {
        let other = Crs::parse(same).expect(same);
        assert!(utm.is_same(&other) && other.is_same(&utm), "{same}");
    }
    for different in ["EPSG:25833", "EPSG:2056", "EPSG:31467", "EPSG:4326", "local"] {
        assert!(!utm.is_same(&Crs::parse(different).expect(different)), "{different}");
    }
    assert_eq!(Crs::parse("EPSG:25832+7837").expect("compound").vertical(), Some("EPSG:7837"));
}

fn crs_definitions_wkt(code: u16) -> &'static str {
    crs_definitions::from_code(code).expect("a known code").wkt
}

#[test]
fn a_system_known_only_by_its_wkt_is_evaluated_from_it() {
    let wkt = crs_definitions_wkt(2154).replace("AUTHORITY[\"EPSG\",\"2154\"]", "AUTHORITY[\"NONE\",\"1\"]");
    let crs = Crs::parse(&wkt).expect("a Lambert projection");
    assert_eq!(crs.epsg(), None);
    assert!(crs.is_same(&Crs::parse("EPSG:2154").expect("a known code")));
}

#[test]
fn geokeys_name_the_horizontal_and_the_vertical_system() {
    let keys: Vec<u8> = [1_u16, 1, 0, 3, 1024, 0, 1, 1, 3072, 0, 1, 25832, 4096, 0, 1, 5783]
        .iter()
        .flat_map(|number| number.to_le_bytes())
        .collect();
    let crs = Crs::from_geokeys(&keys).expect("understood").expect("a code");
    assert_eq!((crs.epsg(), crs.vertical()), (Some(25832), Some("EPSG:5783")));
    assert!(Crs::from_geokeys(&keys[..keys.len() / 4]).expect("understood").is_none());
    assert!(Crs::from_geokeys(&[]).expect("understood").is_none());
}

#[test]
fn what_cannot_be_used_is_refused_with_its_remedy() {
    for (text, word) in [
        ("nonsense", "EPSG:25832"),
        ("EPSG:abc", "EPSG:25832"),
        ("EPSG:99999999", "epsg.io/99999999"),
        ("EPSG:2263", "metric"),  // New York, feet
        ("EPSG:2048", "easting"), // South Africa, westing and southing
        ("+proj=nonsense", "another definition"),
        ("EPSG:4978", "EPSG"),
        ("PROJCS[\"x\"]", "definition"),
        ("", "EPSG:25832"),
        ("+proj=lcc +lat_0=46.'כ\"", "EPSG:25832"),
    ] {
        let error = Crs::parse(text).expect_err(text).to_string();
        assert!(error.contains(word), "{text}: {error}");
    }
    let degrees = Crs::parse("EPSG:4326").expect("a known code");
    assert_eq!(degrees.kind(), CrsKind::Geographic);
    let error = degrees.to_map(&flight()).expect_err("degrees are no metres");
    assert!(matches!(error, CrsError::Geographic { .. }) && error.to_string().contains("reproject"), "{error}");
    let local = Crs::parse("local").expect("local");
    assert_eq!(local.to_map(&flight()).expect_err("no origin"), CrsError::NoOrigin);
}

/// Two minutes over the Alps at 60 m/s, turning, with a jump.
fn flight() -> Trajectory {
    let n = 600;
    let time_s: Vec<f64> = (0..n).map(|i| 388_800.0 + 0.2 * f64::from(i)).collect();
    let position = (0..n).map(|i| {
        let s = f64::from(i) / f64::from(n);
        let jump = if i > 300 { 0.05 } else { 0.0 };
        geodetic(46.8 + 0.06 * s + jump, 9.6 + 0.08 * s * s, 3100.0 + 20.0 * (9.0 * s).sin())
    });
    let attitude = (0..n).map(|i| ned_from_body(0.01, 0.03, 0.6 + 0.003 * f64::from(i)));
    let velocity = (0..n).map(|i| Vector3::new(50.0, 30.0 + 0.01 * f64::from(i), -0.5));
    Trajectory::new(PositionFrame::Geodetic, time_s, position.collect(), attitude.collect(), velocity.collect())
        .expect("a good trajectory")
}

#[test]
fn a_trajectory_goes_to_the_map_and_back() {
    let start = flight();
    let local = Crs::local(geodetic(46.8, 9.6, 1000.0)).expect("a place");
    for crs in [Crs::parse("EPSG:25832").expect("code"), Crs::parse("EPSG:2056").expect("code"), local] {
        let map = crs.to_map(&start).expect("inside");
        assert_eq!(map.frame(), PositionFrame::Map);
        let back = crs.to_geodetic(&map).expect("inside");
        for i in 0..start.len() {
            let miss = ecef_from_geodetic(&back.position()[i]) - ecef_from_geodetic(&start.position()[i]);
            assert!(miss.norm() < 1e-6, "{}: epoch {i}: {}", crs.name(), miss.norm());
            assert!(back.ned_from_body()[i].angle_to(&start.ned_from_body()[i]) < 1e-12);
            assert!((back.velocity_ned_mps()[i] - start.velocity_ned_mps()[i]).norm() < 1e-10);
        }
    }
}

#[test]
fn convergence_and_scale_along_a_trajectory_are_those_at_each_epoch() {
    let start = flight();
    let crs = Crs::parse("EPSG:25832").expect("a known code");
    let map = crs.to_map(&start).expect("inside");
    for i in (0..start.len()).step_by(7) {
        let grid = crs.grid_at(&start.position()[i]).expect("inside");
        assert!((map.grid()[i].0 - grid.convergence_rad).abs() < 1e-9, "epoch {i}");
        assert!((map.grid()[i].1 - grid.scale).abs() < 1e-9, "epoch {i}");
    }
}

#[test]
fn a_short_step_north_east_down_lands_where_the_map_says() {
    let crs = Crs::parse("EPSG:25832").expect("a known code");
    let map = crs.to_map(&flight()).expect("inside");
    let pose = map.epoch(40);
    let start = crs.geodetic_from_map(&pose.position).expect("inside");
    // Straight through space, as a beam goes: the earth curves away by 36² / 2R = 0.10 mm, and 5 m higher up the map
    // has 0.8 ppm less room.
    let beam = Vector3::new(20.0, 30.0, -5.0);
    let there = ecef_from_geodetic(&start) + ned_from_ecef(start.x, start.y).transpose() * beam;
    let there = crs.map_from_geodetic(&geodetic_from_ecef(&there)).expect("inside");
    let by_pose = pose.position + pose.map_from_ned * beam;
    assert!((there - by_pose).norm() < 1.1e-4, "{}", there - by_pose);
    assert!((there - by_pose).xy().norm() < 4e-5, "{}", there - by_pose);
}

#[test]
fn a_heading_from_grid_north_becomes_true_by_the_convergence() {
    let crs = Crs::parse("EPSG:25832").expect("a known code");
    let map = crs.to_map(&flight()).expect("inside");
    let plain = Trajectory::new(
        PositionFrame::Map,
        map.time_s().to_vec(),
        map.position().to_vec(),
        (0..map.len())
            .map(|i| {
                let (r, p, h) = tieline_filter::frames::roll_pitch_heading_rad(&map.ned_from_body()[i]);
                ned_from_body(r, p, h - map.grid()[i].0)
            })
            .collect(),
        map.velocity_ned_mps().to_vec(),
    )
    .expect("a good trajectory");
    let turned = crs.to_map_from_grid_heading(&plain).expect("inside");
    for i in 0..map.len() {
        assert!(turned.ned_from_body()[i].angle_to(&map.ned_from_body()[i]) < 1e-12);
    }
}

#[test]
fn a_local_system_is_level_at_its_origin_and_bends_with_the_earth() {
    let crs = Crs::local(geodetic(46.8, 9.6, 1000.0)).expect("a place");
    let aside = crs.map_from_geodetic(&geodetic(46.8 + 0.09, 9.6, 1000.0)).expect("inside");
    // 10 km north: d²/2R = 7.87 m below the horizon.
    assert!((aside.z + aside.y.powi(2) / (2.0 * 6.37e6)).abs() < 0.02, "{aside}");
    assert!(Crs::local(Vector3::new(f64::NAN, 0.0, 0.0)).is_err());
    assert!(Crs::local(Vector3::new(46.8, 9.6, 1000.0)).is_err(), "degrees");
}

#[test]
fn a_geoid_undulation_is_taken_off_the_height_and_put_back() {
    let crs = Crs::parse("EPSG:2056").expect("a known code").with_geoid_undulation_m(49.5);
    let place = geodetic(46.95, 7.44, 600.0);
    let map = crs.map_from_geodetic(&place).expect("inside");
    assert!((map.z - 550.5).abs() < 1e-12);
    assert!((crs.geodetic_from_map(&map).expect("inside").z - 600.0).abs() < 1e-9);
}
