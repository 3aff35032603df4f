//! Ties in text: there and back, and what is refused, each with line, value and remedy.

use std::path::Path;

use nalgebra::{Matrix3, Rotation3, Vector3};
use proptest::prelude::*;
use tieline_filter::{TieClass, TieKind};
use tieline_io::ties::text::{TextSighting, TextTie, TieTextHeader, TieTextReader, write_tie_text, write_to};

const HEADER: &str = "# tieline ties 1\n# week: 2330\n# time: gps\n# units: m\n# directions: ecef\n# body: frd\n# calibration: applied\n";
/// A row without tie, time and what follows.
const ROW: &str = "0 1.5 -2.25 2.5 1 1 0 0 1 0.0001";

fn read(text: &str) -> Result<(TieTextHeader, Vec<TextTie>), String> {
    let reader = TieTextReader::new(text.as_bytes(), Path::new("given/ties.txt")).map_err(|e| e.to_string())?;
    let header = reader.header().clone();
    Ok((header, reader.collect::<Result<_, _>>().map_err(|e| e.to_string())?))
}

fn good() -> String {
    format!("{HEADER}7 pass_to_pass surface_line 1 100.5 {ROW}\n7 pass_to_pass surface_line 1 160.5 {ROW}\n")
}

/// The file as changed is refused with a message that names the file and holds the words.
fn refused(text: &str, words: &[&str]) {
    let message = read(text).expect_err("refused");
    for word in ["given/ties.txt"].iter().chain(words) {
        assert!(message.contains(word), "\"{word}\" is not in: {message}");
    }
}

/// The good file with a text replaced once.
fn with(from: &str, to: &str) -> String {
    let text = good();
    assert!(text.contains(from), "{from}");
    text.replacen(from, to, 1)
}

#[test]
fn a_file_says_week_frames_and_sightings() {
    let (header, ties) = read(&good()).expect("good");
    assert_eq!(header, TieTextHeader { week: Some(2330), datum: None });
    assert_eq!((ties.len(), ties[0].id, ties[0].class), (1, 7, TieClass::PassToPass));
    let tie = ties[0].for_smoother(-604_800.0).expect("two sightings in use");
    assert_eq!(tie.sightings[0].body_vector_m, Vector3::new(1.5, -2.25, 2.5));
    assert!((tie.sightings[1].time_s - (160.5 - 604_800.0)).abs() < 1e-9 && tie.directions[0] == Vector3::z());
}

#[test]
fn a_sighting_that_was_not_used_stays_out_and_a_weight_widens() {
    let third =
        format!("{}7 pass_to_pass surface_line 1 170 0 1 1 1 1 0.25 0 0 1 0.0001\n", with(" 1 1 0 0 1", " 0 0 0 0 1"));
    let (_, ties) = read(&third).expect("good");
    let tie = ties[0].for_smoother(0.0).expect("two sightings in use");
    assert!((tie.sightings[0].time_s - 160.5).abs() < 1e-12 && tie.sightings.len() == 2);
    assert!((tie.sightings[1].covariance_m2[(0, 0)] - 4e-4).abs() < 1e-15);
    let (_, ties) = read(&with(" 1 1 0 0 1", " 0 0 0 0 1")).expect("good");
    assert!(ties[0].for_smoother(0.0).is_none());
}

#[test]
fn the_week_may_be_unknown_and_fields_may_stand_between_commas() {
    let (header, ties) = read(&with("week: 2330", "week: unknown")).expect("good");
    assert!(header.week.is_none() && ties.len() == 1);
    let commas: String = good()
        .lines()
        .map(|l| if l.starts_with('#') { format!("{l}\n") } else { l.replace(' ', ", ") + "\n" })
        .collect();
    assert_eq!(read(&commas).expect("good").1, ties);
}

#[test]
fn a_header_that_misses_or_contradicts_is_refused() {
    refused("", &["begins with"]);
    refused("tie_id,kind\n", &["tie_id,kind", "# tieline ties"]);
    refused(&with("ties 1", "ties 2"), &["line 1", "\"2\"", "newer"]);
    refused(&with("# week: 2330\n", ""), &["week", "add the line"]);
    refused(&with("week: 2330", "week: -3"), &["line 2", "-3", "GPS week"]);
    refused(&with("time: gps", "time: utc"), &["line 3", "time", "utc", "gps"]);
    refused(&with("directions: ecef", "directions: enu"), &["directions", "enu", "ecef"]);
    refused(&with("body: frd", "body: flu"), &["body", "flu", "frd"]);
    refused(&with("calibration: applied", "calibration: none"), &["calibration", "none", "applied"]);
    refused(&with("# body: frd\n", ""), &["# body: frd"]);
    refused(&format!("{}{HEADER}", good()), &["line 10", "second header"]);
}

#[test]
fn a_row_that_cannot_be_is_refused_with_line_value_and_remedy() {
    refused(&with(" 0.0001\n", "\n"), &["line 8", "14 fields", "15", "rank 1"]);
    refused(&with(" 0.0001\n", " 0.0001 3\n"), &["line 8", "16 fields"]);
    refused(&with(" 1 100.5", ""), &["line 8", "rank", "\"0\""]);
    refused(&with("-2.25", "NaN"), &["line 8", "body_y_m", "NaN", "finite"]);
    refused(&with("-2.25", "1e9"), &["line 8", "1000000000", "100 km"]);
    refused(&with("-2.25", "left"), &["line 8", "body_y_m", "left"]);
    refused(&with("surface_line", "submap"), &["line 8", "kind", "submap", "xyz_point"]);
    refused(&with("pass_to_pass", "pass"), &["line 8", "class", "strip_to_strip"]);
    refused(&with("surface_line 1", "xyz_point 1"), &["line 8", "rank 1", "xyz_point", "3"]);
    refused(&with("surface_line 1", "surface_line 4"), &["line 8", "rank", "\"4\""]);
    refused(&with("0 0 1 0.0001", "0 0 1.01 0.0001"), &["line 8", "direction 1", "1.0100000", "divide"]);
    refused(&with("0 0 1 0.0001", "0 0 0 0.0001"), &["line 8", "direction 1"]);
    refused(&with("0 0 1 0.0001", "0 0 1 -0.0001"), &["line 8", "variance", "-1e-4"]);
    refused(&with("0 0 1 0.0001", "0 0 1 0"), &["line 8", "variance"]);
    refused(&with("0 0 1 0.0001", "0 0 1 nan"), &["line 8", "covariance_m2", "nan"]);
    refused(&with("100.5", "1306235306.5"), &["line 8", "time_s", "1306235306.5", "week"]);
    refused(&with("100.5", "-1"), &["line 8", "time_s", "-1"]);
    refused(&with("2.5 1 1", "2.5 1 0"), &["line 8", "weight 0"]);
    refused(&with("2.5 1 1", "2.5 1 1.5"), &["line 8", "weight", "1.5"]);
    refused(&with("2.5 1 1", "2.5 yes 1"), &["line 8", "used", "yes"]);
    refused(&with("100.5 0", "100.5 70000"), &["line 8", "scanner", "70000"]);
}

#[test]
fn rows_that_do_not_make_a_tie_are_refused() {
    refused(&with("160.5", "100.25"), &["line 9", "tie 7", "100.25", "100.5", "sort"]);
    refused(
        &with("7 pass_to_pass surface_line 1 160.5", "8 pass_to_pass surface_line 1 160.5"),
        &["line 8", "tie 7", "one sighting"],
    );
    refused(
        &format!(
            "{}8 pass_to_pass surface_line 1 1 {ROW}\n8 pass_to_pass surface_line 1 2 {ROW}\n7 pass_to_pass surface_line 1 3 {ROW}\n",
            good()
        ),
        &["line 12", "tie 7", "together"],
    );
    refused(&with("surface_line 1 160.5", "increment 1 160.5"), &["line 9", "kind", "tie 7"]);
    refused(&with("pass_to_pass surface_line 1 160.5", "strip_to_strip surface_line 1 160.5"), &["line 9", "class"]);
    let other = good().replacen("0 0 1 0.0001", "0 1 0 0.0001", 1);
    refused(&other, &["line 9", "direction", "tie 7"]);
}

#[test]
fn directions_of_a_point_stand_at_right_angles_and_its_covariance_is_definite() {
    let row = |u: &str, c: &str| {
        let one = |t: f64| format!("1 strip_to_strip line 2 {t} 0 1 1 1 1 1 {u} {c}\n");
        format!("{HEADER}{}{}", one(5.0), one(9.0))
    };
    assert!(read(&row("1 0 0 0 1 0", "1e-4 5e-5 1e-4")).is_ok());
    refused(&row("1 0 0 0.6 0.8 0", "1e-4 0 1e-4"), &["line 8", "directions 1 and 2", "6.00e-1"]);
    refused(&row("1 0 0 0 1 0", "1e-4 2e-4 1e-4"), &["line 8", "positive definite", "upper triangle"]);
    refused(&row("1 0 0 0 1 0", "1e-4 0 -1e-4"), &["line 8", "direction 2", "-1e-4"]);
}

#[test]
fn a_file_on_the_disk_comes_back_plain_and_gzipped() {
    let (header, ties) = read(&good()).expect("good");
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("ties.txt");
    write_tie_text(&path, &header, &ties).expect("written");
    let again: Vec<TextTie> = TieTextReader::open(&path).expect("opens").map(|t| t.expect("a tie")).collect();
    assert_eq!(again, ties);
    let message = TieTextReader::open(&folder.path().join("none.txt")).expect_err("not there").to_string();
    assert!(message.contains("none.txt"), "{message}");
}

fn tie(id: u64) -> impl Strategy<Value = TextTie> {
    let kinds = [TieKind::SurfaceLine, TieKind::Increment, TieKind::Line, TieKind::XyzPoint];
    let number = -1e3..1e3_f64;
    let sighting = (
        0.0..604_800.0_f64,
        any::<u16>(),
        [number.clone(), number.clone(), number],
        any::<bool>(),
        1e-6..=1.0_f64,
        [0.01..1.0_f64, 0.0..0.3, 0.0..0.3],
    );
    (0..3_usize, 0..4_usize, [-3.0..3.0_f64, -1.5..1.5, -3.0..3.0], prop::collection::vec(sighting, 2..6)).prop_map(
        move |(class, kind, angles, sightings)| {
            let kind = kinds[kind];
            let rank = kind.rank().expect("of the text");
            let turned = Rotation3::from_euler_angles(angles[0], angles[1], angles[2]);
            let directions = (0..rank).map(|k| turned.matrix().column(k).into_owned()).collect();
            let mut sightings: Vec<TextSighting> = sightings
                .into_iter()
                .map(|(time_s, scanner, l, used, weight, c)| TextSighting {
                    time_s,
                    scanner,
                    body_vector_m: Vector3::from(l),
                    covariance_m2: Matrix3::from_fn(|i, j| match (i.max(j) < rank, i == j) {
                        (false, _) => 0.0,
                        (true, true) => c[0],
                        (true, false) => c[0] * c[1 + (i + j) % 2],
                    }),
                    used,
                    weight,
                })
                .collect();
            sightings.sort_by(|a, b| a.time_s.total_cmp(&b.time_s));
            TextTie { id, class: TieClass::ALL[class], kind, directions, sightings }
        },
    )
}

proptest! {
    #[test]
    fn every_bit_comes_back(a in tie(0), b in tie(u64::MAX), week in proptest::option::of(0..9999_u32)) {
        let header = TieTextHeader { week, datum: week.map(|w| format!("frame of {w}")) };
        let mut text = Vec::new();
        write_to(&mut text, &header, [&a, &b]).expect("memory");
        let text = String::from_utf8(text).expect("UTF-8");
        prop_assert_eq!(read(&text), Ok((header, vec![a, b])));
    }

    #[test]
    fn a_damaged_file_is_read_or_refused(ties in [tie(3), tie(4)], cut in 0.0..1.0_f64, at in 0.0..1.0_f64, byte in any::<u8>()) {
        let mut text = Vec::new();
        write_to(&mut text, &TieTextHeader { week: Some(2330), datum: None }, &ties).expect("memory");
        #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss, clippy::cast_precision_loss)] // within the text
        let place = |share: f64| (share * text.len() as f64) as usize;
        let (cut, at) = (place(cut), place(at));
        text[at] = byte;
        let _ = read(&String::from_utf8_lossy(&text));
        let _ = read(&String::from_utf8_lossy(&text[..cut]));
    }
}
