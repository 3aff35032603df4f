//! Ties in text of any bytes: what is read can be used by a smoother, and comes back when written.
#![no_main]

use std::path::Path;

use libfuzzer_sys::fuzz_target;
use tieline_io::ties::text::{TextTie, TieTextReader, write_to};

fn read(bytes: &[u8]) -> Option<(tieline_io::ties::text::TieTextHeader, Vec<TextTie>)> {
    let reader = TieTextReader::new(bytes, Path::new("fuzz")).ok()?;
    let header = reader.header().clone();
    Some((header, reader.collect::<Result<_, _>>().ok()?))
}

fn check(bytes: &[u8]) {
    let Some((header, ties)) = read(bytes) else { return };
    for tie in &ties {
        assert!(tie.sightings.len() >= 2 && tie.kind.rank() == Some(tie.directions.len()), "{tie:?}");
        assert!(tie.sightings.windows(2).all(|w| w[0].time_s <= w[1].time_s), "{tie:?}");
        assert!(tie.directions.iter().all(|u| (u.norm() - 1.0).abs() < 1e-5), "{tie:?}");
        if let Some(tie) = tie.for_smoother(0.0) {
            let rank = tie.directions.len();
            assert!(tie.sightings.iter().all(|s| (0..rank).all(|k| s.covariance_m2[(k, k)] > 0.0)), "{tie:?}");
            assert!(tie.sightings.iter().all(|s| s.covariance_m2.iter().all(|v| v.is_finite())), "{tie:?}");
        }
    }
    let mut text = Vec::new();
    write_to(&mut text, &header, &ties).expect("memory");
    assert_eq!(read(&text), Some((header, ties)));
}

const HEADER: &str = "# tieline ties 1\n# week: 2330\n# time: gps\n# units: m\n# directions: ecef\n# body: frd\n# calibration: applied\n";

fuzz_target!(|data: &[u8]| {
    check(data);
    check(&[HEADER.as_bytes(), data].concat());
});
