//! Damaged bytes are refused or read, and never a panic.

use std::io::Cursor;
use std::path::Path;

use proptest::prelude::*;
use tieline_io::crs::Crs;
use tieline_io::trajectory::{sbet, smrmsg, text, trj};

fn everything(bytes: &[u8]) {
    let path = Path::new("damaged");
    if let Ok(file) = sbet::read_from(bytes, path) {
        assert!(file.trajectory.len() >= 2);
        if let Ok(accuracy) = smrmsg::read_from(bytes, path) {
            let _ = accuracy.join(file.trajectory.clone());
        }
        for code in ["EPSG:25832", "EPSG:2056"] {
            let _ = Crs::parse(code).expect("a known code").to_map(&file.trajectory);
        }
    }
    let _ = smrmsg::read_from(bytes, path);
    if let Ok(file) = trj::read_from(bytes, path) {
        let _ = file.into_trajectory(path);
    }
    let columns = ["time_s", "east_m", "north_m", "h_m", "roll_rad", "pitch_deg", "yaw_deg"].map(str::to_string);
    for columns in [None, Some(columns.as_slice())] {
        let _ = text::read_from(|| Ok(Cursor::new(bytes.to_vec())), path, columns);
    }
}

fn good_sbet() -> Vec<u8> {
    let row = |i: u32| {
        [100.0 + f64::from(i), 0.8, 0.1, 900.0, 60.0, 1.0, 0.0, 0.01, 0.02, 1.0, 0.1, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]
    };
    (0..20).flat_map(row).flat_map(f64::to_le_bytes).collect()
}

fn good_trj() -> Vec<u8> {
    let mut bytes = b"TSCANTRJ".to_vec();
    for number in [20_010_715_i32, 1376, 20, 64] {
        bytes.extend(number.to_le_bytes());
    }
    bytes.resize(1376, 0);
    for i in 0..20_u32 {
        let row = [100.0 + f64::from(i), 5e5, 5e6, 900.0, 45.0, 1.0, 2.0];
        bytes.extend(row.iter().flat_map(|v: &f64| v.to_le_bytes()));
        bytes.extend([0; 8]);
    }
    bytes
}

fn good_text() -> Vec<u8> {
    let mut text = String::from("# flight\nTime[s],Easting[m],Northing[m],Height[m],Roll,Pitch,Yaw\n");
    for i in 0..20 {
        text += &format!("{},{}.5,5e6,900,1,-2,190\n", 100 + i, 500_000 + i);
    }
    text.into_bytes()
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 2000, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn changed_bytes_never_panic(
        which in 0..3_usize,
        changes in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..12),
        cut in any::<prop::sample::Index>(),
        is_cut in any::<bool>(),
    ) {
        let mut bytes = [good_sbet, good_trj, good_text][which]();
        for (at, value) in changes {
            let at = at.index(bytes.len());
            bytes[at] = value;
        }
        if is_cut {
            bytes.truncate(cut.index(bytes.len()));
        }
        everything(&bytes);
    }

    #[test]
    fn any_bytes_never_panic(bytes in prop::collection::vec(any::<u8>(), 0..600)) {
        everything(&bytes);
    }

    #[test]
    fn any_text_never_panics(text in "[-0-9a-z.,;# \\t\\n\\[\\]]{0,300}") {
        everything(text.as_bytes());
    }

    #[test]
    fn any_crs_text_never_panics(text in "(EPSG:|PROJCS|COMPD_CS|\\+proj=utm |local)?[-+=0-9A-Za-z:,\"\\[\\] _.é]{0,120}") {
        let _ = Crs::parse(&text);
    }

    #[test]
    fn any_geokeys_never_panic(bytes in prop::collection::vec(any::<u8>(), 0..80)) {
        let _ = Crs::from_geokeys(&bytes);
    }
}

#[test]
fn the_undamaged_files_are_good() {
    let path = Path::new("good");
    assert_eq!(sbet::read_from(good_sbet().as_slice(), path).expect("good").trajectory.len(), 20);
    let trj = trj::read_from(good_trj().as_slice(), path).expect("good");
    assert_eq!(trj.into_trajectory(path).expect("good").trajectory.len(), 20);
    let text = text::read_from(|| Ok(Cursor::new(good_text())), path, None).expect("good");
    assert_eq!(text.trajectory.len(), 20);
}
