//! Graphs that cannot be adjusted: the error names place, value and remedy; nothing is written.

use std::path::Path;
use std::process::{Command, Output};

fn graph(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_tieline")).arg("graph").args(arguments).output().expect("the program runs")
}

/// Runs on a file with a text; it must fail, without a panic, say all of `words`, and write nothing.
fn refuses(name: &str, text: &str, words: &[&str]) {
    let folder = tempfile::tempdir().expect("a folder");
    let file = folder.path().join(name);
    std::fs::write(&file, text).expect("written");
    let out = folder.path().join("out");
    let output = graph(&["solve", path(&file), "--sigmas", "--out", path(&out)]);
    let message = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(1), "{text}: {message}");
    assert!(!message.contains("panicked"), "{message}");
    for word in words {
        assert!(message.contains(word), "`{word}` is not in: {message}");
    }
    assert!(!out.exists(), "{name}: something was written");
}

fn path(path: &Path) -> &str {
    path.to_str().expect("UTF-8")
}

const TWO: &str = "VERTEX_SE2 0 0 0 0\nVERTEX_SE2 1 1 0 0\n";
const EDGE: &str = "EDGE_SE2 0 1 1 0 0 1 0 0 1 0 1\n";

#[test]
fn malformed_g2o() {
    refuses("empty.g2o", "", &["empty.g2o", "no vertex"]);
    refuses("a.g2o", "VERTEX_SE2 0 0 zero 0\n", &["line 1", "`zero`"]);
    refuses("a.g2o", "VERTEX_SE2 0 0 0\n", &["line 1", "VERTEX_SE2", "cut off"]);
    refuses("a.g2o", "VERTEX_SE2 0 0 nan 0\n", &["line 1", "`nan`"]);
    refuses("a.g2o", &format!("{TWO}VERTEX_SE2 1 0 0 0\n"), &["line 3", "vertex 1 was there before"]);
    refuses("a.g2o", &format!("{TWO}EDGE_SE9 0 1\n"), &["line 3", "EDGE_SE9", "supported are"]);
    refuses("a.g2o", &format!("{TWO}EDGE_SE2_XY 0 1 1 1 1 0 1\n"), &["line 3", "kind of vertex 1"]);
    refuses("a.g2o", "VERTEX_SE3:QUAT 0 0 0 0 0 0 0 0\n", &["line 1", "quaternion"]);
    refuses("a.g2o", &format!("{TWO}EDGE_SE2 0 0 1 0 0 1 0 0 1 0 1\n"), &["line 3", "ties vertex 0 to itself"]);
}

#[test]
fn sections_are_for_bowie() {
    let folder = tempfile::tempdir().expect("a folder");
    let file = folder.path().join("a.g2o");
    std::fs::write(&file, format!("{TWO}{EDGE}")).expect("written");
    let output = graph(&["solve", path(&file), "--sections", "length"]);
    let message = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(1), "{message}");
    assert!(message.contains("--method bowie"), "{message}");
    assert!(graph(&["solve", path(&file), "--sections", "length", "--method", "bowie"]).status.success());
}

#[test]
fn unknown_vertices_and_bad_information() {
    refuses("a.g2o", &format!("{TWO}EDGE_SE2 0 7 1 0 0 1 0 0 1 0 1\n"), &["line 3", "vertex 7", "nowhere"]);
    refuses("a.g2o", &format!("{TWO}EDGE_SE2 0 1 1 0 0 1 0 0 -1 0 1\n"), &["line 3", "not positive definite"]);
    refuses("a.g2o", &format!("{TWO}EDGE_SE2 0 1 1 0 0 1 2 0 1 0 1\n"), &["line 3", "not positive definite"]);
}

#[test]
fn parts_without_a_datum() {
    let text = format!("{TWO}{EDGE}VERTEX_SE2 5 9 0 0\nVERTEX_SE2 6 9 1 0\nEDGE_SE2 5 6 1 0 0 1 0 0 1 0 1\n");
    refuses("a.g2o", &text, &["2 parts", "`5`", "fix"]);
    refuses("a.g2o", &format!("{TWO}{EDGE}VERTEX_SE2 9 9 0 0\n"), &["2 parts", "`9`"]);
}

#[test]
fn a_point_that_nothing_determines_is_named() {
    let gkf = |more: &str| {
        format!(
            "<gama-local><network><points-observations>\n\
             <point id=\"A\" x=\"0\" y=\"0\" fix=\"xy\"/><point id=\"B\" x=\"100\" y=\"0\" fix=\"xy\"/>\n\
             <point id=\"C\" x=\"50\" y=\"80\" adj=\"xy\"/>\n\
             <obs><distance from=\"A\" to=\"C\" val=\"94.34\" stdev=\"5\"/></obs>\n{more}\
             </points-observations></network></gama-local>"
        )
    };
    refuses("a.gkf", &gkf(""), &["not determined", "`C`"]);
    refuses(
        "a.gkf",
        &gkf("<obs><distance from=\"B\" to=\"X\" val=\"1\" stdev=\"5\"/></obs>\n"),
        &["line 5", "`X`", "nowhere"],
    );
    refuses(
        "a.gkf",
        &gkf("<obs><distance from=\"B\" to=\"C\" val=\"far\" stdev=\"5\"/></obs>\n"),
        &["line 5", "`far`"],
    );
    refuses("a.gkf", &gkf("<obs><distance from=\"B\" to=\"C\" val=\"9\" stdev=\"0\"/></obs>\n"), &["line 5", "stdev"]);
    refuses("a.gkf", "<gama-local><network>", &["line 1", "well-formed"]);
    refuses("a.gkf", "<html/>", &["<network>"]);
}

#[test]
fn a_dynadjust_file_alone_or_cut_off() {
    let station = "S000000             FFF XYZ    -4285027.3100   3000839.3529  -3636794.5132";
    refuses("a.stn", station, &[".msr"]);
    let folder = tempfile::tempdir().expect("a folder");
    let (stn, msr) = (folder.path().join("a.stn"), folder.path().join("a.msr"));
    std::fs::write(&stn, station).expect("written");
    let space = " ".repeat(64);
    let rows = "           10.0000 1.0000000000000e-04 1.0000000000000e-06 1.0000000000000e-06";
    let text = format!("G S000000             NOWHERE\n{space}{rows}\n{space}{rows}\n{space}{rows}\n");
    std::fs::write(&msr, text).expect("written");
    let output = graph(&[path(&stn), path(&msr)]);
    let message = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(1));
    assert!(message.contains("line 1") && message.contains("NOWHERE"), "{message}");
}

/// A file size limit stands for a full disk: the write fails in the middle.
#[test]
#[cfg(target_os = "linux")]
fn a_full_disk_out_of_core() {
    let folder = tempfile::tempdir().expect("a folder");
    let blocks = folder.path().join("blocks");
    let script = format!(
        "trap '' XFSZ; ulimit -f 200; exec {} graph generate --stations 10000 --kind directions --solve --memory 4 --blocks {}",
        env!("CARGO_BIN_EXE_tieline"),
        path(&blocks)
    );
    let output = Command::new("bash").args(["-c", &script]).output().expect("bash");
    let message = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(1), "{message}");
    assert!(message.contains("writing the block file") && message.contains("free some space"), "{message}");
    let part = std::fs::read_dir(&blocks)
        .expect("the folder")
        .filter_map(Result::ok)
        .any(|f| f.path().extension().is_some_and(|e| e == "part"));
    assert!(!part, "a file was left half-written");
}
