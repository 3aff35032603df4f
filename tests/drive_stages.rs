//! The stages of a drive one by one: same bytes as `run`, each refusing what is not there, corrections reversible.

mod common;

use std::collections::BTreeMap;
use std::path::Path;
use std::sync::OnceLock;

use common::{Bench, largest_difference_m};
use tieline_io::las::LasFile;

fn project() -> String {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("samples/loop/project.toml").display().to_string()
}

/// The sample drive through all stages, once for all tests, and the files of its output folder.
fn staged() -> &'static (Bench, BTreeMap<String, Vec<u8>>) {
    static STAGED: OnceLock<(Bench, BTreeMap<String, Vec<u8>>)> = OnceLock::new();
    STAGED.get_or_init(|| {
        let bench = Bench::new();
        for stage in ["match", "calibrate", "solve", "correct", "report"] {
            let mut arguments = vec![stage, "PROJECT", "-q", "--out", "out"];
            let project = project();
            arguments[1] = &project;
            if stage != "correct" {
                arguments.push("--csv");
            }
            bench.tieline(&arguments).assert_success();
        }
        let files = bench.files("out");
        (bench, files)
    })
}

/// Without what the clock on the wall and the machine say.
fn timeless(bytes: &[u8]) -> serde_json::Value {
    let mut value: serde_json::Value = serde_json::from_slice(bytes).expect("JSON");
    let object = value.as_object_mut().expect("a table");
    for key in ["timing", "peak_memory_bytes"] {
        assert!(object.remove(key).is_some(), "{key}");
    }
    value
}

/// A page without its section of times.
fn without_times(page: &[u8]) -> String {
    let page = String::from_utf8_lossy(page).into_owned();
    let from = page.find("<section id=\"times\">").expect("a section of times");
    let to = from + page[from..].find("</section>").expect("its end");
    format!("{}{}", &page[..from], &page[to..])
}

#[test]
fn the_stages_of_a_drive_give_what_run_gives() {
    let ran = Bench::new();
    ran.tieline(&["run", &project(), "-q", "--csv", "--out", "out"]).assert_success();
    let (mut one, mut other) = (ran.files("out"), staged().1.clone());
    assert!(other.remove("stages/calibrate.json").is_some());
    assert_eq!(one.keys().collect::<Vec<_>>(), other.keys().collect::<Vec<_>>());
    let mut both = |name: &str| (one.remove(name).expect("there"), other.remove(name).expect("there"));
    let (a, b) = both("summary.json");
    assert_eq!(timeless(&a), timeless(&b));
    let (a, b) = both("report.html");
    assert!(without_times(&a) == without_times(&b), "report.html differs");
    let (a, b) = both("stages/solve.json");
    let state = |bytes: &[u8]| -> serde_json::Value {
        let mut value: serde_json::Value = serde_json::from_slice(bytes).expect("JSON");
        // times and corrected files come into the summary one after the other
        value["summary"] = serde_json::Value::Null;
        value
    };
    assert!(state(&a) == state(&b), "stages/solve.json differs");
    for (name, bytes) in &one {
        assert!(*bytes == other[name], "{name} differs");
    }
    for name in ["corrected/pass1.laz", "ties.txt", "ties.csv", "calibration.toml", "range_bias.csv", "trajectory.sbet"]
    {
        assert!(one.contains_key(name), "{name} is not there");
    }
}

#[test]
fn held_out_ties_take_no_part_and_show_the_gain_over_range() {
    let files = &staged().1;
    let text = String::from_utf8_lossy(&files["ties.csv"]).into_owned();
    let mut lines = text.lines();
    let columns: Vec<&str> = lines.next().expect("a head").split(',').collect();
    let column = |name: &str| columns.iter().position(|c| *c == name).expect("a column");
    let (used, held) = (column("used"), column("held_out"));
    let rows: Vec<Vec<&str>> = lines.map(|l| l.split(',').collect()).collect();
    let is = |row: &[&str], at: usize| matches!(row[at], "true" | "1");
    let count = rows.iter().filter(|r| is(r, held)).count();
    assert!(count * 10 > rows.len() && count * 3 < rows.len(), "{count} of {}", rows.len());
    assert!(rows.iter().all(|r| !(is(r, held) && is(r, used))), "a tie that was held out was used");
    let summary = timeless(&files["summary.json"]);
    let over = summary["difference_over"].as_array().expect("a list");
    for axis in ["range", "lateral distance"] {
        let worst = |stage: &str| -> f64 {
            let mine =
                over.iter().find(|d| d["class"] == "scanner to scanner" && d["over"] == axis && d["held_out"] == true);
            let bins = mine.expect("held-out ties")[stage].as_array().expect("bins");
            assert!(bins.len() > 3, "{bins:?}");
            bins.iter().map(|b| b["median_m"].as_f64().expect("a number").abs()).fold(0.0, f64::max)
        };
        assert!(worst("after") < 0.5 * worst("before"), "{axis}: {} {}", worst("before"), worst("after"));
    }
}

#[test]
fn ties_are_measured_again_and_the_report_shows_the_worst_places() {
    let files = &staged().1;
    let summary = timeless(&files["summary.json"]);
    let again = &summary["measured_again"];
    let number = |key: &str| again[key].as_u64().expect("a number");
    assert!(number("times") >= 1 && number("pairs_before") > 5_000, "{again}");
    assert_eq!(number("pairs_before") + number("pairs_gained"), number("pairs_after") + number("pairs_lost"));
    let moved_m = again["largest_motion_m"].as_f64().expect("a number");
    assert!(moved_m > 0.03 && moved_m < 0.3, "{moved_m}");
    let notes = summary["notes"].as_array().expect("a list");
    let says = |words: &str| notes.iter().filter(|n| n.as_str().is_some_and(|n| n.contains(words))).count();
    assert_eq!(says("measured again on the corrected cloud"), 1, "{notes:?}");
    let page = String::from_utf8_lossy(&files["report.html"]).into_owned();
    for words in ["<section id=\"cuts\">", "Between visits", "visit 2, second", "Innovations of ties over time"] {
        assert!(page.contains(words), "{words}");
    }
    // the files that were corrected, told by `correct`, stand in the page that `report` wrote
    assert!(page.contains("corrected/pass1.laz") && files.contains_key("stages/correct.json"));
}

#[test]
fn corrections_of_a_drive_can_be_taken_off_again() {
    let (bench, before) = staged();
    let corrected = ["pass1.laz", "pass2.laz"].map(|name| format!("out/corrected/{name}"));
    bench
        .tieline(&["correct", &project(), &corrected[0], &corrected[1], "--inverse", "--out", "out", "-q"])
        .assert_success();
    let strips = Path::new(&project()).parent().expect("a folder").join("strips");
    for name in ["pass1.laz", "pass2.laz"] {
        let (input, restored) = (strips.join(name), bench.path(&format!("out/restored/{name}")));
        let moved_m = largest_difference_m(&input, &bench.path(&format!("out/corrected/{name}")));
        let scale_m = LasFile::open(&input).expect("opens").header().scale[0];
        let left_m = largest_difference_m(&input, &restored);
        assert!(moved_m > 0.02 && left_m <= 1.500_001 * scale_m, "{name}: {moved_m} m, comes back with {left_m} m");
    }
    let after = bench.files("out");
    for (name, bytes) in before {
        assert!(*bytes == after[name], "{name} was touched");
    }
}

#[test]
fn a_stage_says_what_calibrate_found_and_left() {
    let (bench, _) = staged();
    let again = bench.tieline(&["report", &project(), "--out", "out"]);
    assert_eq!(again.assert_success().out.lines().count(), 3, "{}", again.out);
    // what calibrate wrote is what solve writes: it is one adjustment
    let folder = tempfile::tempdir().expect("a folder");
    std::fs::create_dir(folder.path().join("stages")).expect("created");
    std::fs::copy(bench.path("out/stages/match.json"), folder.path().join("stages/match.json")).expect("copied");
    let out = folder.path().display().to_string();
    let summary = bench.tieline(&["calibrate", &project(), "--out", &out, "--json"]).json();
    for name in ["calibration.toml", "range_bias.csv"] {
        let of = |path: std::path::PathBuf| std::fs::read(path).expect("there");
        assert!(of(folder.path().join(name)) == of(bench.path(&format!("out/{name}"))), "{name} differs");
    }
    assert_eq!(summary["drives"].as_array().map(Vec::len), Some(1));
    assert!(summary["calibration"]["estimates"].as_array().is_some_and(|e| !e.is_empty()), "{summary}");
    assert!(!folder.path().join("corrected").exists() && !folder.path().join("trajectory.csv").exists());
    // solve begins anew where [calibrate] is another than calibrate saw
    let sample = Path::new(&project()).parent().expect("a folder").display().to_string();
    let text = std::fs::read_to_string(project()).expect("a project");
    let text = text.replace("path = \"", &format!("path = \"{sample}/"));
    let text = text.replace("accuracy = \"", &format!("accuracy = \"{sample}/"));
    std::fs::write(bench.path("held.toml"), text + "\n[calibrate]\nenabled = false\n").expect("written");
    let ran = bench.tieline(&["solve", "held.toml", "--out", &out]);
    assert!(ran.assert_success().err.contains("[calibrate] has changed"), "{}", ran.err);
}

#[test]
fn a_stage_whose_former_one_was_not_run_says_which() {
    let bench = Bench::new();
    let refuse = |stage: &str, out: &str, words: &[&str]| {
        bench.tieline(&[stage, &project(), "--out", out]).assert_refused(words);
    };
    refuse("correct", "none", &["match.json", "tieline match"]);
    refuse("report", "none", &["solve.json", "tieline solve"]);
    assert!(!bench.path("none").exists());
    let files = &staged().1;
    std::fs::create_dir_all(bench.path("half/stages")).expect("created");
    std::fs::write(bench.path("half/stages/match.json"), &files["stages/match.json"]).expect("written");
    refuse("correct", "half", &["solve.json", "tieline solve"]);
    let solve = &files["stages/solve.json"];
    std::fs::write(bench.path("half/stages/solve.json"), &solve[..solve.len() / 2]).expect("written");
    refuse("correct", "half", &["solve.json", "run `tieline solve` again"]);
    refuse("report", "half", &["solve.json", "run `tieline solve` again"]);
    // what a later stage left does not outlive an earlier one
    std::fs::write(bench.path("half/stages/solve.json"), solve).expect("written");
    bench.tieline(&["match", &project(), "--out", "half", "-q"]).assert_success();
    refuse("report", "half", &["solve.json is not there", "tieline solve"]);
}
